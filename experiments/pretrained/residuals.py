"""How far the lifted shape, projected, is from the landmarks that a detector found.

What remains alike on every face is no error of that face: there the detector means another point
than the shapes that the lifter learnt from.
"""

import numpy as np
import pandas as pd

from deepmds_keras.geometry.camera import refit
from deepmds_keras.geometry.units import rms_radius
from deepmds_keras.landmarks import load_scheme
from deepmds_keras.lifting.lifter import LandmarkLifter
from deepmds_keras.tool.detection import detector_sd, upright_axes

_SCHEME = load_scheme("ibug51")
# A detector means another point where its mean residual is longer than both: in radii, and in
# standard errors, so many that chance reaches it at none of 2 x 51 landmarks.
_LEAST, _ERRORS = 0.01, 4.0


def residuals(lifter: LandmarkLifter, landmarks: np.ndarray, sd: np.ndarray | None) -> np.ndarray:
    """From the projected shape to the landmarks.

    Args:
        lifter: Of the scheme `ibug51`.
        landmarks: `(n, 51, 2)` pixels, x right and y down.
        sd: `(n, 51)` pixels, given to the lifter; None for its default.

    Returns:
        `(n, 51, 2)` in axes and radii of `upright_axes`.
    """
    views = landmarks * (1, -1)
    shapes, _, pose = lifter.estimate(views, landmark_sd=sd)
    projected = refit(pose, views, shapes).project(shapes) * (1, -1)
    return along_face(landmarks - projected, landmarks)


def along_face(offsets: np.ndarray, landmarks: np.ndarray) -> np.ndarray:
    """Offsets `(n, 51, 2)` in pixels, in axes and radii of `upright_axes`: what `move` takes."""
    axes, radius = upright_axes(landmarks, _SCHEME.name)
    return offsets @ np.swapaxes(axes, 1, 2) / radius[:, None, None]


def sd_in_pixels(landmarks: np.ndarray, sd: np.ndarray) -> np.ndarray:
    """`(n, 51)` of landmarks `(n, 51, 2)`, from `(51,)` as in `detectors.csv`."""
    return rms_radius(landmarks)[:, None] * sd


def of_detectors(
    lifter: LandmarkLifter, faces: dict[str, np.ndarray]
) -> dict[tuple[str, str], np.ndarray]:
    """Residuals by detector and by the s.d. that the lifter is given, `"detector"` or `"none"`."""
    found = {}
    for detector, landmarks in faces.items():
        sd = sd_in_pixels(landmarks, detector_sd(detector, _SCHEME.name))
        found[detector, "detector"] = residuals(lifter, landmarks, sd)
        found[detector, "none"] = residuals(lifter, landmarks, None)
    return found


def misfits(found: dict[tuple[str, str], np.ndarray]) -> list[dict]:
    """Root mean square residual of a coordinate, the median over faces.

    Returns:
        Rows of `detector, given_sd, misfit, less_mean`; the last is what is left without the mean
        residual, which is that of the other half of the faces.
    """
    rows = []
    for (detector, given), off in found.items():
        half = np.arange(len(off)) % 2 == 0
        means = np.where(half[:, None, None], off[~half].mean(0), off[half].mean(0))
        row = {"detector": detector, "given_sd": given, "misfit": _median(off)}
        rows.append(row | {"less_mean": _median(off - means)})
    return rows


def _median(off: np.ndarray) -> float:
    return float(np.median(np.sqrt((off**2).mean((1, 2)))))


def mean_residuals(found: dict[tuple[str, str], np.ndarray]) -> pd.DataFrame:
    """Where each detector finds a landmark, from where the lifted shape has it.

    Returns:
        Rows of `detector, landmark, name, right, down, error, differs`: the iBUG number, the mean
        residual towards the subject's left (right in the picture) and down the face, its standard
        error, and whether the detector means another point.
    """
    parts = []
    for (detector, given), off in found.items():
        if given != "detector":
            continue
        mean = off.mean(0)
        length = np.linalg.norm(mean, axis=1)
        error = np.linalg.norm(off.std(0, ddof=1), axis=1) / np.sqrt(len(off))
        part = {"detector": detector, "landmark": _SCHEME.numbers, "name": _SCHEME.names}
        part |= {"right": mean[:, 0], "down": mean[:, 1], "error": error}
        part |= {"differs": (length > _LEAST) & (length > _ERRORS * error)}
        parts.append(pd.DataFrame(part))
    return pd.concat(parts)
