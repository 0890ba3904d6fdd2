"""`deepmds predict`: from sources to files, one source after the other or in several processes."""

from __future__ import annotations

import os
import shutil
import signal
import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from multiprocessing import resource_tracker
from pathlib import Path

from joblib import Parallel, cpu_count, delayed
from tqdm import tqdm

from deepmds_keras.errors import InputError
from deepmds_keras.landmarks import load_scheme
from deepmds_keras.tool.command.cli import printable
from deepmds_keras.tool.command.outputs import import_trimesh
from deepmds_keras.tool.command.process import picture_name, process
from deepmds_keras.tool.command.records import (
    USED_BY,
    add_record,
    describe_difference,
    describe_run,
    read_records,
)
from deepmds_keras.tool.command.sources import (
    LOCK,
    find_sources,
    kind_of,
    list_skipped,
    name_sources,
)
from deepmds_keras.tool.detection import DETECTORS
from deepmds_keras.tool.predict.models import DEFAULT, FAMILIES, family_of, load_model
from deepmds_keras.tool.predict.photo_faces import open_detector

_HIDDEN = ".deepmds-"  # prefix of files that are not for users


def run(
    sources: list[str],
    *,
    out: Path,
    recursive: bool,
    overwrite: bool,
    jobs: int,
    stopped: Callable[[], bool] = lambda: False,
    **settings,
) -> int:
    """Write the results of all sources; an unusable one gets a line on stderr.

    The options are those of `cli`, by name; `stopped` is called after every source and says whether
    to stop.

    Returns:
        Number of sources that could not be used.

    Raises:
        InputError: Nothing can be done at all: no detector, no model, a folder that is in use or
            cannot hold results.
        OSError: The folder or the terminal cannot be written to.
        KeyboardInterrupt: It was stopped.
    """
    if out.exists() and not out.is_dir():
        raise InputError(f"{out} must be a folder for the results. Received a file.")
    paths, errors, skipped = find_sources(sources, recursive=recursive)
    for error in errors:
        _complain(error)
    if skipped:
        print(f"skipped: {printable(list_skipped(skipped))}")
    _note_without_effect(paths, settings)
    folders = {path.parent for path in paths} | {Path(s) for s in sources if os.path.isdir(s)}
    if out.resolve() in {folder.resolve() for folder in folders}:
        raise InputError(f"{out} must not be a folder of sources. Choose another (--out).")
    records = read_records(out)
    known = {record["source"][0]: name for name, record in records.items()}
    named = [*zip(paths, name_sources(paths, known), strict=True)]
    described = {name: describe_run(path, settings) for path, name in named}
    todo, n_failed = (named, 0) if overwrite else _unfinished(named, out, records, described)
    failed = len(errors) + n_failed
    if not todo:
        return failed
    usable = _usable(todo, settings)
    failed += len(todo) - len(usable)
    hidden = len(usable) == 1 or None  # None hides it where there is no terminal
    with _locked(out) as folder, tqdm(total=len(usable), unit="source", disable=hidden) as bar:
        records = read_records(out)  # again: another run may have ended meanwhile
        if not overwrite:
            usable, n_failed = _unfinished(usable, out, records, described)
            failed += n_failed
        for name, files, lines, fault in _results(usable, folder, jobs, settings):
            own = {*records.get(name, {}).get("results", ())}  # of a former run, perhaps not all
            free = files if overwrite else own
            if blocked := [path for f in files if _is_taken(path := out / f, f in free)]:
                remedy = "" if blocked[0].is_dir() else ", or replace it by --overwrite"
                fault = (
                    f"{blocked[0]} already exists: move it away, or name another folder (--out)"
                    f"{remedy}."
                )
            elif files:
                # Before the record, so that whatever stops this leaves nothing that it is not of.
                for path in (out / Path(file).name for file in own.union(files)):
                    if not path.is_dir():
                        path.unlink(missing_ok=True)
                add_record(out, name, described[name], files, fault)
                for file in files:
                    os.replace(folder / file, out / file)
                listed = [str(out / files[0]), *files[1:4], *["…"] * (len(files) > 4)]
                lines[0] += f" → {', '.join(listed)}"
                tqdm.write("\n".join(map(printable, lines)))
            if fault:
                _complain(fault)
                failed += 1
            bar.update()
            if stopped():
                raise KeyboardInterrupt
    return failed


def _unfinished(
    named: list[tuple[Path, str]], out: Path, records: dict[str, dict], described: dict[str, dict]
) -> tuple[list[tuple[Path, str]], int]:
    """Sources that are not done, and the number of others that failed, each with a line.

    Those have other results in their place, or are done but for faces that cannot be used.
    """
    todo, taken, faults = [], [], []
    for source, name in named:
        record = records.get(name)
        results = [picture_name(source, name)] if record is None else record["results"]
        there = [path for path in (out / file for file in results) if path.is_file()]
        whose = describe_difference(record, described[name])
        if there and whose:
            fault = f"{there[0]} must be the result of {source} with these options"
            taken.append(f"{fault}. Received one {whose}")
        elif whose or len(there) < len(results):
            todo.append((source, name))
        elif record and record.get("fault"):
            faults.append(record["fault"])
    if done := len(named) - len(todo) - len(taken):
        print(
            f"{done} of {len(named)} sources are done, in {printable(str(out))}, and are skipped; "
            "--overwrite redoes them."
        )
    for fault in taken[:1]:
        more = f", as for {len(taken) - 1} more sources" if len(taken) > 1 else ""
        _complain(f"{fault}{more}. Replace by --overwrite, or name another folder (--out).")
    for fault in faults:
        _complain(fault)
    return todo, len(taken) + len(faults)


def _is_taken(path: Path, replaced: bool) -> bool:
    return path.is_dir() or (os.path.lexists(path) and not replaced)


def _complain(error: object, kind: str = "error") -> None:
    tqdm.write(f"{kind}: {printable(str(error))}", file=sys.stderr)


@contextmanager
def _locked(out: Path) -> Iterator[Path]:
    """A folder for incomplete files within the folder of the results, which is locked meanwhile."""
    out.mkdir(parents=True, exist_ok=True)
    with open(out / LOCK, "wb") as file:
        try:
            if sys.platform == "win32":
                import msvcrt

                msvcrt.locking(file.fileno(), msvcrt.LK_NBLCK, 1)
            else:
                import fcntl

                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            raise InputError(
                f"{out} is in use by another run. Wait until it has ended, or choose another "
                "folder (--out)."
            ) from None
        for left in out.glob(f"{_HIDDEN}*.partial"):  # of a run that was killed
            shutil.rmtree(left, ignore_errors=True)
        with tempfile.TemporaryDirectory(
            ".partial", _HIDDEN, out, ignore_cleanup_errors=True
        ) as folder:
            yield Path(folder)


@contextmanager
def _late_ctrl_c() -> Iterator[None]:
    """Holds Ctrl-C back; processes started meanwhile never get it, and end with this one.

    Else each would print where it was, on top of this one's line.
    """
    if not hasattr(signal, "pthread_sigmask"):  # Windows
        yield
        return
    resource_tracker.ensure_running()  # before Python 3.13, its start lets Ctrl-C through
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _usable(todo: list[tuple[Path, str]], settings: dict) -> list[tuple[Path, str]]:
    """Sources that the installed packages can process; reports the others before the work."""
    if settings["model"] not in (None, *FAMILIES):
        load_model(settings["model"])
    if settings["scheme"] is not None:
        load_scheme(settings["scheme"])
    if "glb" in settings["formats"]:
        import_trimesh()
    given = [pair for pair in todo if kind_of(pair[0]) == "landmarks"]
    if len(given) == len(todo):
        return todo
    detector = DETECTORS[settings["detector"]]
    try:
        open_detector(settings["detector"], settings["landmarker"])
    except InputError as error:
        if not given:
            raise
        _complain(f"{len(todo) - len(given)} photos or videos cannot be used. {error}")
        return given
    if not detector.commercial:
        tqdm.write(f"note: landmarks by {settings['detector']} ({detector.licence})", sys.stderr)
    return todo


def _note_without_effect(paths: list[Path], settings: dict) -> None:
    """Report options that have no effect on any of the sources."""
    kinds = {*map(kind_of, paths)}
    given = {key: settings[key] for key in ("smooth", "y_up", "image_size", "scheme")}
    given["every"] = settings["every"] > 1
    without = [key for key in USED_BY if given.get(key) and not kinds & {*USED_BY[key]}]
    if paths and without:
        options = ", ".join(f"--{key.replace('_', '-')}" for key in without)
        _complain(f"no effect on these sources: {options}.", "note")


def _results(todo: list[tuple[Path, str]], folder: Path, jobs: int, settings: dict) -> Iterator:
    """The name of each source and what `process` returns of it, as soon as it is done."""
    # Videos one by one, after the others; they, and the paper's networks, use all processes.
    videos = [pair for pair in todo if kind_of(pair[0]) == "video"]
    others = [pair for pair in todo if kind_of(pair[0]) != "video"]
    jobs = cpu_count() if jobs == -1 else jobs
    workers = min(jobs, len(others)) if family_of(settings["model"]).family == DEFAULT else 1
    settings = {"folder": folder, "jobs": jobs, **settings}
    if others:
        within = settings | {"jobs": 1 if workers > 1 else jobs}
        tasks = (delayed(process)(*pair, **within) for pair in others)
        with _late_ctrl_c():
            done = Parallel(workers, return_as="generator")(tasks)
        yield from ((name, *each) for (_, name), each in zip(others, done, strict=True))
    yield from ((name, *process(source, name, **settings)) for source, name in videos)
