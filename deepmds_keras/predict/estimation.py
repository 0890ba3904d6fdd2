"""From landmarks of faces to their shapes: the model, the scale, and what to say of each face."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from deepmds_keras.camera import HeadPose, head_poses
from deepmds_keras.detection.errors import INNER, detector_errors
from deepmds_keras.errors import InputError
from deepmds_keras.landmarks import LandmarkScheme, load_scheme
from deepmds_keras.landmarks.conversion import convert
from deepmds_keras.landmarks.y_axis import quarter_turns
from deepmds_keras.normalisation import rms_radius
from deepmds_keras.predict.faces import Face, Found
from deepmds_keras.predict.models import Model, model_for

_POSE_ERROR = 5  # degrees, root mean square, with which the poses of heads are found
# A landmark is misplaced if it lies this many times farther from where the shape has it than the
# median of the face's landmarks, and by this part of the face's size; distances count the less, the
# more the detector errs at that landmark. On the photos that the shipped lifters are tested on, 1
# of 1,000 faces with exact landmarks has one, 1 of 150 of those found by dlib, and none of those by
# MediaPipe. With one landmark moved by 0.3 of the size, that one is found in 100, 93 and 88 %, and
# another beside it in 10, 4 and 0 %.
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
        model: One of `FAMILIES`, whose weights for the scheme are taken; the name of shipped
            weights; or a file that `LandmarkLifter.save` or `DeepMDS.save` wrote. None is
            `DEFAULT`.
        interocular: Millimetres between the outer corners of the eyes; None leaves the shapes in
            the unit of `normalise`.
        jobs: Processes for the embedding of the paper's method.
        progress: Called with the number of faces just done.

    Raises:
        InputError: The model cannot be read or takes other landmarks.
    """
    chosen, scheme = model_for(found.scheme, model), load_scheme(found.scheme)
    if chosen.n_landmarks != len(scheme):
        raise InputError(
            f"{found.source or 'landmarks'} must have {chosen.n_landmarks} landmarks a face for "
            f"the model {model}. Received {len(scheme)}."
        )
    seen = ~np.isnan(found.landmarks).any((1, 2))
    landmarks = found.landmarks[seen]
    views = landmarks * (1, -1)
    quarters = quarter_turns(landmarks, found.scheme)
    sd = _measured_sd(found, views)
    shapes, std = chosen.predict(_turned(views, quarters), sd, jobs, progress)
    if interocular is not None:
        right, left = map(scheme.index, _CORNERS)
        apart = np.linalg.norm(shapes[:, left] - shapes[:, right], axis=1)
        scale = (interocular / apart)[:, None, None]
        shapes, std = shapes * scale, None if std is None else std * scale
    poses = head_poses(views, shapes)
    off = _distances(views, shapes, poses)
    told = off if sd is None else off * sd.mean(1, keepdims=True) / sd
    middle = np.median(told, axis=1, keepdims=True)
    astray = told > np.maximum(_ASTRAY * middle, _ASTRAY_SIZE)
    faces = [
        Face(
            name=name,
            source=found.source,
            photo=found.source if found.is_photo else None,
            scheme=found.scheme,
            landmarks=landmarks,
            shape=shape,
            std=own_std,
            unit="normalised" if interocular is None else "mm",
            pose=pose,
            notes=_astray(scheme, off, far) + _notes(pose, turns, chosen),
            detector=found.detector,
        )
        for name, landmarks, shape, own_std, pose, turns, off, far in zip(
            [found.names[i] for i in np.flatnonzero(seen)],
            landmarks,
            shapes,
            [None] * len(shapes) if std is None else std,
            poses,
            quarters.tolist(),
            off,
            astray,
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


def _measured_sd(found: Found, views: np.ndarray) -> np.ndarray | None:
    """`(n, L)` s.d. of the errors that the detector makes, in the unit of the views."""
    errors = None
    if found.detector is not None and "landmarker" not in found.detector:
        errors = detector_errors(found.detector["name"], found.scheme)
    if errors is None:
        return None
    return rms_radius(convert(views, found.scheme, INNER))[:, None] * errors.sd


def _turned(views: np.ndarray, quarters: np.ndarray) -> np.ndarray:
    """Views turned by so many quarters to the left, each about its middle."""
    cosines, sines = np.rint(np.cos(quarters * np.pi / 2)), np.rint(np.sin(quarters * np.pi / 2))
    turns = np.array([[cosines, sines], [-sines, cosines]]).transpose(2, 0, 1)
    centres = views.mean(1, keepdims=True) * (quarters != 0)[:, None, None]
    return (views - centres) @ turns + centres


def _distances(views: np.ndarray, shapes: np.ndarray, poses: list[HeadPose]) -> np.ndarray:
    """`(n, L)` of the landmarks from where the shapes have them, in larger sides of their box."""
    rows = np.stack([pose.scale * pose.rotation[:2].T for pose in poses])
    projected = shapes @ rows + np.stack([pose.translation for pose in poses])[:, None]
    return np.linalg.norm(projected - views, axis=2) / np.ptp(views, axis=1).max(1)[:, None]


def _astray(scheme: LandmarkScheme, off: np.ndarray, far: np.ndarray) -> tuple[str, ...]:
    if not far.any():
        return ()
    said = ", ".join(f"{scheme.names[i]} ({100 * off[i]:.0f} %)" for i in np.flatnonzero(far))
    return (
        f"may be misplaced, and spoil the shape: {said} of the face's size from where the shape "
        f"has it, while half of the landmarks are within {100 * np.median(off):.0f} %",
    )


def _notes(pose: HeadPose, quarters: int, model: Model) -> tuple[str, ...]:
    notes = []
    if quarters:
        notes.append(
            f"the face does not stand upright in the image (roll {pose.roll:+.0f}°): it was turned "
            "upright to be measured"
        )
    roll = (pose.roll + 90 * quarters + 180) % 360 - 180  # of the face that was turned
    beyond = {
        f"{angle} {value:+.0f}°": f"±{model.turns[angle]}°"
        for angle, value in (("yaw", pose.yaw), ("pitch", pose.pitch), ("roll", roll))
        if abs(value) > model.turns.get(angle, np.inf) + _POSE_ERROR
    }
    if beyond:
        notes.append(
            f"turned farther than the faces of the training: {', '.join(beyond)}, where they had "
            f"at most {', '.join(beyond.values())}; the shape is a guess"
        )
    if pose.residual > model.loose:
        notes.append(
            f"the shape, turned back, misses the landmarks by {100 * pose.residual:.0f} % of the "
            "face's size (RMS): they may be in another order, or not those of a face"
        )
    if not model.centred:
        notes.append(
            "the model was trained on views in the coordinates of a face model "
            "(centre_views=False): the shape depends on where the landmarks have their origin"
        )
    return tuple(notes)
