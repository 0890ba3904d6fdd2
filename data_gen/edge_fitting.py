"""Fits a morphable model and a camera to landmarks and to the edges along a face's outline."""

from dataclasses import dataclass, replace

import numpy as np

from data_gen.edges import EdgeMatcher, ImageEdges, Surface, edges_about
from data_gen.landmark_fitting import (
    N_POSE,
    LandmarkFitter,
    jacobian,
    moved,
    normal_equations,
    seen_by,
)
from data_gen.landmarks import load_vertices
from data_gen.models.mesh import largest_component
from data_gen.models.morphable_model import MorphableModel
from data_gen.renderer import part_of
from deepmds_keras.errors import InputError, naming
from deepmds_keras.geometry.camera import HeadPose

_N_JAW = load_vertices("ibug51").numbers[0] - 1
# Those of Bas et al.: of the mean squared distance of edges and that of landmarks, in pixels, and
# of the mean squared coefficient.
_EDGES, _LANDMARKS, _PRIOR = 0.45, 0.15, 0.40
_N_IDENTITY, _BOX = 40, 3.0  # components; standard deviations
_PIXELS_PER_MM = 0.6  # in CelebA's aligned images, where the pupils are 38 pixels apart
_MAX_ROUNDS = 20
_TOLERANCE = 0.05  # change of a coefficient, or ten times that of the rotation or the scale

# Millimetres on the face. Little depends on them: half or twice as much changes the mean error of
# fits to renders by 5 % at most.
_REACH, _TURN = 6.0, 8.0  # see EdgeMatcher
_ROBUST = 2.0  # distance of an edge that has a quarter of its weight (Geman and McClure 1987)
_AROUND = 10.0  # beyond the hull of the landmarks, how far edges are looked for

_OUTER_EYE_CORNERS, _MOUTH_CORNERS, _CHIN = (36, 45), (48, 54), (8,)  # of iBUG's landmarks
_FACE = (0.75, 0.4, 0.95)  # below mouth, above and behind eyes, in distances of eyes and mouth
_BORDER = 0.3  # of them, around that, where other parts may hide it
# Meshes on which the tables have some of the landmarks, by their numbers of vertices.
_PARTLY_KNOWN = {"bfm2009": 53490, "bfm2017": 53149}


@dataclass(frozen=True, eq=False)
class EdgeFit:
    """A neutral face of a model, and a camera, that put landmarks and outline where they are.

    The vertices are `model.shape(fit.identity)`, in the frame of the model and in millimetres of
    its scale: one view alone does not tell a near small face from a far large one.

    Attributes:
        identity: `(K,)` standard-normal coefficients, from -3 to 3.
        camera: Camera from the frame of the model to pixels, but y up.
    """

    identity: np.ndarray
    camera: HeadPose

    def project(self, vertices: np.ndarray) -> np.ndarray:
        """Where points of the model are seen: `(..., 3)` mm → `(..., 2)` pixels, y down."""
        return seen_by(self.camera, vertices) * (1, -1)


class EdgeFitter:
    """Fits landmarks and occluding edges in the spirit of Bas et al. 2016, arXiv:1602.01125.

    As theirs: a scaled orthographic camera; 40 identity coefficients within three standard
    deviations, and no expression; a start from landmarks alone; then rounds, at most 20. Each
    matches the outline that the model now has with the nearest Canny edges. Then it finds pose and
    identity from edges, landmarks and prior, weighted 0.45, 0.15 and 0.40, each over its count.
    Their pixels are taken to be those of CelebA's aligned images. Edges are looked for at about
    that size, so that larger images of a face give much the same.

    Unlike theirs: the outline is the face's alone, as hair covers the head's, and only where it is
    seen against something well behind it. Edges that run another way or lie far from all landmarks
    do not match; the distance across the outline counts alone; and far matches lose weight, instead
    of the worst 5 % being dropped. Of the detector's jaw line (landmarks 1 to 17) only the chin is
    used: the rest is no fixed line of the mesh, and taken for points of the outline it made fits to
    renders no better.

    A fit takes 10 to 25 ms, and 100 ms with the 53,490 vertices of the Basel Face Model 2009, where
    BLAS runs in one thread (`threadpoolctl`).

    Args:
        model: Morphable model with landmarks `"ibug68"`, `"ibug51"`, or, as the Basel Face Models,
            `"bfm72"`, some of which are the same points.

    Raises:
        InputError: The model has none of these.
    """

    def __init__(self, model: MorphableModel):
        self._known, vertices = _known_landmarks(model)
        n_identity = min(_N_IDENTITY, model.n_identity)
        # What the weights say in units of the prior: a squared coefficient counts 1.
        self._landmark_sd, self._edges_sd = (
            np.sqrt(_PRIOR / n_identity / weight) / _PIXELS_PER_MM
            for weight in (_LANDMARKS / len(vertices), _EDGES)
        )
        self._start = LandmarkFitter(
            replace(model, landmarks={"known": vertices}),
            "known",
            n_identity=n_identity,
            n_expression=0,
            landmark_sd=self._landmark_sd,
        )
        part = model.restrict(vertices)
        self._mean = part.mean
        self._basis = part.identity_basis_times_sd[:n_identity].astype(float)
        face, within = _face_of(model, dict(zip(self._known.tolist(), part.mean, strict=True)))
        self._surface = Surface(face, within, n_identity)

    def fit(self, landmarks: np.ndarray, image: np.ndarray) -> EdgeFit:
        """The most probable face and camera.

        Args:
            landmarks: `(68, 2)` as a detector finds iBUG's: pixels, x right and y down, the left
                upper corner of the image being (0, 0).
            image: `(H, W, 3)` uint8 RGB. Where it has no edges near the outline, the landmarks
                decide alone.

        Raises:
            InputError: Most landmarks lie beyond the image, or are not of a face that is seen from
                in front.
        """
        n_inside = ((landmarks >= 0) & (landmarks <= image.shape[1::-1])).all(1).sum()
        if n_inside < len(landmarks) / 2:
            raise InputError(
                f"landmarks must be pixels of the image, of {image.shape[1]} x {image.shape[0]}. "
                f"Received {n_inside} of {len(landmarks)} within it."
            )
        targets = landmarks[self._known] * (1, -1)
        with naming("landmarks, here with y turned up"):
            start = self._start.fit(targets)
        # Pixels a millimetre at the start, throughout: by its own, a smaller face would fit better.
        pose = start.camera
        unit = pose.scale
        edges = edges_about(landmarks, image, _AROUND * unit, round(unit / _PIXELS_PER_MM))
        edges = ImageEdges(edges.points * (1, -1), edges.normals * (1, -1))
        matcher = EdgeMatcher(edges, _REACH * unit, _TURN * unit)
        identity = start.identity.clip(-_BOX, _BOX)
        for _ in range(_MAX_ROUNDS):
            outline = self._surface.occluding_edges(identity, pose.rotation)
            near, places = matcher.match(seen_by(pose, outline.points), outline.normals)
            outline = outline[near]
            distances = ((seen_by(pose, outline.points) - places) * outline.normals).sum(1)
            robust = (1 + (distances / (_ROBUST * unit)) ** 2) ** -2
            weights = np.sqrt(outline.shares * robust) / (self._edges_sd * unit)
            by_edges = jacobian(pose, outline.points, outline.basis)
            seen = self._mean + np.tensordot(identity, self._basis, 1)
            missed = (seen_by(pose, seen) - targets) / (self._landmark_sd * unit)
            by_landmarks = jacobian(pose, seen, self._basis) / (self._landmark_sd * unit)
            by_edges = (by_edges * outline.normals).sum(2) * weights
            curvature, gradient = normal_equations(
                np.concatenate([by_edges, by_landmarks.reshape(len(by_edges), -1)], axis=1),
                np.concatenate([distances * weights, missed.ravel()]),
                identity,
            )
            step = np.linalg.solve(curvature, -gradient)
            previous, identity = identity, (identity + step[N_POSE:]).clip(-_BOX, _BOX)
            pose = moved(pose, step)
            change = max(np.abs(identity - previous).max(), 10 * np.abs(step[:4]).max())
            if change < _TOLERANCE:
                break
        return EdgeFit(identity, pose)


def _known_landmarks(model: MorphableModel) -> tuple[np.ndarray, np.ndarray]:
    """Those of the chin and the 51 inner landmarks that a model knows, and their vertices."""
    known = {}
    if "bfm72" in model.landmarks:
        on_openhead = [load_vertices(s).vertices["openhead"] for s in ("ibug68", "bfm72")]
        _, same, others = np.intersect1d(*on_openhead, return_indices=True)
        known.update(zip(same.tolist(), model.landmarks["bfm72"][others].tolist(), strict=True))
    if model.n_vertices == _PARTLY_KNOWN.get(model.name):
        known.update(load_vertices("ibug68").anchors[model.name])
    for scheme, first in (("ibug51", _N_JAW), ("ibug68", 0)):
        known.update(enumerate(model.landmarks.get(scheme, np.empty(0, int)).tolist(), first))
    known = {i: vertex for i, vertex in sorted(known.items()) if i >= _N_JAW or i in _CHIN}
    if not known.keys() >= {*_OUTER_EYE_CORNERS, *_MOUTH_CORNERS}:
        raise InputError(
            f"{model.name} must be a mesh with the landmarks ibug68, ibug51 or bfm72."
            f" Received one that has {', '.join(model.landmarks) or 'none'}."
        )
    return np.array([*known]), np.array([*known.values()])


def _face_of(
    model: MorphableModel, landmarks: dict[int, np.ndarray]
) -> tuple[MorphableModel, np.ndarray]:
    """The skin of the face with what is around it, and `(V,)` bool, which of it is the face.

    From the brows to below the chin, and back to before the ears; landmarks are in millimetres.
    """
    eyes, mouth = (
        np.mean([landmarks[i] for i in pair], axis=0)
        for pair in (_OUTER_EYE_CORNERS, _MOUTH_CORNERS)
    )
    unit = eyes[1] - mouth[1]
    below, above, behind = (unit * share for share in _FACE)
    _, y, z = model.mean.T
    beyond = np.max([mouth[1] - below - y, y - eyes[1] - above, eyes[2] - behind - z], axis=0)
    skin = np.zeros(model.n_vertices, bool)
    skin[largest_component(model.n_vertices, model.triangles)] = True
    kept = np.flatnonzero(skin & (beyond < unit * _BORDER))
    return part_of(model, kept), beyond[kept] < 0
