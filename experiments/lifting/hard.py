"""Views far from the paper's: turned, near, noisy and incomplete, against the limit of any method.

Every condition is a column of the table. Methods that are trained are trained for each, on faces of
one sampler; the large lifting network is trained once, for all.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pandas as pd

from deepmds_keras.alignment import align
from deepmds_keras.io.archives import read_arrays, write_arrays
from deepmds_keras.metrics import mse
from deepmds_keras.normalisation import centre, normalise
from experiments.arguments import parse_run
from experiments.build_key import is_done
from experiments.figures.lifting_curves import errors_by_condition, errors_by_yaw, reliability
from experiments.figures.style import save
from experiments.lifting.calibration import coverage
from experiments.lifting.contenders import PREDICT
from experiments.lifting.hard_networks import (
    DEEP_MDS,
    LIFTERS,
    SEEDED,
    Cell,
    describe_networks,
    load_network,
    seeds_of,
    train,
    training_of,
)
from experiments.lifting.hard_tables import (
    LIMIT,
    by_cell,
    by_yaw,
    calibration,
    latex,
    summarise,
    text,
)
from experiments.lifting.limit import limit
from experiments.lifting.views import (
    CONDITIONS,
    HIDDEN,
    Condition,
    HardFaces,
    face_model,
    find_hidden,
    hard_faces,
    landmark_model,
)
from experiments.manifest import MANIFEST, clear_results, records_of, write_manifest
from experiments.progress import Bar
from experiments.records import write_text
from experiments.run import Run
from experiments.running import stage
from experiments.scoring.tables import write_csv
from experiments.streams import Stream
from experiments.tasks import unordered

FOLDER = "lifting/hard"
# Fits of a face model, which take long, see only so many of the test faces.
_FITS = ("aldrian", "model_fit")
# Axes of a figure, and where on them conditions stand.
_SWEEPS = {
    "Noise (% of 90 mm)": {
        c.id: c.noise for c in CONDITIONS if c.protocol == "hard" and not c.missing
    },
    "Missing landmarks (%), noise 1 %": {
        c.id: 100 * c.missing for c in CONDITIONS if c.noise == 1 and c.missing != HIDDEN
    },
}


def cells(run: Run) -> Iterator[Cell]:
    """Every method, condition that it is measured in, and seed."""
    for condition in CONDITIONS:
        for method in (*PREDICT, DEEP_MDS, *LIFTERS, LIMIT):
            if method == DEEP_MDS and training_of(method, condition, run.seed) is None:
                continue
            for seed in seeds_of(run, method, condition):
                yield method, condition, seed


def cell_file(run: Run, method: str, condition: Condition, seed: int) -> Path:
    """Errors of a method on the test faces, and how they are covered."""
    return run.work / "hard" / "errors" / condition.id / f"{method}-seed{seed}.npz"


def measure(run: Run, method: str, condition: Condition, seed: int) -> None:
    """Write a method's errors on the test faces of a condition."""
    faces = hard_faces(run, condition)
    if method in _FITS:
        faces = faces[: run.preset.fitted_faces]
    if method == LIMIT:
        rng = np.random.default_rng([run.seed, Stream.HARD_LIMIT])
        arrays = {"mse": limit(landmark_model(run), faces, rng)}
    elif method in LIFTERS:
        network = load_network(run, training_of(method, condition, seed))
        shapes, sd = network.predict(faces.views, landmark_sd=faces.sd_mm, return_std=True)
        truth = centre(normalise(faces.shapes))
        arrays = {"mse": _errors(shapes, faces), "coverage": coverage(shapes - truth, sd)}
    elif method == DEEP_MDS:
        network = load_network(run, training_of(method, condition, seed))
        arrays = {"mse": _errors(network.predict(faces.views), faces)}
    else:
        arrays = {"mse": _errors(PREDICT[method](run, condition, faces), faces)}
    described = {"method": method, "condition": condition.id, "seed": seed}
    write_arrays(cell_file(run, method, condition, seed), arrays, described)


def _errors(shapes: np.ndarray, faces: HardFaces) -> np.ndarray:
    truth = normalise(faces.shapes)
    return mse(align(shapes, truth), truth)


def measure_all(run: Run) -> None:
    """Measure what is not measured yet."""
    todo = [(run, *cell) for cell in cells(run) if not cell_file(run, *cell).exists()]
    with Bar(total=len(todo), desc="methods by conditions", unit="cell") as bar:
        for _ in unordered(run.jobs, measure, todo):
            bar.update()


def write(run: Run, folder: Path) -> None:
    """Write the tables and figures of all that was measured."""
    measured = {cell: read_arrays(cell_file(run, *cell))[0] for cell in cells(run)}
    errors = {cell: arrays["mse"] for cell, arrays in measured.items()}
    covered = {cell: own["coverage"] for cell, own in measured.items() if "coverage" in own}
    yaw = {condition.id: hard_faces(run, condition).cameras.yaw for condition in CONDITIONS}
    metrics, curves, levels = by_cell(errors, covered), by_yaw(errors, yaw), calibration(covered)
    table = summarise(metrics)
    clear_results(folder)
    for name, rows in (
        ("metrics", metrics),
        ("table", table),
        ("by_yaw", curves),
        ("calibration", levels),
    ):
        write_csv(folder / f"{name}.csv", rows)
    write_text(folder / "table.tex", latex(table))
    draw(table, curves, levels, folder / "figures")


def draw(table: pd.DataFrame, curves: pd.DataFrame, levels: pd.DataFrame, folder: Path) -> None:
    """Write the figures of the tables."""
    save(errors_by_yaw(curves[curves["condition"] == SEEDED]), folder, "errors_by_yaw")
    known = table[(table["metric"] == "mse") & table["mean"].notna()]
    sweeps = {
        label: known[known["condition"].isin(values)].assign(
            value=lambda rows, values=values: rows["condition"].map(values)
        )
        for label, values in _SWEEPS.items()
    }
    save(errors_by_condition(sweeps), folder, "errors_by_condition")
    first = levels[levels["seed"] == levels["seed"].min()]
    titles = {condition.id: condition.title for condition in CONDITIONS}
    save(reliability(first.assign(condition=first["condition"].map(titles))), folder, "reliability")


def main(arguments: list[str] | None = None) -> None:
    run = parse_run(__doc__, arguments)
    folder = run.experiment_results(FOLDER)
    if not is_done(run, "hard"):
        with stage(run, "hard") as record:
            model = face_model(run)
            record |= {"model": model.name, "model_sha256": model.sha256}
            record["processes_mb"] = train(run)
            record |= describe_networks(run)
            find_hidden(run)
            measure_all(run)
            clear_results(folder)  # of an earlier run
    if not (folder / MANIFEST).exists():
        write(run, folder)
        write_manifest(run, "lifting", records_of(run, "hard"), folder)
    print(f"\n{run.model}, {run.preset.name} preset, seed {run.seed}\n")
    print(text(pd.read_csv(folder / "table.csv")))
    print(f"\nTables, figures and manifest: {folder}/")
