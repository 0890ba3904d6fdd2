"""Key of a build: hashes of files from outside, and of the records of earlier stages."""

from __future__ import annotations

import functools
import glob
import hashlib
from pathlib import Path

from data_gen.datasets.casia import find_scans
from data_gen.datasets.celeba import find_images
from data_gen.datasets.coma import find_meshes
from data_gen.models.registry import model_files
from deepmds_keras.io.checksums import sha256_of
from deepmds_keras.io.errors import InputError
from experiments.records import read_record, with_checksum, write_json
from experiments.run import AUTHORS_FILES, Run
from experiments.stages import stage_of

# What a folder of arrays is of, from its first stage to its last. Of other files of the rest,
# stages are run again.
_KEY = ("MODEL", "COMA", "CASIA", "CELEBA")
# Variables that name no file.
_WORDS = {"SEEDS": lambda run: str(run.n_seeds), "MOBILEFACE": lambda run: run.mobileface}
_KEY_FILE = "key.json"


def inputs_of(run: Run, stage: str) -> dict[str, str]:
    """sha256 of the files that a stage reads from outside the build, as far as they are named.

    Beside them, the words that it depends on.

    Returns:
        By variable of `make`; of the authors' weights and of the licensed RingNet for each file.
        Data sets, which are large, are hashed by the names and sizes of their files.

    Raises:
        InputError: A file or folder is missing, or is not what it is named as.
    """
    hashes: dict[str, str] = {}
    for variable in stage_of(run.track, stage).reads:
        hashes |= _hashes(run, variable)
    return hashes


@functools.cache
def _hashes(run: Run, variable: str) -> dict[str, str]:
    if variable in _WORDS:
        return {variable: _WORDS[variable](run)}
    if variable in ("COMA", "CASIA", "CELEBA"):
        folder = run.folder_of(variable.lower())
        return {variable: "stand-in" if folder is None else _listing(run, variable, folder)}
    if variable == "MODEL":
        named = run.data is not None or run.model == "openhead"
        return {variable: sha256_of(model_files(run.model, run.data))} if named else {}
    value = getattr(run, variable.lower())
    if value is None:
        return {}
    files = {
        "AUTHORS": lambda: [Path(value, name) for name in AUTHORS_FILES[run.track]],
        "CASIA_INDEX": lambda: [Path(value)],
        "RINGNET": lambda: map(Path, sorted(glob.glob(f"{glob.escape(value)}.*"))),
        "TF_FLAME": lambda: sorted(path for path in Path(value).glob("*") if path.is_file()),
    }[variable]()
    return {f"{variable}/{path.name}": sha256_of([path]) for path in files}


def _listing(run: Run, variable: str, folder: Path) -> str:
    """sha256 of the names and sizes of a data set's files."""
    digest = hashlib.sha256()
    for path in _files_of(run, variable, folder):
        digest.update(f"{path.relative_to(folder)} {path.stat().st_size}\n".encode())
    return digest.hexdigest()


def _files_of(run: Run, variable: str, folder: Path) -> list[Path]:
    if variable == "COMA":
        return [mesh.path for mesh in find_meshes(folder)]
    if variable == "CELEBA":
        return [image.path for image in find_images(folder)[: run.preset.photos]]
    scans = find_scans(folder, report=lambda _: None)
    return [path for scan in scans for path in (scan.points, scan.image)]


def needs_of(run: Run, stage: str) -> dict[str, str]:
    """sha256 of the records of the stages that one needs, as far as they are done."""
    needed = (need for need in stage_of(run.track, stage).needed if need.is_of(run))
    records = {need.id: run.on(need.track).record_file(need.name) for need in needed}
    return {name: sha256_of([path]) for name, path in records.items() if path.exists()}


def is_done(run: Run, stage: str) -> bool:
    """Whether a stage is complete, and of the files and stages that it would be made of now.

    What the run does not name, or leaves out, may stay in what is there.
    """
    path = run.record_file(stage)
    if not path.exists():
        return False
    record = read_record(path)
    own = stage_of(run.track, stage)
    left_out = {need.id for need in {*own.needed} - {*own.needed_by(run)}}
    needs = {name: own for name, own in needs_of(run, stage).items() if name not in left_out}
    inputs = inputs_of(run, stage)
    return (
        needs.items() <= record.get("needs", {}).items()
        and inputs.items() <= record.get("inputs", {}).items()
    )


def check_key(run: Run, stage: str, *, write: bool = False) -> None:
    """See that a stage reads the files that the run's folder is made of.

    Args:
        run, stage: The stage.
        write: Whether to note what the folder is made of; to be done under its lock.

    Raises:
        InputError: The folder is made of others.
    """
    path = run.work / _KEY_FILE
    key = read_record(path) if path.exists() else {}
    given = {name: own for name, own in inputs_of(run, stage).items() if name in _KEY}
    for variable, own in given.items():
        if key.get(variable, own) != own:
            named = f"DATA={run.data}" if variable == "MODEL" else (
                f"{variable}={getattr(run, variable.lower())}"
            )  # fmt: skip
            raise InputError(
                f"{named} must be what {run.work} was made of, sha256 {key[variable][:12]}. "
                f"Received sha256 {own[:12]}; delete that folder to make it anew."
            )
    if write and not given.items() <= key.items():
        write_json(path, with_checksum(key | given))
