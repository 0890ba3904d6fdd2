"""Part of a face model that an image can ever show: the rest need not be drawn."""

from __future__ import annotations

from itertools import cycle

import numpy as np

from data_gen.models.morphable_model import MorphableModel
from data_gen.rendering.rasteriser import Rasteriser
from data_gen.rendering.renderer import MARGIN, square_frames, stretched_frames
from data_gen.views.projections import Cameras, in_camera_frame, project_with_depth

# Views in which the model is looked at, a little beyond those of the data sets.
_YAWS, _PITCHES = (-50.0, -25.0, 0.0, 25.0, 50.0), (-35.0, -15.0, 0.0, 10.0)
_FACES_PER_VIEW = 3
_PIXELS = 512


def seen_vertices(
    model: MorphableModel,
    scheme: str,
    *,
    whole: bool = False,
    margin: float = MARGIN,
    expressions: np.ndarray | None = None,
) -> np.ndarray:
    """Vertices of the triangles seen in some view of some random faces, and of their neighbours.

    Args:
        model: Morphable model.
        scheme: Landmark scheme by which images are framed.
        whole: Whether images show the whole model instead of a square about the landmarks.
        margin: Of that square, as for `rendering.square_frames`.
        expressions: `(m, E)` weights of expressions that the faces take in turn, at least those
            that show what a neutral face hides, such as the teeth; None for neutral faces.

    Returns:
        Sorted 0-based vertex numbers.
    """
    yaw, pitch = (angles.ravel() for angles in np.meshgrid(_YAWS, _PITCHES))
    level = np.zeros(len(yaw))
    cameras = Cameras(level.astype(int), yaw, pitch, level, level)
    rasteriser = Rasteriser(model.n_vertices, model.triangles, _PIXELS, by_triangle=True)
    seen = np.zeros(len(model.triangles) + 1, bool)
    rng = np.random.default_rng(0)
    taken = cycle([None] if expressions is None else expressions)
    for _ in range(_FACES_PER_VIEW):
        identity = rng.standard_normal((len(yaw), model.n_identity))
        for k, coefficients in enumerate(identity):
            camera = cameras[k : k + 1]
            face = in_camera_frame(model.shape(coefficients, next(taken))[None], camera)
            landmarks = model.landmarks[scheme]
            points = project_with_depth(face, face[:, landmarks], camera)
            views = points[..., :2]
            frame = (
                stretched_frames(views, _PIXELS)
                if whole
                else square_frames(views[:, landmarks], _PIXELS, margin)
            )
            numbers = rasteriser.draw_numbers(frame.pixels(views)[0], points[0, :, 2])
            seen[np.minimum(numbers, len(model.triangles))] = True
    rasteriser.close()
    touched = np.unique(model.triangles[seen[:-1]])
    beside = np.isin(model.triangles, touched).any(1)
    return np.unique(model.triangles[beside])


def part_of(model: MorphableModel, vertices: np.ndarray) -> MorphableModel:
    """The model with only these vertices, and the triangles that lie wholly among them.

    Args:
        model: Morphable model.
        vertices: Sorted 0-based vertex numbers.
    """
    within = np.isin(model.triangles, vertices).all(1)
    triangles = np.searchsorted(vertices, model.triangles[within])
    return model.restrict(vertices, triangles)
