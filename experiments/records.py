"""What steps write in addition to their arrays: records, manifests of results, tables and text.

A record says how one step was made when it ran: by which commit, on which machine, from which
files. The manifest of a folder of results lists the records of all steps behind it.
"""

from __future__ import annotations

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

    from experiments.run import Run

MANIFEST = "manifest.json"
_ROOT = Path(__file__).parents[1]
_PIECES = "pieces-of.json"
_CHECKSUM = "sha256"
# What runs write.
_WRITTEN = (":!/results", ":!/deepmds_keras/pretrained")
_PACKAGES = (
    "dlib-bin", "h5py", "joblib", "keras", "matplotlib", "mediapipe", "numpy", "pandas",
    "scikit-learn", "scipy", "snakemake", "tensorflow", "tensorflow-cpu", "vtk",
)  # fmt: skip
# For other steps only, not for readers of the results.
_INTERNAL = ("checksums", "rows", "results")


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
        raise InputError(f"{path} must be there: the record of a step that is done.") from None
    except (AttributeError, KeyError, RecursionError, TypeError, ValueError):
        whole = False
    if not whole:
        raise InputError(
            f"{path} must be a record as it was written. Received another text; delete it and run "
            "again."
        )
    return record


def load_record(run: Run, name: str) -> dict:
    """Read the record of a step of a run.

    Raises:
        InputError: The step was not run, or its record is damaged.
    """
    return read_record(run.record_file(name))


def steps_behind(record: dict) -> list[dict]:
    """Records of all steps behind a record, and itself, in the order in which they ended."""
    steps, left = {}, [Path(path) for path in record["needs"]]
    while left:
        path = left.pop()
        if path not in steps:
            steps[path] = read_record(path)
            left += map(Path, steps[path]["needs"])
    behind = [*sorted(steps.values(), key=lambda step: step["started"]), record]
    return [{k: v for k, v in step.items() if k not in _INTERNAL} for step in behind]


def is_current(record: dict) -> bool:
    """Whether all results of a step still exist."""
    return all(
        Path(folder, name).is_file()
        for folder, names in record.get("results", {}).items()
        for name in (MANIFEST, *names)
    )


def outside_files(paths: Iterable[Path]) -> dict[str, str]:
    """sha256 of files by name."""
    return {path.name: sha256_of([path]) for path in paths}


def listing(folder: str | Path | None) -> str:
    """sha256 of the names and sizes of all files in a folder, whose content may be too large."""
    digest = hashlib.sha256()
    for where, folders, names in os.walk(folder) if folder else ():
        folders.sort()
        for name in sorted(names):
            path = os.path.join(where, name)
            size = os.stat(path).st_size
            digest.update(f"{os.path.relpath(path, folder)} {size}\n".encode())
    return digest.hexdigest() if folder else ""


# Results


def clear_results(folder: Path) -> None:
    """Delete the files that an earlier run wrote to a folder of results, as its manifest lists."""
    try:
        written = read_manifest(folder).get("files", ())
    except InputError:
        written = ()
    (folder / MANIFEST).unlink(missing_ok=True)
    for name, path in _results(folder).items():
        if name in written:
            path.unlink()


def write_manifest(folder: Path, record: dict) -> dict[str, str]:
    """Write `manifest.json`: the steps behind the results, and hashes of what was written.

    It is written last, and `clear_results` deletes it first, so that a folder with a manifest has
    the files of one run.

    Returns:
        sha256 of each file, by its name in the folder.
    """
    files = {name: sha256_of([path]) for name, path in _results(folder).items()}
    steps = steps_behind(record)
    # What all steps have in common, such as the commit, is written once.
    shared = {k: v for k, v in steps[-1].items() if all(step.get(k) == v for step in steps[:-1])}
    shared |= {"command": record["command"]}
    manifest = shared | {
        "published_sha256": sha256_of([_ROOT / "results/published/published.csv"]),
        "steps": [{k: v for k, v in step.items() if k not in shared} for step in steps],
        "files": files,
    }
    write_json(folder / MANIFEST, manifest)
    return files


def read_manifest(folder: Path) -> dict:
    """Read the manifest of a folder of results.

    Raises:
        InputError: The file does not exist, or is not a manifest.
    """
    path = folder / MANIFEST
    try:
        manifest = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise InputError(f"{path} must be there. Received a folder without it.") from None
    except ValueError:
        manifest = None
    if not isinstance(manifest, dict):
        raise InputError(f"{path} must be a JSON object. Received another text.")
    return manifest


def steps_of(manifest: dict) -> list[dict]:
    """The steps behind results, each completed by what they have in common.

    Manifests before version 0.3 call them `stages`.
    """
    shared = {name: value for name, value in manifest.items() if name not in ("steps", "stages")}
    return [shared | step for step in manifest.get("steps", manifest.get("stages", []))]


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
        raise InputError(f"{error.filename} must be there. Run the step that writes it.") from None
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
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        return platform.processor()
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.processor()


def _commit() -> str | None:
    """Commit of the code, with a `+` if tracked files have changed, other than by runs."""
    try:
        if git("rev-parse", "--show-prefix"):  # a repository of something else, around this folder
            return None
        commit = git("rev-parse", "--short=12", "HEAD")
        changed = git("status", "--porcelain", "--untracked-files=no", "--", ":/", *_WRITTEN)
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
    text = json.dumps(json.loads(json.dumps(record)), sort_keys=True)  # keys of a file are strings
    return hashlib.sha256(text.encode()).hexdigest()
