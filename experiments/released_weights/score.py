"""Step: the authors' networks on faces around the mean of their training model.

The released weights contain the mean of the Basel Face Model, see `bfm_mean`, but not the variation
around it. That is borrowed from the open models, at several scales. With `MODEL=bfm2009` and the
like, the faces are the model's. Four answers are scored on the same test faces: the networks'
outputs, one such output for all views, a random face for all, and the mean shape.
"""

from collections.abc import Iterator

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from scipy.stats import bootstrap

from data_gen.datasets.dataset import make_dataset
from data_gen.models.morphable_model import MorphableModel
from data_gen.models.registry import OPEN, TITLES, load_model, open_models
from deepmds_keras.deep_mds import DeepMDS
from deepmds_keras.geometry.units import normalise
from experiments.figures.errors import Panel, error_lines, level
from experiments.figures.style import INK, Look, look
from experiments.inputs import Faces, as_seen
from experiments.progress import counted
from experiments.released_weights.bfm_mean import SCHEME, about_mean, authors_file, read_mean
from experiments.released_weights.train import trained_file, trainings
from experiments.run import AUTHORS_FILES, SECOND_NET, Run
from experiments.scoring.numbers import power, rounded
from experiments.scoring.published import published_mse
from experiments.scoring.scores import score
from experiments.streams import Stream
from experiments.studies.study_results import write_results

SCALES = (0.0, 0.2, 0.4, 0.6, 0.8, 1.0, 1.25, 1.5, 1.75, 2.0)
VIEWS = {"released": "views of the released code", "paper": "views as in the text"}
NETS = {"released": AUTHORS_FILES["bfm"][1], "released_2": SECOND_NET}
_PUBLISHED = {"deep_mds": ("Deep-MDS", (4, 2)), "deep_mds_constant": ("trivial case", (1, 1))}
_CONSTANT = "one of their outputs, for all views"
_LOOKS = {
    "released": look("deep_mds")._replace(title="authors' networks", dashes="-"),
    "released_2": Look("the same, second dissimilarity net", look("deep_mds_released").colour, "p"),
    "deep_mds_constant": Look(_CONSTANT, look("zhao").colour, "^"),
    "random_face": Look("a random face, for all views", "#117733", "v"),
    "mean_shape": look("mean_shape")._replace(title="mean shape", dashes="-"),
}
_CONSTANTS = 25  # outputs, and faces, over which the error of one answer to all views is averaged
_UNIT = 1e-4


def main(run: Run) -> dict:
    networks = released_networks(run)
    populations = [*faces_by_scale(run)]
    released = pd.DataFrame(
        row
        for population in counted("population", populations, len(populations))
        for views in VIEWS
        for row in measure(run, networks, views, *population)
    )
    tables, figures, folder = {"released": released}, {}, run.experiment_results("released-weights")
    if run.model in OPEN:
        trained = pd.concat([pd.read_csv(trained_file(run, name)) for name in trainings(run)])
        tables["trained"] = trained
        figures = {"released": draw_released(released), "trained": draw_trained(trained)}
        folder = run.shared_results / "released-weights"
    return write_results(run, folder, tables, cells(released), figures=figures)


def released_networks(run: Run) -> dict[str, DeepMDS]:
    """The authors' method with each of their dissimilarity nets that is available.

    Raises:
        InputError: The files do not exist.
    """
    autoencoder = authors_file(run, AUTHORS_FILES["bfm"][0])
    nets = {name: authors_file(run, file) for name, file in NETS.items()}
    return {
        name: DeepMDS.from_released(autoencoder, net).set_params(n_jobs=run.jobs, solver="numba")
        for name, net in nets.items()
        if net.exists() or name == "released"
    }


def faces_by_scale(run: Run) -> Iterator[tuple[str, float, MorphableModel]]:
    """Source of the s.d., its scale, and a model of such faces."""
    if run.model not in OPEN:
        yield run.model, 1.0, load_model(run.model, run.data, SCHEME)
        return
    mean = read_mean(run)
    for name in open_models(run.data)[0]:
        model = load_model(name, run.data, SCHEME)
        for scale in SCALES:
            yield name, scale, about_mean(model, scale, mean)


def measure(
    run: Run,
    networks: dict[str, DeepMDS],
    views: str,
    sd_of: str,
    scale: float,
    model: MorphableModel,
) -> Iterator[dict]:
    """Errors of every answer, with 95 % bootstrap intervals over faces, or over constant answers.

    Yields:
        `sd_of, views, scale, answer, mse, low, high, depth_corr`.
    """
    rng = np.random.default_rng([run.seed, Stream.RELEASED_WEIGHTS_FACES])
    n = run.preset.test_faces
    dataset = make_dataset(model, n + _CONSTANTS, rng, scheme=SCHEME, protocol=views)
    faces = as_seen(dataset)
    test, others = faces[:n], faces[n:].shapes
    outputs = {
        name: network.predict(test.views, check_orientation=False)
        for name, network in networks.items()
    }
    mean = normalise(faces.shapes).mean(0)
    constants = {
        "deep_mds_constant": outputs["released"][:_CONSTANTS],
        "random_face": others if scale else mean[None],
    }
    errors = {name: _errors(shapes, test) for name, shapes in outputs.items()}
    for name, shapes in constants.items():
        errors[name] = np.array([_errors(shape, test).mean(0) for shape in shapes])
    errors["mean_shape"] = _errors(mean, test)
    for answer, (mse, depth_corr) in ((answer, columns.T) for answer, columns in errors.items()):
        low, high = _interval(mse, rng)
        row = {"sd_of": sd_of, "views": views, "scale": scale, "answer": answer}
        yield row | {"mse": mse.mean(), "low": low, "high": high, "depth_corr": depth_corr.mean()}


def _errors(shapes: np.ndarray, test: Faces) -> np.ndarray:
    """`(n, 2)` squared error and depth correlation of shapes `(n, L, 3)`, or of one for all."""
    scores = score(np.broadcast_to(shapes, test.shapes.shape), test)
    return np.stack([scores.mse, scores.depth_corr], 1)


def _interval(values: np.ndarray, rng: np.random.Generator) -> tuple[float, float]:
    if len(values) < 2 or np.ptp(values) == 0:
        return values[0], values[0]
    options = {"n_resamples": 1000, "method": "percentile", "rng": rng, "batch": 100}
    return tuple(bootstrap((values,), np.mean, **options).confidence_interval)


def cells(released: pd.DataFrame) -> pd.DataFrame:
    """MSE and, for the networks, depth correlation, as text, by source and scale of the s.d."""
    rows = released[released["views"] == "released"].copy()
    rows["text"] = [rounded(mse / _UNIT, 2) for mse in rows["mse"]]
    nets = rows["answer"].isin(NETS)
    rows.loc[nets, "text"] += " (" + rows["depth_corr"].map(lambda c: rounded(c, 3)) + ")"
    rows = rows.assign(
        sd_of=rows["sd_of"].map(TITLES),
        scale=rows["scale"].map("{:g}".format),
        answer=[_LOOKS[answer].title for answer in rows["answer"]],
    )
    table = rows.pivot_table("text", ["sd_of", "scale"], "answer", "first", sort=False)
    return table.fillna("").rename_axis(columns=f"MSE ({power(_UNIT)})")


def draw_released(released: pd.DataFrame) -> Figure:
    """Errors of all answers by the scale of the s.d., one panel per model and kind of views."""
    panels, published, looks = [], {}, dict(_LOOKS)
    for method, (name, dashes) in _PUBLISHED.items():
        published[name] = published_mse(method)
        label = f"published: {name}, {published[name] / _UNIT:.1f}"
        looks[name] = Look(label, INK, "", (0, dashes))
    for (sd_of, views), rows in released.groupby(["sd_of", "views"], sort=False):
        rows = rows.rename(columns={"answer": "method", "mse": "mean"})
        lines = [level(rows["scale"], name, mse) for name, mse in published.items()]
        rows = pd.concat([rows, *lines])
        title = f"S.d. of {TITLES[sd_of]}, {VIEWS[views]}"
        panels.append(Panel(rows, "scale", "Scale of the s.d.", title))
    return error_lines(panels, looks=looks, interval="95 % interval", n_columns=2, log_y=False)


def draw_trained(trained: pd.DataFrame) -> Figure:
    """Errors of methods trained around the Basel mean, relative to the mean shape's error."""
    errors = trained.pivot(index=["scale", "seed"], columns="method", values="mse")
    ratios = errors.drop(columns="mean_shape").div(errors["mean_shape"], axis=0)
    ratios["mean_shape"] = 1.0
    rows = ratios.melt(ignore_index=False, value_name="mean").reset_index()
    rows = rows.groupby(["method", "scale"])["mean"].agg(["median", "min", "max"]).reset_index()
    rows.columns = ["method", "scale", "mean", "low", "high"]
    rows = rows.assign(scale=rows["scale"].map("{:g}".format))  # too few to be joined by lines
    panel = Panel(rows, "scale", "Scale of the s.d. (no unit)")
    options = {"interval": "range over seeds"}
    return error_lines([panel], "MSE relative to the mean shape's", 1, "no unit", **options)
