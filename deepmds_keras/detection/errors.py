"""What detectors get wrong: errors measured on photos whose true landmarks are known.

`make pretrained` measures them, on photos drawn of both open face models.
"""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import NamedTuple

import numpy as np

from deepmds_keras.files import read_arrays, write_arrays

INNER = "ibug51"  # landmarks whose radius is the unit
FOLDER = Path(__file__).with_name("measured_errors")
_MOST_TOLD = 3.0


class DetectorErrors(NamedTuple):
    """Errors of a detector by the yaw of the face, `B` bins of it.

    A detector pulls faces towards those that it knows, so that its errors depend on the face: of
    MediaPipe's on renders, three fifths of the variance. What the view tells is `read` as `R`
    numbers of unit variance and turned to errors by `write`; the rest is random.

    Coordinates are those of the upright face, x right and y up: the image is turned back by the
    roll. The unit is the root mean square radius of the true landmarks `ibug51` in the view, and
    their mean is the origin.

    Attributes:
        yaw: `(B,)` middles of the bins, degrees.
        bias: `(B, L, 2)` mean errors.
        view: `(B, L, 2)` mean of the true views.
        read: `(B, R, L, 2)`, of which the products with a view less the mean are the numbers.
        write: `(B, R, L, 2)` errors for a number of 1.
        components: `(B, R, L, 2)` principal components of what these leave, times s.d.
        rest: `(B, L, 2)` s.d. of what is left after all.
    """

    yaw: np.ndarray
    bias: np.ndarray
    view: np.ndarray
    read: np.ndarray
    write: np.ndarray
    components: np.ndarray
    rest: np.ndarray

    @property
    def sd(self) -> np.ndarray:
        """`(L,)` root mean square error of a coordinate of each landmark, bias included."""
        squares = (self.write**2).sum(1) + (self.components**2).sum(1) + self.rest**2
        return np.sqrt((self.bias**2 + squares).mean((0, 2)))

    def sample(self, views: np.ndarray, yaw: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        """Random errors in true views of faces turned by `(n,)` degrees: `(n, L, 2)`."""
        bins = nearest_bin(yaw, self.yaw)
        told = np.einsum("nld,nrld->nr", views - self.view[bins], self.read[bins])
        # Views of other faces than those measured may lie far off, where nothing is known.
        told = np.clip(told, -_MOST_TOLD, _MOST_TOLD)
        errors = self.bias[bins] + np.einsum("nr,nrld->nld", told, self.write[bins])
        weights = rng.standard_normal((len(yaw), self.components.shape[1]))
        errors += np.einsum("nr,nrld->nld", weights, self.components[bins])
        return errors + rng.standard_normal(errors.shape) * self.rest[bins]


def nearest_bin(yaw: np.ndarray, middles: np.ndarray) -> np.ndarray:
    """`(n,)` int: which of the middles of bins is nearest to each yaw `(n,)`."""
    return np.abs(middles - yaw[:, None]).argmin(1)


@cache
def read_errors(path: Path) -> DetectorErrors:
    """Errors as a file has them.

    Raises:
        InputError: The file is missing or damaged.
    """
    arrays, _ = read_arrays(path)
    return DetectorErrors(**{name: np.float64(array) for name, array in arrays.items()})


def write_errors(errors: DetectorErrors, detector: str, scheme: str) -> None:
    """Write errors where `detector_errors` finds them, at half precision."""
    arrays = {name: np.float16(array) for name, array in errors._asdict().items()}
    write_arrays(FOLDER / f"{detector}-{scheme}.npz", arrays, {})


def detector_errors(detector: str, scheme: str) -> DetectorErrors | None:
    """Errors of a detector in the landmarks of a scheme, or None where none were measured."""
    path = FOLDER / f"{detector}-{scheme}.npz"
    return read_errors(path) if path.exists() else None
