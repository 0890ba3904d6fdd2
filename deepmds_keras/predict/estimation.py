"""From landmarks of faces to their shapes: the model, the scale, and what to say of each face."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np

import deepmds_keras
from deepmds_keras.camera import HeadPose, head_poses
from deepmds_keras.io.errors import InputError
from deepmds_keras.landmarks import LandmarkScheme, load_scheme
from deepmds_keras.landmarks.y_axis import quarter_turns
from deepmds_keras.predict.faces import Face, Found
from deepmds_keras.weights import pretrained_path

PRETRAINED = {"ibug51": "openhead-ibug51", "bfm72": "openhead-bfm72"}
# Turns of the heads that the shipped weights were trained on, degrees; and the error with which
# poses of such heads are found, root mean square.
_TRAINED = {"yaw": 50, "pitch": 25, "roll": 30}
_POSE_ERROR = 5
# Residual of a pose beyond which landmarks hardly are those of the shape. It is 0.03 to 0.08 for
# faces in photos and for those of the training; 0.16 and more if the brows are swapped or all
# landmarks are in another order by one, above 0.3 if they are shuffled.
_LOOSE = 0.12
# A landmark is misplaced if it lies this many times farther from where the shape has it than the
# median of the face's landmarks, and by this part of the face's size. Of 400 faces like those of
# the training none had one (the farthest was 3.9 times as far); with one landmark moved by 0.3 of
# the size, that one was found in 99 % of them, and never another.
_ASTRAY, _ASTRAY_SIZE = 4, 0.05
_CORNERS = ("right_eye_outer_corner", "left_eye_outer_corner")


def estimate(
    found: Found,
    *,
    model: str | None = None,
    interocular: float | None = None,
    jobs: int = 1,
    progress: Callable[[int], object] | None = None,
) -> list[Face]:
    """The shapes of all faces of a source; gaps stay gaps.

    Args:
        found: Their landmarks, at least one face that is no gap.
        model: File that `DeepMDS.save` wrote, or name of shipped weights; None takes those that
            ship for the scheme.
        interocular: Millimetres between the outer corners of the eyes; None leaves the shapes in
            the unit of `normalise`.
        jobs: Processes for the embedding.
        progress: Called with the number of faces just done.

    Raises:
        InputError: The model cannot be read or takes other landmarks.
    """
    estimator = load_model(model or PRETRAINED[found.scheme])
    scheme = load_scheme(found.scheme)
    if estimator.n_landmarks != len(scheme):
        raise InputError(
            f"{found.source} must have {estimator.n_landmarks} landmarks a face for the model "
            f"{model}. Received {len(scheme)}."
        )
    seen = ~np.isnan(found.landmarks).any((1, 2))
    landmarks = found.landmarks[seen]
    views = landmarks * (1, -1)
    quarters = quarter_turns(landmarks, found.scheme)
    shapes = estimator.set_params(n_jobs=jobs).predict(_turned(views, quarters), progress=progress)
    if interocular is not None:
        right, left = map(scheme.index, _CORNERS)
        apart = np.linalg.norm(shapes[:, left] - shapes[:, right], axis=1)
        shapes = shapes * (interocular / apart)[:, None, None]
    poses = head_poses(views, shapes)
    faces = [
        Face(
            name=name,
            source=found.source,
            photo=found.source if found.is_photo else None,
            scheme=found.scheme,
            landmarks=landmarks,
            shape=shape,
            unit="normalised" if interocular is None else "mm",
            pose=pose,
            notes=_astray(scheme, off) + _notes(pose, turns, estimator.centre_views),
            detector=found.detector,
        )
        for name, landmarks, shape, pose, turns, off in zip(
            [found.names[i] for i in np.flatnonzero(seen)],
            landmarks,
            shapes,
            poses,
            quarters.tolist(),
            _distances(views, shapes, poses),
            strict=True,
        )
    ]
    rest = iter(faces)
    return [
        next(rest)
        if seen[i]
        else faces[0].gap(name, (found.faults[i],) if i in found.faults else ())
        for i, name in enumerate(found.names)
    ]


def describe_model(scheme: str, model: str | None) -> dict[str, str]:
    """Name and provenance of a model, for the files that are written."""
    if model is not None:
        return {"name": model, "weights": "given by the user"}
    return {
        "name": PRETRAINED[scheme],
        "weights": "shipped with deepmds-keras (MIT); trained on landmarks of the embedded open "
        "head model (CC0 assets), no photo of a person",
    }


def hash_weights(model: str | None) -> str:
    """SHA-256 of the weights that a run may use: of one model, or of all that are its defaults.

    Raises:
        InputError: There is no such model.
    """
    digest = hashlib.sha256()
    for path in map(weights_path, (model,) if model else PRETRAINED.values()):
        try:
            digest.update(path.read_bytes())
        except OSError as error:
            raise InputError(
                f"{path} must be a file that DeepMDS.save() wrote. Received: {error.strerror}."
            ) from None
    return digest.hexdigest()


@cache
def load_model(name: str) -> deepmds_keras.DeepMDS:
    """Shipped weights by name, or a file.

    Raises:
        InputError: Neither.
    """
    return deepmds_keras.DeepMDS.load(weights_path(name))  # loads TensorFlow, the first time


def weights_path(name: str) -> Path:
    """File of weights: itself, or that of shipped ones by their name.

    Raises:
        InputError: No file's name, and none of those that ship.
    """
    path = Path(name)
    if path.suffix or path.exists():
        return path
    try:
        return pretrained_path(name)
    except InputError as error:
        raise InputError(f"model must be a file of DeepMDS.save(), or its {error}") from None


def _turned(views: np.ndarray, quarters: np.ndarray) -> np.ndarray:
    """Views turned by so many quarters to the left, each about its middle."""
    cosines, sines = np.rint(np.cos(quarters * np.pi / 2)), np.rint(np.sin(quarters * np.pi / 2))
    turns = np.array([[cosines, sines], [-sines, cosines]]).transpose(2, 0, 1)
    centres = views.mean(1, keepdims=True) * (quarters != 0)[:, None, None]
    return (views - centres) @ turns + centres


def _distances(views: np.ndarray, shapes: np.ndarray, poses: list[HeadPose]) -> np.ndarray:
    """`(n, L)` of the landmarks from where the shapes have them, in larger sides of their box."""
    projected = [pose.project(shape) for pose, shape in zip(poses, shapes, strict=True)]
    return np.linalg.norm(projected - views, axis=2) / np.ptp(views, axis=1).max(1)[:, None]


def _astray(scheme: LandmarkScheme, off: np.ndarray) -> tuple[str, ...]:
    far = np.flatnonzero(off > max(_ASTRAY * np.median(off), _ASTRAY_SIZE))
    if not len(far):
        return ()
    said = ", ".join(f"{scheme.names[i]} ({100 * off[i]:.0f} %)" for i in far)
    return (
        f"may be misplaced, and spoil the shape: {said} of the face's size from where the shape "
        f"has it, while half of the landmarks are within {100 * np.median(off):.0f} %",
    )


def _notes(pose: HeadPose, quarters: int, centred: bool) -> tuple[str, ...]:
    notes = []
    if quarters:
        notes.append(
            f"the face does not stand upright in the image (roll {pose.roll:+.0f}°): it was turned "
            "upright to be measured"
        )
    roll = (pose.roll + 90 * quarters + 180) % 360 - 180  # of the face that was turned
    beyond = {
        f"{angle} {value:+.0f}°": f"±{_TRAINED[angle]}°"
        for angle, value in (("yaw", pose.yaw), ("pitch", pose.pitch), ("roll", roll))
        if abs(value) > _TRAINED[angle] + _POSE_ERROR
    }
    if beyond:
        notes.append(
            f"turned farther than the faces of the training: {', '.join(beyond)}, where they had "
            f"at most {', '.join(beyond.values())}; the shape is a guess"
        )
    if pose.residual > _LOOSE:
        notes.append(
            f"the shape, turned back, misses the landmarks by {100 * pose.residual:.0f} % of the "
            "face's size (RMS): they may be in another order, or not those of a face"
        )
    if not centred:
        notes.append(
            "the model was trained on views in the coordinates of a face model "
            "(centre_views=False): the shape depends on where the landmarks have their origin"
        )
    return tuple(notes)
