"""Topics on views: poses and projections, landmark noise, perspective."""

from dataclasses import replace
from itertools import repeat

import numpy as np
import pandas as pd
from scipy.stats import sem

from data_gen.views import sample_cameras
from deepmds_keras.geometry.alignment import align
from deepmds_keras.geometry.units import normalise
from deepmds_keras.geometry.views import PROJECTIONS, Cameras, project
from deepmds_keras.landmarks import load_scheme
from experiments.audit.measure import Evidence
from experiments.bench.released_code import released_views
from experiments.inputs import Faces
from experiments.methods import predict
from experiments.progress import counted
from experiments.scoring.scores import score
from experiments.streams import Stream

# Degrees; all other angles are 0, and the projection orthographic but in the last sweep.
SWEEPS = {
    "yaw": tuple(range(-90, 91, 15)),
    "pitch": tuple(range(-60, 61, 15)),
    "roll": tuple(range(-90, 91, 15)),
    "field_of_view": (0, 5, 10, 20, 30, 45, 60),
}
# Ranges of the training views, see `data_gen.views.sample_cameras`.
TRAINED = {"yaw": (-45, 45), "pitch": (-30, 0), "roll": (0, 0), "field_of_view": (0, 5)}
# Standard deviations of each coordinate, in percent of the distance of the outer corners of the
# eyes, in which the errors of landmark detectors are given.
NOISE_PERCENTS = (0, 0.5, 1, 2, 3, 4, 5)
CURVES = ["sweep", "value", "method", "mse", "sem"]
_NOISY = ("mean_shape", "ridge", "zhao", "aldrian", "deep_mds", "deep_mds_cosine")
_POSED = (*_NOISY, "landmark_lifter")
_FACES_SWEPT = 50  # of the audited ones: each is embedded for 42 views and two or three methods
_NOISE_DRAWS = 3  # per face; its MSE is averaged over them
_FIELD_OF_VIEW = 5.0  # degrees, the largest that the paper draws
_CAMERAS_DRAWN = 10_000  # of each protocol


def poses(evidence: Evidence) -> pd.DataFrame:
    """Errors by pose and projection: `sweep, value, method, mse, sem`."""
    models = _models(evidence, _POSED)
    faces = evidence.audited[:_FACES_SWEPT]
    landmarks, truth = evidence.landmarks[:_FACES_SWEPT], evidence.test[faces]
    rows = []
    for sweep, values in counted("sweep", SWEEPS.items(), len(SWEEPS)):
        views = sweep_views(landmarks, sweep)
        for method, model in models.items():
            mse = errors(model, views, truth)
            rows += zip(repeat(sweep), values, repeat(method), mse.mean(1), sem(mse, axis=1))
    return pd.DataFrame(rows, columns=CURVES)


def noise(evidence: Evidence) -> pd.DataFrame:
    """Errors by the noise of the landmarks, with columns as `poses`."""
    views, landmarks, truth = evidence.views, evidence.landmarks, evidence.test[evidence.audited]
    right, left = load_scheme(evidence.run.scheme).eye_corners()
    distances = np.linalg.norm(landmarks[:, right] - landmarks[:, left], axis=-1)
    # The same draws at every size, so that a curve shows nothing but the size.
    draws = evidence.rng(Stream.AUDIT_NOISE).standard_normal((_NOISE_DRAWS, *views.shape))
    draws *= distances[:, None, None]
    rows = []
    models = _models(evidence, _NOISY)
    for method, model in counted("method", models.items(), len(models)):
        for percent in NOISE_PERCENTS:
            noisy = views + percent / 100 * (draws if percent else draws[:1])
            mse = errors(model, normalise(noisy), truth).mean(0)
            rows.append(("noise_percent", percent, method, mse.mean(), sem(mse)))
    return pd.DataFrame(rows, columns=CURVES)


def perspective(evidence: Evidence) -> pd.DataFrame:
    """Difference of perspective views from orthographic ones of the same faces and poses.

    Returns:
        `views`: those that the `text` describes, or those of the `released` generator, which never
        divides by the fourth row of its matrix. `rms` and `max` distance of landmarks, relative to
        the face's size, after alignment of whole views by a similarity, at the largest field of
        view in the paper.
    """
    rng, n = evidence.rng(Stream.AUDIT_CAMERAS), len(evidence.audited)
    rows = []
    for name, protocol, views_of, points, size in (
        ("text", "paper", project, evidence.landmarks, evidence.test.unit_mm[evidence.audited]),
        ("released", "released", released_views, evidence.shapes, np.ones(n)),
    ):
        drawn = sample_cameras(_CAMERAS_DRAWN, rng, protocol)
        cameras = drawn[drawn.projection == PROJECTIONS.index("perspective")][:n]
        views, orthographic = (
            views_of(points, replace(cameras, field_of_view=np.full(n, angle)))
            for angle in (_FIELD_OF_VIEW, 0.0)
        )
        aligned = align(views, orthographic, reflection=False)
        distances = np.linalg.norm(aligned - orthographic, axis=2) / size[:, None]
        rows.append((name, np.sqrt(np.mean(distances**2)), distances.max()))
    return pd.DataFrame(rows, columns=["views", "rms", "max"])


def sweep_views(landmarks: np.ndarray, sweep: str) -> np.ndarray:
    """Normalised views of faces `(n, L, 3)` for every value of a sweep, `(values, n, L, 2)`."""
    values, n = SWEEPS[sweep], len(landmarks)
    angles = {angle: np.zeros(len(values) * n) for angle in SWEEPS}
    angles[sweep] += np.repeat(values, n)
    cameras = Cameras((angles["field_of_view"] > 0).astype(int), **angles)
    views = normalise(project(np.tile(landmarks, (len(values), 1, 1)), cameras))
    return views.reshape(len(values), n, *views.shape[1:])


def errors(model, views: np.ndarray, truth: Faces) -> np.ndarray:
    """MSE of each face in each of its views: `(k, n, L, 2)` → `(k, n)`."""
    shapes = predict(model, views.reshape(-1, *views.shape[2:]))
    faces = np.tile(np.arange(views.shape[1]), len(views))
    return score(shapes, truth[faces]).mse.reshape(views.shape[:2])


def _models(evidence: Evidence, methods: tuple[str, ...]) -> dict:
    """Trained methods by id, with the authors' weights where they were given."""
    given = ["deep_mds_weights"] if evidence.run.authors else []
    return {method: evidence.method(method) for method in (*methods, *given)}
