"""FaceMesh's 468 points of faces in images, by MediaPipe, and the 51 landmarks of them.

FaceMesh (Kartynnik et al. 2019, arXiv:1907.06724) comes with MediaPipe up to 0.10.21; later
releases contain no model and need a face landmarker file (`.task`) from the user.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, nullcontext, redirect_stderr
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from importlib.util import find_spec, module_from_spec
from pathlib import Path

import numpy as np

from deepmds_keras.errors import InputError, brief
from deepmds_keras.files import read_table
from deepmds_keras.landmarks import FOLDER
from deepmds_keras.tool.detection.photos import check_photo

N_POINTS = 468
_GRAPH = "modules/face_landmark/face_landmark_front_cpu.binarypb"
_POINTS, _DETECTIONS = "multi_face_landmarks", "face_detections"
_HOW_TO = (
    "from the repository, pip install '.[mediapipe]', for Python 3.11 and 3.12 on x86-64 and "
    "macOS; a later MediaPipe takes a model by --landmarker FILE; or take --detector dlib"
)


@cache
def shared_detector() -> MediaPipeLandmarks:
    """The FaceMesh detector of this process: it takes a while to start."""
    return MediaPipeLandmarks()


class MediaPipeLandmarks:
    """Finds the points of the faces in an image; not for two threads at once.

    Args:
        landmarker: File of a face landmarker (`.task`), for a MediaPipe later than 0.10.21; None
            uses the FaceMesh in 0.10.21.
        max_faces: Maximum number of faces per image.

    Raises:
        InputError: No such MediaPipe is installed, or the file is not such a model.
    """

    def __init__(self, landmarker: str | Path | None = None, *, max_faces: int = 20):
        with _silenced():
            self._find: _FaceMesh | _FaceLandmarker = (
                _FaceMesh(max_faces)
                if landmarker is None
                else _FaceLandmarker(landmarker, max_faces)
            )
        self._has_found = False

    def detect_all(self, image: np.ndarray) -> np.ndarray:
        """Points of every face, without the scores of `detect_scored`."""
        return self.detect_scored(image)[0]

    def detect_scored(self, image: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Points of every face, the largest first, and the detector's scores.

        Args:
            image: `(H, W, 3)` uint8 RGB.

        Returns:
            `(n, 468, 3)` float32 pixels, x right and y down from the upper left corner, z in the
            same scale and growing towards the viewer; n may be 0. `(n,)` scores: above 0.9 for
            most upright faces, and less if the image lies on its side or is upside down; NaN for
            a landmarker, which gives none.

        Raises:
            InputError: Not such an image.
        """
        image = np.ascontiguousarray(check_photo(image))
        # The library logs only until it has found a face.
        with nullcontext() if self._has_found else _silenced():
            faces, scores = self._find(image)
        self._has_found |= len(faces) > 0
        height, width = image.shape[:2]
        points = (faces * (width, height, -width)).astype(np.float32)
        order = np.argsort(-np.ptp(points[..., :2], axis=1).prod(1), kind="stable")
        return points[order], scores[order]


def detect(images: Iterable[np.ndarray]) -> np.ndarray:
    """Points of the most prominent face in each image `(H, W, 3)` uint8 RGB, by FaceMesh.

    Returns:
        `(n, 468, 3)` float32 as from `MediaPipeLandmarks.detect_all`; NaN where no face is found.
    """
    detector = MediaPipeLandmarks(max_faces=1)
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


def has_face_mesh() -> bool:
    """Whether a MediaPipe that contains FaceMesh is installed; loads nothing."""
    return _face_mesh_file() is not None


class _FaceMesh:
    """The model in MediaPipe 0.10.21, as a function of one image."""

    def __init__(self, max_faces: int):
        file = _face_mesh_file()
        if file is None:
            raise _no_mediapipe(f"MediaPipe with FaceMesh must be installed: {_HOW_TO}")
        try:
            with _bare_package():
                import mediapipe.python as mp
                from mediapipe.framework.formats import (  # noqa: F401 what comes out is of these
                    detection_pb2,
                    landmark_pb2,
                )
        except ImportError as error:
            raise _no_mediapipe(f"MediaPipe must be whole: {_HOW_TO}", error) from None
        self._mp, self._n_images = mp, 0
        self._packets: dict[str, list] = {_POINTS: [], _DETECTIONS: []}
        mp.resource_util.set_resource_dir(str(file.parents[3]))
        self._graph = mp.CalculatorGraph(binary_graph_path=str(file))
        for name, packets in self._packets.items():
            self._graph.observe_output_stream(
                name, lambda _, packet, packets=packets: packets.append(packet)
            )
        make = mp.packet_creator
        self._graph.start_run(
            {
                "num_faces": make.create_int(max_faces),
                "with_attention": make.create_bool(False),
                # Otherwise the search for a face would begin where the last image had one.
                "use_prev_landmarks": make.create_bool(False),
            }
        )
        self._graph.wait_until_idle()  # until its threads have loaded the models

    def __call__(self, image: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """`(n, 468, 3)`: x, z in units of the width, y of the height, z smaller when nearer.

        Also `(n,)` scores: each face takes that of the nearest detected box.
        """
        mp = self._mp
        frame = mp.packet_creator.create_image_frame(image, image_format=mp.ImageFormat.SRGB)
        self._n_images += 1  # its time stamp, which must grow
        for packets in self._packets.values():
            packets.clear()
        self._graph.add_packet_to_input_stream("image", frame.at(self._n_images))
        self._graph.wait_until_idle()
        faces, detections = (
            [proto for packet in packets for proto in mp.packet_getter.get_proto_list(packet)]
            for packets in self._packets.values()
        )
        points = _points(face.landmark for face in faces)
        if not faces:
            return points, np.empty(0)
        boxes = [detection.location_data.relative_bounding_box for detection in detections]
        centres = [(box.xmin + box.width / 2, box.ymin + box.height / 2) for box in boxes]
        apart = np.linalg.norm(points[:, None, :, :2].mean(2) - np.array(centres), axis=2)
        return points, np.array([detections[i].score[0] for i in apart.argmin(1)])


class _FaceLandmarker:
    """The model in the user's file, by a MediaPipe that has the task API.

    It must be released before the interpreter ends, or MediaPipe prints an error.
    """

    def __init__(self, path: str | Path, max_faces: int):
        try:
            content = Path(path).read_bytes()
        except OSError as error:
            raise _no_landmarker(path, error.strerror or brief(error)) from None
        try:
            import mediapipe as mp

            options = mp.tasks.vision.FaceLandmarkerOptions(
                base_options=mp.tasks.BaseOptions(model_asset_buffer=content),
                num_faces=max_faces,
            )
            self._model = mp.tasks.vision.FaceLandmarker.create_from_options(options)
        except (ImportError, AttributeError, TypeError) as error:
            needed = "--landmarker needs a whole MediaPipe 0.10.30 or later, which is not that of "
            raise _no_mediapipe(f"{needed}the extra mediapipe", error) from None
        except (RuntimeError, ValueError, OSError) as error:
            raise _no_landmarker(
                path, f"{type(error).__name__}: {brief(error).rstrip('.')}"
            ) from None
        self._path, self._image = path, lambda data: mp.Image(mp.ImageFormat.SRGB, data)

    def __call__(self, image: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """As for `_FaceMesh`, without the points of the irises; scores are NaN."""
        faces = _points(self._model.detect(self._image(image)).face_landmarks)
        if faces.shape[1] < N_POINTS:
            raise _no_landmarker(self._path, f"{faces.shape[1]} points a face")
        return faces[:, :N_POINTS], np.full(len(faces), np.nan)


def _points(faces: Iterable) -> np.ndarray:
    points = [[(point.x, point.y, point.z) for point in face] for face in faces]
    return np.array(points) if points else np.empty((0, N_POINTS, 3))


def _face_mesh_file() -> Path | None:
    spec = find_spec("mediapipe")
    folders = spec.submodule_search_locations or () if spec else ()
    return next((path for path in (Path(f, _GRAPH) for f in folders) if path.is_file()), None)


def _no_mediapipe(needed: str, error: Exception | None = None) -> InputError:
    try:
        received = f"MediaPipe {version('mediapipe')}"
    except PackageNotFoundError:
        received = "no MediaPipe"
    cause = f", {type(error).__name__}: {brief(error)}" if error else ""
    return InputError(f"{needed}. Received {received}{cause}.")


def _no_landmarker(path: str | Path, received: str) -> InputError:
    return InputError(f"{path} must be a face landmarker of MediaPipe's. Received: {received}.")


@contextmanager
def _bare_package() -> Iterator[None]:
    """Allow parts of MediaPipe to be imported without all of it.

    The package's `__init__` imports OpenCV, matplotlib and, if installed, TensorFlow and JAX;
    FaceMesh needs none of them (0.2 s instead of 5 to 20 s, and no libGL). A later import of
    MediaPipe gets all of it, with the same compiled library.
    """
    spec = find_spec("mediapipe")
    if spec is None or "mediapipe" in sys.modules:
        yield
        return
    sys.modules["mediapipe"] = module_from_spec(spec)
    try:
        yield
    finally:
        for name in [name for name in sys.modules if name.partition(".")[0] == "mediapipe"]:
            if not name.startswith("mediapipe.python._framework_bindings"):
                del sys.modules[name]


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
