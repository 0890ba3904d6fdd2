"""The manifest beside every set of results: what made them, enough to do it again."""

from __future__ import annotations

import json
import os
import platform
import shlex
import subprocess
from importlib.metadata import distributions
from pathlib import Path

from deepmds_keras.io.checksums import sha256_of
from deepmds_keras.io.errors import InputError
from experiments.build_key import needs_of
from experiments.code_hash import code_hash
from experiments.published import PUBLISHED
from experiments.records import load_record, write_json
from experiments.run import Run
from experiments.stages import STAGES, stage_of, stages_to

MANIFEST = "manifest.json"

# What runs write.
_WRITTEN = tuple(
    f":!/{folder}"
    for folder in ("results", "deepmds_keras/pretrained", "deepmds_keras/detection/measured_errors")
)
_PACKAGES = (
    "dlib-bin", "h5py", "joblib", "keras", "matplotlib", "mediapipe", "numpy", "pandas",
    "scikit-learn", "scipy", "tensorflow", "tensorflow-cpu", "vtk",
)  # fmt: skip


def write_manifest(run: Run, target: str, stages: list[dict], folder: Path) -> None:
    """Write `manifest.json`: command, sizes, durations, versions, and hashes of what was written.

    It is written last, and `clear_results` takes it away first, so that a folder with a manifest
    holds what one run wrote. `experiments.report` refuses a folder that it does not fit.

    Args:
        run: The run.
        target: Of the Makefile.
        stages: Records of the stages, in order, as `records_of` reads them.
        folder: Of the results.
    """
    done = {record["stage"] for record in stages if record["build"] == run.work.name}
    variables = {
        "MODEL": run.model,
        "DATA": run.data,
        "PRESET": run.preset.name,
        "SEED": str(run.seed),
        "PROTOCOL": run.protocol,
        "AUTHORS": run.authors,
        "COMA": run.coma,
        "CASIA": run.casia,
        "CELEBA": run.celeba,
        "TF_FLAME": run.tf_flame,
        "CASIA_INDEX": None if run.casia_index is None else str(run.casia_index),
        "RINGNET": run.ringnet,
        "FACES": str(run.preset.streamed_faces) if target == "stream" else None,
        "SEEDS": next((str(r["n_seeds"]) for r in stages if "n_seeds" in r), None),
        "MOBILEFACE": "paper" if run.mobileface == "paper" and "mobileface" in done else None,
        "EVALUATOR": None if run.evaluator == "paper" else run.evaluator,
    }
    own = [stage for goal in stages_to(target) for stage in goal.needed if stage.switch]
    for variable in sorted({stage.switch for stage in own if stage.track == run.track}):
        if not done & {stage.name for stage in own if stage.switch == variable}:
            variables[variable] = "no"
    given = " ".join(f"{key}={shlex.quote(value)}" for key, value in variables.items() if value)
    made = {
        "command": f"make {target} {given}",
        "seed": run.seed,
        "preset": vars(run.preset),
        "protocol": run.protocol,
        "track": run.track,
        "model": run.model,
        "model_sha256": next(r["model_sha256"] for r in stages if "model_sha256" in r),
        "inputs": {name: own for r in stages for name, own in r.get("inputs", {}).items()},
        "started": min(record["started"] for record in stages),
        "seconds": round(sum(record["seconds"] for record in stages), 1),
        "stages": stages,
        **environment(),
        "code_sha256": code_hash(modules_of(stages)),
        "published_sha256": sha256_of([PUBLISHED]),
        "files": files_of(folder),
    }
    write_json(folder / MANIFEST, made)


def modules_of(stages: list[dict]) -> list[str]:
    """Modules of the stages whose records are given."""
    names = {record["stage"] for record in stages}
    return sorted({f"experiments.{stage.module}" for stage in STAGES if stage.name in names})


def read_manifest(folder: Path) -> dict:
    """Read the manifest that `write_manifest` wrote of a folder of results.

    Raises:
        InputError: The file is not there, or is no manifest.
    """
    path = folder / MANIFEST
    try:
        made = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise InputError(f"{path} must be there. Received a folder without it.") from None
    except ValueError:
        made = None
    if not isinstance(made, dict):
        raise InputError(f"{path} must be a JSON object. Received another text.")
    return made


def clear_results(folder: Path) -> None:
    """Delete what an earlier run wrote into a folder of results: what its manifest lists."""
    try:
        written = read_manifest(folder).get("files", ())
    except InputError:
        written = ()
    (folder / MANIFEST).unlink(missing_ok=True)
    for name, path in _results(folder).items():
        if name in written:
            path.unlink()


def files_of(folder: Path) -> dict[str, str]:
    """sha256 of every file in a folder of results but the manifest, by relative name."""
    return {name: sha256_of([path]) for name, path in _results(folder).items()}


def _results(folder: Path) -> dict[str, Path]:
    """Files but the manifest, and those with temporary names, by relative name."""
    paths = (path for path in sorted(folder.rglob("*")) if path.is_file())
    return {
        path.relative_to(folder).as_posix(): path
        for path in paths
        if path.name != MANIFEST and not path.name.startswith(".")
    }


def records_of(run: Run, name: str, *, own: bool = True) -> list[dict]:
    """Records of the stages that one is made from, for the manifest.

    Args:
        run, name: The stage.
        own: Whether to add its own, which is complete.
    """
    goal = stage_of(run.track, name)
    found, left = {goal.id} if own else set(), [*needs_of(run, name)]
    while left:
        need = left.pop()
        if need not in found:
            found.add(need)
            left += _record(run, need)["needs"]
    records = [_record(run, stage.id) for stage in STAGES if stage.id in found]
    for record in records:
        record.pop("checksums", None)  # of the images, which nobody else has
        record.pop("rows", None)  # of the tables
    return records


def _record(run: Run, stage: str) -> dict:
    track, name = stage.split("/")
    return load_record(run.on(track), name)


def environment() -> dict:
    """Versions of what computed the numbers."""
    versions = {d.name.replace("_", "-"): d.version for d in distributions()}
    packages = {name: versions[name] for name in _PACKAGES if name in versions}
    return {
        "python": platform.python_version(),
        "platform": f"{platform.system()} {platform.machine()}, {os.cpu_count()} cores",
        "processor": _processor(),
        "packages": dict(sorted(packages.items())),
        "commit": _commit(),
    }


def _processor() -> str:
    """Model of the processor, as far as the system tells: rounding differs between them."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        return platform.processor()
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.processor()


def _commit() -> str | None:
    """Commit of the code, with a `+` if files that git knows were changed since, but by runs."""
    try:
        commit = _git("rev-parse", "--short=12", "HEAD")
        changed = _git("status", "--porcelain", "--untracked-files=no", "--", ":/", *_WRITTEN)
    except (OSError, subprocess.CalledProcessError):
        return None
    return commit + "+" * bool(changed)


def _git(*arguments: str) -> str:
    return subprocess.run(
        ["git", *arguments],
        capture_output=True, text=True, check=True, cwd=Path(__file__).parent,
    ).stdout.strip()  # fmt: skip
