"""What detectors get wrong: errors measured on photos whose true landmarks are known.

`make pretrained` measures them, on photos drawn of both open face models.
"""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import NamedTuple

import numpy as np

from deepmds_keras.io.archives import read_arrays, write_arrays
from deepmds_keras.landmarks.conversion import convert

INNER = "ibug51"  # landmarks whose radius is the unit
FOLDER = Path(__file__).with_name("measured_errors")


class DetectorErrors(NamedTuple):
    """Errors of a detector by the yaw of the face, `B` bins of it.

    Coordinates are those of the upright face, x right and y up: the image is turned back by the
    roll. The unit is the root mean square radius of the true landmarks `ibug51` in the view.

    Attributes:
        yaw: `(B,)` middles of the bins, degrees.
        bias: `(B, L, 2)` mean errors.
        components: `(B, R, L, 2)` principal components of the errors about the bias, times s.d.
        rest: `(B, L, 2)` s.d. of what these leave.
    """

    yaw: np.ndarray
    bias: np.ndarray
    components: np.ndarray
    rest: np.ndarray

    @property
    def sd(self) -> np.ndarray:
        """`(L,)` root mean square error of a coordinate of each landmark, bias included."""
        squares = self.bias**2 + (self.components**2).sum(1) + self.rest**2
        return np.sqrt(squares.mean((0, 2)))

    def converted(self, source: str, target: str) -> DetectorErrors:
        """The landmarks of another scheme, as `landmarks.conversion.convert`."""
        shape = self.components.shape
        components = convert(self.components.reshape(-1, *shape[2:]), source, target)
        return DetectorErrors(
            self.yaw,
            convert(self.bias, source, target),
            components.reshape(*shape[:2], -1, 2),
            convert(self.rest, source, target),
        )

    def sample(self, yaw: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        """Random errors of faces turned by `(n,)` degrees: `(n, L, 2)`."""
        bins = nearest_bin(yaw, self.yaw)
        weights = rng.standard_normal((len(yaw), self.components.shape[1]))
        rest = rng.standard_normal((len(yaw), *self.bias.shape[1:])) * self.rest[bins]
        return self.bias[bins] + np.einsum("nr,nrld->nld", weights, self.components[bins]) + rest


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
    for source in ("ibug68", "ibug51"):
        path = FOLDER / f"{detector}-{source}.npz"
        if path.exists():
            return read_errors(path).converted(source, scheme)
    return None
