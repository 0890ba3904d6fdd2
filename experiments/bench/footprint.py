"""Step: the cost of predicting: size of a fresh installation, memory and time of the command.

`make footprint` installs the package with each detector into a separate environment. Times are
those of whole processes, as a user waits for them.
"""

import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from statistics import median

import numpy as np
import pandas as pd

from data_gen.models.openhead import load_openhead
from data_gen.views import sample_photo_views
from experiments.records import new_results, write_csv
from experiments.run import Run

_ROOT = Path(__file__).parents[2]
_PHOTO = _ROOT / "docs" / "pictures" / "portraits.jpg"
_REPEATS, _ROWS, _MB = 5, 20_000, 1e6
# The second photo of a process, with everything loaded.
_WARM = """
import sys, time
from deepmds_keras import predict_photo
predict_photo(sys.argv[1])
start = time.perf_counter()
predict_photo(sys.argv[1])
print(time.perf_counter() - start)
"""
# A small process starts the command: the peak memory of a process counts that of its parent.
_METER = """
import resource, subprocess, sys, time
start = time.perf_counter()
subprocess.run(sys.argv[1:], check=True, stdout=subprocess.DEVNULL)
seconds = time.perf_counter() - start
print(seconds, resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss * 1024)
"""


def main(run: Run) -> dict:
    rows = []
    for extra in ("dlib", "mediapipe"):
        with tempfile.TemporaryDirectory() as environment:
            rows += [(extra, *row) for row in measure(extra, Path(environment))]
    table = pd.DataFrame(rows, columns=["extra", "measure", "value", "unit"])
    folder = run.shared_results / "footprint"
    write_csv(new_results(folder) / "footprint.csv", table)
    print(table.to_string(index=False))
    return {"results": [folder]}


def measure(extra: str, folder: Path) -> Iterator[tuple[str, float, str]]:
    """Install with an extra into a folder; yield what is measured, how much, and in which unit."""
    venv, sources, rows = folder / "venv", folder / "sources", folder / "rows.npy"
    # A copy, since pip builds in the folder, whose `build/` is that of the runs.
    shutil.copytree(_ROOT / "deepmds_keras", sources / "deepmds_keras")
    for name in ("setup.cfg", "pyproject.toml", "README.md", "LICENSE"):
        shutil.copy(_ROOT / name, sources)
    subprocess.run([sys.executable, "-m", "venv", venv], check=True)
    empty, python = _size(venv), venv / "bin" / "python"  # pip is in every environment
    start = time.perf_counter()
    subprocess.run([python, "-m", "pip", "install", "-q", f"{sources}[{extra}]"], check=True)
    yield "pip install", time.perf_counter() - start, "s"
    yield "size of what is installed", (_size(venv) - empty) / _MB, "MB"

    command = [venv / "bin" / "deepmds", "predict", "--overwrite", "--out", folder / "out"]
    _metered([*command, _PHOTO])  # compiles what is imported
    photos = [_metered([*command, _PHOTO]) for _ in range(_REPEATS)]
    yield "one photo, cold", median(seconds for seconds, _ in photos), "s"
    yield "one photo, memory", max(memory for _, memory in photos) / _MB, "MB"
    warm = subprocess.check_output([python, "-c", _WARM, _PHOTO], text=True, cwd=folder)
    yield "one photo, warm", float(warm), "s"
    views, _, _ = sample_photo_views(load_openhead(), "ibug51", _ROWS, np.random.default_rng(0))
    np.save(rows, views * (1, -1))
    yield f"{_ROWS:,} rows to CSV", _metered([*command, rows, "--format", "csv"])[0], "s"


def _size(folder: Path) -> int:
    """Bytes on disk."""
    return sum(path.lstat().st_blocks * 512 for path in folder.rglob("*"))


def _metered(command: list) -> tuple[float, float]:
    """Seconds that a process takes, and its peak memory in bytes."""
    meter = [sys.executable, "-S", "-c", _METER, *map(str, command)]
    seconds, memory = subprocess.check_output(meter, text=True).split()
    return float(seconds), float(memory)
