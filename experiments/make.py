"""`python -m experiments.make TARGET VARIABLE=value …`: what `make TARGET VARIABLE=value` runs.

It checks the variables, waits for other commands on the same model, and starts Snakemake on
`experiments/Snakefile`, which defines what a target needs.
"""

import json
import os
import platform
import re
import shlex
import shutil
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from filelock import FileLock, Timeout

from data_gen.models.registry import MODELS, model_files
from deepmds_keras.errors import InputError
from deepmds_keras.tool.detection.mediapipe_landmarks import has_mediapipe
from experiments.__main__ import PARENT, one_line_errors
from experiments.given import check_given
from experiments.run import left_out, run_of_variables

_SNAKEFILE = Path(__file__).with_name("Snakefile")
_TRACKS = {"reproduce-flame": "flame", "reproduce-celeba": "celeba"}  # the others are the BFM's
_DRAWN = ("reproduce-bfm", "audit")  # which need images of the BFM track's faces
# Code is no trigger: a comment is no reason to train again.
_OPTIONS = (
    "--rerun-triggers", "mtime", "params", "input", "--rerun-incomplete", "--nolock",
)  # fmt: skip
# What a target cannot do without, which is to be said before long work.
_WEIGHTS = "the folder of the authors' released weights, see docs/data.md"
_NEEDED = {
    "released-weights": ("AUTHORS", _WEIGHTS),
    "objects": ("OBJECTS", "a folder of npz files of objects, see docs/data.md"),
    "real-faces": ("REAL", "an npz file of arrays dlib and mediapipe"),
}
_PATIENCE = 3  # seconds that steps have to end after Ctrl-C


def main(arguments: list[str] | None = None) -> None:
    target, *given = sys.argv[1:] if arguments is None else arguments
    variables = dict(pair.partition("=")[::2] for pair in given)
    dry, drawing = variables.pop("DRY", ""), variables.pop("DAG", "")
    more = variables.pop("SNAKEMAKE", "")
    with one_line_errors():
        try:
            more = shlex.split(more)
        except ValueError as error:
            raise InputError(
                f"SNAKEMAKE must be words as a shell has them. Received {more}: {error}."
            ) from None
        run = run_of_variables(variables, _TRACKS.get(target, "bfm"))
        check_given(run)
        if run.track == "flame" and "MEDIAPIPE" not in left_out(variables) and not has_mediapipe():
            raise InputError(
                "MEDIAPIPE must be no if MediaPipe is not installed; it has no wheel for "
                "Linux on ARM or macOS on Intel. Received yes."
            )
        draws = target in _DRAWN and "MOBILEFACE" not in left_out(variables)
        if draws and MODELS[run.model].scheme:
            raise InputError(
                f"MOBILEFACE must be no with MODEL={run.model}, which has no mesh to "
                "render. Received yes."
            )
        model_files(run.model, run.data)  # which says where to get what is missing
        snakemake = [
            sys.executable, "-m", "snakemake", target.replace("-", "_"), "-s", str(_SNAKEFILE),
            "--cores", str(run.jobs) if run.jobs > 0 else "all", *_OPTIONS, *more, "--config",
            *(f"{name}={json.dumps(value)}" for name, value in variables.items()),
        ]  # fmt: skip
        if drawing:
            draw([*snakemake, "--dag"], Path(drawing))
            return
        if target in _NEEDED and getattr(run, (name := _NEEDED[target][0]).lower()) is None:
            raise InputError(f"{name} must be {_NEEDED[target][1]}. Received nothing.")
        if target == "scales" and run.model != "bfm68":
            raise InputError(
                "MODEL must be bfm68, whose scale is unknown. Received "
                f"{run.model}, whose s.d. are known."
            )
        if target == "check":
            from experiments.scoring.verdict import check

            check(run)
            return
        words = [f"{name}={shlex.quote(value)}" for name, value in variables.items() if value]
        with locked(run.build / run.model):
            if dry:
                lines = _planned([*snakemake, "--dry-run", "--quiet", "host"]).splitlines()
                steps = [line for line in lines if line.startswith("Step ")]
                print("\n".join(steps) or "Nothing to do.")
                return
            for path in (run.build / run.model).rglob(".*.partial"):  # of steps that were killed
                path.unlink(missing_ok=True)
            _run([*snakemake, "--quiet", "all"], " ".join(["make", target, *words]))
        if target.startswith("reproduce"):
            from experiments.scoring.tables import print_tables

            print_tables(run)


def draw(command: list[str], path: Path) -> None:
    """Draw the steps that a Snakemake command prints as SVG, with finished ones dashed.

    Raises:
        InputError: Graphviz is not installed.
    """
    if shutil.which("dot") is None:
        raise InputError("Graphviz not found: install it (apt install graphviz).")
    graph = re.sub(r'\\nwork: [^\\"]*', "", _planned(command))  # the folder of all steps
    path.parent.mkdir(parents=True, exist_ok=True)
    # From left to right: a method's steps stand in a row, which a page holds.
    dot = ["dot", "-Tsvg", "-Grankdir=LR", "-o", str(path)]
    subprocess.run(dot, input=graph, text=True, check=True)
    print(path)


@contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Hold the lock of a model's folder; the system frees it when the process ends."""
    folder.mkdir(parents=True, exist_ok=True)
    lock = FileLock(folder / ".lock")
    try:
        held = lock.acquire(timeout=0)
    except Timeout:
        print(f"Another command works in {folder}; waiting for it to end.", flush=True)
        held = lock.acquire()
    with held:
        yield


def _planned(command: list[str]) -> str:
    """Output of a Snakemake command that runs no step.

    Raises:
        InputError: It failed, such as for a target that there is not.
    """
    done = subprocess.run(command, capture_output=True, text=True)
    if done.returncode:
        # As JobLines print it or, before there are any, Snakemake: in a dry run to stdout.
        reason = " ".join((done.stdout + done.stderr).rpartition("error: ")[2].split())
        raise InputError(f"Snakemake could not plan the steps: {reason}")
    return done.stdout


def _run(command: list[str], made_by: str) -> None:
    """Run Snakemake in a separate session, so that Ctrl-C ends all of it within seconds."""
    variables = {PARENT: f"{os.getpid()}@{platform.node()}", "EXPERIMENTS_COMMAND": made_by}
    process = subprocess.Popen(command, env=os.environ | variables, start_new_session=True)

    def stop(signal_number: int, _) -> None:
        raise SystemExit(128 + signal_number)

    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, stop)
    try:
        status = process.wait()
    except SystemExit:
        _end(process)
        print("\nStopped; the same command goes on from here.", file=sys.stderr)
        raise
    if status:
        print("Stopped; the same command goes on from here.", file=sys.stderr)
        raise SystemExit(2)


def _end(process: subprocess.Popen) -> None:
    """Ask all processes of a session to end, then kill them."""
    for number in (signal.SIGTERM, signal.SIGKILL):
        with suppress(ProcessLookupError):
            os.killpg(process.pid, number)
        with suppress(subprocess.TimeoutExpired):
            process.wait(_PATIENCE)


if __name__ == "__main__":
    main()
