"""From landmarks of faces to their shapes: the model, the scale, and notes on single faces."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from deepmds_keras.errors import InputError
from deepmds_keras.geometry.camera import HeadPose
from deepmds_keras.landmarks import LandmarkScheme, load_scheme
from deepmds_keras.landmarks.y_axis import quarter_turns
from deepmds_keras.tool.detection import sd_of_landmarks
from deepmds_keras.tool.predict.faces import Detections, Face
from deepmds_keras.tool.predict.models import Model, load_model, name_for

_POSE_ERROR = 5  # root mean square error of head poses, degrees
# A landmark is misplaced if its distance from the projected shape is this many times the median of
# the face's landmarks, and this part of the face's size. Distances are weighted by the accuracy of
# the detector at that landmark.
_ASTRAY, _ASTRAY_SIZE = 4, 0.05
_MOST_ACCURATE = 1 / 4  # smallest s.d. relative to the mean: exact landmarks would always be astray
# Rotations by so many quarters to the left, to be multiplied from the left.
_TURNS = np.array([np.linalg.matrix_power([[0.0, -1.0], [1.0, 0.0]], k) for k in range(4)])


def estimate_faces(
    detections: Detections,
    *,
    model: str | None = None,
    interocular: float | None = None,
    jobs: int = 1,
    progress: Callable[[int], object] = lambda n: None,
) -> list[Face]:
    """Estimate the shapes of all faces of a source; gaps stay gaps.

    Args:
        detections: Their landmarks, with at least one face that is not a gap.
        model: One of `FAMILIES`, which uses the weights for the scheme; the name of shipped
            weights; or a file that `LandmarkLifter.save` or `DeepMDS.save` wrote. None is
            `DEFAULT`.
        interocular: Millimetres between the outer corners of the eyes, positive and finite; None
            leaves the shapes in the unit of `normalise`.
        jobs: Number of processes for the embedding of the paper's method.
        progress: Called with the number of faces just done.

    Returns:
        A face for each name, in the same order.

    Raises:
        InputError: The model cannot be read or needs other landmarks.
    """
    scheme = load_scheme(detections.scheme)
    chosen = load_model(name_for(detections.scheme, model))
    if chosen.n_landmarks != len(scheme):
        received = f"{len(scheme)}"
        if detections.detector is not None:
            received += f" from {detections.detector['name']}; take another detector or model"
        raise InputError(
            f"{detections.source or 'landmarks'} must have {chosen.n_landmarks} landmarks per "
            f"face for the model {model}. Received {received}."
        )
    seen = np.flatnonzero(~np.isnan(detections.landmarks).all((1, 2)))
    landmarks = detections.landmarks[seen]
    views = landmarks * (1, -1)
    quarters = quarter_turns(landmarks, detections.scheme)
    sd = _landmark_sd(detections, seen, views)
    turns = _TURNS[quarters % 4]
    # 0 for faces that are not rotated, whose digits stay as they are.
    middle = np.nanmean(views, axis=1, keepdims=True) * (quarters != 0)[:, None, None]
    upright = (views - middle) @ np.swapaxes(turns, 1, 2) + middle
    shapes, std, poses = chosen.predict(upright, sd, jobs, progress)
    poses = _turned_back(poses, turns, middle)
    if interocular is not None:
        right, left = scheme.eye_corners()
        scale = interocular / np.linalg.norm(shapes[:, left] - shapes[:, right], axis=1)
        shapes = shapes * scale[:, None, None]
        std = None if std is None else std * scale[:, None, None]
        poses = replace(poses, scale=poses.scale / scale, perspective=poses.perspective / scale)
    size = np.nanmax(views, axis=1) - np.nanmin(views, axis=1)
    off = np.linalg.norm(poses.project(shapes) - views, axis=2) / size.max(1)[:, None]
    poses = replace(poses, residual=np.sqrt(np.nanmean(off**2, axis=1)))
    notes = _notes(poses, quarters, chosen)
    for i, note in _misplaced(scheme, off, sd).items():
        notes[i].insert(0, note)
    scores, faults = detections.scores, detections.faults
    faces = {
        i: Face(
            name=detections.names[i],
            source=detections.source,
            photo=detections.source if detections.is_photo else None,
            scheme=detections.scheme,
            landmarks=landmarks[k],
            xyz=shapes[k],
            unit="normalised" if interocular is None else "mm",
            pose=poses[k],
            notes=tuple(notes[k]) + ((detections.notes[i],) if i in detections.notes else ()),
            detector=detections.detector,
            frame_ref=None if detections.frame_refs is None else detections.frame_refs[i],
            std=None if std is None else std[k],
            score=None if scores is None or np.isnan(scores[i]) else float(scores[i]),
        )
        for k, i in enumerate(seen.tolist())
    }
    some = next(iter(faces.values()))
    return [
        faces[i] if i in faces else some.gap(name, (faults[i],) if i in faults else ())
        for i, name in enumerate(detections.names)
    ]


def _landmark_sd(detections: Detections, seen: np.ndarray, views: np.ndarray) -> np.ndarray | None:
    """`(n, L)` s.d. of the landmarks' errors, in their unit: as given, or as measured."""
    if detections.landmark_sd is not None:
        return detections.landmark_sd[seen]
    detector = detections.detector["name"] if detections.detector else detections.found_by
    return sd_of_landmarks(views, detector, detections.scheme)


def _turned_back(poses: HeadPose, turns: np.ndarray, middle: np.ndarray) -> HeadPose:
    """The cameras of views that were rotated by quarters about their middle `(n, 1, 2)`."""
    rotation = poses.rotation.copy()
    rotation[:, :2] = np.swapaxes(turns, 1, 2) @ rotation[:, :2]
    translation = (poses.translation[:, None] - middle) @ turns + middle
    return replace(poses, rotation=rotation, translation=translation[:, 0])


def _misplaced(scheme: LandmarkScheme, off: np.ndarray, sd: np.ndarray | None) -> dict[int, str]:
    """Notes on faces with landmarks far from the projected shape; `off` is relative to its size."""
    sd = np.ones_like(off) if sd is None else sd + 1e-12  # which may all be 0
    mean = sd.mean(1, keepdims=True)
    weighted = off * mean / np.maximum(sd, _MOST_ACCURATE * mean)
    whole = not np.isnan(weighted).any()  # as nearly always; NumPy's nanmedian is slow
    median = (np.median if whole else np.nanmedian)(weighted, axis=1, keepdims=True)
    far = weighted > np.maximum(_ASTRAY * median, _ASTRAY_SIZE)
    notes = {}
    for i in np.flatnonzero(far.any(1)).tolist():
        listed = ", ".join(
            f"{scheme.names[k]} ({100 * off[i, k]:.0f} %)" for k in np.flatnonzero(far[i])
        )
        notes[i] = (
            f"may be misplaced, and spoil the shape: {listed} of the shape's size from where it "
            f"has them, while half of the landmarks are within {100 * np.nanmedian(off[i]):.0f}"
            " %"
        )
    return notes


def _notes(poses: HeadPose, quarters: np.ndarray, model: Model) -> list[list[str]]:
    angles = {name: getattr(poses, name) for name in ("yaw", "pitch", "roll")}
    # The face may have been rotated.
    upright = angles | {"roll": (angles["roll"] + 90 * quarters + 180) % 360 - 180}
    notes: list[list[str]] = []
    for i, residual in enumerate(np.asarray(poses.residual)):
        notes.append([])
        if quarters[i]:
            notes[i].append(
                f"the face does not stand upright in the image (roll {angles['roll'][i]:+.0f}°): "
                "it was turned upright to be measured"
            )
        beyond = {
            f"{name} {values[i]:+.0f}°": f"±{model.turns[name]}°"
            for name, values in upright.items()
            if abs(values[i]) > model.turns.get(name, np.inf) + _POSE_ERROR
        }
        if beyond:
            notes[i].append(
                f"turned farther than the shapes of the training: {', '.join(beyond)}, where they "
                f"had at most {', '.join(beyond.values())}; the shape is a guess"
            )
        if residual > model.max_residual:
            notes[i].append(
                f"the shape, turned back, misses the landmarks by {100 * residual:.0f} % of its "
                "size (RMS): they may be in another order, or of another thing"
            )
        if not model.centred:
            notes[i].append(
                "the model was trained on views in the coordinates of a face model "
                "(centre_views=False): the shape depends on where the landmarks have their origin"
            )
    return notes
