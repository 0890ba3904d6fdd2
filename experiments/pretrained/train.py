"""Step: trains one of the networks that ship with the package, on faces as in photos.

The lifters see faces of both open models, with i.i.d. noise whose size they get as an approximate
input. Every face is changed beyond its model, since real people are of no model at all. The
networks of Deep-MDS are those of `deep_mds_cosine`, on faces of the open head alone.
"""

import functools
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from data_gen.models.morphable_model import MorphableModel
from data_gen.models.registry import load_model, model_files, open_models
from data_gen.views import DETECTOR_SD_MM, sample_expressive, sample_photo_views
from deepmds_keras.geometry.alignment import align, procrustes
from deepmds_keras.geometry.views import project, sample_perspective_cameras
from deepmds_keras.landmarks import load_scheme
from experiments.pretrained.canonical_face import canonical_mean
from experiments.recipes import deep_mds, fit, landmark_lifter
from experiments.records import resumable
from experiments.run import Run
from experiments.streams import Stream

# Standard deviation of the noise in Deep-MDS's training, mm. No detector finds the 72 landmarks:
# they come from fits of face models to photos.
DEEP_MDS = {"ibug51": DETECTOR_SD_MM, "bfm72": 1.0}
LIFTERS = ("ibug51", "ibug68", "bfm72")
CANONICAL = "canonical"
# Names of all networks, under which they ship, those that take long first.
NETWORKS = (*(f"deepmds-{scheme}" for scheme in DEEP_MDS), *(f"lifting-{s}" for s in LIFTERS))
_MISSING = 0.3
_RATE, _BATCH = 3e-3, 256
# Uniform, to either side, degrees; and the angle that the landmarks fill, from 0.
_YAW, _PITCH, _ROLL, _FIELD_OF_VIEW = 90.0, 40.0, 40.0, 40.0
# The mean of a training face is a mix of three: those of both open models, and MediaPipe's
# canonical face. The weights spread about these, beyond any of the three. The open head's nose is
# shallow, see `canonical_face`.
_CENTRE = {"openhead": 0.2, "ict": 0.4, CANONICAL: 0.4}
_SPREAD_OF_WEIGHTS = 1.5  # times a uniform distribution over the mixes of the three
_PARTS = {"openhead": 1, "ict": 2}  # of the training faces
# S.d. of the noise in a view, of most much less; and the share of views that have none.
_MOST_NOISE_MM, _EXACT = 6.0, 0.1
# S.d. of the logarithm of the ratio of the given to the true s.d.: a detector's is never known
# exactly, and a network that takes it for exact trusts it too much.
_GIVEN_SD = 0.2
# Changes beyond the models: larger features, smooth offsets, displaced landmarks, other aspects.
_IDENTITY = (0.8, 1.6)
_SMOOTH_MM, _SMOOTH_SD_MM = 25.0, 3.0
_OFFSET_SD_MM, _ASPECT_SD = 2.0, 0.03
_FLAT = 0.01  # share of faces that lose any part of their depth, that the s.d. knows of such


def weights_file(run: Run, name: str) -> Path:
    return run.work / "photo-networks" / f"{name}.npz"


def photo_faces(run: Run, scheme: str) -> Callable:
    """What a lifter is trained on: `sample_faces` of a number of faces and a generator."""
    models = (load_model(name, run.data, scheme) for name in open_models(run.data)[0])
    parts = [model.at_landmarks(scheme) for model in models]
    return functools.partial(sample_faces, [_in_frame_of(parts[0], part) for part in parts], scheme)


def main(run: Run, name: str) -> None:
    method, scheme = name.split("-")
    models = open_models(run.data)[0] if method == "lifting" else ["openhead"]
    inputs = [file for model in models for file in model_files(model, run.data)]
    checkpoint = resumable(weights_file(run, name).with_suffix(""), inputs)
    if method == "lifting":
        checkpoint, data = checkpoint / "network.npz", (photo_faces(run, scheme),)
        network = landmark_lifter(run).set_params(
            steps=run.preset.shipped_steps,
            batch_size=_BATCH,
            learning_rate=_RATE,
            missing=_MISSING,
        )
    else:
        rng = np.random.default_rng([run.seed, Stream.PRETRAINED, [*DEEP_MDS].index(scheme)])
        model, n = load_model("openhead", None, scheme), run.preset.train_faces
        data = sample_photo_views(model, scheme, n, rng, detector_sd=DEEP_MDS[scheme])[:2]
        network = deep_mds(run, "paper", "cosine")
        network.set_params(centre_views=True, solver="sklearn", n_jobs=None)
    network.set_params(n_landmarks=len(load_scheme(scheme)))
    fit(network, *data, checkpoint=checkpoint)
    network.history_ = {}  # the curves would take a good part of the file
    network.save(weights_file(run, name))


def sample_faces(
    models: Sequence[MorphableModel], scheme: str, n: int, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Random faces with noise in their views, of the open models restricted to the landmarks.

    Returns:
        Views `(n, L, 2)` and shapes `(n, L, 3)`, millimetres, and the stated s.d. of the noise,
        `(n,)`.
    """
    ends = np.cumsum([0, *(_PARTS[model.name] for model in models)])
    counts = np.diff(np.round(n * ends / ends[-1]).astype(int))
    shapes = [
        _beyond(model, _means(models, model, scheme), count, rng)
        for model, count in zip(models, counts, strict=True)
    ]
    shapes = rng.permutation(np.concatenate(shapes))
    cameras = sample_perspective_cameras(
        n, rng, yaw=_YAW, pitch=_PITCH, roll=_ROLL, field_of_view=(0, _FIELD_OF_VIEW)
    )
    sd = np.where(rng.random(n) < _EXACT, 0.0, _MOST_NOISE_MM * rng.random(n) ** 2)
    views = project(shapes, cameras)
    views += sd[:, None, None] * rng.standard_normal(views.shape)
    return views, shapes, sd * np.exp(_GIVEN_SD * rng.standard_normal(n))


def _in_frame_of(first: MorphableModel, model: MorphableModel) -> MorphableModel:
    """The model, rotated so that its mean face is nearest to that of the first.

    ICT looks up by 4 to 6 degrees when the open head looks ahead: mixed faces would have no common
    front.
    """
    turn = procrustes(model.mean[None], first.mean[None], scaling=False, reflection=False).rotation
    arrays = ("mean", "identity_basis_times_sd", "expression_basis")
    return replace(model, **{name: getattr(model, name) @ turn[0] for name in arrays})


def _means(
    models: Sequence[MorphableModel], of: MorphableModel, scheme: str
) -> dict[str, np.ndarray]:
    """The mean faces `(L, 3)` that are mixed, in the frame and size of one model's."""
    means = {m.name: align(m.mean, of.mean, reflection=False) for m in models}
    return means | {CANONICAL: canonical_mean(of.mean, scheme)}


def _beyond(
    model: MorphableModel, means: dict[str, np.ndarray], n: int, rng: np.random.Generator
) -> np.ndarray:
    """`(n, L, 3)` faces of one of the models, changed in ways beyond it."""
    mean, uniform = model.mean, 1 / len(means)
    identity, expression = sample_expressive(model, n, rng)
    shapes = model.shape(identity * rng.uniform(*_IDENTITY, (n, 1)), expression)
    centre = np.array([_CENTRE[name] for name in means])
    mix = rng.dirichlet(np.ones(len(means)), n) - uniform
    mix = centre / centre.sum() + _SPREAD_OF_WEIGHTS * mix
    shapes += np.einsum("nk,kld->nld", mix, np.stack([*means.values()]) - mean)
    # Times white noise it gives offsets alike for landmarks that lie together.
    squares = ((mean[:, None] - mean) ** 2).sum(2)
    kernel = np.exp(-squares / (2 * _SMOOTH_MM**2))
    smooth = np.linalg.cholesky(kernel + 1e-6 * np.eye(len(kernel)))
    bend = _SMOOTH_SD_MM * rng.random((n, 1, 1)) * (smooth @ rng.standard_normal(shapes.shape))
    offset = _OFFSET_SD_MM * rng.random((n, 1, 1)) * rng.standard_normal(shapes.shape)
    aspect = 1 + _ASPECT_SD * rng.standard_normal((n, 1, 3))
    aspect[..., 2] *= np.where(rng.random((n, 1)) < _FLAT, rng.random((n, 1)), 1)
    return aspect * (shapes + bend + offset)
