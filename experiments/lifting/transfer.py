"""Transfer: methods trained on faces of one model and tested on those of another, as users do.

Expressive faces in poses as photos show, with a detector's errors of random strength in training.
The face model of the run is the one trained on; those tested on are the open ones, and itself.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pandas as pd
from joblib import Parallel, delayed
from scipy.stats import sem

from data_gen.models.morphable_model import MorphableModel
from data_gen.models.registry import load_model, open_models
from data_gen.views.photo_views import sample_photo_views
from deepmds_keras.alignment import align
from deepmds_keras.baselines.aldrian import Aldrian
from deepmds_keras.baselines.linear import Linear
from deepmds_keras.baselines.mean_shape import MeanShape
from deepmds_keras.metrics import mse
from deepmds_keras.normalisation import centre, normalise
from experiments.arguments import parse_run
from experiments.build_key import is_done
from experiments.face_models import TITLES
from experiments.figures.across_models import across_models
from experiments.figures.style import save
from experiments.lifting.study_tables import left_out_notes, transfer_cells
from experiments.manifest import clear_results, records_of, write_manifest
from experiments.progress import Bar
from experiments.recipes import deep_mds, fit_deep_mds, fit_lifter
from experiments.records import load_record, write_text
from experiments.run import Run
from experiments.running import call_single_threaded, single_threaded, stage
from experiments.scoring.latex import tabular
from experiments.scoring.tables import write_csv
from experiments.streams import Stream

NOISES_MM = (0.0, 1.0, 3.0)
_SCHEME = "ibug51"
_MOST_NOISE_MM = 6.0  # in training
# A component below it moves no landmark by what can be seen: the fit takes it for noise.
_LEAST_SD_MM = 0.3
_FACES_PER_TASK = 250


def tested_models(run: Run) -> tuple[dict[str, MorphableModel], list[str]]:
    """The models tested on, that of the run first, and which of the open ones are not there."""
    found = {run.model: load_model(run.model, run.data, _SCHEME)}
    there, left_out = open_models(run.data)
    for name in there:
        if name not in found:
            found[name] = load_model(name, run.data, _SCHEME)
    return found, left_out


def training_faces(run: Run, model: MorphableModel) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Views `(n, L, 2)` and shapes `(n, L, 3)`, millimetres, and the s.d. of each view's errors.

    Their strength is random, mostly small: `_MOST_NOISE_MM` times the square of a uniform number.
    """
    rng = np.random.default_rng([run.seed, Stream.TRANSFER_TRAINING])
    sd = _MOST_NOISE_MM * rng.random(run.preset.train_faces) ** 2
    views, shapes, _ = sample_photo_views(
        model, _SCHEME, len(sd), rng, detector_sd=sd[:, None, None]
    )
    return views, shapes, sd


class Trained:
    """Every method, trained on the same faces; what is trained already is read.

    Args:
        run: The run.
        model: Face model that the faces are sampled from.
    """

    def __init__(self, run: Run, model: MorphableModel):
        from deepmds_keras.lifting.lifter import LandmarkLifter

        self._jobs = run.jobs
        views, shapes, sd = training_faces(run, model)
        folder = run.work / "transfer"
        net = deep_mds(run.on("flame"), "paper", "cosine")
        net.set_params(centre_views=True, solver="batched")
        lifter = LandmarkLifter(views.shape[1], steps=run.preset.lifting_steps, seed=run.seed)
        self._net = fit_deep_mds(net, views, shapes, checkpoint=folder)
        self._lifter = fit_lifter(
            lifter, views, shapes, landmark_sd=sd, checkpoint=folder / "lifting.npz"
        )
        self._components = principal_components(shapes)
        normal = _normal(views), normalise(shapes)
        with single_threaded():  # the regression's last bits depend on the threads
            self._mean, self._linear = MeanShape().fit(*normal), Linear().fit(*normal)

    def predict(self, views: np.ndarray, sd_mm: float) -> Iterator[tuple[str, np.ndarray]]:
        """Yield each method and its shapes of views `(n, L, 2)`, millimetres.

        The fit and the lifting network are told the standard deviation of the errors.
        """
        yield "mean_shape", self._mean.predict(views)
        yield "linear", self._linear.predict(_normal(views))
        yield "aldrian", self._fitted(views, sd_mm)
        yield "ours_stable", self._net.predict(views)
        yield "lifting", self._lifter.predict(views, landmark_sd=sd_mm)

    def _fitted(self, views: np.ndarray, sd_mm: float) -> np.ndarray:
        fit = Aldrian(*self._components)
        size = np.ptp(views, axis=1).max(1).mean()
        # With less than its default the first, wrong cameras would be fitted too closely.
        fit.set_params(view_noise=max(sd_mm / size, fit.view_noise))
        parts = np.split(views, range(_FACES_PER_TASK, len(views), _FACES_PER_TASK))
        tasks = (delayed(call_single_threaded)(fit.predict, part) for part in parts)
        return np.concatenate(Parallel(self._jobs if len(parts) > 1 else 1)(tasks))


def principal_components(shapes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Mean `(L, 3)` of shapes and their principal components times s.d., `(K, L, 3)`.

    Expressions are not Gaussian: the components are the Gaussian nearest to them.

    Args:
        shapes: `(n, L, 3)` in one frame, millimetres.
    """
    n = len(shapes)
    mean = shapes.mean(0)
    flat = (shapes - mean).reshape(n, -1)
    values, vectors = np.linalg.eigh(flat.T @ flat / n)
    kept = values > _LEAST_SD_MM**2
    basis = (vectors[:, kept] * np.sqrt(values[kept])).T[::-1]
    return mean, basis.reshape(-1, *mean.shape)


def _normal(views: np.ndarray) -> np.ndarray:
    return normalise(centre(views))


def measure(run: Run, models: dict[str, MorphableModel]) -> list[tuple]:
    """Train on the faces of the run's model and test on every one.

    Returns:
        Rows of `trained, tested, noise_mm, method, mse, sem, n_faces`.
    """
    trained, rows = Trained(run, models[run.model]), []
    with Bar(total=len(models) * len(NOISES_MM) * 5, desc="transfer", unit="test") as bar:
        for name, model in models.items():
            for noise in NOISES_MM:
                # The same faces, and the same errors but for their size.
                rng = np.random.default_rng([run.seed, Stream.TRANSFER_TESTS])
                views, shapes, _ = sample_photo_views(
                    model, _SCHEME, run.preset.test_faces, rng, detector_sd=noise
                )
                truth = normalise(shapes)
                for method, found in trained.predict(views, noise):
                    error = mse(align(found, truth), truth)
                    values = float(error.mean()), float(sem(error)), len(error)
                    rows.append((run.model, name, noise, method, *values))
                    bar.update()
    return rows


def main(arguments: list[str] | None = None) -> None:
    run = parse_run(__doc__, arguments)
    folder = run.experiment_results("lifting/transfer")
    models, left_out = tested_models(run)
    hashes = {name: model.sha256 for name, model in models.items()}
    done = is_done(run, "transfer") and load_record(run, "transfer")["tested_sha256"] == hashes
    if not done:
        with stage(run, "transfer") as record:
            record |= {"model_sha256": hashes[run.model], "tested_sha256": hashes}
            record |= {"left_out": left_out, "rows": measure(run, models)}
    columns = ["trained", "tested", "noise_mm", "method", "mse", "sem", "n_faces"]
    table = pd.DataFrame(load_record(run, "transfer")["rows"], columns=columns)
    notes = left_out_notes(left_out)
    clear_results(folder)
    write_csv(folder / "table.csv", table)
    write_text(folder / "table.tex", tabular(transfer_cells(table), "llrrr", notes))
    save(across_models(table), folder / "figures", "transfer")
    write_manifest(run, "lifting", records_of(run, "transfer"), folder)
    print(f"\ntrained on {TITLES[run.model]}, {table['n_faces'].max():,} test faces, by noise\n")
    print(transfer_cells(table).to_string(index=False), *notes, sep="\n")
    print(f"\nTables, figure and manifest: {folder}/")
