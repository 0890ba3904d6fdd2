"""The manifest beside every set of results: what made them, enough to do it again."""

from __future__ import annotations

import os
import platform
import shlex
import subprocess
from collections.abc import Iterable
from importlib.metadata import distributions
from pathlib import Path

from experiments.run import Run, load_record, write_json

_PACKAGES = (
    "dlib-bin", "h5py", "joblib", "keras", "matplotlib", "numpy", "pandas", "scikit-learn",
    "scipy", "tensorflow", "tensorflow-cpu", "vtk",
)  # fmt: skip
# Variables by which stages are left out.
_OPTIONAL = {
    "reproduce-bfm": {"MOBILEFACE": {"mobileface"}},
    "reproduce-flame": {"RINGNET": {"ringnet", "ringnet-licensed"}, "MEDIAPIPE": {"mediapipe"}},
}


def write_manifest(run: Run, target: str, stages: list[dict], folder: Path) -> None:
    """Write `manifest.json`: command, sizes, durations, versions and the model file's hash.

    Args:
        run: The run.
        target: Of the Makefile.
        stages: Records of the stages, in order, as `run.stage` wrote them.
        folder: Of the results.
    """
    variables = {
        "MODEL": run.model,
        "DATA": run.data,
        "PRESET": run.preset.name,
        "SEED": str(run.seed),
        "PROTOCOL": run.protocol,
        "AUTHORS": run.authors,
        "COMA": run.coma,
        "CASIA": run.casia,
        "CASIA_INDEX": None if run.casia_index is None else str(run.casia_index),
        "RINGNET": run.ringnet,
        "EVALUATOR": None if run.evaluator == "paper" else run.evaluator,
    }
    stages_run = {record["stage"] for record in stages}
    for variable, names in _OPTIONAL.get(target, {}).items():
        if not stages_run & names:
            variables[variable] = "no"
    given = " ".join(f"{key}={shlex.quote(value)}" for key, value in variables.items() if value)
    made = {
        "command": f"make {target} {given}",
        "seed": run.seed,
        "preset": vars(run.preset),
        "protocol": run.protocol,
        "model": run.model,
        "model_sha256": stages[0]["model_sha256"],
        "started": stages[0]["started"],
        "seconds": round(sum(record["seconds"] for record in stages), 1),
        "stages": stages,
        **environment(),
    }
    write_json(folder / "manifest.json", made)


def records_of(run: Run, stages: Iterable[str]) -> list[dict]:
    """Records of those stages that are complete, for the manifest."""
    done = [name for name in stages if (run.work / f"{name}.json").exists()]
    records = [load_record(run, name) for name in done]
    for record in records:
        record.pop("checksums", None)  # of the images, which nobody else has
    return records


def environment() -> dict:
    """Versions of what computed the numbers."""
    packages = {d.name: d.version for d in distributions() if d.name in _PACKAGES}
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
    """Commit of the code, with a `+` if files that git knows, results aside, were changed since."""
    try:
        commit = _git("rev-parse", "--short=12", "HEAD")
        changed = _git("status", "--porcelain", "--untracked-files=no", "--", ":/", ":!/results")
    except (OSError, subprocess.CalledProcessError):
        return None
    return commit + "+" * bool(changed)


def _git(*arguments: str) -> str:
    return subprocess.run(
        ["git", *arguments],
        capture_output=True, text=True, check=True, cwd=Path(__file__).parent,
    ).stdout.strip()  # fmt: skip
