"""Claims on photos of turned heads: what MediaPipe finds, and what 51 landmarks give."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pandas as pd

from data_gen.datasets.dataset import load_dataset
from experiments.audit.evidence import Inputs
from experiments.audit.findings import ALIKE, Finding, does_not_hold, holds, holds_if, unknown
from experiments.audit.poses import SWEEPS, curves, reach, sweep_views
from experiments.build_key import is_done
from experiments.inputs import as_seen
from experiments.methods import load, title
from experiments.run import Run
from experiments.scoring.numbers import enumeration, minus, scientific
from experiments.streams import Stream

_METHODS = ("ours", "ours_stable", "mean_shape")
_FACES = 50
_FARTHEST = 45  # degrees, to which the views of the training are turned


def measure(inputs: Inputs) -> dict:
    """Share of the faces that MediaPipe finds by yaw, and errors with 51 landmarks by yaw."""
    return {"found_by_yaw": measure_detections(inputs.run), "yaw_51": _yaw_51(inputs.run)}


def mediapipe_poses(found_by_yaw: Mapping | None) -> Finding:
    """Does MediaPipe find fewer faces in posed images than in frontal ones?"""
    if found_by_yaw is None:
        return unknown("`make pretrained`")
    found = {float(yaw): share for yaw, share in found_by_yaw.items()}
    evidence = (
        "Of rendered photos of both open face models MediaPipe finds the face in "
        + enumeration([f"{100 * share:.3g} % (yaw {yaw:g}°)" for yaw, share in found.items()])
        + "."
    )
    return holds(evidence) if found[max(found)] < found[0] else does_not_hold(evidence)


def pose_invariant_51(yaw_51: Mapping | None, alike: float = ALIKE) -> Finding:
    """Is the error with 51 landmarks and expressions the same whatever the yaw?"""
    if yaw_51 is None:
        return unknown("`make reproduce-flame`")
    yaws, frontal = np.array(SWEEPS["yaw"]), SWEEPS["yaw"].index(0)
    known = np.abs(yaws) <= _FARTHEST
    alike_to, said = {}, []
    for method in ("ours", "ours_stable"):
        errors = np.array(yaw_51[method])
        span = reach(yaws, errors, alike * errors[frontal])
        alike_to[method] = span[0] <= -_FARTHEST and span[1] >= _FARTHEST
        said.append(
            f"{title(method)} has {scientific(errors[frontal], 2)} from the front, at most "
            f"{scientific(errors[known].max(), 2)} for yaws up to {_FARTHEST}°, and stays within "
            f"{alike:g} times the frontal error from {minus('{:g}° to {:g}°'.format(*span))}"
        )
    mean_shape = scientific(yaw_51["mean_shape"][frontal], 2)
    evidence = (
        f"On {_FACES} frames of the training, with expressions, by exact landmarks: "
        f"{'; '.join(said)}. The mean shape has {mean_shape} whatever the yaw."
    )
    if alike_to["ours"]:
        return holds(evidence)
    if alike_to["ours_stable"]:
        return holds_if("if the learning rate decays in training", evidence)
    return does_not_hold(evidence)


def measure_detections(run: Run) -> dict[str, float] | None:
    """Absolute yaw, degrees as JSON has keys, to the share found, by `make pretrained`."""
    path = replace(run, model="openhead").experiment_results("pretrained") / "detection.csv"
    if not path.exists():
        return None
    table = pd.read_csv(path)
    own = table[table["detector"] == "mediapipe"]
    own = own.assign(yaw=own["yaw"].abs(), found=own["found"] * own["n_photos"])
    sums = own.groupby("yaw")[["found", "n_photos"]].sum()
    return {f"{yaw:g}": float(row.found / row.n_photos) for yaw, row in sums.iterrows()} or None


def _yaw_51(run: Run) -> dict[str, list[float]] | None:
    """Method to mean errors along `SWEEPS["yaw"]`, of the networks of the FLAME track."""
    flame = run.on("flame")
    if not is_done(flame, "networks"):
        return None
    frames = load_dataset(flame.work / "train.npz")
    rng = np.random.default_rng([run.seed, Stream.AUDITED_FACES])
    faces = np.sort(rng.choice(len(frames), min(_FACES, len(frames)), replace=False))
    models = {method: load(flame, method) for method in _METHODS}
    for method in ("ours", "ours_stable"):
        models[method].set_params(solver="batched", n_jobs=1)
    views = sweep_views(frames.landmarks[faces].astype(float), ("yaw",))
    rows = curves(models, views, as_seen(frames)[faces])
    return {m: [row["mse"] for row in rows if row["method"] == m] for m in _METHODS}
