"""FaceMesh's 468 points of faces in images, by MediaPipe, and the 51 landmarks of them.

The model is FaceMesh (Kartynnik et al. 2019, arXiv:1907.06724) with its detector of faces, in
`face_landmarker.task`, which `data_gen/build_landmarker.py` makes.
"""

from __future__ import annotations

import io
import os
import sys
import weakref
import zipfile
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, nullcontext, redirect_stderr
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from importlib.util import find_spec
from pathlib import Path
from types import ModuleType, SimpleNamespace

import numpy as np

from deepmds_keras.errors import InputError, brief, check_fork
from deepmds_keras.files import read_table
from deepmds_keras.landmarks import FOLDER
from deepmds_keras.tool.detection.photos import check_photo
from deepmds_keras.tool.detection.small_faces import find_faces

N_POINTS = 468
LANDMARKER = Path(__file__).with_name("face_landmarker.task")
_DETECTOR = "face_detector.tflite"  # in the bundle
_MOST_FACES = 100
# Pixels: OpenCV ends the process where a side of an image or of the crop around a face is too long.
_LONGEST_SIDE = 16_384


@cache
def shared_detector() -> MediaPipeLandmarks:
    """The FaceMesh detector of this process: it takes a while to start."""
    return MediaPipeLandmarks()


class MediaPipeLandmarks:
    """Finds the points of the faces in an image; not for two threads at once.

    Args:
        landmarker: File of a face landmarker (`.task`); None uses the one in the package.

    Raises:
        InputError: MediaPipe is not installed, the file is not such a model, or this is a fork of
            a process that has used MediaPipe.
    """

    def __init__(self, landmarker: str | Path | None = None):
        check_fork("MediaPipe")
        self._path = LANDMARKER if landmarker is None else Path(landmarker)
        with _silenced():
            self._open()
        self._has_found = False

    def _open(self) -> None:
        mp = _import_mediapipe()
        try:
            bundle = self._path.read_bytes()
            with zipfile.ZipFile(io.BytesIO(bundle)) as files:
                detector = files.read(_DETECTOR)
            vision, base = mp.tasks.vision, mp.tasks.BaseOptions
            self._landmarker = vision.FaceLandmarker.create_from_options(
                vision.FaceLandmarkerOptions(
                    base_options=base(model_asset_buffer=bundle), num_faces=_MOST_FACES
                )
            )
            # The landmarker keeps the scores of its detector to itself.
            self._detector = vision.FaceDetector.create_from_options(
                vision.FaceDetectorOptions(base_options=base(model_asset_buffer=detector))
            )
        except (AttributeError, TypeError) as error:
            raise _no_mediapipe(error) from None
        except (RuntimeError, ValueError, OSError, KeyError, zipfile.BadZipFile) as error:
            cause = f"{type(error).__name__}: {brief(error).rstrip('.')}"
            raise InputError(
                f"{self._path} must be a MediaPipe face landmarker. "
                f"Received: {getattr(error, 'strerror', None) or cause}."
            ) from None
        for model in (self._landmarker, self._detector):
            # Its own release, when the interpreter ends, prints an error.
            release, model.close = model.close, lambda: None
            weakref.finalize(self, release).atexit = False
        self._image = lambda data: mp.Image(mp.ImageFormat.SRGB, np.ascontiguousarray(data))

    def detect_all(self, image: np.ndarray) -> np.ndarray:
        """Points of every face, without the scores of `detect_scored`."""
        return self.detect_scored(image)[0]

    def detect_scored(
        self, image: np.ndarray, before: np.ndarray | None = None
    ) -> tuple[np.ndarray, np.ndarray]:
        """Points of every face, the largest first, and the detector's scores.

        Args:
            image: `(H, W, 3)` uint8 RGB.
            before: As for `find_faces`.

        Returns:
            `(n, 468, 3)` float32 pixels, x right and y down from the upper left corner, z in the
            same scale and growing towards the viewer; n may be 0. `(n,)` scores: above 0.9 for
            most upright faces, and less if the image lies on its side or is upside down.

        Raises:
            InputError: Not such an image, or in a fork of the process.
        """
        check_fork("MediaPipe")
        image = check_photo(image)
        factor = -(-max(image.shape[:2]) // _LONGEST_SIDE)
        before = None if before is None else before / factor
        image = image[::factor, ::factor]
        points, scores = find_faces(image, self._find, self._find_boxes, before)
        points = points * np.float32(factor)
        order = np.argsort(-np.ptp(points[..., :2], axis=1).prod(1), kind="stable")
        return points[order], scores[order]

    def _find(self, image: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Large faces, as `detect_scored` returns them, in any order.

        Each takes the score of the nearest detected box.
        """
        frame, (height, width) = self._image(image), image.shape[:2]
        # The library logs only until it has found a face.
        with nullcontext() if self._has_found else _silenced():
            faces = self._landmarker.detect(frame).face_landmarks
            detections = self._detector.detect(frame).detections
        if not faces:
            return np.empty((0, N_POINTS, 3), np.float32), np.empty(0)
        self._has_found = True
        points = np.array([[(point.x, point.y, point.z) for point in face] for face in faces])
        points = points[:, :N_POINTS] * (width, height, -width)
        boxes = _boxes(detections)
        centres = (boxes[:, :2] + boxes[:, 2:4]) / 2
        nearest = np.linalg.norm(points[:, None, :, :2].mean(2) - centres, axis=2).argmin(1)
        # The unit of z is that of the line between the detected eyes, drawn in the unit square.
        eyes = np.array([[(k.x, k.y) for k in detections[i].keypoints[:2]] for i in nearest])
        lines = np.diff(eyes, axis=1)[:, 0]
        z = np.linalg.norm(lines * (1, height / width), axis=1) / np.linalg.norm(lines, axis=1)
        points[..., 2] *= z[:, None]
        return points.astype(np.float32), boxes[nearest, 4]

    def _find_boxes(self, image: np.ndarray) -> np.ndarray:
        """`(n, 5)` boxes of faces: left, top, right, bottom in pixels, score."""
        with nullcontext() if self._has_found else _silenced():
            return _boxes(self._detector.detect(self._image(image)).detections)


def detect(images: Iterable[np.ndarray]) -> np.ndarray:
    """Points of the largest face in each image `(H, W, 3)` uint8 RGB.

    Returns:
        `(n, 468, 3)` float32 as from `MediaPipeLandmarks.detect_all`; NaN where no face is found.
    """
    detector = shared_detector()
    none = np.full((N_POINTS, 3), np.nan, np.float32)
    faces = [next(iter(detector.detect_all(image)), none) for image in images]
    return np.reshape(faces, (-1, N_POINTS, 3)).astype(np.float32)


def landmarks51(points: np.ndarray, which: str = "corrected") -> np.ndarray:
    """The iBUG landmarks 18 to 68 among FaceMesh's points, in a right-handed frame.

    Args:
        points: `(n, 468, 3)` as from `detect`.
        which: `"corrected"`, or `"authors"` for their published list, whose left brow is off by
            one.

    Returns:
        `(n, 51, 3)` pixels: x right, y up (from the upper edge, so negative inside the image),
        z towards the viewer.
    """
    if points.ndim != 3 or points.shape[1:] != (N_POINTS, 3):
        raise InputError(f"points must have shape (n, {N_POINTS}, 3). Received {points.shape}.")
    column = "number" if which == "corrected" else "authors"
    numbers = [int(row[column]) for row in read_table(FOLDER / "mediapipe_ibug68.csv")]
    return points[:, numbers] * np.array((1, -1, 1), points.dtype)


def _boxes(detections: Iterable) -> np.ndarray:
    boxes = [(each.bounding_box, each.categories[0].score) for each in detections]
    sides = [(b.origin_x, b.origin_y, b.origin_x + b.width, b.origin_y + b.height, score)
             for b, score in boxes]  # fmt: skip
    return np.reshape(np.array(sides, float), (-1, 5))


def has_mediapipe() -> bool:
    """Whether MediaPipe is installed; loads nothing."""
    return find_spec("mediapipe") is not None


def _import_mediapipe() -> ModuleType:
    """MediaPipe, without TensorFlow.

    Where that is installed MediaPipe loads it, 6 s, to mark parts of its own documentation.
    """
    name = "mediapipe.tasks.python.core.optional_dependencies"
    marks = ModuleType(name)
    vars(marks)["doc_controls"] = SimpleNamespace(do_not_generate_docs=lambda part: part)
    sys.modules.setdefault(name, marks)
    try:
        import mediapipe
    except (ImportError, OSError) as error:  # the latter for a compiled library that cannot load
        raise _no_mediapipe(error) from None
    return mediapipe


def _no_mediapipe(error: Exception) -> InputError:
    try:
        received = f"MediaPipe {version('mediapipe')}"
    except PackageNotFoundError:
        received = "no MediaPipe"
    return InputError(
        "MediaPipe 0.10.30 or later must be installed: from the repository, pip install "
        f"'.[mediapipe]'; or use --detector dlib. Received {received}, "
        f"{type(error).__name__}: {brief(error).rstrip('.')}."
    )


@contextmanager
def _silenced() -> Iterator[None]:
    """Silence stderr, where MediaPipe logs in spite of its settings."""
    with open(os.devnull, "w") as nowhere, redirect_stderr(nowhere):
        kept = os.dup(2)
        os.dup2(nowhere.fileno(), 2)
        try:
            yield
        finally:
            os.dup2(kept, 2)
            os.close(kept)
