"""What steps write in addition to their arrays: records, manifests of results, tables and text.

A record says how one step was made when it ran: by which commit, on which machine, from which
files. The manifest of a folder of results lists the records of all steps behind it.
"""

from __future__ import annotations

import ctypes
import functools
import hashlib
import json
import os
import platform
import shutil
import subprocess
from collections.abc import Iterable
from importlib.metadata import distributions
from pathlib import Path
from typing import TYPE_CHECKING

from filelock import FileLock

from deepmds_keras.errors import InputError
from deepmds_keras.files import sha256_of, write_bytes

if TYPE_CHECKING:
    import pandas as pd

MANIFEST = "manifest.json"
_ROOT = Path(__file__).parents[1]
PUBLISHED = _ROOT / "results" / "published"  # what the paper prints and claims
_PIECES = "pieces-of.json"
_CHECKSUM = "sha256"
# What numbers depend on, but for files of the package that steps write: steps that read these name
# them as inputs, whose hashes are in their manifests.
_CODE = (
    *("data_gen", "deepmds_keras", "experiments", "setup.cfg", "constraints.txt"),
    *(":!deepmds_keras/pretrained", ":!deepmds_keras/landmarks/detectors.csv"),
    ":!deepmds_keras/tool/predict/surface.npz",
)
_PACKAGES = (
    "dlib-bin", "h5py", "joblib", "keras", "matplotlib", "mediapipe", "numpy", "pandas",
    "scikit-learn", "scipy", "snakemake", "tensorflow", "tensorflow-cpu", "vtk",
)  # fmt: skip
# What steps write for others, besides their records; `{}` is the item that a step is done for.
_WRITTEN = {
    "faces": ("train.npz", "test.npz", "landmark_model.npz"),
    "images": ("images",),
    "frames": ("train.npz",),
    "scans": ("test.npz", "scans.npz", "images/test"),
    "rings": ("rings.npz", "landmark_model.npz", "images/rings"),
    "photos": ("test.npz", "photos.npz", "images/test"),
    "portraits": ("portraits",),
    "predict": ("predictions/{}.npz",),
    "audit": ("audit/{}.csv",),
    "lifting": ("lifting/{}.npz",),
    "object": ("objects/{}.csv",),
    "pretrained": ("photo-networks/{}.npz",),
    "released_weights": ("released-weights/{}.csv",),
    "scale": ("scales/{}.csv",),
    "variant": ("ablation/{}.json",),
}
# For other steps only, not for readers of the results.
_INTERNAL = ("checksums", "rows")
# Of Linux's renameat2: paths are relative to the current folder; two names change places.
_HERE, _EXCHANGE = -100, 2


def write_json(path: Path, value: dict) -> None:
    write_text(path, json.dumps(value, indent=2, ensure_ascii=False) + "\n")


def write_text(path: Path, text: str) -> None:
    write_bytes(path, text.encode("utf-8"))


def write_csv(path: Path, table: pd.DataFrame) -> None:
    """Write CSV with eight significant digits, the same on every system."""
    write_text(path, table.to_csv(index=False, float_format="%.8g", lineterminator="\n"))


# Records


def write_record(path: Path, record: dict) -> None:
    """Write a record with a checksum of its content."""
    write_json(path, record | {_CHECKSUM: _checksum(record)})


def read_record(path: Path) -> dict:
    """Read a record, without its checksum.

    Raises:
        InputError: The file is missing or damaged.
    """
    try:
        record = json.loads(path.read_text(encoding="utf-8"))
        whole = record.pop(_CHECKSUM) == _checksum(record)
    except FileNotFoundError:
        raise InputError(f"{path} not found: the record of a finished step.") from None
    except (AttributeError, KeyError, RecursionError, TypeError, ValueError):
        whole = False
    if not whole:
        raise InputError(
            f"{path} must be an unchanged record. Received other text; delete it and run again."
        )
    return record


def writers(message: str, folder: Path) -> list[Path]:
    """Records in a folder of runs of the steps that wrote a file which a message names."""

    def files(record: Path) -> Iterable[str]:
        kind, _, item = record.stem.partition("-")
        return (str(record.parents[1] / name.format(item)) for name in _WRITTEN.get(kind, ()))

    records = sorted(folder.glob("*/records/*.json"))
    return [record for record in records if any(file in message for file in files(record))]


def steps_behind(record: dict) -> list[dict]:
    """Records of all steps behind a record, and itself, in the order in which they began."""
    steps: dict[Path, dict] = {}

    def add(paths: Iterable[str]) -> None:
        # What a step needs is added before it, and so stays before it if both began in one second.
        for path in map(Path, paths):
            if path not in steps:
                step = read_record(path)
                add(step["needs"])
                steps[path] = step

    add(record["needs"])
    behind = [*sorted(steps.values(), key=lambda step: step["started"]), record]
    return [{k: v for k, v in step.items() if k not in _INTERNAL} for step in behind]


def listing(folder: str | Path | None) -> str:
    """sha256 of the names and sizes of all files in a folder, whose content may be too large."""
    digest = hashlib.sha256()
    # As readers, through links to folders; a link to nothing counts as itself.
    for where, folders, names in os.walk(folder, followlinks=True) if folder else ():
        folders.sort()
        for name in sorted(names):
            path = os.path.join(where, name)
            size = os.stat(path, follow_symlinks=os.path.exists(path)).st_size
            digest.update(f"{os.path.relpath(path, folder)} {size}\n".encode())
    return digest.hexdigest() if folder else ""


# Results


def new_results(folder: Path) -> Path:
    """Empty folder for the results of a step, beside those of an earlier run."""
    new = _beside(folder)
    shutil.rmtree(new, ignore_errors=True)
    new.mkdir(parents=True)
    return new


def publish(folder: Path) -> None:
    """Put new results in the place of earlier ones, all at once.

    A process that is killed at any moment leaves the whole folder of either run. Files that a user
    added to the earlier one stay.
    """
    new = _beside(folder)
    if folder.exists():
        written = read_manifest(folder).get("files", ()) if (folder / MANIFEST).exists() else ()
        for name, path in _results(folder).items():
            if name not in written and not (new / name).exists():
                (new / name).parent.mkdir(parents=True, exist_ok=True)
                shutil.copy2(path, new / name)
        _exchange(new, folder)
        shutil.rmtree(new, ignore_errors=True)
    else:
        new.rename(folder)


def _beside(folder: Path) -> Path:
    return folder.with_name(f".{folder.name}.partial")


def _exchange(new: Path, old: Path) -> None:
    """Exchange two folders; where the system cannot, the old one is deleted, its manifest first."""
    try:
        exchange = ctypes.CDLL(None).renameat2
    except AttributeError:  # not Linux
        failed = True
    else:
        failed = exchange(_HERE, os.fsencode(new), _HERE, os.fsencode(old), _EXCHANGE)
    if failed:
        (old / MANIFEST).unlink(missing_ok=True)
        shutil.rmtree(old)
        new.rename(old)


def write_manifest(folder: Path, record: dict) -> None:
    """Write `manifest.json` of new results: the steps behind them, and hashes of their files."""
    new = _beside(folder)
    steps = steps_behind(record)
    shared = _of_most(steps) | {"command": record["command"]}
    manifest = shared | {
        "published_sha256": sha256_of([PUBLISHED / "published.csv"]),
        "steps": [
            {k: v for k, v in step.items() if k not in shared or shared[k] != v} for step in steps
        ],
        "files": {name: sha256_of([path]) for name, path in _results(new).items()},
    }
    write_json(new / MANIFEST, manifest)


def _of_most(steps: list[dict]) -> dict:
    """What most steps have in common, such as the commit, which is then written once."""
    common = {}
    for name in steps[-1]:
        values = [step[name] for step in steps if name in step]
        value = max(values, key=values.count)
        # A step without it would seem to have it.
        if len(values) == len(steps) < 2 * values.count(value):
            common[name] = value
    return common


def manifests(folder: Path) -> list[Path]:
    """Manifests of all results in a folder, but not of those that a killed step did not finish."""
    paths = sorted(folder.rglob(MANIFEST))
    return [path for path in paths if not path.parent.name.startswith(".")]


def read_manifest(folder: Path) -> dict:
    """Read the manifest of a folder of results.

    Raises:
        InputError: The file does not exist, or is not a manifest.
    """
    path = folder / MANIFEST
    try:
        manifest = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise InputError(f"{path} not found.") from None
    except ValueError:
        manifest = None
    if not isinstance(manifest, dict):
        raise InputError(f"{path} must be a JSON object. Received other text.")
    return manifest


def steps_of(manifest: dict) -> list[dict]:
    """The steps behind results, each completed by what most of them have in common."""
    shared = {name: value for name, value in manifest.items() if name != "steps"}
    return [shared | step for step in manifest.get("steps", [])]


def commits_of(manifest: dict) -> set[str]:
    """Commits whose code made results, with a `+` if files had changed; empty if unknown."""
    return {step["commit"] for step in steps_of(manifest) if step.get("commit")}


def _results(folder: Path) -> dict[str, Path]:
    """Files but the manifest, and those with temporary names, by relative name."""
    paths = (path for path in sorted(folder.rglob("*")) if path.is_file())
    return {
        path.relative_to(folder).as_posix(): path
        for path in paths
        if path.name != MANIFEST and not path.name.startswith(".")
    }


# Pieces of a step


def resumable(folder: Path, inputs: Iterable[Path] = (), **parameters) -> Path:
    """Folder of pieces from which an interrupted step resumes; emptied if its inputs changed.

    Args:
        folder: Folder of checkpoints, shards or images.
        inputs: Files that the pieces are made from.
        parameters: What else they depend on, as JSON values.

    Raises:
        InputError: An input is missing.
    """
    try:
        digests = [sha256_of([path]) for path in inputs]
    except FileNotFoundError as error:
        raise InputError(
            f"{error.filename} not found: run the step that writes it first."
        ) from None
    made_from = json.dumps({"inputs": digests, **parameters}, sort_keys=True)
    note = folder / _PIECES
    folder.parent.mkdir(parents=True, exist_ok=True)
    with FileLock(folder.with_name(f".{folder.name}.lock")):  # steps that share it start together
        if not (note.exists() and note.read_text(encoding="utf-8") == made_from):
            shutil.rmtree(folder, ignore_errors=True)
            write_text(note, made_from)
    return folder


# The machine and the code


@functools.cache
def environment() -> dict:
    """Commit of the code, versions and processor: numbers depend on them besides the inputs."""
    versions = {d.name.replace("_", "-"): d.version for d in distributions()}
    return {
        "commit": _commit(),
        "python": platform.python_version(),
        "platform": f"{platform.system()} {platform.machine()}, {os.cpu_count()} cores",
        "processor": _processor(),
        "packages": {name: versions[name] for name in _PACKAGES if name in versions},
    }


def _processor() -> str:
    """Model of the processor, if the system tells: rounding differs between them."""
    try:
        first = Path("/proc/cpuinfo").read_text(encoding="utf-8").partition("\n\n")[0]
    except OSError:
        return platform.processor()
    pairs = (line.partition(":") for line in first.splitlines())
    told = {name.strip(): value.strip() for name, _, value in pairs}
    # Virtual machines hide the generation in the name, but not in these numbers.
    numbers = [f"{name} {told[name]}" for name in ("cpu family", "model") if name in told]
    return ", ".join([told.get("model name", platform.processor()), *numbers])


def _commit() -> str | None:
    """Commit of the code, with a `+` if a file of it was changed or is new."""
    try:
        if git("rev-parse", "--show-prefix"):  # a repository of something else, around this folder
            return None
        commit = git("rev-parse", "--short=12", "HEAD")
        changed = git("status", "--porcelain", "--untracked-files=all", "--", *_CODE)
    except (OSError, subprocess.CalledProcessError):
        return None
    return commit + "+" * bool(changed)


def git(*arguments: str, folder: Path = _ROOT) -> str:
    """Output of git; raises OSError or CalledProcessError if it fails."""
    return subprocess.run(
        ["git", *arguments], capture_output=True, text=True, check=True, cwd=folder
    ).stdout.strip()


def _checksum(record: dict) -> str:
    """sha256 of the content of a record, whatever its layout."""
    return hashlib.sha256(json.dumps(record, sort_keys=True).encode()).hexdigest()
