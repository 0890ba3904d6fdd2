"""What it takes to predict: size of a fresh installation, memory and time of the command.

`make footprint` installs the package with each detector into an environment of its own and writes
`results/bench/footprint.csv`. Times are those of whole processes, as a user waits for them.
"""

from __future__ import annotations

import argparse
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from statistics import median

import numpy as np
import pandas as pd

from data_gen.models.openhead import load_openhead
from data_gen.views.photo_views import sample_photo_views
from experiments.manifest import environment
from experiments.progress import Bar
from experiments.running import exit_on_user_error
from experiments.scoring.tables import write_csv

_ROOT = Path(__file__).parents[2]
_PHOTO = _ROOT / "docs" / "pictures" / "portraits.jpg"
_RESULT = _ROOT / "results" / "bench" / "footprint.csv"
_EXTRAS = ("dlib", "mediapipe")
_REPEATS, _ROWS = 5, 20_000
_MB = 1e6
# The second photo of a process: what is loaded once is loaded.
_WARM = """
import sys, time
from deepmds_keras import predict_photo
predict_photo(sys.argv[1])
start = time.perf_counter()
predict_photo(sys.argv[1])
print(time.perf_counter() - start)
"""

_METER = """
import resource, subprocess, sys, time
start = time.perf_counter()
subprocess.run(sys.argv[1:], check=True, stdout=subprocess.DEVNULL)
seconds = time.perf_counter() - start
print(seconds, resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss)
"""


def main(arguments: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(prog="python -m experiments footprint", description=__doc__)
    parser.parse_args(arguments)
    rows = []
    with exit_on_user_error(), Bar(total=len(_EXTRAS), desc="footprint", unit="install") as bar:
        for extra in _EXTRAS:
            with tempfile.TemporaryDirectory() as folder:
                rows += [{"extra": extra, **row} for row in measure(extra, Path(folder))]
            bar.update()
    table = pd.DataFrame(rows).assign(processor=environment()["processor"])
    write_csv(_RESULT, table)
    print(table.to_string(index=False))


def measure(extra: str, folder: Path) -> Iterator[dict]:
    """Rows of an installation with an extra: what is measured, how much, and in which unit."""
    venv = folder / "venv"
    subprocess.run([sys.executable, "-m", "venv", venv], check=True)
    empty = _size(venv)  # pip, which is in every environment
    python = venv / "bin" / "python"
    pip = [python, "-m", "pip", "install", "-q", "--disable-pip-version-check"]
    subprocess.run([*pip, f"{_sources(folder / 'sources')}[{extra}]"], check=True)
    installed = (_size(venv) - empty) / _MB
    yield {"measure": "size of what is installed", "value": installed, "unit": "MB"}

    rows = folder / "rows.csv"
    views, _, _ = sample_photo_views(load_openhead(), "ibug51", _ROWS, np.random.default_rng(0))
    np.savetxt(rows, (views * (1, -1)).reshape(_ROWS, -1), "%.3f", ",")
    command = [venv / "bin" / "deepmds", "predict", "--force", "--out", folder / "out"]
    _used([*command, _PHOTO])  # compiles what is imported
    photo = [_used([*command, _PHOTO]) for _ in range(_REPEATS)]
    yield {"measure": "one photo, cold", "value": median(s for s, _ in photo), "unit": "s"}
    yield {"measure": "one photo, memory", "value": max(b for _, b in photo) / _MB, "unit": "MB"}
    warm = subprocess.run(
        [python, "-c", _WARM, _PHOTO], check=True, capture_output=True, text=True, cwd=folder
    )
    yield {"measure": "one photo, warm", "value": float(warm.stdout), "unit": "s"}
    seconds, _ = _used([*command, rows, "--format", "csv"])
    yield {"measure": f"{_ROWS:,} rows to CSV", "value": seconds, "unit": "s"}


def _sources(folder: Path) -> Path:
    """A copy of what is installed: pip builds in the folder, where `build/` is that of the runs."""
    shutil.copytree(_ROOT / "deepmds_keras", folder / "deepmds_keras")
    for name in ("setup.cfg", "pyproject.toml", "README.md", "LICENSE"):
        shutil.copy(_ROOT / name, folder)
    return folder


def _size(folder: Path) -> int:
    """Bytes on disk."""
    return sum(path.lstat().st_blocks * 512 for path in folder.rglob("*"))


def _used(command: list) -> tuple[float, int]:
    """Seconds that a process takes, and the most memory that it holds, in bytes.

    A small process starts it: the most memory of a process counts that of the one it was forked
    from.
    """
    meter = [sys.executable, "-S", "-c", _METER, *map(str, command)]
    said = subprocess.run(meter, check=True, capture_output=True, text=True).stdout.split()
    return float(said[0]), int(said[1]) * 1024
