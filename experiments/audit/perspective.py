"""Claims on perspective: how much of it is in the views that are called so."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from data_gen.views.photo_views import DETECTOR_SD_MM
from data_gen.views.projections import (
    PROJECTIONS,
    PROTOCOLS,
    Cameras,
    project,
    rotations,
    sample_cameras,
)
from deepmds_keras.alignment import align
from experiments.audit.evidence import Inputs
from experiments.audit.findings import Finding, does_not_hold, holds, holds_if
from experiments.scoring.numbers import scientific
from experiments.streams import Stream

# Degrees: the most that the paper draws, and what MATLAB's help likens to a normal and to a
# wide-angle lens.
ANGLES = (5, 25, 60)
# Share of the face's size below which views are the same but for the rounding of the computer.
_ROUNDING = 1e-9
_DRAWN = 10_000  # cameras of a protocol


def measure(inputs: Inputs) -> dict:
    """Difference of perspective views from orthographic ones, as shares of the face's size.

    Both are of the same faces and poses; shift, turn and scale of a whole view are left out.
    """
    rng = np.random.default_rng([inputs.run.seed, Stream.AUDIT_CAMERAS])
    drawn = {protocol: sample_cameras(_DRAWN, rng, protocol) for protocol in PROTOCOLS}
    perspective = {
        protocol: cameras.projection == PROJECTIONS.index("perspective")
        for protocol, cameras in drawn.items()
    }
    seen = {protocol: drawn[protocol][own] for protocol, own in perspective.items()}
    normalised = inputs.test.shapes[inputs.audited].astype(float)
    landmarks = inputs.test_dataset.landmarks[inputs.audited].astype(float)
    unit_mm = inputs.test.unit_mm[inputs.audited]
    n = len(landmarks)

    released = seen["released"][np.arange(n)]
    orthographic = _through(normalised, released, 0)
    views = {angle: _through(normalised, released, angle) for angle in ANGLES}
    text = seen["paper"][np.arange(n)]
    flat = project(landmarks, replace(text, field_of_view=np.zeros(n)))
    by_text = {
        angle: project(landmarks, replace(text, field_of_view=np.full(n, float(angle))))
        for angle in ANGLES
    }
    return {
        "faces_seen": n,
        "released_undivided": {
            angle: _difference(own[..., :2], orthographic[..., :2]) for angle, own in views.items()
        },
        "released_divided": {
            angle: _difference(own[..., :2] / own[..., 3:], orthographic[..., :2])
            for angle, own in views.items()
        },
        "text": {angle: _difference(own, flat, unit_mm) for angle, own in by_text.items()},
        "perspective_share": {key: float(own.mean()) for key, own in perspective.items()},
        "detector_rms": float(np.sqrt(np.mean(2 * (DETECTOR_SD_MM / unit_mm) ** 2))),
    }


def perspective_views(
    released_undivided: dict,
    released_divided: dict,
    text: dict,
    perspective_share: dict,
    detector_rms: float,
    faces_seen: int,
) -> Finding:
    """A field of view changes views: those of the released generator, and those of the text."""
    smallest = min(text, key=float)
    released = max(own["max"] for own in released_undivided.values())
    evidence = (
        f"The released generator takes the first two rows of MATLAB's viewmtx and never divides by "
        f"the fourth. That matrix was rebuilt here from its documentation, for {faces_seen} faces "
        f"and fields of view of {smallest}° to {max(text, key=float)}°. But for shift, turn and "
        f"scale of the whole, its views are the orthographic ones to {scientific(released, 2)} of "
        f"the face's size. Divided, they would differ by "
        f"{_percent(released_divided[smallest]['rms'])} (r.m.s.) at {smallest}°. Views as the text "
        f"describes them, which this project makes by default, differ by "
        f"{_percent(text[smallest]['rms'])}, at most {_percent(text[smallest]['max'])}, where a "
        f"landmark detector errs by {_percent(detector_rms)}. Called perspective are "
        f"{_percent(perspective_share['paper'])} of the text's views and "
        f"{_percent(perspective_share['released'])} of the released generator's."
    )
    if text[smallest]["max"] <= _ROUNDING:
        return does_not_hold(evidence)
    if released <= _ROUNDING:
        return holds_if(
            "if they are made as the text says, not as the released code does", evidence
        )
    return holds(evidence)


def viewmtx(azimuth: float, elevation: float, field_of_view: float = 0.0) -> np.ndarray:
    """The matrix of MATLAB's function of that name, `(4, 4)`, from its public documentation.

    The viewer is at an azimuth about z, counted from -y, and an elevation above the x-y plane. With
    a field of view the unit cube fills that angle. The target lies where the sphere around the cube
    is nearest to the viewer. The fourth row holds 1 less the depth beyond it, in units of the
    viewer's distance. The help names the origin as the target; its worked examples, which this
    function reproduces, have the one described here.

    https://www.mathworks.com/help/matlab/ref/viewmtx.html

    Args:
        azimuth, elevation: Degrees.
        field_of_view: Degrees; 0 is orthographic.

    Returns:
        Matrix to be multiplied from the left to `(x, y, z, 1)`. Its first two rows, divided by the
        fourth, are the view, x to the right and y up.
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


def _through(shapes: np.ndarray, cameras: Cameras, field_of_view: float) -> np.ndarray:
    """Homogeneous views of the released generator, `(n, L, 4)`, by where the viewer stands."""
    points = np.concatenate([shapes, np.ones((*shapes.shape[:2], 1))], axis=2)
    x, y, z = rotations(cameras)[:, 2].T
    azimuths, elevations = np.rad2deg([np.arctan2(x, -y), np.arcsin(z)])
    matrices = [
        viewmtx(azimuth, elevation, field_of_view)
        for azimuth, elevation in zip(azimuths, elevations, strict=True)
    ]
    return points @ np.swapaxes(matrices, 1, 2)


def _percent(share: float) -> str:
    return f"{100 * share:.2g} %"


def _difference(views: np.ndarray, others: np.ndarray, size: np.ndarray | float = 1.0) -> dict:
    """Root mean square and largest distance of landmarks, once views lie over others."""
    aligned = align(views, others, reflection=False)
    distances = np.linalg.norm(aligned - others, axis=2) / np.reshape(size, (-1, 1))
    return {"rms": float(np.sqrt(np.mean(distances**2))), "max": float(distances.max())}
