"""3D landmarks of a scanned face, as the paper finds them on CASIA-3D.

The face model is fitted to the landmarks detected in the photo and then registered rigidly to the
scan; the scan's point nearest to each landmark of the fitted model is taken for the truth.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import KDTree

from data_gen.fitting.icp import IcpResult, icp
from data_gen.fitting.landmark_fitting import LandmarkFit, LandmarkFitter
from data_gen.models.mesh import largest_component, vertex_normals
from data_gen.models.morphable_model import MorphableModel
from deepmds_keras.errors import InputError

# Blendshapes go from 0 to 1; FLAME's expressions are principal components at one s.d.
_EXPRESSION_SD = {"flame": 1.0}
_NEAR_MM = 40.0  # the part of the model that is registered: so near to a landmark
_SURFACE_POINTS = 1500
_COARSE_POINTS, _COARSE_ITERATIONS = 300, 20
_MAX_RMS_MM = 4.0  # farther from the scan, the model is not where the face is


@dataclass(frozen=True, eq=False)
class Registration:
    """A fitted model on a scan, and the landmarks that are therefore taken for the ground truth.

    Attributes:
        fit: Of the model to the photo.
        icp: Of the fitted model, as posed in the photo, to the scan.
        landmarks: `(51, 3)` the scan's points nearest to the model's landmarks, in the frame of the
            face model, millimetres.
        fitted: `(51, 3)` the landmarks of the fitted model, likewise.
        gaps: `(51,)` how far those are from the landmarks of the registered model, millimetres.
        model_to_scan: Rotation `(3, 3)` and translation `(3,)`: a point p of the fitted model is at
            `rotation @ p + translation` in the scan.
    """

    fit: LandmarkFit
    icp: IcpResult
    landmarks: np.ndarray
    fitted: np.ndarray
    gaps: np.ndarray
    model_to_scan: tuple[np.ndarray, np.ndarray]


class GroundTruth:
    """Finds landmarks on scans by a face model (paper, section "Datasets", CASIA3D).

    Args:
        model: Morphable model with landmarks `"ibug51"`.
        n_identity: Leading identity components that are fitted.
    """

    def __init__(self, model: MorphableModel, n_identity: int = 100):
        landmarks = model.landmarks["ibug51"]
        self._fitter = LandmarkFitter(
            model, n_identity=n_identity, expression_sd=_EXPRESSION_SD.get(model.name, 0.3)
        )
        surface = _surface(model, landmarks)
        self._n_surface = len(surface)
        self._model = model.restrict(np.concatenate([surface, landmarks]))

    def register(self, pixels: np.ndarray, points: np.ndarray) -> Registration:
        """Landmarks of one scan.

        Args:
            pixels: `(51, 2)` landmarks detected in the photo, x right and y down.
            points: `(n, 3)` of the scan, see `scans.Scan`.

        Raises:
            InputError: Too few points; or the fit or the registration did not converge, or left the
                model too far from the scan. The message says which and by how much.
        """
        fit = self._fitter.fit(pixels * (1, -1))
        if not fit.converged:
            raise InputError(
                "The fit of the face model to the photo must converge. Received one that still "
                f"moved after {fit.n_iterations} iterations."
            )
        shape = self._model.shape(fit.identity, fit.expression)
        posed = shape @ fit.camera.rotation.T
        surface, landmarks = posed[: self._n_surface], posed[self._n_surface :]
        tree = KDTree(points)
        found = _register(surface, tree)
        if not found.converged or found.rms > _MAX_RMS_MM:
            raise InputError(
                f"The registration must converge to within {_MAX_RMS_MM:g} mm. Received "
                f"{found.rms:.1f} mm after {found.n_iterations} iterations"
                f"{'' if found.converged else ', still moving'}."
            )
        gaps, nearest = tree.query(landmarks @ found.rotation.T + found.translation)
        rotation = found.rotation @ fit.camera.rotation
        truth = (points[nearest] - found.translation) @ rotation
        fitted = shape[self._n_surface :]
        return Registration(fit, found, truth, fitted, gaps, (rotation, found.translation))


def _surface(model: MorphableModel, landmarks: np.ndarray) -> np.ndarray:
    """Vertices of the face's skin about the landmarks, thinned out evenly."""
    skin = largest_component(model.n_vertices, model.triangles)
    near = KDTree(model.mean[landmarks]).query(model.mean[skin])[0] < _NEAR_MM
    facing = vertex_normals(model.mean, model.triangles)[skin, 2] > 0
    surface = skin[near & facing]
    return surface[:: -(-len(surface) // _SURFACE_POINTS)]


def _register(surface: np.ndarray, tree: KDTree) -> IcpResult:
    """Rigid registration from the better of two starts: middle on middle, front on front."""
    points = tree.data
    few = surface[:: -(-len(surface) // _COARSE_POINTS)]
    starts = (
        points.mean(0) - surface.mean(0),
        points[points[:, 2].argmax()] - surface[surface[:, 2].argmax()],
    )
    coarse = [
        icp(few, tree, translation=start, max_iterations=_COARSE_ITERATIONS) for start in starts
    ]
    best = min(coarse, key=lambda result: result.rms)
    return icp(surface, tree, rotation=best.rotation, translation=best.translation)
