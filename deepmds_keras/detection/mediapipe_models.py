"""MediaPipe's models of the face, each as a function of one image.

FaceMesh (Kartynnik et al. 2019, arXiv:1907.06724) comes with MediaPipe up to 0.10.21; later
releases bring no model, and take a face landmarker from a file of the user's (`.task`).
"""

from __future__ import annotations

from collections.abc import Iterable
from importlib.metadata import PackageNotFoundError, version
from importlib.util import find_spec
from pathlib import Path

import numpy as np

from deepmds_keras.detection.mediapipe_loading import bare_package, without_tensorflow
from deepmds_keras.errors import InputError

N_POINTS = 468
_GRAPH = "modules/face_landmark/face_landmark_front_cpu.binarypb"
_POINTS, _SCORES = "multi_face_landmarks", "face_detections"
_HOW_TO = (
    "pip install 'deepmds-keras[mediapipe]', which has wheels for Python 3.10 to 3.12 on x86-64 "
    "and macOS; a later MediaPipe takes a model by --landmarker FILE; or take --detector dlib"
)


class FaceMesh:
    """The model that MediaPipe 0.10.21 brings; each image is looked at by itself.

    Args:
        max_faces: Of one image.

    Raises:
        InputError: No MediaPipe that has it is installed.
    """

    def __init__(self, max_faces: int):
        file = _face_mesh_file()
        if file is None:
            raise _no_mediapipe(f"MediaPipe with FaceMesh must be installed: {_HOW_TO}")
        try:
            with bare_package():
                import mediapipe.python as mp
                from mediapipe.framework.formats import (  # noqa: F401 what comes out is of these
                    detection_pb2,
                    landmark_pb2,
                )
        except ImportError as error:
            raise _no_mediapipe(f"MediaPipe must be whole: {_HOW_TO}", error) from None
        self._mp, self._packets, self._n_images = mp, {_POINTS: [], _SCORES: []}, 0
        mp.resource_util.set_resource_dir(str(file.parents[3]))
        self._graph = mp.CalculatorGraph(binary_graph_path=str(file))
        for name, packets in self._packets.items():
            self._graph.observe_output_stream(
                name, lambda _, packet, own=packets: own.append(packet)
            )
        make = mp.packet_creator
        self._graph.start_run(
            {
                "num_faces": make.create_int(max_faces),
                "with_attention": make.create_bool(False),
                # Else the search for a face would begin where the last image had one.
                "use_prev_landmarks": make.create_bool(False),
            }
        )
        self._graph.wait_until_idle()  # until its threads have loaded the models

    def __call__(self, image: np.ndarray) -> tuple[np.ndarray, float]:
        """Points of the faces in an image, and how much the surest of them looks like a face.

        Args:
            image: `(H, W, 3)` uint8 RGB, contiguous.

        Returns:
            `(n, 468, 3)`: x and y in shares of the width and of the height, z in shares of the
            width and smaller when nearer. 0 to 1: above 0.9 for most upright faces, and less
            where the image lies on its side or is upside down; 0 where there is none.
        """
        mp = self._mp
        frame = mp.packet_creator.create_image_frame(image, image_format=mp.ImageFormat.SRGB)
        self._n_images += 1  # its time stamp, which must grow
        for packets in self._packets.values():
            packets.clear()
        self._graph.add_packet_to_input_stream("image", frame.at(self._n_images))
        self._graph.wait_until_idle()
        faces, boxes = (
            [proto for packet in packets for proto in mp.packet_getter.get_proto_list(packet)]
            for packets in self._packets.values()
        )
        points = _points(face.landmark for face in faces)
        return points, max(box.score[0] for box in boxes) if faces else 0.0


class FaceLandmarker:
    """The model in a file of the user's, by a MediaPipe that has the task API.

    It must be let go of before the interpreter ends, or MediaPipe complains then.

    Args:
        path: The file, such as `face_landmarker.task`.
        max_faces: Of one image.

    Raises:
        InputError: It is no such file, or no MediaPipe that reads it is installed.
    """

    def __init__(self, path: str | Path, max_faces: int):
        try:
            content = Path(path).read_bytes()
        except OSError as error:
            raise _no_landmarker(path, error.strerror) from None
        try:
            with without_tensorflow():
                import mediapipe as mp

                options = mp.tasks.vision.FaceLandmarkerOptions(
                    base_options=mp.tasks.BaseOptions(model_asset_buffer=content),
                    num_faces=max_faces,
                )
                self._model = mp.tasks.vision.FaceLandmarker.create_from_options(options)
        except (ImportError, AttributeError, TypeError) as error:
            needed = (
                "--landmarker needs a whole MediaPipe, 0.10.30 or later: pip install -U mediapipe"
            )
            raise _no_mediapipe(needed, error) from None
        except (RuntimeError, ValueError, OSError) as error:
            raise _no_landmarker(path, _line(error)) from None
        self._path, self._image = path, lambda data: mp.Image(mp.ImageFormat.SRGB, data)

    def __call__(self, image: np.ndarray) -> tuple[np.ndarray, float]:
        """As `FaceMesh`, without the points of the irises; the score is 1, or 0 without a face.

        Raises:
            InputError: The model has fewer points.
        """
        faces = _points(self._model.detect(self._image(image)).face_landmarks)
        if faces.shape[1] < N_POINTS:
            raise _no_landmarker(self._path, f"{faces.shape[1]} points a face")
        return faces[:, :N_POINTS], float(len(faces) > 0)


def has_face_mesh() -> bool:
    """Whether a MediaPipe is installed that brings FaceMesh; loads nothing."""
    return _face_mesh_file() is not None


def _face_mesh_file() -> Path | None:
    spec = find_spec("mediapipe")
    folders = spec.submodule_search_locations or () if spec else ()
    return next((path for path in (Path(own, _GRAPH) for own in folders) if path.is_file()), None)


def _points(faces: Iterable) -> np.ndarray:
    points = [[(point.x, point.y, point.z) for point in face] for face in faces]
    return np.array(points) if points else np.empty((0, N_POINTS, 3))


def _no_mediapipe(needed: str, error: Exception | None = None) -> InputError:
    try:
        found = f"MediaPipe {version('mediapipe')}"
    except PackageNotFoundError:
        found = "no MediaPipe"
    return InputError(f"{needed}. Received {found}{f', {_line(error)}' if error else ''}.")


def _no_landmarker(path: str | Path, received: str) -> InputError:
    return InputError(
        f"{path} must be a face landmarker of MediaPipe's, such as face_landmarker.task. "
        f"Received: {received}."
    )


def _line(error: Exception) -> str:
    return f"{type(error).__name__}: {' '.join(str(error).split())[:120]}".rstrip(".")
