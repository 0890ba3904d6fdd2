"""Stage: measures the shipped weights on photos whose truth is known, and ships them."""

from __future__ import annotations

import shutil
from collections.abc import Iterator

import numpy as np
import pandas as pd
from scipy.stats import sem

from deepmds_keras.alignment import align
from deepmds_keras.baselines.linear import Linear
from deepmds_keras.baselines.mean_shape import MeanShape
from deepmds_keras.detection.errors import write_errors
from deepmds_keras.landmarks.conversion import convert
from deepmds_keras.lifting.lifter import LandmarkLifter
from deepmds_keras.metrics import mse
from deepmds_keras.normalisation import centre, normalise, rms_radius
from deepmds_keras.pipeline import DeepMDS
from deepmds_keras.weights import PRETRAINED
from experiments.arguments import parse_run
from experiments.audit.bias import bias_of
from experiments.face_models import TITLES
from experiments.lifting.study_tables import left_out_notes
from experiments.manifest import clear_results, records_of, write_manifest
from experiments.methods import title
from experiments.pretrained.detector_errors import (
    N_INNER,
    detection_table,
    errors_on,
    errors_table,
)
from experiments.pretrained.photo_networks import (
    DEEP_MDS,
    FOUND,
    LIFTERS,
    found_on_photos,
    measured_errors,
    photo_faces,
    trainings,
    weights_file,
)
from experiments.pretrained.portraits import read_portraits
from experiments.records import load_record, write_text
from experiments.run import Run
from experiments.running import single_threaded, stage
from experiments.scoring.latex import tabular
from experiments.scoring.numbers import plus_minus, power
from experiments.scoring.tables import write_csv
from experiments.streams import Stream

_UNIT = 1e-5


class Compared:
    """Every method for the landmarks of a scheme, the simple ones fitted on the lifter's faces."""

    def __init__(self, run: Run, scheme: str):
        self._scheme = scheme
        rng = np.random.default_rng([run.seed, Stream.PHOTO_FACES, LIFTERS.index(scheme)])
        views, shapes, _ = photo_faces(run, scheme)(run.preset.train_faces, rng)
        normal = normalise(centre(views)), normalise(shapes)
        with single_threaded():
            self._mean, self._linear = MeanShape().fit(*normal), Linear().fit(*normal)
        self._lifter = LandmarkLifter.load(weights_file(run, "lifting", scheme))
        self._deep_mds = None
        if scheme in DEEP_MDS:
            self._deep_mds = DeepMDS.load(weights_file(run, "deepmds", scheme))
            self._deep_mds.set_params(n_jobs=run.jobs)

    def predict(self, views: np.ndarray, sd: np.ndarray) -> Iterator[tuple[str, np.ndarray]]:
        """Yield each method and its shapes of views `(n, L, 2)`, y up, with errors of `(n, L)`."""
        yield "mean_shape", self._mean.predict(views)
        yield "linear", self._linear.predict(normalise(centre(views)))
        if self._deep_mds is not None:
            yield "ours_stable", self._deep_mds.predict(views, check_orientation=False)
        yield "lifting", self._lifter.predict(views, landmark_sd=sd, check_orientation=False)


def measure(run: Run) -> Iterator[dict]:
    """Rows of the table: each method, on each kind of landmarks of the photos of each model."""
    errors = measured_errors(run)
    for scheme in LIFTERS:
        compared = Compared(run, scheme)
        for model in load_record(run, "portraits")["models"]:
            photos = read_portraits(run, model, "tests")
            source = "bfm72" if scheme == "bfm72" else "ibug68"
            truth = normalise(convert(photos[f"landmarks_{source}"], source, scheme))
            pixels = convert(photos[f"pixels_{source}"], source, scheme)
            everyone = np.ones(len(truth), bool)
            kinds = {"exact": (pixels, everyone, 0.0)}
            radius = rms_radius(photos["pixels_ibug68"][:, -N_INNER:])
            for (detector, own_scheme), own in errors.items():
                if own_scheme == scheme:
                    first = FOUND[detector][0]
                    *_, found = errors_on(photos, detector, first)
                    kinds[detector] = convert(photos[detector], first, scheme), found, own.sd
            for kind, (landmarks, found, sd) in kinds.items():
                views, own_truth = landmarks[found] * (1, -1), truth[found]
                if len(views) < 2:
                    continue
                told = np.broadcast_to(radius[found, None] * sd, views.shape[:2])
                shapes = dict(compared.predict(views, told))
                if kind == "mediapipe":
                    shapes["mediapipe_corrected"] = photos["mediapipe_shape"][found]
                mean = align(shapes["mean_shape"], own_truth)
                for method, shape in shapes.items():
                    aligned = align(shape, own_truth)
                    error = mse(aligned, own_truth)
                    yield {
                        "scheme": scheme,
                        "faces": model,
                        "views": kind,
                        "method": method,
                        "mse": error.mean(),
                        "sem": sem(error),
                        "found_again": bias_of(aligned, mean, own_truth)["slope"],
                        "n_faces": len(error),
                        "not_found": int((~found).sum()),
                    }


def detections(run: Run) -> pd.DataFrame:
    """`detection_table` of each detector that was there, on the photos of each model."""
    portraits = load_record(run, "portraits")
    parts = [
        detection_table(read_portraits(run, model, "errors"), detector, FOUND[detector][0]).assign(
            faces=model
        )
        for detector in portraits["detectors"]
        for model in portraits["models"]
    ]
    return pd.concat(parts)


def cells(table: pd.DataFrame) -> pd.DataFrame:
    """A row a kind of landmarks, a column a method: mean ± standard error, and what is found."""
    methods = list(dict.fromkeys(table["method"]))
    rows = []
    for (scheme, faces, views), own in table.groupby(["scheme", "faces", "views"], sort=False):
        own = own.set_index("method")
        for name, said in (("MSE", _quoted), ("found again", _share)):
            row = [said(own.loc[m]) if m in own.index else "" for m in methods]
            rows.append([scheme, TITLES[faces], views, name, *row])
    heads = ["Landmarks", "Faces", "As found by", f"MSE in {power(_UNIT)}"]
    return pd.DataFrame(rows, columns=[*heads, *map(title, methods)])


def _quoted(row: pd.Series) -> str:
    return plus_minus(row["mse"], row["sem"], _UNIT)


def _share(row: pd.Series) -> str:
    return f"{row['found_again']:.2f}"


def ship(run: Run) -> None:
    """Put weights and measured errors into the package."""
    for method, scheme in trainings():
        path = weights_file(run, method, scheme)
        shutil.copyfile(path, PRETRAINED / path.name)
    for (detector, scheme), errors in measured_errors(run).items():
        write_errors(errors, detector, scheme)


def main(arguments: list[str] | None = None) -> None:
    run = parse_run(__doc__, arguments)
    folder = run.experiment_results("pretrained")
    portraits = load_record(run, "portraits")
    with stage(run, "pretrained") as record:
        table = pd.DataFrame(measure(run))
        record["left_out"], record["lacking"] = portraits["left_out"], portraits["lacking"]
        errors = []
        for name in portraits["detectors"]:
            wrong, _, _, yaw = found_on_photos(run, name)
            errors.append(errors_table(name, FOUND[name][0], wrong, yaw))
        found = detections(run) if portraits["detectors"] else None
        # Weights of one model's faces, or of guessed errors, are not those that the docs describe.
        if run.preset.name == "paper" and not portraits["left_out"] and not portraits["lacking"]:
            ship(run)
    notes = left_out_notes(portraits["left_out"])
    clear_results(folder)
    write_csv(folder / "table.csv", table)
    if errors:
        write_csv(folder / "detector_errors.csv", pd.concat(errors))
        write_csv(folder / "detection.csv", found)
    shown = cells(table)
    write_text(folder / "table.tex", tabular(shown, "llll" + "r" * (shown.shape[1] - 4), notes))
    write_manifest(run, "pretrained", records_of(run, "pretrained"), folder)
    print(shown.to_string(index=False), *notes, *portraits["lacking"].values(), sep="\n")
