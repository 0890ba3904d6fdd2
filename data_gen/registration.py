"""3D landmarks of a scanned face: iterated closest points, and a face model registered by them.

As the paper does on CASIA-3D: the face model is fitted to the landmarks detected in the photo and
then registered rigidly to the scan; the scan's point nearest to each landmark of the fitted model
is the ground truth.
"""

from dataclasses import dataclass

import numpy as np
from scipy.spatial import KDTree
from scipy.spatial.transform import Rotation

from data_gen.landmark_fitting import LandmarkFit, LandmarkFitter
from data_gen.models.mesh import largest_component, vertex_normals
from data_gen.models.morphable_model import MorphableModel
from deepmds_keras.errors import InputError
from deepmds_keras.geometry.alignment import procrustes

_MIN_POINTS = 3  # fewer leave the rotation open
_STRETCH = 1.5  # growth of the steps while they keep their direction
_LONGEST = 10.0  # times the motion to the closest points
_SAME_DIRECTION = 0.7  # cosine
_TOLERANCE = 1e-3  # mm, motion of the farthest moved source point that ends the search

_NEAR_MM = 40.0  # the part of the model that is registered: so near to a landmark
_SURFACE_POINTS = 1500
_COARSE_POINTS, _COARSE_ITERATIONS = 300, 20
_MAX_RMS_MM = 4.0  # farther from the scan, the model is not where the face is


@dataclass(frozen=True, eq=False)
class IcpResult:
    """A rigid motion: `target ≈ source @ rotation.T + translation`.

    Attributes:
        rotation: `(3, 3)`, of determinant 1, to be multiplied from the left.
        translation: `(3,)` mm.
        rms: Root mean square distance of the last pairs kept, mm.
        n_iterations: Number of searches for closest points.
        converged: Whether the closest points moved no source point by more than 0.001 mm. That may
            still be the wrong resting place, as after a start too far away; `rms` tells.
    """

    rotation: np.ndarray
    translation: np.ndarray
    rms: float
    n_iterations: int
    converged: bool


def icp(
    source: np.ndarray,
    target: KDTree,
    *,
    rotation: np.ndarray | None = None,
    translation: np.ndarray | None = None,
    trim: float = 0.8,
    max_iterations: int = 100,
) -> IcpResult:
    """Moves a point set onto another, point to point.

    Besl and McKay 1992, doi:10.1109/34.121791, with the farthest pairs left out as in Chetverikov
    et al. 2002, doi:10.1109/ICPR.2002.1047997. While steps keep their direction they go beyond the
    closest points, a simple form of Besl and McKay's acceleration: a third of the steps to the
    same rest.

    Args:
        source: `(m, 3)` mm, the set whose every point looks for its closest in the other: the
            model, rather than the scan with its background.
        target: Tree of `(n, 3)` mm.
        rotation: `(3, 3)` to start from; None is the identity.
        translation: `(3,)` mm to start from; None is zero.
        trim: Share in (0, 1] of the source points that are kept, those closest to the target: at
            most what the target shows of the source.
        max_iterations: Look-ups after which to give up.
    """
    rotation = np.eye(3) if rotation is None else rotation
    n_kept = max(_MIN_POINTS, round(trim * len(source)))
    # Motions are about the middle of the source, where turning and shifting are independent.
    centre = source.mean(0)
    centred = source - centre
    radius = np.sqrt((centred**2).sum(1).mean())
    middle = rotation @ centre + (np.zeros(3) if translation is None else translation)
    last, stretch = np.zeros(6), 1.0
    for n_iterations in range(1, max_iterations + 1):
        moved = centred @ rotation.T + middle
        distance, nearest = target.query(moved)
        kept = np.argpartition(distance, n_kept - 1)[:n_kept]
        pairs = centred[kept], target.data[nearest[kept]]
        turned, _, best_middle = procrustes(*pairs, scaling=False, reflection=False)
        best = turned.T
        rms = np.sqrt(((pairs[0] @ best.T + best_middle - pairs[1]) ** 2).sum(1).mean())
        motion = np.linalg.norm(centred @ best.T + best_middle - moved, axis=1).max()
        converged = bool(motion <= _TOLERANCE)
        if converged or n_iterations == max_iterations:
            break
        turn = Rotation.from_matrix(best @ rotation.T).as_rotvec()
        shift = best_middle - middle
        step = np.concatenate([turn * radius, shift])
        cosine = step @ last / max(np.linalg.norm(step) * np.linalg.norm(last), 1e-300)
        if cosine > _SAME_DIRECTION:
            stretch = min(stretch * _STRETCH, _LONGEST)
        elif cosine < 0:
            stretch = 1.0
        rotation = Rotation.from_rotvec(stretch * turn).as_matrix() @ rotation
        middle = middle + stretch * shift
        last = step
    return IcpResult(best, best_middle - best @ centre, float(rms), n_iterations, converged)


@dataclass(frozen=True, eq=False)
class Registration:
    """A fitted model on a scan, and the landmarks that are therefore the ground truth.

    Attributes:
        fit: Of the model to the photo.
        landmarks: `(51, 3)` the scan's points nearest to the model's landmarks, in the frame of the
            face model, millimetres.
        fitted: `(51, 3)` the landmarks of the fitted model, likewise.
        model_to_scan: Rotation `(3, 3)` and translation `(3,)`: a point p of the fitted model is at
            `rotation @ p + translation` in the scan.
    """

    fit: LandmarkFit
    landmarks: np.ndarray
    fitted: np.ndarray
    model_to_scan: tuple[np.ndarray, np.ndarray]


class GroundTruth:
    """Landmarks on scans by a face model with landmarks `"ibug51"` (paper, "Datasets", CASIA3D)."""

    def __init__(self, model: MorphableModel):
        landmarks = model.landmarks["ibug51"]
        self._fitter = LandmarkFitter(model)
        # Of the face's skin about the landmarks, thinned out evenly.
        skin = largest_component(model.n_vertices, model.triangles)
        near = KDTree(model.mean[landmarks]).query(model.mean[skin])[0] < _NEAR_MM
        facing = vertex_normals(model.mean, model.triangles)[skin, 2] > 0
        surface = thinned(skin[near & facing], _SURFACE_POINTS)
        self._n_surface = len(surface)
        self._model = model.restrict(np.concatenate([surface, landmarks]))

    def register(self, pixels: np.ndarray, points: np.ndarray) -> Registration:
        """Landmarks of one scan.

        Args:
            pixels: `(51, 2)` landmarks detected in the photo, x right and y down.
            points: `(n, 3)` of the scan, see `scans.Scan`.

        Raises:
            InputError: The fit or the registration did not converge, or left the model too far from
                the scan. The message says which and by how much.
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
        motion = _register(surface, tree)
        if not motion.converged or motion.rms > _MAX_RMS_MM:
            raise InputError(
                f"The registration must converge to within {_MAX_RMS_MM:g} mm. Received "
                f"{motion.rms:.1f} mm after {motion.n_iterations} iterations"
                f"{'' if motion.converged else ', still moving'}."
            )
        nearest = tree.query(landmarks @ motion.rotation.T + motion.translation)[1]
        rotation = motion.rotation @ fit.camera.rotation
        truth = (points[nearest] - motion.translation) @ rotation
        fitted = shape[self._n_surface :]
        return Registration(fit, truth, fitted, (rotation, motion.translation))


def _register(surface: np.ndarray, tree: KDTree) -> IcpResult:
    """Rigid registration from the better of two starts: middle on middle, front on front."""
    points, few = tree.data, thinned(surface, _COARSE_POINTS)
    starts = (
        points.mean(0) - surface.mean(0),
        points[points[:, 2].argmax()] - surface[surface[:, 2].argmax()],
    )
    coarse = [
        icp(few, tree, translation=start, max_iterations=_COARSE_ITERATIONS) for start in starts
    ]
    best = min(coarse, key=lambda result: result.rms)
    return icp(surface, tree, rotation=best.rotation, translation=best.translation)


def thinned(rows: np.ndarray, most: int) -> np.ndarray:
    """Evenly chosen rows, no more than that many."""
    return rows[:: -(-len(rows) // most)]
