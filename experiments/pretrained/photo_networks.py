"""Stage: trains the networks that ship with the package, on faces as photos show them.

The lifters see faces of both open models, with errors as they were measured on the detectors. The
networks of Deep-MDS are those of `ours_stable`, on faces of the open head alone and white errors.
"""

from __future__ import annotations

import functools
from pathlib import Path

import numpy as np

from data_gen.models.registry import load_model
from data_gen.views.photo_views import DETECTOR_SD_MM, sample_photo_views
from deepmds_keras.detection.errors import DetectorErrors
from deepmds_keras.landmarks import load_scheme
from deepmds_keras.landmarks.conversion import convert
from deepmds_keras.lifting.lifter import LandmarkLifter
from experiments.arguments import parse_run
from experiments.methods import METHODS
from experiments.pretrained.detector_errors import errors_on, summarise_errors
from experiments.pretrained.photo_faces import FoundFaces, PhotoFaces
from experiments.pretrained.portraits import open_model, read_portraits
from experiments.recipes import deep_mds, fit_deep_mds, fit_lifter
from experiments.records import load_record
from experiments.run import Run
from experiments.running import stage
from experiments.streams import Stream
from experiments.trainings import side_by_side

# Landmarks that a detector's points have a place among, the first as it finds them.
FOUND = {"dlib": ("ibug68", "ibug51"), "mediapipe": ("ibug51",)}
LIFTERS = ("ibug51", "ibug68", "bfm72")
# Standard deviation of the white errors that Deep-MDS is trained with, mm. No detector finds the
# 72 landmarks: they come from fits of face models to photos.
DEEP_MDS = {"ibug51": DETECTOR_SD_MM, "bfm72": 1.0}
_MISSING = 0.3


def weights_file(run: Run, method: str, scheme: str) -> Path:
    """Weights, by the name under which they ship."""
    return run.work / "photo-networks" / f"{method}-{scheme}.npz"


@functools.cache
def measured_errors(run: Run) -> dict[tuple[str, str], DetectorErrors]:
    """Errors over the photos of all models, by detector that was there and scheme."""
    measured = {}
    for detector in load_record(run, "portraits")["detectors"]:
        errors, views, _, yaw = found_on_photos(run, detector)
        for scheme in FOUND[detector]:
            own = (convert(array, FOUND[detector][0], scheme) for array in (errors, views))
            measured[detector, scheme] = summarise_errors(*own, yaw)
    return measured


@functools.cache
def found_on_photos(run: Run, detector: str) -> tuple[np.ndarray, ...]:
    """What is known of the faces that a detector found in the photos of all models.

    Returns:
        `(n, L, 2)` errors and true views, and `(n, L, 3)` true shapes in millimetres, in the
        detector's own scheme; and `(n,)` yaws.
    """
    parts, scheme = [], FOUND[detector][0]
    for model in load_record(run, "portraits")["models"]:
        photos = read_portraits(run, model, "errors")
        errors, views, found = errors_on(photos, detector, scheme)
        shapes = convert(photos["landmarks_ibug68"], "ibug68", scheme)
        parts.append([own[found] for own in (errors, views, shapes, photos["yaw"])])
    return tuple(map(np.concatenate, zip(*parts, strict=True)))


def photo_faces(run: Run, scheme: str) -> PhotoFaces:
    """What a lifter is trained on."""
    models = [open_model(run, name, scheme) for name in load_record(run, "portraits")["models"]]
    errors, found = [], []
    for (detector, own_scheme), own in measured_errors(run).items():
        known = found_on_photos(run, detector)
        if own_scheme == scheme and len(known[0]):
            wrong, views, shapes = (convert(a, FOUND[detector][0], scheme) for a in known[:3])
            errors.append(own)
            found.append(
                FoundFaces(views + wrong, shapes, np.broadcast_to(own.sd, views.shape[:2]))
            )
    return PhotoFaces(models, scheme, errors, found)


def train_lifter(run: Run, scheme: str) -> None:
    """Train the lifter of a scheme."""
    lifter = LandmarkLifter(
        len(load_scheme(scheme)), steps=run.preset.shipped_steps, missing=_MISSING, seed=run.seed
    )
    path = weights_file(run, "lifting", scheme)
    checkpoint = path.with_name(f"{path.stem}-checkpoint.npz")
    path.parent.mkdir(parents=True, exist_ok=True)
    fit_lifter(lifter, photo_faces(run, scheme), checkpoint=checkpoint)
    lifter.history_ = {}  # the curves would be a good part of the file
    lifter.save(path)


def train_deep_mds(run: Run, scheme: str) -> None:
    """Train the paper's networks on centred views, with a decaying learning rate."""
    model = load_model("openhead", None, scheme)
    number = list(DEEP_MDS).index(scheme)
    rng = np.random.default_rng([run.seed, Stream.PRETRAINED, number])
    views, shapes, _ = sample_photo_views(
        model, scheme, run.preset.train_faces, rng, detector_sd=DEEP_MDS[scheme]
    )
    path = weights_file(run, "deepmds", scheme)
    networks = deep_mds(run, *METHODS["ours_stable"].deep_mds)
    networks.set_params(
        n_landmarks=len(load_scheme(scheme)), centre_views=True, solver="batched", n_jobs=None
    )
    fit_deep_mds(networks, views, shapes, checkpoint=path.with_suffix(""))
    networks.history_ = {}
    networks.save(path)


_TRAIN = {"lifting": train_lifter, "deepmds": train_deep_mds}


def _train(run: Run, method: str, scheme: str) -> None:
    _TRAIN[method](run, scheme)


def trainings() -> list[tuple[str, str]]:
    """Every network by its method and scheme, those that take long first."""
    deep = [("deepmds", scheme) for scheme in DEEP_MDS]
    return [*deep, *(("lifting", scheme) for scheme in LIFTERS)]


def main(arguments: list[str] | None = None) -> None:
    run = parse_run(__doc__, arguments)
    with stage(run, "photo-networks") as record:
        todo = [(run, *own) for own in trainings() if not weights_file(run, *own).exists()]
        _, record["processes_mb"] = side_by_side(run.jobs, _train, todo)
