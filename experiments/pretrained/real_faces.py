"""Step: what photos of real people, without ground truth, tell about detectors and methods.

It compares the landmarks of the same faces from two detectors. Their differences give the table by
which prediction corrects a detector, `deepmds_keras/landmarks/detectors.csv`. A method is reliable
if its shapes from both are similar, and unlike those of other people.
"""

from __future__ import annotations

import numpy as np
import pandas as pd

from data_gen.models.registry import OPEN, open_models
from deepmds_keras.deep_mds import DeepMDS
from deepmds_keras.errors import InputError
from deepmds_keras.files import read_npz
from deepmds_keras.geometry.alignment import align
from deepmds_keras.geometry.camera import refit
from deepmds_keras.geometry.units import normalise, rms_radius
from deepmds_keras.landmarks import FOLDER, load_scheme
from deepmds_keras.lifting.lifter import LandmarkLifter
from deepmds_keras.tool.detection import detector_sd, move, upright_axes
from experiments.lifting.transfer import Trained
from experiments.methods import title
from experiments.pretrained.portraits import read_portraits
from experiments.pretrained.pretrained import SCHEMES, errors_of
from experiments.pretrained.train import LIFTERS, photo_faces
from experiments.recipes import mlp
from experiments.records import write_csv
from experiments.run import Run
from experiments.streams import Stream
from experiments.studies.study_results import write_results

_SCHEME = "ibug51"
_EYES = ("right_eye_outer_corner", "left_eye_outer_corner")
# Assumed variance of the errors, of both detectors together, relative to that of their difference.
# Errors are correlated, between neighbouring landmarks and between the two detectors, and weigh
# more than white ones of the same size: with 1, the shapes from the two agree less.
_STRENGTH = 6.0


def main(run: Run) -> dict:
    if run.real is None:
        raise InputError("REAL must be an npz file of arrays dlib and mediapipe. Received nothing.")
    arrays = read_npz(run.real)
    if not {"dlib", "mediapipe"} <= {*arrays}:
        raise InputError(f"{run.real} must hold arrays dlib and mediapipe. Received {[*arrays]}.")
    # To image coordinates, y down.
    faces = {name: np.float64(arrays[name]) * (1, -1) for name in ("dlib", "mediapipe")}
    if run.preset.name == "full" and not open_models(run.data)[1]:
        write_csv(FOLDER / "detectors.csv", detector_table(run, faces))
    methods = _methods(run)
    table = pd.DataFrame(reliability(methods, faces))
    misfit = pd.DataFrame(misfits(methods, faces))
    cells = table.set_index(table["method"].map(title))[["ratio", "within", "between"]]
    cells = cells.map("{:.3g}".format).replace("nan", "–")
    return write_results(run, "real", {"table": table, "misfit": misfit}, cells)


def _methods(run: Run) -> Trained:
    """The shipped weights, and other methods trained on the lifter's training faces."""
    rng = np.random.default_rng([run.seed, Stream.PHOTO_FACES, LIFTERS.index(_SCHEME)])
    views, shapes, _ = photo_faces(run, _SCHEME)(run.preset.train_faces, rng)
    networks = LandmarkLifter.pretrained(_SCHEME), DeepMDS.pretrained(f"deepmds-{_SCHEME}")
    return Trained(views, shapes, *networks, mlp(run, views.shape[1]))


def differences(faces: dict[str, np.ndarray]) -> np.ndarray:
    """`(n, 51, 2)` from MediaPipe's landmarks to dlib's, in axes and radii of the upright face."""
    axes, radius = upright_axes(faces["mediapipe"], _SCHEME)
    apart = faces["dlib"] - faces["mediapipe"]
    return apart @ np.swapaxes(axes, 1, 2) / radius[:, None, None]


def detector_table(run: Run, faces: dict[str, np.ndarray]) -> pd.DataFrame:
    """Rows of `detector, landmark, dx, dy, sd`, landmarks by their iBUG numbers.

    dlib was trained on iBUG 300-W: its landmarks stay, MediaPipe's move by the mean difference. The
    s.d. of landmarks relative to each other are those on rendered photos; their common scale is set
    by the difference on real ones.
    """
    apart = differences(faces)
    variances = {name: _variance(run, name) for name in SCHEMES}
    both = sum(variance[-apart.shape[1] :] for variance in variances.values()).mean()
    size = np.sqrt(_STRENGTH * apart.var(0).mean() / both)
    parts = []
    for detector, (scheme, *_) in SCHEMES.items():
        sd = size * np.sqrt(variances[detector])
        offset = apart.mean(0) if detector == "mediapipe" else np.zeros((len(sd), 2))
        part = {"detector": detector, "landmark": load_scheme(scheme).numbers}
        part |= {"dx": offset[:, 0], "dy": offset[:, 1], "sd": sd}
        parts.append(pd.DataFrame(part))
    return pd.concat(parts).round(5)


def _variance(run: Run, detector: str) -> np.ndarray:
    """`(L,)` of a coordinate of each landmark about its mean error on rendered photos."""
    errors = (errors_of(read_portraits(run, model), detector) for model in OPEN)
    return np.mean([e[detected].var(0).mean(1) for e, detected in errors], axis=0)


def reliability(methods: Trained, faces: dict[str, np.ndarray]) -> list[dict]:
    """Similarity of a face's shapes from both detectors, for each method.

    Returns:
        Rows of `method, ratio, within, between`: mean squared distance between the two shapes of a
        face after alignment, over that between shapes of different faces from different detectors;
        0 if the detectors agree perfectly, 1 if a shape says nothing about a person. The unit is
        that of `normalise`, squared. Offsets come from one half of the faces, the test from the
        other.
    """
    apart, rows = differences(faces), []
    n = len(apart)
    for half in (np.arange(n) % 2, np.arange(n) // (n // 2 + 1)):
        for tested in (half == 0, half == 1):
            mediapipe = move(faces["mediapipe"][tested], _SCHEME, apart[~tested].mean(0))
            first = _predict(methods, faces["dlib"][tested], "dlib")
            second = _predict(methods, mediapipe, "mediapipe")
            for method in first:
                rows.append({"method": method, **_distances(first[method], second[method])})
    means = pd.DataFrame(rows).groupby("method", sort=False, as_index=False).mean()
    means.insert(1, "ratio", (means["within"] / means["between"]).where(means["between"] > 1e-12))
    return means.to_dict("records")


def _predict(methods: Trained, landmarks: np.ndarray, detector: str) -> dict[str, np.ndarray]:
    sd = rms_radius(landmarks)[:, None] * detector_sd(detector, _SCHEME)
    return methods.predict(landmarks * (1, -1), sd)


def _distances(first: np.ndarray, second: np.ndarray) -> dict[str, float]:
    first, second = normalise(first), normalise(second)
    n = len(first)
    pairs = [((align(second, np.stack([face] * n)) - face) ** 2).mean((1, 2)) for face in first]
    same = np.eye(n, dtype=bool)
    return {"within": np.array(pairs)[same].mean(), "between": np.array(pairs)[~same].mean()}


def misfits(methods: Trained, faces: dict[str, np.ndarray]) -> list[dict]:
    """Distance of the projected lifted shape from the landmarks.

    Returns:
        Rows of `detector, given_sd, misfit`: the median over faces of the root mean square residual
        of a coordinate, relative to the distance between the outer corners of the eyes; with the
        detector's s.d., and with the lifter's default.
    """
    right, left = map(load_scheme(_SCHEME).index, _EYES)
    rows = []
    for detector, landmarks in faces.items():
        views, eyes = landmarks * (1, -1), landmarks[:, right] - landmarks[:, left]
        sd = rms_radius(landmarks)[:, None] * detector_sd(detector, _SCHEME)
        for given, options in (("detector", {"landmark_sd": sd}), ("none", {})):
            shapes, _, pose = methods.lifter.estimate(views, **options)
            off = refit(pose, views, shapes).project(shapes) - views
            off = np.sqrt((off**2).mean((1, 2))) / np.linalg.norm(eyes, axis=1)
            rows.append({"detector": detector, "given_sd": given, "misfit": np.median(off)})
    return rows
