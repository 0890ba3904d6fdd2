"""Step: methods trained on faces of one model and tested on those of another, as in practice.

The faces have expressions, poses as in photos and, in training, landmark noise of random size.
Training uses the run's face model; the tests use the open ones, and the run's.
"""

import functools

import numpy as np
import pandas as pd
from sklearn.linear_model import LinearRegression

from data_gen.models.registry import TITLES, load_model, open_models
from data_gen.views import FIELD_OF_VIEW, sample_photo_cameras, sample_photo_views
from deepmds_keras.baselines.eos_fit import EosFit
from deepmds_keras.baselines.map_fit import principal_components
from deepmds_keras.geometry.units import centre, normalise, rms_radius
from deepmds_keras.geometry.views import project
from experiments.figures.errors import Panel, error_lines
from experiments.lifting.contenders import (
    aligned_mse,
    fit_aldrian,
    fit_aldrian_in_hindsight,
    fit_regressions,
)
from experiments.lifting.surrey import sample_surrey
from experiments.lifting.train import (
    BOTH,
    TRANSFER_SCHEME,
    load_network,
    network_file,
    transfer_faces,
    transfer_models,
    transfer_name,
)
from experiments.methods import title
from experiments.progress import counted
from experiments.recipes import map_fit_of, mlp
from experiments.run import Run
from experiments.scoring.numbers import power
from experiments.streams import Stream
from experiments.studies.study_results import grid, mean_error, write_results
from experiments.tasks import single_threaded, unordered

NOISES_MM = (0.0, 1.0, 3.0)
SURREY = "surrey"
# Components below it move no landmark visibly: the fit treats them as noise.
_LEAST_SD_MM = 0.3
_UNIT = 1e-5
_NOTES = (
    "All learn from the same views, with noise of random size. LandmarkLifter, MAP and the fits of "
    "Aldrian & Smith are told the noise of a view, in training and test; the others are not.",
)
_TITLES = TITLES | {"surrey": "Surrey faces", BOTH: "both open models"}


class Trained:
    """Methods trained on the same faces, for views that may lie anywhere in an image.

    Args:
        views, shapes: `(n, L, 2)` and `(n, L, 3)` of the training faces.
        lifter, deep_mds: Trained networks; None leaves Deep-MDS out.
        mlp: An untrained one.
    """

    def __init__(self, views, shapes, lifter, deep_mds, mlp):
        self._views, self._components = views, principal_components(shapes, _LEAST_SD_MM)
        self.lifter, self._deep_mds = lifter, deep_mds
        mean, basis = self._components
        self._map = map_fit_of(mean, basis, np.linspace(0, FIELD_OF_VIEW))
        self._regressions = fit_regressions(normalise(centre(views)), normalise(shapes), mlp)

    def predict(
        self, views: np.ndarray, sd: float | np.ndarray, truth: np.ndarray | None = None
    ) -> dict[str, np.ndarray]:
        """Method to shapes `(n, L, 3)`.

        Args:
            views: `(n, L, 2)`, y up; NaN where all faces lack a landmark. Methods that need it get
                the prediction of a regression on the others.
            sd: Standard deviation of all errors, or `(n, L)`.
            truth: `(n, L, 3)`, for the fit with the best noise; None leaves that out.
        """
        given, views = views, self._filled(views)
        seen = normalise(centre(views))
        shapes = {method: model.predict(seen) for method, model in self._regressions.items()}
        shapes["aldrian_learnt"] = fit_aldrian(*self._components, views, sd)
        with single_threaded():
            shapes["map_learnt"] = self._map.predict(given, sd)
        if truth is not None:
            fitted = fit_aldrian_in_hindsight(*self._components, views, truth)
            shapes["aldrian_hindsight"] = fitted
        if self._deep_mds is not None:
            shapes["deep_mds_cosine"] = self._deep_mds.predict(views, check_orientation=False)
        lifted = self.lifter.predict(given, landmark_sd=sd, check_orientation=False)
        return shapes | {"landmark_lifter": lifted}

    def _filled(self, views: np.ndarray) -> np.ndarray:
        known = np.isfinite(views).all((0, 2))
        if known.all():
            return views
        train, _, _ = _relative(self._views, known)
        test, middle, size = _relative(views, known)
        flat = [faces[:, where].reshape(len(faces), -1)
                for faces, where in ((train, known), (train, ~known), (test, known))]  # fmt: skip
        expected = LinearRegression().fit(*flat[:2]).predict(flat[2])
        filled = views.copy()
        filled[:, ~known] = expected.reshape(len(views), -1, 2) * size + middle
        return filled


def _relative(faces: np.ndarray, known: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Views in the frame and size of the known landmarks; `(n, 1, 2)` and `(n, 1, 1)` of these."""
    middle = faces[:, known].mean(1, keepdims=True)
    size = rms_radius(faces[:, known])[:, None, None]
    return (faces - middle) / size, middle, size


@functools.cache
def trained(run: Run, faces: str) -> Trained:
    """Every method, trained on the same faces, see `transfer_faces`."""
    views, shapes, _ = transfer_faces(run, faces)
    names = (transfer_name(method, faces) for method in ("landmark_lifter", "deep_mds_cosine"))
    networks = (load_network(network_file(run, name)) for name in names)
    return Trained(views, shapes, *networks, mlp(run, views.shape[1]))


def tested_faces(run: Run, tested: str, noise_mm: float) -> tuple[np.ndarray, np.ndarray]:
    """Views with noise, and shapes, `(n, 51, ·)`; NaN for landmarks that the model lacks."""
    # The same faces and, except for their size, the same errors.
    rng, n = np.random.default_rng([run.seed, Stream.TRANSFER_TESTS]), run.preset.test_faces
    if tested != SURREY:
        model = load_model(tested, run.data, TRANSFER_SCHEME)
        return sample_photo_views(model, TRANSFER_SCHEME, n, rng, detector_sd=noise_mm)[:2]
    shapes = sample_surrey(run.sfm, n, rng)
    known = np.isfinite(shapes[0, :, 0])
    cameras = sample_photo_cameras(n, rng)
    views = np.full((*shapes.shape[:2], 2), np.nan)
    views[:, known] = project(shapes[:, known], cameras)
    return views + rng.normal(0, noise_mm, views.shape), shapes


def measure(run: Run, faces: str, tested: str, noise_mm: float) -> pd.DataFrame:
    """One row per method: its error on faces of a model, with landmark noise of that s.d.

    On the Surrey model also eos, to which it belongs.
    """
    views, shapes = tested_faces(run, tested, noise_mm)
    predicted = trained(run, faces).predict(views, noise_mm, shapes)
    if tested == SURREY:
        predicted["eos"] = EosFit(run.sfm).predict(views)
    known = np.isfinite(shapes[0, :, 0])
    test = {"trained": faces, "tested": tested, "noise_mm": noise_mm}
    return pd.DataFrame(
        test | {"method": method} | mean_error(aligned_mse(shape[:, known], shapes[:, known]))
        for method, shape in predicted.items()
    )


def main(run: Run) -> dict:
    tests = [*dict.fromkeys([run.model, *open_models(run.data)[0]]), *([SURREY] if run.sfm else [])]
    tasks = [
        (run, faces, tested, noise)
        for faces in transfer_models(run) for tested in tests for noise in NOISES_MM
    ]  # fmt: skip
    parts = counted("condition", unordered(run.jobs, measure, tasks), len(tasks))
    keys = ["trained", "tested", "noise_mm"]
    measured = {tuple(part[keys].iloc[0]): part for part in parts}
    table = pd.concat([measured[task[1:]] for task in tasks])
    texts = grid(table, ["trained", "tested", "method"], "noise_mm", _UNIT)
    texts = texts.rename(columns="{:g} mm".format)
    texts = texts.rename(index=_TITLES, level="trained").rename(index=_TITLES, level="tested")
    texts = texts.rename(index=title, level="method")
    texts = texts.rename_axis(["Trained on", "Tested on", f"MSE ({power(_UNIT)})"])
    panels = [
        Panel(errors, "noise_mm", "Noise of each coordinate (mm)", f"Tested on {_TITLES[tested]}")
        for tested, errors in table[table["trained"] == run.model]
        .rename(columns={"mse": "mean"})
        .groupby("tested", sort=False)
    ]
    figures = {"transfer": error_lines(panels, unit=_UNIT)}
    return write_results(run, "lifting/transfer", {"table": table}, texts, _NOTES, figures)
