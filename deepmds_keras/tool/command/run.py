"""`deepmds predict`: from sources to files, one source after the other or in several processes."""

from __future__ import annotations

import os
import shutil
import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path

import numpy as np
from joblib import Parallel, cpu_count, delayed
from tqdm import tqdm

from deepmds_keras.errors import InputError
from deepmds_keras.landmarks import convert, load_scheme, scheme_of
from deepmds_keras.landmarks.y_axis import check_y_axis
from deepmds_keras.tool.command.cli import fault_of, lines_about, printable
from deepmds_keras.tool.command.outputs import (
    MESH_FORMATS,
    import_trimesh,
    output_files,
    write_output,
)
from deepmds_keras.tool.command.overlay import write_overlay
from deepmds_keras.tool.command.page import write_page
from deepmds_keras.tool.command.sources import (
    LOCK,
    find_sources,
    kind_of,
    list_skipped,
    name_sources,
)
from deepmds_keras.tool.detection import DETECTORS
from deepmds_keras.tool.detection.photos import read_photo
from deepmds_keras.tool.predict.estimation import estimate_faces
from deepmds_keras.tool.predict.faces import Detections, Face, name_faces
from deepmds_keras.tool.predict.landmark_files import find_unusable, read_faces
from deepmds_keras.tool.predict.models import (
    DEFAULT,
    FAMILIES,
    describe_model,
    given_scheme,
    load_model,
    name_for,
    target_scheme,
)
from deepmds_keras.tool.predict.photo_faces import find_in_photo, no_face, open_detector
from deepmds_keras.tool.predict.video_faces import find_in_video, smooth_over_time
from deepmds_keras.tool.predict.videos import portraits, read_stills, write_landmark_video

_DRAWN_FACES = 24  # of one source, in a picture without a photo and in a page
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

    Args:
        sources: Names of photos, folders, videos and files of landmarks.
        out: Folder of the results.
        recursive: Whether to include the photos in subfolders.
        overwrite: Whether to redo finished sources, and to replace files that no run wrote.
        jobs: Number of processes; -1 is one per core.
        stopped: Called after every source; whether to stop.
        settings: The other options of `cli`, by name.

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
    if out.resolve() in {folder.resolve() for folder in {path.parent for path in paths}}:
        raise InputError(f"{out} must not be a folder of sources. Name another (--out).")
    named = [*zip(paths, name_sources(paths), strict=True)]
    todo = [pair for pair in named if overwrite or not _is_done(out, *pair)]
    if len(todo) < len(named):
        print(
            f"{len(named) - len(todo)} of {len(named)} sources have a newer picture in "
            f"{printable(str(out))} and are skipped; --overwrite does them again."
        )
    if not todo:
        return len(errors)
    usable = _usable(todo, settings)
    failed = len(errors) + len(todo) - len(usable)
    hidden = len(usable) == 1 or None  # None hides it where there is no terminal
    with _locked(out) as folder, tqdm(total=len(usable), unit="source", disable=hidden) as bar:
        for files, lines, fault in _results(usable, folder, jobs, settings):
            if blocked := [path for file in files if _is_taken(path := out / file, overwrite)]:
                fault = (
                    f"{blocked[0]} must not be there yet. Received an existing file: move it away, "
                    "name another folder (--out), or replace it by --overwrite."
                )
            elif files:
                for file in files:  # the picture, by which a source is done, comes last
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


def _picture(source: Path, name: str) -> str:
    """File that exists once a source is done."""
    return f"{name}{'.mp4' if kind_of(source) == 'video' else '.png'}"


def _is_done(out: Path, source: Path, name: str) -> bool:
    """Whether the picture, the last file that a run writes, is newer than the source."""
    picture = out / _picture(source, name)
    return picture.is_file() and picture.stat().st_mtime_ns >= source.stat().st_mtime_ns


def _is_taken(path: Path, overwrite: bool) -> bool:
    return path.is_dir() or (os.path.lexists(path) and not overwrite)


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
                f"{out} must not be in use by another run. Wait until that has ended, or name "
                "another folder (--out)."
            ) from None
        for left in out.glob(f"{_HIDDEN}*.partial"):  # of a run that was killed
            shutil.rmtree(left, ignore_errors=True)
        with tempfile.TemporaryDirectory(
            ".partial", _HIDDEN, out, ignore_cleanup_errors=True
        ) as folder:
            yield Path(folder)


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
    videos, files = "video" in kinds, "landmarks" in kinds
    without = {
        "--smooth": settings["smooth"] and not (videos or files),
        "--every": settings["every"] > 1 and not videos,
        "--y-up": settings["y_up"] and not files,
        "--image-size": settings["image_size"] and not files,
        "--scheme": settings["scheme"] and not files,
    }
    if paths and any(without.values()):
        options = ", ".join(option for option, idle in without.items() if idle)
        _complain(f"no effect on these sources: {options}.", "note")


def _results(todo: list[tuple[Path, str]], folder: Path, jobs: int, settings: dict) -> Iterator:
    """What `_process` returns for each source, as soon as it is done."""
    # Videos one by one, after the others; they, and the paper's networks, use all processes.
    videos = [pair for pair in todo if kind_of(pair[0]) == "video"]
    others = [pair for pair in todo if kind_of(pair[0]) != "video"]
    model = settings["model"] or DEFAULT
    family = model if model in FAMILIES else load_model(model).family
    jobs = cpu_count() if jobs == -1 else jobs
    workers = min(jobs, len(others)) if family == DEFAULT else 1
    settings = {"folder": folder, "jobs": jobs, **settings}
    if others:
        within = settings | {"jobs": 1 if workers > 1 else jobs}
        tasks = (delayed(_process)(*pair, **within) for pair in others)
        yield from Parallel(workers, return_as="generator")(tasks)
    yield from (_process(*pair, **settings) for pair in videos)


def _process(
    source: Path,
    name: str,
    *,
    folder: Path,
    formats: tuple[str, ...],
    view: bool,
    mesh: bool,
    **settings,
) -> tuple[list[str], list[str], object]:
    """Write the files of a source into a folder.

    Returns:
        Names of the files, lines for the terminal, and what could not be used, or None.
    """
    try:
        photo, detections = _detect(source, name, **settings)
        n = len(detections.names)
        with tqdm(total=n, unit="face", leave=False, disable=n <= _DRAWN_FACES or None) as bar:
            options = {key: settings[key] for key in ("model", "interocular", "jobs")}
            faces = estimate_faces(detections, progress=bar.update, **options)
        model = describe_model(detections.scheme, settings["model"])
        kinds = [*formats, *(MESH_FORMATS if mesh else ())]
        files: dict[Path, Callable[[Path], None]] = {
            path: partial(write_output, faces=held, model=model)
            for path, held in output_files(folder, name, faces, kinds).items()
        }
        files |= _pictures(folder, source, name, faces, photo, view, mesh, settings["every"])
        for path, write in files.items():
            write(path)
    except InputError as error:
        return [], [], error
    except OSError as error:
        place = folder.parent / Path(error.filename or name).name
        return [], [], f"{place} cannot be written: {error.strerror}."
    lines = [*lines_about(source, faces, _DRAWN_FACES)]
    lines[1:1] = [f"  {remark}" for remark in detections.remarks]
    return [path.name for path in files], lines, fault_of(source, faces)


def _detect(
    source: Path,
    name: str,
    *,
    detector: str,
    landmarker: str | None,
    model: str | None,
    smooth: float,
    every: int,
    y_up: bool,
    image_size: tuple[float, float] | None,
    scheme: str | None,
    jobs: int,
    **_,
) -> tuple[np.ndarray | None, Detections]:
    """The photo, or None for other sources, and the landmarks of its faces."""
    if kind_of(source) == "video":
        return None, find_in_video(
            source,
            name,
            detector=detector,
            landmarker=landmarker,
            model=model,
            every=every,
            smooth=smooth,
            jobs=jobs,
        )
    if kind_of(source) == "photo":
        photo, n_pictures = read_photo(source)
        detections = find_in_photo(
            photo,
            source,
            name,
            detector=detector,
            landmarker=landmarker,
            model=model,
            n_pictures=n_pictures,
        )
        if not detections.names:
            of = f" in the first of {n_pictures} pictures" if n_pictures > 1 else ""
            raise no_face(source, detector, f"whichever side is up{of}")
        return photo, detections
    scheme = given_scheme(scheme, model)
    landmarks, faults, remarks = read_faces(source, y_up=y_up, image_size=image_size, scheme=scheme)
    n, scheme = len(landmarks), scheme or scheme_of(landmarks.shape[1])
    odd = check_y_axis(landmarks, scheme, str(source))
    target = target_scheme(scheme, model)
    landmarks = convert(landmarks, scheme, target)  # what is not among these may be missing
    if target != scheme:
        faults |= find_unusable(landmarks)
    missing = np.isnan(landmarks).any(2)
    if missing.any() and load_model(name_for(target, model)).family != DEFAULT:
        incomplete = np.flatnonzero(missing.any(1) & ~missing.all(1))
        fault = f"must have all landmarks for the model {model}. Received some without"
        faults |= dict.fromkeys(incomplete.tolist(), fault)
    landmarks[[*faults]] = np.nan
    if np.isnan(landmarks).all():
        fault = next(iter(faults.values()), f"must have landmarks of {target}. Received none")
        raise InputError(f"{source}: each face {fault}.")
    rows = np.flatnonzero(~np.isnan(landmarks).any((1, 2)))
    landmarks[rows] = smooth_over_time(landmarks[rows], rows, smooth)
    return None, Detections(
        source=source,
        names=name_faces(name, n),
        scheme=target,
        landmarks=landmarks,
        is_photo=False,
        faults=faults,
        notes={i: [f"stands unlike the other faces: {fault}"] for i, fault in odd.items()},
        remarks=remarks,
    )


def _pictures(
    folder: Path,
    source: Path,
    name: str,
    faces: list[Face],
    photo: np.ndarray | None,
    view: bool,
    mesh: bool,
    every: int,
) -> dict[Path, Callable[[Path], None]]:
    """The page and the picture of a source, for a video another video, each with its writer."""
    shown = [face for face in faces if not face.is_gap]
    if video := faces[0].frame_ref is not None:
        shown = portraits(shown, _DRAWN_FACES)
    some = shown[:_DRAWN_FACES]

    def write_view(path: Path) -> None:
        stills = read_stills(source, some, every) if video else [photo] * len(some)
        write_page(path, some, stills, mesh=mesh)

    def write_picture(path: Path) -> None:
        if video:
            write_landmark_video(path, source, faces, every)
        else:
            write_overlay(path, some if photo is None else shown, photo)

    writers = {folder / f"{name}.html": write_view} if view else {}
    return {**writers, folder / _picture(source, name): write_picture}
