"""From landmarks of faces to their shapes: the model, the scale, and what to say of each face."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np

from deepmds_keras.errors import InputError
from deepmds_keras.landmarks import load_scheme
from deepmds_keras.landmarks.conversion import SIZES
from deepmds_keras.pipeline import DeepMDS
from deepmds_keras.pose import HeadPose, head_pose
from deepmds_keras.predict.faces import Face, Found

PRETRAINED = {"ibug51": "openhead-ibug51", "bfm72": "openhead-bfm72"}
# Turns of the heads that the shipped weights were trained on, degrees.
_TRAINED = {"yaw": 50, "pitch": 25, "roll": 30}
_CORNERS = ("right_eye_outer_corner", "left_eye_outer_corner")
_LOOSE = 0.07  # residual of a pose beyond which landmarks hardly are those of the shape


def estimate(
    found: Found, *, model: str | None = None, interocular: float | None = None, jobs: int = 1
) -> list[Face]:
    """The shapes of all faces of a source.

    Args:
        found: Their landmarks.
        model: File that `DeepMDS.save` wrote, or name of shipped weights; None takes those that
            ship for the scheme.
        interocular: Millimetres between the outer corners of the eyes; None leaves the shapes in
            the unit of `normalise`.
        jobs: Processes for the embedding.

    Raises:
        InputError: The model cannot be read or takes other landmarks, or the landmarks are not of
            a face.
    """
    estimator = load_model(model or PRETRAINED[found.scheme])
    if estimator.n_landmarks != SIZES[found.scheme]:
        raise InputError(
            f"{found.source} must have {estimator.n_landmarks} landmarks a face for the model "
            f"{model}. Received {SIZES[found.scheme]}."
        )
    views = found.landmarks * (1, -1)
    shapes = estimator.set_params(n_jobs=jobs).predict(views)
    if interocular is not None:
        right, left = map(load_scheme(found.scheme).names.index, _CORNERS)
        apart = np.linalg.norm(shapes[:, left] - shapes[:, right], axis=1)
        shapes = shapes * (interocular / apart)[:, None, None]
    faces = []
    for name, landmarks, view, shape in zip(
        found.names, found.landmarks, views, shapes, strict=True
    ):
        try:
            pose = head_pose(view, shape)
        except InputError as error:
            raise InputError(f"{found.source}, face {name}: {error}") from None
        faces.append(
            Face(
                name=name,
                source=found.source,
                photo=found.source if found.is_photo else None,
                scheme=found.scheme,
                landmarks=landmarks,
                shape=shape,
                unit="normalised" if interocular is None else "mm",
                pose=pose,
                notes=_notes(pose),
            )
        )
    return faces


def described(scheme: str, model: str | None) -> dict[str, str]:
    """Name and provenance of a model, for the files that are written."""
    if model is not None:
        return {"name": str(model), "weights": "given by the user"}
    return {
        "name": PRETRAINED[scheme],
        "weights": "shipped with deepmds-keras (MIT); trained on landmarks of the embedded open "
        "head model (CC0 assets), no photo of a person",
    }


@cache
def load_model(name: str) -> DeepMDS:
    """Shipped weights by name, or a file.

    Raises:
        InputError: Neither.
    """
    return DeepMDS.load(name) if Path(name).suffix else DeepMDS.pretrained(name)


def _notes(pose: HeadPose) -> tuple[str, ...]:
    turned = [
        f"{angle} {getattr(pose, angle):+.0f}°"
        for angle, most in _TRAINED.items()
        if abs(getattr(pose, angle)) > most
    ]
    notes = []
    if turned:
        limits = ", ".join(f"{angle} ±{most}°" for angle, most in _TRAINED.items())
        notes.append(
            f"turned farther than the faces of the training ({', '.join(turned)}; {limits}): the "
            "shape is a guess"
        )
    if pose.residual > _LOOSE:
        notes.append(
            f"the shape, turned back, misses the landmarks by {100 * pose.residual:.0f} % of their "
            "extent: they may not be those of a face"
        )
    return tuple(notes)
