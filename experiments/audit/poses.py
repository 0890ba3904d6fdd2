"""Topics on views: poses and projections, landmark noise, perspective."""

from __future__ import annotations

from dataclasses import replace
from itertools import repeat

import numpy as np
import pandas as pd
from scipy.stats import sem

from data_gen.views import PROJECTIONS, Cameras, project, rotations, sample_cameras
from deepmds_keras.alignment import align, normalise
from deepmds_keras.landmarks import load_scheme
from experiments.audit.measure import Evidence
from experiments.inputs import Faces
from experiments.methods import predict
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
_NOISY = ("mean_shape", "linear", "zhao", "aldrian", "ours", "ours_stable")
_POSED = (*_NOISY, "lifting")
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
    for sweep, values in SWEEPS.items():
        views = sweep_views(landmarks, sweep)
        for method, model in models.items():
            mse = errors(model, views, truth)
            rows += zip(repeat(sweep), values, repeat(method), mse.mean(1), sem(mse, axis=1))
    return pd.DataFrame(rows, columns=CURVES)


def noise(evidence: Evidence) -> pd.DataFrame:
    """Errors by the noise of the landmarks, with columns as `poses`."""
    views = evidence.test_dataset.views[evidence.audited].astype(float)
    landmarks, truth = evidence.landmarks, evidence.test[evidence.audited]
    names = load_scheme(evidence.run.scheme).names
    right, left = (names.index(f"{side}_eye_outer_corner") for side in ("right", "left"))
    distances = np.linalg.norm(landmarks[:, right] - landmarks[:, left], axis=-1)
    # The same draws at every size, so that a curve shows nothing but the size.
    draws = evidence.rng(Stream.AUDIT_NOISE).standard_normal((_NOISE_DRAWS, *views.shape))
    draws *= distances[:, None, None]
    rows = []
    for method, model in _models(evidence, _NOISY).items():
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
        ("released", "released", _released_views, evidence.shapes, np.ones(n)),
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


def viewmtx(azimuth: float, elevation: float, field_of_view: float = 0.0) -> np.ndarray:
    """The matrix of MATLAB's function of that name, `(4, 4)`, from its public documentation.

    The viewer is at an azimuth about z, counted from -y, and an elevation above the x-y plane. With
    a field of view the unit cube fills that angle. The target lies where the sphere around the cube
    is nearest to the viewer: so in the help's worked examples, not the origin that it names.
    https://www.mathworks.com/help/matlab/ref/viewmtx.html

    Angles are in degrees; a field of view of 0 is orthographic.

    Returns:
        Matrix to be multiplied from the left to `(x, y, z, 1)`. Its first two rows, divided by the
        fourth, are the view, x to the right and y up. The fourth holds 1 less the depth beyond the
        target, in units of the viewer's distance.
    """
    turn, rise = np.deg2rad([azimuth, elevation])
    towards = np.array([np.cos(rise) * np.sin(turn), -np.cos(rise) * np.cos(turn), np.sin(rise)])
    right = np.array([np.cos(turn), np.sin(turn), 0.0])
    matrix = np.eye(4)
    matrix[:3, :3] = right, np.cross(towards, right), towards
    if field_of_view == 0:
        return matrix
    target = np.full(3, 0.5) + np.sqrt(3) / 2 * towards
    matrix[:3, 3] = -matrix[:3, :3] @ target
    distance = np.sqrt(2) / 2 / np.tan(np.deg2rad(field_of_view) / 2)
    matrix[3] = np.array([0, 0, 0, 1]) - matrix[2] / distance
    return matrix


def _released_views(shapes: np.ndarray, cameras: Cameras) -> np.ndarray:
    """Views of the released generator, `(n, L, 2)`, by where the viewer stands."""
    points = np.concatenate([shapes, np.ones((*shapes.shape[:2], 1))], axis=2)
    x, y, z = rotations(cameras)[:, 2].T
    azimuths, elevations = np.rad2deg([np.arctan2(x, -y), np.arcsin(z)])
    viewers = zip(azimuths, elevations, cameras.field_of_view, strict=True)
    return points @ np.stack([viewmtx(*viewer)[:2].T for viewer in viewers])


def _models(evidence: Evidence, methods: tuple[str, ...]) -> dict:
    """Trained methods by id, with the authors' weights where they were given."""
    given = ["authors_weights"] if evidence.run.authors else []
    return {method: evidence.method(method) for method in (*methods, *given)}
