"""The 68 iBUG landmarks of a face in an image, by dlib's detector and shape predictor.

The detector is dlib's frontal HOG one; the predictor an ensemble of regression trees (Kazemi and
Sullivan 2014, doi:10.1109/CVPR.2014.241), trained on iBUG 300-W, whose licence excludes commercial
use. It comes as one file of 99,693,937 bytes.
"""

from __future__ import annotations

import math
from functools import cache
from importlib.util import find_spec
from pathlib import Path

import numpy as np
from PIL import Image

from deepmds_keras.errors import InputError, needs
from deepmds_keras.photos import check_photo

N_LANDMARKS = 68
# What the detector needs grows with the image: at 64 million pixels 3.5 s and 1.1 GB, and four
# times as much where the image is doubled.
SEARCHED_PIXELS = 6_000_000
_FILE = "shape_predictor_68_face_landmarks.dat"
_PACKAGE = "face_recognition_models"
_DEBIAN_FOLDER = Path("/usr/share/dlib")


def find_shape_predictor(path: str | Path | None = None) -> Path:
    """Where dlib's 68-landmark model is.

    Args:
        path: The file itself; None looks into the package face_recognition_models (PyPI), then
            where Debian's libdlib-data puts it.

    Raises:
        InputError: There is no such file.
    """
    if path is not None:
        path = Path(path)
        if not path.is_file():
            raise InputError(f"{path} must be dlib's {_FILE}. Received a path that is no file.")
        return path
    # Found but not imported: on import it asks for pkg_resources, which setuptools has dropped.
    spec = find_spec(_PACKAGE)
    folders = [Path(place) / "models" for place in spec.submodule_search_locations] if spec else []
    for folder in (*folders, _DEBIAN_FOLDER):
        if (folder / _FILE).is_file():
            return folder / _FILE
    raise InputError(
        f"{_FILE} must be on this machine: install it with pip install {_PACKAGE}, or on Debian "
        "and Ubuntu with apt install libdlib-data. Received neither."
    )


@cache
def shared_detector() -> DlibLandmarks:
    """One for each process: its model is large.

    Raises:
        InputError: As `DlibLandmarks`.
    """
    return DlibLandmarks()


class DlibLandmarks:
    """Finds the landmarks of the faces in an image.

    Args:
        path: As for `find_shape_predictor`.

    Raises:
        InputError: dlib is missing, or there is no file or not one of the 68-landmark model.
    """

    def __init__(self, path: str | Path | None = None):
        with needs("dlib", "dlib"):
            import dlib
        found = find_shape_predictor(path)
        try:
            self._predict = dlib.shape_predictor(str(found))
        except (RuntimeError, MemoryError) as error:
            cause = str(error).partition("\n")[0]
            raise InputError(f"{found} must be dlib's {_FILE}, whole. Received: {cause}") from None
        n = self._predict(np.zeros((8, 8, 3), np.uint8), dlib.rectangle(0, 0, 7, 7)).num_parts
        if n != N_LANDMARKS:
            raise InputError(f"{found} must have {N_LANDMARKS} landmarks. Received {n}.")
        self._rectangle = dlib.rectangle
        self._find_faces = dlib.get_frontal_face_detector()

    def detect(self, image: np.ndarray) -> np.ndarray | None:
        """Landmarks of the largest face, `(68, 2)` as from `detect_all`, None where none is found.

        Raises:
            InputError: As `detect_all`.
        """
        faces = self.detect_all(image)
        return faces[0] if len(faces) else None

    def detect_all(self, image: np.ndarray) -> np.ndarray:
        """Landmarks of every face, the largest first.

        Faces of some 80 pixels and more are looked for first; only where there is none, the image
        is doubled, which finds those of half that size. An image of more than 6 million pixels
        is made smaller for the search; the landmarks are placed in the image itself.

        Args:
            image: `(H, W, 3)` uint8 RGB.

        Returns:
            `(n, 68, 2)` float64 pixels, x right and y down, in iBUG's order; n may be 0. dlib
            names a pixel by its index, and rounds to it; half is added, so that the middle of the
            first pixel is (0.5, 0.5) and the left upper corner of the image (0, 0).

        Raises:
            InputError: Not such an image.
        """
        image = np.ascontiguousarray(check_photo(image))
        boxes = sorted(self._boxes(image), key=lambda box: box.area(), reverse=True)
        faces = [
            [(point.x, point.y) for point in self._predict(image, box).parts()] for box in boxes
        ]
        return np.array(faces, float).reshape(-1, N_LANDMARKS, 2) + 0.5

    def _boxes(self, image: np.ndarray):
        """dlib's rectangles about the faces, in pixels of the image."""
        scale = math.sqrt(SEARCHED_PIXELS / (image.shape[0] * image.shape[1]))
        if scale >= 1:
            return self._find_faces(image, 0) or self._find_faces(image, 1)
        # To make the image smaller and then double it would lose what is in it.
        return self._boxes_at(image, scale) or self._boxes_at(image, min(2 * scale, 1.0))

    def _boxes_at(self, image: np.ndarray, scale: float):
        height, width = image.shape[:2]
        size = round(scale * width), round(scale * height)
        small = Image.fromarray(image).resize(size, Image.Resampling.BILINEAR)
        x, y = width / size[0], height / size[1]
        return [
            self._rectangle(
                round(x * box.left()),
                round(y * box.top()),
                round(x * box.right()),
                round(y * box.bottom()),
            )
            for box in self._find_faces(np.array(small), 0)
        ]
