"""Step: methods trained on faces of one model and tested on those of another, as users do.

Expressive faces in poses as photos show, with a detector's errors of random strength in training.
The face model of the run is the one trained on; those tested on are the open ones, and itself.
"""

from __future__ import annotations

import functools

import numpy as np
import pandas as pd

from data_gen.models.registry import load_model, open_models
from data_gen.views import sample_photo_views
from deepmds_keras.alignment import align, centre, normalise
from deepmds_keras.baselines.closed_form import Linear, MeanShape
from deepmds_keras.metrics import mse
from experiments.face_models import TITLES
from experiments.figures.errors import Panel, error_lines
from experiments.lifting.contenders import fit_aldrian
from experiments.lifting.train import TRANSFER_SCHEME, load_network, network_file, transfer_faces
from experiments.methods import title
from experiments.progress import Bar
from experiments.run import Run
from experiments.scoring.numbers import power
from experiments.streams import Stream
from experiments.studies.study_results import grid, mean_error, write_results
from experiments.tasks import single_threaded, unordered

NOISES_MM = (0.0, 1.0, 3.0)
# A component below it moves no landmark by what can be seen: the fit takes it for noise.
_LEAST_SD_MM = 0.3
_UNIT = 1e-5


class Trained:
    """Methods trained on the same faces, for views that may lie anywhere in an image.

    Args:
        views, shapes: `(n, L, 2)` and `(n, L, 3)` of the training faces.
        lifter, deep_mds: Trained networks; None leaves Deep-MDS out.
        components: For the fit by `fit_aldrian`; None leaves it out.
    """

    def __init__(self, views, shapes, lifter, deep_mds=None, components=None):
        faces = normalise(centre(views)), normalise(shapes)
        with single_threaded():  # the regression's last bits depend on the threads
            self._mean, self._linear = MeanShape().fit(*faces), Linear().fit(*faces)
        self._lifter, self._deep_mds, self._components = lifter, deep_mds, components

    def predict(self, views: np.ndarray, sd: float | np.ndarray) -> dict[str, np.ndarray]:
        """Method to shapes `(n, L, 3)` of views `(n, L, 2)`, y up, with errors of an s.d."""
        shapes = {"mean_shape": self._mean.predict(views)}
        shapes["linear"] = self._linear.predict(normalise(centre(views)))
        if self._components is not None:
            shapes["aldrian"] = fit_aldrian(*self._components, views, sd)
        if self._deep_mds is not None:
            shapes["ours_stable"] = self._deep_mds.predict(views, check_orientation=False)
        lifted = self._lifter.predict(views, landmark_sd=sd, check_orientation=False)
        return shapes | {"lifting": lifted}


@functools.cache
def trained(run: Run) -> Trained:
    """Every method, trained on faces of the run's model."""
    views, shapes, _ = transfer_faces(run)
    files = (network_file(run, f"transfer-{method}") for method in ("lifting", "ours_stable"))
    return Trained(views, shapes, *map(load_network, files), principal_components(shapes))


def principal_components(shapes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Mean `(L, 3)` of shapes `(n, L, 3)` and principal components times s.d., `(K, L, 3)`.

    Expressions are not Gaussian: the components are the Gaussian nearest to them.
    """
    n, mean = len(shapes), shapes.mean(0)
    flat = (shapes - mean).reshape(n, -1)
    values, vectors = np.linalg.eigh(flat.T @ flat / n)
    kept = values > _LEAST_SD_MM**2
    basis = (vectors[:, kept] * np.sqrt(values[kept])).T[::-1]
    return mean, basis.reshape(-1, *mean.shape)


def measure(run: Run, tested: str, noise_mm: float) -> pd.DataFrame:
    """A row a method: its error on faces of a model, whose landmarks have errors of that s.d."""
    model = load_model(tested, run.data, TRANSFER_SCHEME)
    # The same faces, and the same errors but for their size.
    rng = np.random.default_rng([run.seed, Stream.TRANSFER_TESTS])
    views, shapes, _ = sample_photo_views(
        model, TRANSFER_SCHEME, run.preset.test_faces, rng, detector_sd=noise_mm
    )
    truth = normalise(shapes)
    test = {"trained": run.model, "tested": tested, "noise_mm": noise_mm}
    return pd.DataFrame(
        test | {"method": method} | mean_error(mse(align(predicted, truth), truth))
        for method, predicted in trained(run).predict(views, noise_mm).items()
    )


def main(run: Run) -> dict:
    models = dict.fromkeys([run.model, *open_models(run.data)[0]])
    tasks = [(run, model, noise) for model in models for noise in NOISES_MM]
    parts = Bar(unordered(run.jobs, measure, tasks), total=len(tasks), desc="transfer")
    measured = {tuple(part[["tested", "noise_mm"]].iloc[0]): part for part in parts}
    table = pd.concat([measured[task[1:]] for task in tasks])
    texts = grid(table, ["tested", "method"], "noise_mm", _UNIT)
    texts = texts.rename(columns="{:g} mm".format)
    texts = texts.rename(index=TITLES, level="tested").rename(index=title, level="method")
    texts = texts.rename_axis(["Tested on", f"MSE ({power(_UNIT)})"])
    panels = [
        Panel(errors, "noise_mm", "Noise of each coordinate (mm)", f"Tested on {TITLES[tested]}")
        for tested, errors in table.rename(columns={"mse": "mean"}).groupby("tested", sort=False)
    ]
    figures = {"transfer": error_lines(panels, unit=_UNIT)}
    return write_results(run, "lifting/transfer", {"table": table}, texts, (), figures)
