"""An open stand-in for the CASIA-3D scans: faces of a model, photographed and scanned."""

from __future__ import annotations

import numpy as np

from data_gen.datasets.dataset import Dataset, dataset_of
from data_gen.datasets.images import Scene, make_scene, render
from data_gen.datasets.scanner import Scanner
from data_gen.datasets.scans import Scan
from data_gen.models.expressions import SCAN_EXPRESSIONS, scan_expression_weights
from data_gen.models.morphable_model import MorphableModel
from data_gen.views.projections import (
    in_camera_frame,
    project_with_depth,
    sample_perspective_cameras,
)

SCHEME = "ibug51"
_PIXELS, _MARGIN = 320, 2.6  # a photo with room about the face, about 0.85 mm a pixel
_YAW, _PITCH, _ROLL = 20.0, 10.0, 5.0  # degrees to either side
# The angle that the landmarks fill from 0.75 to 1.25 m away, as scanners stand.
_FIELD_OF_VIEW = (6.0, 10.0)
_EYES = (range(19, 25), range(25, 31))  # landmarks about each


class ScansStandin:
    """Subjects who hold one of six expressions a scan, their heads a little turned.

    Identity is standard normal and differs between subjects alone; pose, light, colours, noise and
    holes differ between scans. Subjects are made one by one, each from its own random numbers.

    Args:
        model: Morphable model with landmarks `"ibug51"` and named expressions.
        n_subjects: People.
        n_scans: Of all of them, spread evenly.
        seed: Of everything random.

    Raises:
        InputError: As `images.make_scene`, or the model's expressions have other names.
    """

    def __init__(self, model: MorphableModel, n_subjects: int, n_scans: int, seed: list[int]):
        self.n_subjects, self.n_scans, self._seed = n_subjects, n_scans, seed
        self._expressions = model.restrict(np.empty(0, int))
        self._landmarks = model.restrict(model.landmarks[SCHEME])
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
        images, pixels = render(self._scene, dataset, range(n), rng)
        points = self._points(dataset, rng)
        return [
            Scan(f"{subject + 1:03}-{k + 1:03}", names[k], images[k], points[k], truth, pixels[k])
            for k, truth in enumerate(dataset.landmarks.astype(float))
        ]

    def _faces(self, expressions: list[str], rng: np.random.Generator) -> Dataset:
        n = len(expressions)
        identity = np.repeat(rng.standard_normal((1, self._landmarks.n_identity)), n, axis=0)
        weights = scan_expression_weights(self._expressions, expressions, rng)
        cameras = sample_perspective_cameras(
            n, rng, yaw=_YAW, pitch=_PITCH, roll=_ROLL, field_of_view=_FIELD_OF_VIEW
        )
        landmarks = self._landmarks.shape(identity, weights)
        return dataset_of(landmarks, cameras, {}, identity=identity, expression=weights)

    def _points(self, dataset: Dataset, rng: np.random.Generator) -> list[np.ndarray]:
        model = self._scene.model
        scanner = Scanner(model.n_vertices, model.triangles)
        points = []
        for k in range(len(dataset)):
            camera = dataset.cameras[k : k + 1]
            shape = model.shape(dataset.identity[k : k + 1], dataset.expression[k : k + 1])
            posed = in_camera_frame(shape, camera)
            landmarks = in_camera_frame(dataset.landmarks[k : k + 1].astype(float), camera)
            seen = project_with_depth(posed, landmarks, camera)
            eyes = np.array([landmarks[0, list(eye)].mean(0) for eye in _EYES])
            points.append(scanner.scan(posed[0], seen[0], landmarks[0], eyes, rng))
        scanner.close()
        return points
