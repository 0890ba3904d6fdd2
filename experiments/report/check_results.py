"""`make check-results`: whether today's code would make the committed results.

All of them take hours, so that a folder may be of an earlier commit. The small preset is then run
by the code of that commit and by that of the last one: what writes the same digits there is taken
to do so at full size.
"""

import os
import shlex
import subprocess
import sys
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import pandas as pd

from deepmds_keras.errors import InputError
from experiments.records import commits_of, git, manifests, read_manifest
from experiments.run import EXISTING

_ROOT = Path(__file__).parents[2]
_TREES = _ROOT / "build" / "check-results"
_FILES = {name.upper() for name in (*EXISTING, "authors")}
_TIMES = ("ms_per_face", "seconds", "memory")  # in names of columns and metrics that differ


@dataclass(frozen=True)
class Made:
    """A folder of results, the commits that made it, and the command.

    Attributes:
        folder: Relative to `results/`.
    """

    folder: Path
    commits: tuple[str, ...]
    command: str


def main() -> None:
    """Print a line for each folder; exit with status 1 if one would come out otherwise now."""
    last = git("rev-parse", "--short=12", "HEAD", folder=_ROOT)
    stale = False
    for made in find_results(_ROOT / "results"):
        answers = [check(made, commit, last) for commit in made.commits] or ["of unknown commits"]
        print(f"{made.folder}: " + "; ".join(answers), flush=True)
        stale |= not all("same digits" in answer for answer in answers)
    sys.exit(stale)


def find_results(results: Path) -> list[Made]:
    """All folders of results that have a manifest."""
    found = []
    for path in manifests(results):
        folder, manifest = path.parent.relative_to(results), read_manifest(path.parent)
        if folder.parts[0] != "smoke":
            commits = tuple(sorted(commits_of(manifest)))
            found.append(Made(folder, commits, manifest.get("command", "")))
    return found


def check(made: Made, commit: str, last: str) -> str:
    """What a small run says of results of a commit."""
    if commit == last:
        return f"{commit}, the last commit: the same digits"
    try:
        before, now = (small_run(made, each) for each in (commit, last))
        difference = compare(before, now)
    except InputError as error:
        difference = f"not checked: {error}"
    return f"{commit}: {difference or 'the same digits'}"


def small_run(made: Made, commit: str) -> Path:
    """Folder of the results of the small preset by the code of a commit.

    Raises:
        InputError: That code has no such command, a file is missing, or it failed.
    """
    tree = _TREES / commit
    if not tree.is_dir():
        try:
            git("worktree", "add", "--force", "--detach", str(tree), commit, folder=_ROOT)
        except subprocess.CalledProcessError:
            raise InputError(f"{commit} is no commit of this clone") from None
    if not made.command.startswith("make ") or not (tree / "experiments" / "make.py").is_file():
        raise InputError(f"{commit} has no command that runs `{made.command}` at a small size")
    fault = _make(tree, made.command)
    folder = tree / "results" / "smoke" / made.folder
    if fault is not None or not folder.is_dir():
        raise InputError(f"`{made.command}` failed at {commit}: {fault or 'no results'}")
    return folder


@cache  # several folders are of one command
def _make(tree: Path, command: str) -> str | None:
    """Run a command of `make` at the small size in a checkout; the last line if it failed.

    Raises:
        InputError: A file is missing.
    """
    _, target, *given = shlex.split(command)
    variables = dict(word.split("=", 1) for word in given) | {"PRESET": "smoke"}
    if "SEEDS" in variables:
        variables["SEEDS"] = "2"
    for name in _FILES & variables.keys():
        path = (_ROOT / variables[name]).resolve()
        if not path.exists():
            raise InputError(f"{name}={variables[name]} not found")
        variables[name] = str(path)
    words = [f"{name}={value}" for name, value in variables.items()]
    done = subprocess.run(
        [sys.executable, "-m", "experiments.make", target, *words],
        cwd=tree, env=os.environ | {"PYTHONPATH": str(tree)}, capture_output=True, text=True,
    )  # fmt: skip
    return done.stderr.strip().rpartition("\n")[2] if done.returncode else None


def compare(before: Path, now: Path) -> str | None:
    """The first table that differs, times apart, or None."""
    names = {path.name for folder in (before, now) for path in folder.glob("*.csv")}
    if not names:
        return "no table to compare"
    for name in sorted(names):
        tables = [digits(folder / name) for folder in (before, now)]
        if tables[0] is None or tables[1] is None:
            return f"{name} is {'gone' if tables[1] is None else 'new'}"
        if list(tables[0]) != list(tables[1]) or len(tables[0]) != len(tables[1]):
            return f"{name} has other rows or columns"
        if (off := tables[0].ne(tables[1]).to_numpy()).any():
            row = tables[1].loc[off.any(1)].iloc[0]
            return f"{name} differs in {off.sum()} cells, first {', '.join(row[:3])}"
    return None


def digits(path: Path) -> pd.DataFrame | None:
    """Cells of a table as text, without times."""
    if not path.is_file():
        return None
    table = pd.read_csv(path, dtype=str, keep_default_na=False)
    table = table[[name for name in table if not any(time in name for time in _TIMES)]]
    if "metric" in table:
        table = table[~table["metric"].str.contains("|".join(_TIMES))]
    return table.reset_index(drop=True)


if __name__ == "__main__":
    main()
