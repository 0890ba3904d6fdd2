"""Step: time each part of the method on one core, here and in the authors' implementation.

The column `way` has `released` for the authors' implementation, and `deep_mds` for this one, whose
embeddings are scikit-learn's (`sklearn`) or compiled by numba (`numba`). `landmark_lifter` is the
other method of this package, `eos` (`SFM=`) eos's fit of the Surrey Face Model.
"""

from collections.abc import Callable, Iterator
from functools import partial
from itertools import product
from statistics import median
from timeit import repeat

import keras
import numpy as np
import pandas as pd

from data_gen.datasets.dataset import make_dataset
from data_gen.models.registry import load_model
from data_gen.views import sample_photo_views
from deepmds_keras.baselines.eos_fit import EosFit
from deepmds_keras.deep_mds import DeepMDS
from deepmds_keras.embedding import embed
from deepmds_keras.geometry.units import normalise
from deepmds_keras.lifting.lifter import LandmarkLifter
from deepmds_keras.networks import build_dissimilarity_net
from deepmds_keras.proximities import pair_features
from deepmds_keras.training import Recipe, compiled_by_xla, face_order, pairs_of_faces
from experiments.bench import released_code as released
from experiments.figures.errors import Panel, error_lines
from experiments.figures.style import Look, save
from experiments.progress import counted
from experiments.records import new_results, write_csv, write_text
from experiments.run import Run
from experiments.scoring.latex import plain_tabular
from experiments.streams import Stream
from experiments.tasks import single_threaded
from experiments.tracks.train import limit_threads

SCHEME, N_LANDMARKS, VARIANT = "bfm72", 72, "paper"
_LOOKS = {
    "released": Look("authors' implementation", "#777777", "s"),
    "deep_mds": Look("this package", "#D55E00", "o"),
    "sklearn": Look("this package, scikit-learn's solver", "#0072B2", "^"),
    "numba": Look("this package, numba's solver", "#E69F00", "p"),
}


def main(run: Run) -> dict:
    limit_threads(1)
    with single_threaded():
        todo = [*tasks(run)]
        measured = counted("measurement", todo, len(todo))
        table = with_ratios([(*task, seconds(run, call)) for *task, call in measured])
    folder = run.shared_results / "bench"
    new = new_results(folder)
    write_csv(new / "bench.csv", table)
    write_text(new / "bench.tex", plain_tabular(table.drop(columns="seconds")))
    parts = table[table["comparison"] == "parts"]
    parts = parts.rename(columns={"way": "method", "ms_per_face": "mean"})
    panel = Panel(parts, "part", "Part, on one core")
    figure = error_lines([panel], "Time per face", 1, "ms", looks=_LOOKS)
    save(figure, new / "figures", "bench", run.preset.caution)
    print(f"\n{table.to_string(index=False)}\n\n{folder}/")
    return {"results": [folder]}


def seconds(run: Run, call: Callable) -> float:
    """Median time of a call; the first one, which compiles, counts only if there is no other."""
    passes = repeat(call, number=1, repeat=1 + run.preset.bench_passes)
    return median(passes[1:] or passes)


def tasks(run: Run) -> Iterator[tuple[str, str, str, int, Callable]]:
    """Each part of the method, all of them, and a training step.

    Weights of Deep-MDS are those of the package, whatever the face model is.

    Yields:
        A comparison, its part and way, the number of faces, and what is timed.
    """
    model = load_model(run.model, run.data, SCHEME)

    def draw_faces(n: int):
        rng = np.random.default_rng([run.seed, Stream.BENCH])
        return make_dataset(model, n, rng, scheme=SCHEME, protocol=run.protocol)

    def one_by_one(predict: Callable, views: np.ndarray) -> list:
        return [predict(view) for view in views]

    faces = draw_faces(run.preset.bench_faces)
    shapes, pairs = normalise(faces.landmarks), [*product(range(N_LANDMARKS), repeat=2)]
    solvers = ("sklearn", "numba")
    methods = {
        solver: DeepMDS.pretrained("deepmds-bfm72").set_params(n_jobs=1, solver=solver)
        for solver in solvers
    }
    networks = methods["sklearn"]
    matrices = np.abs(networks.dissimilarities(faces.views))
    # After one step of training: no weight changes its time.
    lifter = LandmarkLifter(N_LANDMARKS, steps=1).fit(faces.views, shapes)
    predictors = {
        way: method.predict for way, method in (*methods.items(), ("landmark_lifter", lifter))
    }

    calls = {
        "data generation": {
            "released": lambda views: released.make_faces(model, faces, len(views), SCHEME),
            "deep_mds": lambda views: draw_faces(len(views)),
        },
        "pair features": {
            "released": lambda views: [released.pair_features(view, pairs) for view in views],
            "deep_mds": pair_features,
        },
        "prediction": {
            "released": lambda views: released.predict(networks, views),
            "deep_mds": networks.dissimilarities,
        },
        "embedding": {
            "released": lambda views: released.embed(matrices[: len(views)]),
            **{s: lambda v, s=s: embed(matrices[: len(v)], solver=s) for s in solvers},
        },
        "end to end": {"released": lambda views: released.shapes(networks, views), **predictors},
    }
    fewer = max(1, run.preset.bench_faces // 5)
    slow = {"released": run.preset.bench_released_faces, "sklearn": fewer}
    for part, ways in calls.items():
        for way, call in ways.items():
            n = slow.get(way, run.preset.bench_faces)
            yield "parts", part, way, n, partial(call, faces.views[:n])
    inner = load_model(run.model, run.data, "ibug51")
    rng = np.random.default_rng([run.seed, Stream.BENCH])
    inner_views = sample_photo_views(inner, "ibug51", fewer, rng, detector_sd=0)[0]
    fits = {"landmark_lifter": LandmarkLifter.pretrained("ibug51").predict}
    if run.sfm:
        fits["eos"] = EosFit(run.sfm).predict
    single = {
        "one face at a time": (predictors, faces.views[:fewer]),
        "one face of 51 landmarks at a time": (fits, inner_views[:, None]),
    }
    for part, (ways, views) in single.items():
        for way, call in ways.items():
            yield "one face", part, way, fewer, partial(one_by_one, call, views)
    n = run.preset.bench_steps
    for way in ("released", "deep_mds"):
        _, epoch = training(way, shapes[..., :2], shapes, n)
        yield "training", "training step, dissimilarity net", way, n, epoch


def training(
    way: str, frontal: np.ndarray, shapes: np.ndarray, steps: int
) -> tuple[keras.Model, Callable]:
    """A dissimilarity net, and a function that trains it for an epoch.

    Args:
        way: `"deep_mds"`, as in `train_dissimilarity_net`, or `"released"`.
        frontal, shapes: `(n, L, 2)` frontal views and `(n, L, 3)` normalised shapes.
        steps: Mini-batches in an epoch, each of one face.
    """
    faces = face_order(len(shapes), steps, 0, 0)
    frontal, shapes = np.float32(normalise(frontal))[faces], np.float32(shapes)[faces]
    network, optimizer = build_dissimilarity_net(VARIANT), Recipe(1).optimizer(steps)
    if way == "released":
        network.compile(optimizer, "mse")
        more = {"shuffle": False, "steps_per_epoch": steps, "verbose": 0}
        return network, lambda: network.fit(released.training_batches(frontal, shapes), **more)
    ends = np.triu_indices(shapes.shape[1], 1)
    model = compiled_by_xla(network, optimizer, steps)

    def epoch() -> None:
        pairs = pairs_of_faces(frontal, shapes, ends, VARIANT)
        model.fit(*pairs, batch_size=len(ends[0]), shuffle=False, verbose=0)

    return network, epoch


def with_ratios(rows: list[tuple]) -> pd.DataFrame:
    """Rows of `comparison, part, way, n_faces, seconds`, each with the time of a face.

    Ratios are the speed-up of each way over the other ways of the same part.
    """
    table = pd.DataFrame(rows, columns=["comparison", "part", "way", "n_faces", "seconds"])
    table["ms_per_face"] = 1000 * table["seconds"] / table["n_faces"]
    times = table.set_index(["part", "way"])["ms_per_face"].unstack()
    for way in [way for way in ("released", "sklearn", "numba", "eos") if way in times]:
        table[f"times_{way}"] = table["part"].map(times[way]) / table["ms_per_face"]
    return table
