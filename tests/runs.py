"""Steps of the experiments at the smallest size, as Snakemake would run them.

To load TensorFlow takes longer than what such a step does. Hence they are forked from a process
that has loaded it, but for those that render, which refuse to where it is.
"""

from __future__ import annotations

import atexit
import multiprocessing
import os
import shlex
import subprocess
import sys
import tempfile
import threading
import traceback
from importlib import import_module
from pathlib import Path

from places import ROOT

PRESET = "tiny"
# A step that runs alone is as deterministic as its threads.
ENVIRONMENT = os.environ | {"PYTHONPATH": str(ROOT)}
# One core: for ten faces no step needs a pool of processes.
SNAKEMAKE = (
    sys.executable, "-m", "snakemake", "-s", str(ROOT / "experiments" / "Snakefile"),
    "--cores", "1", "--rerun-triggers", "mtime", "params", "input", "--nolock",
)  # fmt: skip
RENDERING = {
    "datasets.images", "datasets.scans", "datasets.rings", "datasets.photos", "tracks.celeba",
    "tracks.celeba_flame", "pretrained.portraits",
}  # fmt: skip
_LIBRARIES = (
    "tensorflow", "keras", "h5py", "pandas", "joblib", "sklearn.manifold", "sklearn.linear_model",
    "scipy.stats", "matplotlib.pyplot", "PIL.Image",
)  # fmt: skip
_SYSTEM = ("/proc/", "/sys/", "/dev/", "/etc/", "/usr/", "/lib", os.path.expanduser("~/."))
_LISTED = ("--coma", "--casia", "--celeba")
_context = multiprocessing.get_context("forkserver")
_context.set_forkserver_preload([*_LIBRARIES])


def run(
    step: str, folder: Path, *arguments: str, command: str = ""
) -> subprocess.CompletedProcess[str]:
    """Run a step with `build` and `results` in a folder, at the preset `tiny` if none is named.

    Its record says that it was run by the command, if there is one.
    """
    environment = ENVIRONMENT | {"EXPERIMENTS_COMMAND": command}
    words = [step, *arguments]
    if "--preset" not in words:
        words += ["--preset", PRESET]
    if step in RENDERING:
        called = [sys.executable, "-c", "import sys, runs; runs.call(sys.argv[1:])", *words]
        environment |= {"PYTHONPATH": f"{ROOT}{os.pathsep}{ROOT / 'tests'}"}
        return subprocess.run(called, cwd=folder, env=environment, capture_output=True, text=True)
    with tempfile.TemporaryDirectory(prefix="step-") as texts:
        paths = [Path(texts, name) for name in ("stdout", "stderr")]
        process = _context.Process(target=_fork, args=(words, folder, paths, environment))
        process.start()
        process.join()
        printed = (path.read_text("utf-8") for path in paths)
        return subprocess.CompletedProcess(words, process.exitcode, *printed)


def succeed(step: str, folder: Path, *arguments: str, command: str = "") -> str:
    """Run a step that is to succeed, and return what it printed."""
    done = run(step, folder, *arguments, command=command)
    assert done.returncode == 0, done.stderr
    return done.stdout


def make(target: str, folder: Path, *variables: str) -> list[list[str]]:
    """Run all steps of a target in the order of Snakemake's plan, but in forked processes.

    Returns:
        Words of each step that was run.
    """
    steps = plan(target, folder, *variables)
    command = " ".join(["make", target, *variables, f"PRESET={PRESET}"])
    for words in steps:
        succeed(words[0], folder, *words[1:], command=command)
    return steps


def mark_as_done(target: str, folder: Path, *variables: str) -> None:
    """Have Snakemake note by which parameters the files of a target were made."""
    _snakemake(target, folder, variables, "--touch", "--forceall", "--quiet", "all")


def plan(target: str, folder: Path, *variables: str) -> list[list[str]]:
    """Words of each step that Snakemake would run for a target, in order."""
    done = _snakemake(target, folder, variables, "--dry-run", "--printshellcmds")
    lines = done.stderr.splitlines() + done.stdout.splitlines()
    steps = (line.partition(" -m experiments ")[2] for line in lines)
    return [shlex.split(words) for words in steps if words]


def command(target: str, folder: Path, *variables: str, **options) -> subprocess.Popen:
    """Start what `make TARGET VARIABLE=value …` runs, in a separate session."""
    words = [sys.executable, "-m", "experiments.make", target, f"PRESET={PRESET}", *variables]
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    options = pipes | {"cwd": folder, "env": ENVIRONMENT, "start_new_session": True} | options
    return subprocess.Popen(words, **options)


def results(folder: Path, name: str) -> Path:
    """Folder of the tables and figures of that name."""
    return folder / "results" / PRESET / "openhead" / name


def work(folder: Path, track: str, model: str = "openhead") -> Path:
    """Folder of the arrays and weights of a track."""
    return folder / "build" / model / f"{track}-{PRESET}-paper-seed0"


def _snakemake(target: str, folder: Path, variables: tuple[str, ...], *options: str):
    """Run Snakemake on a target; it is to succeed."""
    config = ("--config", *variables, f"PRESET={PRESET}")
    words = [*SNAKEMAKE, target.replace("-", "_"), *options, *config]
    done = subprocess.run(words, cwd=folder, env=ENVIRONMENT, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    return done


def call(words: list[str]) -> None:
    """Be `python -m experiments`, with the modules in `TEST_MODULES`.

    A step that Snakemake would run may read nothing outside of the repository, of its folder and of
    the system but what it was given as inputs.
    """
    from experiments.__main__ import main

    sys.path += os.environ["PYTHONPATH"].split(os.pathsep)
    for module in os.environ.get("TEST_MODULES", "").split():
        import_module(module)
    opened, written = set(), set()

    def note(event: str, arguments: tuple) -> None:
        if event == "open" and isinstance(arguments[0], str):
            writes = arguments[2] & (os.O_WRONLY | os.O_RDWR | os.O_CREAT)
            (written if writes else opened).add(os.path.abspath(arguments[0]))

    sys.addaudithook(note)
    sys.argv = [str(ROOT / "experiments" / "__main__.py"), *words]
    main(words)
    if "--inputs" in words:
        given = {os.path.abspath(word) for word in words[words.index("--inputs") + 1 :]}
        # Of large data sets, the list of files is a parameter of the rule.
        listed = [words[words.index(name) + 1] for name in _LISTED if name in words]
        known = (*_SYSTEM, *listed, str(ROOT), os.getcwd(), sys.prefix, sys.base_prefix)
        read = {path for path in opened - given - written if not path.startswith(known)}
        read = {path for path in read if not path.endswith((".py", ".pyc"))}  # TensorFlow's own
        assert not read, f"{words[0]} reads what its rule does not name: {read}"


def _fork(words: list[str], folder: Path, paths: list[Path], environment: dict) -> None:
    """Be `python -m experiments`, in a process that was forked for it."""
    os.chdir(folder)
    os.environ.clear()
    os.environ.update(environment)
    sys.path.insert(0, str(ROOT))
    for number, path in enumerate(paths, 1):
        file = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_APPEND)
        os.dup2(file, number)
        os.close(file)
    status = 0
    try:
        call(words)
    except SystemExit as end:
        status = end.code if isinstance(end.code, int) else int(end.code is not None)
    except BaseException:
        traceback.print_exc()
        status = 1
    # As an interpreter ends: joblib's processes are asked to end here, and waited for by `atexit`.
    threading._shutdown()
    atexit._run_exitfuncs()
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(status)
