"""Step: measures the weights for photos on rendered ones, with known truth, and ships them."""

import functools
import shutil
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
import pandas as pd

from data_gen.models.registry import TITLES, open_models
from deepmds_keras.baselines.closed_form import RidgeRegression
from deepmds_keras.baselines.eos_fit import EosFit
from deepmds_keras.deep_mds import DeepMDS
from deepmds_keras.geometry.alignment import align
from deepmds_keras.geometry.units import centre, normalise, rms_radius
from deepmds_keras.landmarks import convert
from deepmds_keras.lifting.lifter import LandmarkLifter
from deepmds_keras.metrics import mse
from deepmds_keras.tool.detection import detector_sd, to_ibug
from deepmds_keras.weights import PRETRAINED
from experiments.audit.shapes import bias_of
from experiments.lifting.train import load_network
from experiments.lifting.transfer import Trained
from experiments.methods import title
from experiments.pretrained.portraits import read_portraits
from experiments.pretrained.train import LIFTERS, NETWORKS, photo_faces, weights_file
from experiments.progress import counted
from experiments.recipes import mlp
from experiments.run import Run
from experiments.scoring.numbers import power
from experiments.streams import Stream
from experiments.studies.study_results import grid, mean_error, write_results

# Schemes of each detector's landmarks: all of them, and parts of them.
SCHEMES = {"dlib": ("ibug68", "ibug51"), "mediapipe": ("ibug51",)}
_YAWS = np.arange(-60.0, 61.0, 20.0)  # middles of bins, degrees
# Root mean square error of a face, in radii, beyond which a detector has found something else.
_GROSS = 0.3
_UNIT = 1e-5
_FEWEST = 4  # least number of photos with a detected face


@functools.cache
def trained(run: Run, scheme: str) -> Trained:
    """The networks of a scheme, and the other methods trained on the same faces."""
    names = [name for name in (f"lifting-{scheme}", f"deepmds-{scheme}") if name in NETWORKS]
    return trained_beside(run, scheme, *(load_network(weights_file(run, name)) for name in names))


def trained_beside(
    run: Run, scheme: str, lifter: LandmarkLifter, deep_mds: DeepMDS | None = None
) -> Trained:
    """Networks for photos, and other methods trained on fewer faces of the lifter's kind."""
    rng = np.random.default_rng([run.seed, Stream.PHOTO_FACES, LIFTERS.index(scheme)])
    views, shapes, _ = photo_faces(run, scheme)(run.preset.train_faces, rng)
    return Trained(views, shapes, lifter, deep_mds, mlp(run, views.shape[1]))


def measure(run: Run) -> Iterator[dict]:
    """Rows of the table: each method, on each kind of landmarks of the photos of each model."""
    photos = {model: read_portraits(run, model) for model in open_models(run.data)[0]}
    for scheme in counted("scheme of landmarks", LIFTERS, len(LIFTERS)):
        for kind in ("exact", *SCHEMES):
            faces = {model: views_of(each, kind, scheme) for model, each in photos.items()}
            if any(each is None or each.detected.sum() < _FEWEST for each in faces.values()):
                continue
            regression = {} if kind == "exact" else _on_detections(faces)
            for model, (views, sd, truth, detected) in faces.items():
                shapes = trained(run, scheme).predict(views[detected], sd[detected])
                if kind != "exact":
                    shapes["ridge_detections"] = regression[model]
                if kind == "mediapipe":
                    shapes["mediapipe_corrected"] = photos[model]["mediapipe_shape"][detected]
                scored = np.ones(truth.shape[1], bool)
                if scheme == "ibug51" and run.sfm:
                    shapes["eos"] = EosFit(run.sfm).predict(views[detected])
                    scored = np.isfinite(shapes["eos"][0, :, 0])  # for all methods alike
                row = {"scheme": scheme, "faces": model, "views": kind, "landmarks": scored.sum()}
                shapes = {method: shape[:, scored] for method, shape in shapes.items()}
                for errors in _errors(shapes, truth[detected][:, scored]):
                    yield row | errors | {"not_found": int((~detected).sum())}


class Views(NamedTuple):
    """Landmarks of photos: views y up, their s.d., true shapes, and whether the face was found."""

    views: np.ndarray  # (n, L, 2) pixels
    sd: np.ndarray  # (n, L)
    truth: np.ndarray  # (n, L, 3) normalised
    detected: np.ndarray  # (n,)


def views_of(photos: dict[str, np.ndarray], kind: str, scheme: str) -> Views | None:
    """Landmarks of a scheme in `read_portraits`, as prediction takes them; None if unknown.

    The kind is `"exact"` or a detector.
    """
    source = "bfm72" if scheme == "bfm72" else "ibug68"
    truth = normalise(convert(photos[f"landmarks_{source}"], source, scheme))
    if kind == "exact":
        pixels, detected = photos[f"pixels_{source}"], np.ones(len(truth), bool)
        sd = np.zeros(truth.shape[:2])
    elif kind in photos and scheme in SCHEMES[kind]:
        source, detected = SCHEMES[kind][0], errors_of(photos, kind)[1]
        pixels = to_ibug(photos[kind], kind, source)
        radius = rms_radius(convert(pixels, source, "ibug51"))
        sd = radius[:, None] * detector_sd(kind, scheme)
    else:
        return None
    return Views(convert(pixels, source, scheme) * (1, -1), sd, truth, detected)


def _on_detections(faces: dict[str, Views]) -> dict[str, np.ndarray]:
    """Shapes by ridge regression on detections, each half of the photos from the other.

    It sees photos of all models. No other method of the table is trained on detections.
    """
    inputs = {m: normalise(centre(each.views[each.detected])) for m, each in faces.items()}
    truths = {m: each.truth[each.detected] for m, each in faces.items()}
    shapes = {m: np.empty_like(truth) for m, truth in truths.items()}
    for half in (0, 1):
        parts = [(inputs[m][1 - half :: 2], truths[m][1 - half :: 2]) for m in faces]
        regression = RidgeRegression().fit(*map(np.concatenate, zip(*parts, strict=True)))
        for m in faces:
            shapes[m][half::2] = regression.predict(inputs[m][half::2])
    return shapes


def _errors(shapes: dict[str, np.ndarray], truth: np.ndarray) -> Iterator[dict]:
    """Error of each method, and the recovered fraction of a face's offset from the mean."""
    mean = align(shapes["mean_shape"], truth)
    for method, shape in shapes.items():
        aligned = align(shape, truth)
        slope = bias_of(aligned, mean, truth)["slope"]
        yield {"method": method, **mean_error(mse(aligned, truth)), "found_again": slope}


def errors_of(photos: dict[str, np.ndarray], detector: str) -> tuple[np.ndarray, np.ndarray]:
    """Errors of a detector on photos, as `read_portraits` returns them.

    Returns:
        `(n, L, 2)` errors relative to the root mean square radius of the face's true `ibug51`, NaN
        where no face was found; and `(n,)` whether the face itself was found.
    """
    pixels = photos["pixels_ibug68"]
    radius = rms_radius(convert(pixels, "ibug68", "ibug51"))[:, None, None]
    errors = (photos[detector] - convert(pixels, "ibug68", SCHEMES[detector][0])) / radius
    return errors, np.sqrt((errors**2).sum(2).mean(1)) <= _GROSS  # False for NaN


def detections(run: Run) -> pd.DataFrame:
    """Share of faces that each detector finds, by yaw, and its accuracy.

    Returns:
        Rows of `detector, yaw, n_photos, found, rms, faces`: the share of photos with a detection;
        for these, the root mean square error of a coordinate of `ibug51` in percent of the face's
        radius; and the face model.
    """
    parts = []
    for detector, (scheme, *_) in SCHEMES.items():
        for model in open_models(run.data)[0]:
            photos = read_portraits(run, model)
            if detector in photos:
                errors, detected = errors_of(photos, detector)
                errors = convert(errors, scheme, "ibug51")
                rows = pd.DataFrame({"detector": detector, "faces": model, "found": detected})
                rows["yaw"] = _YAWS[np.abs(_YAWS - photos["yaw"][:, None]).argmin(1)]
                rows["square"] = np.where(detected, (errors**2).mean((1, 2)), np.nan)
                parts.append(rows.sort_values("yaw"))
    grouped = pd.concat(parts).groupby(["detector", "faces", "yaw"], sort=False, as_index=False)
    table = grouped.agg(n_photos=("found", "size"), found=("found", "mean"), rms=("square", "mean"))
    table["rms"] = 100 * np.sqrt(table["rms"])
    return table[["detector", "yaw", "n_photos", "found", "rms", "faces"]]


def main(run: Run) -> dict:
    table = pd.DataFrame(measure(run))
    table = table[[*table.columns.drop(["n_faces", "not_found"]), "n_faces", "not_found"]]
    # Weights trained on one model's faces are not those of the docs.
    if run.preset.name == "full" and not open_models(run.data)[1]:
        for name in NETWORKS:
            shutil.copyfile(weights_file(run, name), PRETRAINED / f"{name}.npz")
    cells = grid(table, ["scheme", "faces", "views"], "method", _UNIT).rename(columns=title)
    cells = cells.rename(index=TITLES, level="faces")
    cells = cells.rename_axis(["Landmarks", "Faces", f"MSE ({power(_UNIT)}), as found by"])
    return write_results(run, "pretrained", {"table": table, "detection": detections(run)}, cells)
