"""Shapes of objects from `OBJECTS=`, their views from all sides, and what is held out for tests."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from deepmds_keras.errors import InputError
from deepmds_keras.files import read_npz
from deepmds_keras.geometry.alignment import align_to_mean
from deepmds_keras.geometry.units import centre_to_radius_1
from deepmds_keras.lifting.sampling import distinct_shapes
from experiments.run import Run
from experiments.streams import Stream

# Objects, and the share of their shapes that is held out: of sequences the last third, of
# separate things as many at random as of 920 chairs 220.
SEQUENCES = ("walking", "dance", "yoga", "stretch", "pickup", "drink", "jaws", "face")
OBJECTS = {"chairs": 220 / 920, **dict.fromkeys(SEQUENCES, 1 / 3)}
METHODS = ("mean_shape", "ridge", "mlp", "deep_mds", "map_learnt", "landmark_lifter")
NOISES = (0.0, 0.02)  # s.d. of a coordinate in the view, in r.m.s. radii of the shape
_COMMON = 0.9  # share of the shapes that must have a landmark if it is to be used


@dataclass(frozen=True, eq=False)
class Views:
    """Views `(n, L, 2)` of shapes `(n, L, 3)`, which are centred, of r.m.s. radius 1."""

    views: np.ndarray
    shapes: np.ndarray


def object_file(folder: str | Path, name: str) -> Path:
    """File of an object: npz with `points`, `(n, L, 3)`, NaN where a shape lacks a landmark."""
    return Path(folder, f"{name}.npz")


def scores_file(run: Run, name: str, seed: int) -> Path:
    """File of the errors on an object."""
    return run.work / "objects" / f"{name}-seed{seed}.csv"


def read_shapes(path: Path) -> np.ndarray:
    """Distinct shapes `(n, L, 3)` that have all landmarks which most have, centred, of radius 1.

    Raises:
        InputError: The file is missing or damaged, or holds too few shapes or landmarks.
    """
    points = np.asarray(read_npz(path, "shapes (npz)").get("points", np.empty(0)))
    if points.ndim != 3 or points.shape[-1] != 3 or points.dtype.kind != "f":
        raise InputError(
            f"{path}: points must be floats of shape (shapes, landmarks, 3). "
            f"Received {points.dtype} {points.shape}."
        )
    known = np.isfinite(points).all(2)
    landmarks = known.mean(0) >= _COMMON
    points = points[known[:, landmarks].all(1)][:, landmarks].astype(float)
    if len(points) < 10 or points.shape[1] < 6:
        raise InputError(
            f"{path}: at least 10 shapes must have the same 6 landmarks. "
            f"Received {len(points)} with {points.shape[1]}."
        )
    # Jaws repeats itself, turned, after 120 frames: what is held out would be known from training.
    return distinct_shapes(centre_to_radius_1(points))


def views_of(run: Run, name: str, seed: int, noise: float) -> tuple[Views, Views]:
    """Training and test views of an object, orthographic, turned in any way.

    The same shapes are held out whatever the noise, of sequences whatever the seed. A shape has the
    same views, and the same errors but for their size, at all noise levels.
    """
    shapes, held = read_shapes(object_file(run.objects, name)), OBJECTS[name]
    rng = np.random.default_rng([seed, Stream.OBJECTS, [*OBJECTS].index(name)])
    order = np.arange(len(shapes)) if name in SEQUENCES else rng.permutation(len(shapes))
    n_train = len(shapes) - round(held * len(shapes))
    # People turn in the sequences: most of the coordinates' variance is which way they face.
    shapes = align_to_mean(shapes[order], n_train)
    n_views = run.preset.object_views
    parts = (shapes[:n_train], n_views), (shapes[n_train:], max(1, n_views // 8))
    seen = []
    for chosen, times in parts:
        repeated = np.repeat(chosen, times, axis=0)
        turns = Rotation.random(len(repeated), rng).as_matrix()
        views = (repeated @ np.swapaxes(turns, 1, 2))[..., :2]
        seen.append(Views(views + noise * rng.standard_normal(views.shape), repeated))
    return tuple(seen)
