"""The fit of the Surrey Face Model by eos, for comparison.

Huber et al. 2016, doi:10.5220/0005669500580067. The model is for non-commercial research, from
https://github.com/patrikhuber/eos/tree/master/share, and is not part of this package.
"""

from pathlib import Path
from typing import Any

import numpy as np

from deepmds_keras.errors import InputError, brief, needs
from deepmds_keras.landmarks import convert, scheme_of

_FIRST = 18  # of the landmarks ibug51, by their numbers
# The model has no vertices at two corners of the inner mouth.
NUMBERS = tuple(n for n in range(_FIRST, 69) if n not in (61, 65))
_FILE = "sfm_shape_3448.bin"
_BLENDSHAPES, _MAPPING = "expression_blendshapes_3448.bin", "ibug_to_sfm.txt"
_TOPOLOGY, _CONTOUR = "sfm_3448_edge_topology.json", "sfm_model_contours.json"
_IMAGE = 512  # width and height in pixels of the image for eos


def surrey_files(path: str | Path) -> list[Path]:
    """Files that eos reads, the model first: its folder `share` holds them, or that is the path.

    Raises:
        InputError: One of them is missing.
    """
    folder = Path(path).parent if Path(path).is_file() else Path(path)
    files = [folder / name for name in (_FILE, _BLENDSHAPES, _MAPPING, _TOPOLOGY, _CONTOUR)]
    for file in files:
        if not file.is_file():
            raise InputError(f"{folder} must hold {file.name}, from eos's folder share. Not found.")
    return files


def read_surrey(path: str | Path) -> tuple[Path, Any, list, Any, list[int]]:
    """Read the Surrey model by eos, from the path of `surrey_files`.

    Returns:
        The folder; shape model, blendshapes and landmark mapper, as eos reads them; and the
        vertices of `NUMBERS`.

    Raises:
        InputError: eos-py is missing, or a file is missing or damaged.
    """
    with needs("eos-py", "eos"):
        from eos import core, morphablemodel
    file = surrey_files(path)[0]
    folder = file.parent
    try:
        shape = morphablemodel.load_model(str(file)).get_shape_model()
        blendshapes = morphablemodel.load_blendshapes(str(folder / _BLENDSHAPES))
        mapper = core.LandmarkMapper(str(folder / _MAPPING))
        return folder, shape, blendshapes, mapper, [int(mapper.convert(str(n))) for n in NUMBERS]
    except (RuntimeError, MemoryError, ValueError, TypeError) as error:
        raise InputError(f"{folder} must hold eos's files, undamaged. {brief(error)}.") from None


class EosFit:
    """Shape, expression and camera of each view, by eos's `fit_shape_and_pose` as documented.

    The path, and errors, are those of `read_surrey`.
    """

    def __init__(self, path: str | Path):
        folder, shape, blendshapes, self._mapper, self._vertices = read_surrey(path)
        import eos

        colour = eos.morphablemodel.PcaModel()
        self._model = eos.morphablemodel.MorphableModel(shape, blendshapes, colour)
        self._landmark, self._fit_shape = eos.core.Landmark, eos.fitting.fit_shape_and_pose
        self._contour = (
            eos.morphablemodel.load_edge_topology(str(folder / _TOPOLOGY)),
            eos.fitting.ContourLandmarks.load(str(folder / _MAPPING)),
            eos.fitting.ModelContour.load(str(folder / _CONTOUR)),
        )

    def predict(self, views: np.ndarray) -> np.ndarray:
        """The fitted faces `(n, 51, 3)`, millimetres, frontal, y up; NaN at 61 and 65.

        Args:
            views: `(n, 51, 2)` or `(n, 68, 2)` in iBUG's order, y up, any scale and place; of 68
                the jaw line is not used. NaN where a landmark is missing.

        Raises:
            InputError: Landmarks of another scheme.
        """
        views = convert(views, scheme_of(np.shape(views)[1]), "ibug51")
        low, high = np.nanmin(views, 1), np.nanmax(views, 1)
        scale = _IMAGE / 2 / (high - low).max(1)[:, None, None]
        pixels = (views - (low + high)[:, None] / 2) * scale * (1, -1) + _IMAGE / 2  # y down
        shapes = np.full((*views.shape[:2], 3), np.nan)
        shapes[:, [n - _FIRST for n in NUMBERS]] = [self._fit(face) for face in pixels]
        return shapes

    def _fit(self, pixels: np.ndarray) -> np.ndarray:
        points = [
            self._landmark(str(_FIRST + i), point)
            for i, point in enumerate(pixels)
            if np.isfinite(point).all()
        ]
        fitted = self._fit_shape(self._model, points, self._mapper, _IMAGE, _IMAGE, *self._contour)
        return np.array(fitted[0].vertices)[self._vertices]
