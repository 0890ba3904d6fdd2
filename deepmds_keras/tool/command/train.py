"""`deepmds train`: a lifter of a user's shapes, and its error on shapes that it has not seen."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from tqdm import tqdm

from deepmds_keras.errors import InputError, needs
from deepmds_keras.files import map_npy
from deepmds_keras.geometry.alignment import align, align_to_mean
from deepmds_keras.geometry.units import centre_to_radius_1, normalise
from deepmds_keras.geometry.views import sample_views
from deepmds_keras.lifting.inputs import LEAST_VISIBLE
from deepmds_keras.lifting.lifter import LandmarkLifter
from deepmds_keras.lifting.sampling import distinct_shapes
from deepmds_keras.streams import Stream
from deepmds_keras.validation import as_numbers, find_faults

_HELD_OUT = 10  # one in so many shapes is left for the report
_VIEWS = 20_000  # to train on, at least: twice as many gain nothing
_TEST_VIEWS = 20  # of each shape
_UNIT = 1e-3
_ALL_AROUND = 180  # degrees of yaw to either side, at which no view shows which way a shape faced


def train(
    source: str | Path,
    out: str | Path,
    *,
    steps: int,
    noise: float,
    missing: float,
    seed: int,
    yaw: float = _ALL_AROUND,
    **angles: float,
) -> dict[str, list[float]]:
    """Train a lifter on random views of shapes, write it, and print a report.

    A stopped training goes on from `OUT.checkpoint`, which is deleted at the end.

    Args:
        source: `.npy` of shapes `(n, L, 3)`, in any unit, +y up; equal ones count once,
            however turned, moved and scaled.
        out: File to write, as `LandmarkLifter.save` does; it must not exist.
        steps, missing, seed: As for `LandmarkLifter`.
        noise: Likewise; the report has views with half of it, the mean in training, too.
        yaw: As for `sample_views`, degrees. At 180 shapes that face different ways are first turned
            about the vertical, onto their mean.
        angles: `pitch`, `roll` and `field_of_view` likewise.

    Returns:
        Errors by method on the shapes that are held out, in exact and in noisy views: the mean
        squared distance of a landmark in squared r.m.s. radii, after alignment with scale.

    Raises:
        InputError: The file is not of such shapes, an option is out of range, the output exists, or
            the checkpoint is of another run.
    """
    with needs("Keras with TensorFlow, which train,", "keras"):
        from deepmds_keras.lifting.trainer import STEPS_PER_BLOCK
    out = Path(out)
    if out.suffix != ".npz" or out.exists():
        received = "one that exists" if out.exists() else f"the suffix {out.suffix!r}"
        raise InputError(f"{out} must be a new file, .npz. Received {received}.")
    shapes = _read_shapes(Path(source))
    order = np.random.default_rng([seed, Stream.SHAPES_HELD_OUT]).permutation(len(shapes))
    n_held_out = len(shapes) // _HELD_OUT
    n_known = len(shapes) - n_held_out
    shapes = shapes[np.roll(order, -n_held_out)]
    if yaw >= _ALL_AROUND:
        shapes = align_to_mean(shapes, n_known, upright=True)
    known, held_out = shapes[:n_known], shapes[n_known:]
    rng = np.random.default_rng([seed, Stream.VIEWS_OF_SHAPES])
    seen = sample_views(known, -(-_VIEWS // len(known)), yaw=yaw, rng=rng, **angles)
    test = sample_views(held_out, _TEST_VIEWS, yaw=yaw, rng=rng, **angles)
    lifter = LandmarkLifter(shapes.shape[1], steps=steps, noise=noise, missing=missing, seed=seed)
    checkpoint = out.with_name(f"{out.name}.checkpoint")
    with tqdm(total=steps, unit="step") as bar:
        lifter.fit(
            *seen,
            checkpoint=checkpoint,
            progress=lambda _: bar.update(min(STEPS_PER_BLOCK, steps - bar.n)),
        )
    levels = [*dict.fromkeys([0.0, noise / 2])]
    errors = _errors(lifter, *seen, *test, levels, rng)
    lifter.save(out)  # after the errors: a stop before would lose them
    checkpoint.unlink()
    print(
        f"{out}: {lifter.n_landmarks} landmarks, trained on {len(known):,} shapes. Error on "
        f"{n_held_out:,} others, in 10⁻³ of the squared r.m.s. radius:"
    )
    print(f"{'noise, in radii':18}", *(f"{sd:8.3g}" for sd in levels))
    for method, row in errors.items():
        print(f"{method:18}", *(f"{error / _UNIT:8.2f}" for error in row))
    return errors


def _read_shapes(path: Path) -> np.ndarray:
    """The different shapes of a file, `(n, L, 3)`, centred, of r.m.s. radius 1."""
    shapes = map_npy(path)
    usable = shapes.ndim == 3 and shapes.shape[1] >= LEAST_VISIBLE and shapes.shape[2] == 3
    if not usable or not len(shapes):
        raise InputError(
            f"{path} must hold shapes (n, L, 3) with {LEAST_VISIBLE} landmarks or more. "
            f"Received {shapes.shape}."
        )
    shapes = as_numbers(shapes, f"{path}:")
    faults = find_faults(shapes)
    for shape, fault in faults.items():
        raise InputError(
            f"{path}, shape {shape + 1} of {len(shapes)}, {fault}. "
            f"Shapes to leave out or mend: {len(faults)}."
        )
    shapes = distinct_shapes(centre_to_radius_1(np.unique(shapes, axis=0)))
    if len(shapes) < _HELD_OUT:
        raise InputError(
            f"{path} must hold {_HELD_OUT} different shapes or more, some for the report. "
            f"Received {len(shapes)}."
        )
    return shapes


def _errors(
    lifter: LandmarkLifter,
    views: np.ndarray,
    shown: np.ndarray,
    test: np.ndarray,
    truth: np.ndarray,
    levels: list[float],
    rng: np.random.Generator,
) -> dict[str, list[float]]:
    """Errors by method, one for each level of noise; ridge regression is fitted to each."""
    from deepmds_keras.baselines.closed_form import RidgeRegression

    errors: dict[str, list[float]] = {}
    for sd in levels:
        known, seen = (x + sd * rng.standard_normal(x.shape) for x in (views, test))
        ridge = RidgeRegression().fit(normalise(known), normalise(shown))
        predicted = {
            "mean shape": np.broadcast_to(shown.mean(0), truth.shape),
            "ridge regression": ridge.predict(normalise(seen)),
            "lifter": lifter.predict(seen, landmark_sd=sd, check_orientation=False),
        }
        for method, shapes in predicted.items():
            off = align(shapes, truth, reflection=False) - truth
            errors.setdefault(method, []).append(float((off**2).sum(2).mean()))
    return errors
