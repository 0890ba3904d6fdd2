"""An open substitute for the CASIA-3D scans: faces of a model, photographed and scanned."""

from dataclasses import dataclass

import numpy as np

from data_gen.datasets.dataset import Dataset, dataset_of
from data_gen.datasets.images import Scene, make_scene, posed_faces, render
from data_gen.models.expressions import SCAN_EXPRESSIONS, scan_expression_weights
from data_gen.models.mesh import triangle_corners, vertex_normals
from data_gen.models.morphable_model import MorphableModel
from data_gen.renderer import Rasteriser
from deepmds_keras.geometry.views import in_camera_frame, sample_perspective_cameras

SCHEME = "ibug51"
_PIXELS, _MARGIN = 320, 2.6  # a photo with room about the face, about 0.85 mm a pixel
_YAW, _PITCH, _ROLL = 20.0, 10.0, 5.0  # degrees to either side
# The angle that the landmarks fill from 0.75 to 1.25 m away, as scanners stand.
_FIELD_OF_VIEW = (6.0, 10.0)
_EYES = (slice(19, 25), slice(25, 31))  # landmarks about each
# Of the scanner.
_REACH_MM = 140.0  # what lies farther from the middle of the landmarks is cut off
_SCAN_PIXELS = 2 * int(_REACH_MM)  # a point a millimetre
_NOISE_MM = 0.2  # s.d. along the line of sight, twice the makers' figure for a still target
_GRAZING = 0.25  # cosine below which a surface sends too little light back
_EYE_HOLES, _EYE_MM = 0.5, 7.0  # share of eyes that leave a hole; its radius
_N_HOLES, _HOLES_MM = 3.0, (2.0, 7.0)  # mean number of others; their radii


@dataclass(frozen=True, eq=False)
class Scan:
    """A photo of a face and a scan of it.

    Attributes:
        name: Unique within its source, such as `"001-004"`.
        condition: What the source says of it, such as the name of an expression; may be empty.
        image: `(H, W, 3)` uint8, RGB.
        points: `(n, 3)` millimetres: +x to the right of the image, +y up, +z towards the viewer.
        truth: `(51, 3)` true landmarks in millimetres, in the frame of the face model, or None
            where nobody knows them.
    """

    name: str
    condition: str
    image: np.ndarray
    points: np.ndarray
    truth: np.ndarray | None = None


class ScansSubstitute:
    """Subjects who hold one of six expressions a scan, their heads a little turned.

    Identity is standard normal and differs between subjects alone; pose, light, colours, noise and
    holes differ between scans. Subjects are drawn one by one, each from its random numbers.

    Args:
        model: Morphable model with landmarks `"ibug51"` and named expressions.
        n_scans: Total number of scans, spread evenly.

    Raises:
        InputError: As `images.make_scene`, or the model's expressions have other names.
    """

    def __init__(self, model: MorphableModel, n_subjects: int, n_scans: int, seed: list[int]):
        self.n_subjects, self.n_scans, self._seed = n_subjects, n_scans, seed
        self._landmarks = model.at_landmarks(SCHEME)
        self._scene: Scene = make_scene(model, SCHEME, _PIXELS, margin=_MARGIN, expressive=True)

    def scans_of(self, subject: int) -> int:
        """Number of scans of a subject."""
        return self.n_scans // self.n_subjects + (subject < self.n_scans % self.n_subjects)

    def subject(self, subject: int) -> list[Scan]:
        """The scans of one subject."""
        rng = np.random.default_rng([*self._seed, subject])
        n = self.scans_of(subject)
        names = [SCAN_EXPRESSIONS[k % len(SCAN_EXPRESSIONS)] for k in range(n)]
        dataset = self._faces(names, rng)
        images, _ = render(self._scene, dataset, range(n), rng)
        points = _scan(self._scene.model, dataset, rng)
        return [
            Scan(f"{subject + 1:03}-{k + 1:03}", names[k], images[k], points[k], truth)
            for k, truth in enumerate(dataset.landmarks.astype(float))
        ]

    def _faces(self, expressions: list[str], rng: np.random.Generator) -> Dataset:
        n, model = len(expressions), self._landmarks
        identity = np.repeat(rng.standard_normal((1, model.n_identity)), n, axis=0)
        weights = scan_expression_weights(model, expressions, rng)
        cameras = sample_perspective_cameras(
            n, rng, yaw=_YAW, pitch=_PITCH, roll=_ROLL, field_of_view=_FIELD_OF_VIEW
        )
        landmarks = model.shape(identity, weights)
        return dataset_of(landmarks, cameras, {}, identity=identity, expression=weights)


def _scan(model: MorphableModel, dataset: Dataset, rng: np.random.Generator) -> list[np.ndarray]:
    """Points `(n, 3)` of each face, as a triangulating laser scanner would have them.

    The figures are of the kind that CASIA-3D was scanned with (Minolta VIVID 910: one view, about a
    point a millimetre, holes where the surface is dark, wet or seen at a grazing angle).
    """
    triangles, clouds = model.triangles, []
    corners = triangle_corners(model.n_vertices, triangles)
    rasteriser = Rasteriser(model.n_vertices, triangles, _SCAN_PIXELS, by_triangle=True)
    for k, camera in enumerate(dataset.cameras[[k]] for k in range(len(dataset))):
        posed, seen = (points[0] for points in posed_faces(model, dataset, slice(k, k + 1)))
        landmarks = in_camera_frame(dataset.landmarks[k : k + 1].astype(float), camera)[0]
        middle = (landmarks.max(0) + landmarks.min(0)) / 2
        low = middle[:2] - _REACH_MM
        places = (seen[:, :2] - low) * (_SCAN_PIXELS / (2 * _REACH_MM))
        places[:, 1] = _SCAN_PIXELS - places[:, 1]
        number = rasteriser.draw_numbers(places, seen[:, 2])
        row, column = np.nonzero(number < len(triangles))
        hit = triangles[number[row, column]]
        weights = _barycentric(np.column_stack([column + 0.5, row + 0.5]), places[hit])
        points = np.einsum("nk,nkd->nd", weights, posed[hit])
        normals = vertex_normals(posed, triangles, corners)
        towards = np.einsum("nk,nk->n", weights, normals[hit][..., 2])
        kept = (towards > _GRAZING) & (np.linalg.norm(points - middle, axis=1) < _REACH_MM)
        points = points[kept]
        eyes = np.array([landmarks[eye].mean(0) for eye in _EYES])
        points = points[~_in_holes(points, eyes, rng)]
        points[:, 2] += rng.normal(0, _NOISE_MM, len(points))
        clouds.append(points)
    rasteriser.close()
    return clouds


def _barycentric(places: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """Weights `(n, 3)` of the corners `(n, 3, 2)` of a triangle at places `(n, 2)` within it."""
    a, b, c = np.swapaxes(corners, 0, 1)
    u, v, w = b - a, c - a, places - a
    area = u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]
    area = np.where(area == 0, 1, area)
    second = (w[:, 0] * v[:, 1] - w[:, 1] * v[:, 0]) / area
    third = (u[:, 0] * w[:, 1] - u[:, 1] * w[:, 0]) / area
    # The middle of a pixel may lie a little outside of the triangle that is drawn there.
    weights = np.stack([1 - second - third, second, third], axis=1).clip(0, 1)
    return weights / weights.sum(1, keepdims=True)


def _in_holes(points: np.ndarray, eyes: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Mask `(n,)` of the points that fall into a hole: some eyes, and some places anywhere."""
    n = rng.poisson(_N_HOLES)
    centres = np.vstack(
        [eyes[rng.random(len(eyes)) < _EYE_HOLES], points[rng.integers(len(points), size=n)]]
    )
    radii = np.append(np.full(len(centres) - n, _EYE_MM), rng.uniform(*_HOLES_MM, n))
    distance = np.linalg.norm(points[:, None] - centres, axis=2)
    return (distance < radii).any(1)
