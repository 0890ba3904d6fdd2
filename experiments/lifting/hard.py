"""Views far from the paper's: turned, near, noisy and incomplete, against the limit of any method.

Every condition is a column of the table. Methods that are trained are trained for each, on faces of
one sampler.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pandas as pd

from deepmds_keras.alignment import align
from deepmds_keras.io.archives import read_arrays, write_arrays
from deepmds_keras.metrics import mse
from deepmds_keras.normalisation import normalise
from experiments.arguments import parse_run
from experiments.build_key import is_done
from experiments.lifting.contenders import PREDICT
from experiments.lifting.hard_tables import latex, text, with_limit
from experiments.lifting.limit import limit
from experiments.lifting.views import (
    CONDITIONS,
    Condition,
    face_model,
    find_hidden,
    landmark_model,
    tested_faces,
)
from experiments.manifest import MANIFEST, clear_results, records_of, write_manifest
from experiments.progress import Bar
from experiments.records import write_text
from experiments.run import Run
from experiments.running import stage
from experiments.scoring.tables import to_csv
from experiments.streams import Stream
from experiments.tasks import unordered

FOLDER = "lifting/hard"
LIMIT = "limit"
# Fits of a face model, which take long, see only so many of the test faces.
_FITS = ("aldrian", "model_fit")


def measurements() -> Iterator[tuple[str, Condition]]:
    """Every method with every condition that it is measured in."""
    for condition in CONDITIONS:
        for method in (*PREDICT, LIMIT):
            yield method, condition


def measure(run: Run, method: str, condition: Condition) -> None:
    """Write a method's errors on the test faces of a condition, unless they are there."""
    path = errors_file(run, method, condition)
    if path.exists():
        return
    faces = tested_faces(run, condition)
    if method in _FITS:
        faces = faces[: run.preset.fitted_faces]
    if method == LIMIT:
        rng = np.random.default_rng([run.seed, Stream.HARD_LIMIT])
        errors = limit(landmark_model(run), faces, condition.sd_mm, rng)
    else:
        truth = normalise(faces.shapes)
        errors = mse(align(PREDICT[method](run, condition, faces), truth), truth)
    write_arrays(path, {"mse": errors}, {"method": method, "condition": condition.id})


def errors_file(run: Run, method: str, condition: Condition) -> Path:
    return run.work / "hard" / condition.id / f"{method}.npz"


def collected(run: Run) -> pd.DataFrame:
    """Mean errors of all that was measured: `condition, method, metric, mean, …, n_faces`."""
    rows = []
    for method, condition in measurements():
        errors = read_arrays(errors_file(run, method, condition))[0]["mse"]
        best = read_arrays(errors_file(run, LIMIT, condition))[0]["mse"][: len(errors)]
        rows += with_limit(condition.id, method, errors, best)
    return pd.DataFrame(rows)


def write(run: Run, folder: Path) -> None:
    """Write the tables of all that was measured."""
    metrics = collected(run)
    clear_results(folder)
    write_text(folder / "metrics.csv", to_csv(metrics))
    write_text(folder / "table.tex", latex(metrics))


def main(arguments: list[str] | None = None) -> None:
    run = parse_run(__doc__, arguments)
    folder = run.experiment_results(FOLDER)
    if not is_done(run, "hard"):
        with stage(run, "hard") as record:
            model = face_model(run)
            record |= {"model": model.name, "model_sha256": model.sha256}
            find_hidden(run)
            tasks = [(run, *item) for item in measurements()]
            with Bar(total=len(tasks), desc="measurements", unit="cell") as bar:
                for _ in unordered(run.jobs, measure, tasks):
                    bar.update()
            clear_results(folder)  # of an earlier run
    if not (folder / MANIFEST).exists():
        write(run, folder)
        write_manifest(run, "lifting", records_of(run, "hard"), folder)
    print(f"\n{run.model}, {run.preset.name} preset, seed {run.seed}: MSE in 10⁻⁶\n")
    print(text(pd.read_csv(folder / "metrics.csv")))
    print(f"\nTables and manifest: {folder}/")
