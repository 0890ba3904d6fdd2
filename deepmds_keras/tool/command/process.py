"""One source of `deepmds predict`: its faces are found, estimated and written."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
from tqdm import tqdm

from deepmds_keras.errors import InputError
from deepmds_keras.files import atomic_write
from deepmds_keras.landmarks import convert, scheme_of
from deepmds_keras.landmarks.y_axis import Y_UP_ADVICE, check_y_axis
from deepmds_keras.tool.command.cli import fault_of, lines_about
from deepmds_keras.tool.command.outputs import MESH_FORMATS, output_files, write_output
from deepmds_keras.tool.command.overlay import overlay
from deepmds_keras.tool.command.page import write_page
from deepmds_keras.tool.command.sources import kind_of
from deepmds_keras.tool.detection import FOUND_BY, to_ibug
from deepmds_keras.tool.detection.photos import read_photo
from deepmds_keras.tool.predict.estimation import estimate_faces
from deepmds_keras.tool.predict.faces import Detections, Face, name_faces
from deepmds_keras.tool.predict.landmark_files import find_unusable, read_faces
from deepmds_keras.tool.predict.models import (
    DEFAULT,
    describe_model,
    family_of,
    given_scheme,
    target_scheme,
)
from deepmds_keras.tool.predict.photo_faces import find_in_photo, no_face
from deepmds_keras.tool.predict.smoothing import smooth_over_time
from deepmds_keras.tool.predict.video_faces import find_in_video
from deepmds_keras.tool.predict.videos import portraits, read_stills, write_landmark_video

_DRAWN_FACES = 24  # of one source, in a picture without a photo and in a page


def process(
    source: Path, name: str, *, folder: Path, **settings
) -> tuple[list[str], list[str], object]:
    """Write the files of a source into a folder, with the other options of `cli` by name.

    Returns:
        Names of the files, lines for the terminal, and what could not be used, or None.
    """
    try:
        photo, detections = _detect(source, name, settings)
        n = len(detections.names)
        with tqdm(total=n, unit="face", leave=False, disable=n <= _DRAWN_FACES or None) as bar:
            options = {key: settings[key] for key in ("model", "interocular", "jobs")}
            faces = estimate_faces(detections, progress=bar.update, **options)
        model = describe_model(detections.scheme, settings["model"])
        kinds = [*settings["formats"], *(MESH_FORMATS if settings["mesh"] else ())]
        files: dict[Path, Callable[[Path], None]] = {
            path: partial(write_output, faces=held, model=model)
            for path, held in output_files(folder, name, faces, kinds).items()
        }
        files |= _pictures(folder, source, name, faces, photo, settings)
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


def picture_name(source: Path, name: str) -> str:
    """Name of the picture of a source, for a video another video."""
    return f"{name}{'.mp4' if kind_of(source) == 'video' else '.png'}"


def _detect(source: Path, name: str, settings: dict) -> tuple[np.ndarray | None, Detections]:
    """The photo, or None for other sources, and the landmarks of its faces."""
    how = {key: settings[key] for key in ("detector", "landmarker", "model")}
    if kind_of(source) == "video":
        how |= {key: settings[key] for key in ("every", "smooth", "jobs")}
        return None, find_in_video(source, name, **how)
    if kind_of(source) == "photo":
        photo, n_pictures = read_photo(source)
        detections = find_in_photo(photo, source, name, n_pictures=n_pictures, **how)
        if not detections.names:
            of = f" in the first of {n_pictures} pictures" if n_pictures > 1 else ""
            raise no_face(source, how["detector"], f"whichever side is up{of}")
        return photo, detections
    return None, _read(source, name, settings)


def _read(source: Path, name: str, settings: dict) -> Detections:
    """The landmarks of a file, in the scheme of the model; faces that cannot be used are gaps."""
    model, smooth = settings["model"], settings["smooth"]
    scheme = given_scheme(settings["scheme"], model)
    landmarks, faults, remarks = read_faces(
        source, y_up=settings["y_up"], image_size=settings["image_size"], scheme=scheme
    )
    n, scheme = len(landmarks), scheme or scheme_of(landmarks.shape[1])
    needed = Y_UP_ADVICE[settings["y_up"]]
    odd = check_y_axis(landmarks, scheme, str(source), needed=needed)
    target = target_scheme(scheme, model)
    landmarks = convert(landmarks, scheme, target)  # what is not among these may be missing
    if target != scheme:
        faults |= find_unusable(landmarks)
    missing = np.isnan(landmarks).any(2)
    if missing.any() and family_of(model).family != DEFAULT:
        incomplete = np.flatnonzero(missing.any(1) & ~missing.all(1))
        fault = f"must have all landmarks for the model {model}. Received some without"
        faults |= dict.fromkeys(incomplete.tolist(), fault)
    landmarks[[*faults]] = np.nan
    if np.isnan(landmarks).all():
        fault = next(iter(faults.values()), f"must have landmarks of {target}. Received none")
        raise InputError(f"{source}: each face {fault}.")
    found_by = FOUND_BY.get(scheme)
    landmarks = to_ibug(landmarks, found_by, target)
    seen = ~np.isnan(landmarks).any(2)
    rows = np.flatnonzero(seen.all(1))
    landmarks[rows] = smooth_over_time(landmarks[rows], rows, smooth)
    if smooth and (rough := int(seen.any(1).sum()) - len(rows)):
        remarks.append(f"{rough} of {n} rows lack landmarks and are not smoothed")
    return Detections(
        source=source,
        names=name_faces(name, n),
        scheme=target,
        landmarks=landmarks,
        faults=faults,
        notes={i: f"stands unlike the other faces: {fault}" for i, fault in odd.items()},
        remarks=remarks,
        found_by=found_by,
    )


def _pictures(
    folder: Path,
    source: Path,
    name: str,
    faces: list[Face],
    photo: np.ndarray | None,
    settings: dict,
) -> dict[Path, Callable[[Path], None]]:
    """The page and the picture of a source, for a video another video, each with its writer."""
    every = settings["every"]
    shown = [face for face in faces if not face.is_gap]
    if video := faces[0].frame_ref is not None:
        shown = portraits(shown, _DRAWN_FACES)
    some = shown[:_DRAWN_FACES]

    def write_view(path: Path) -> None:
        stills = read_stills(source, some, every) if video else [photo] * len(some)
        write_page(path, some, stills, mesh=settings["mesh"])

    def write_picture(path: Path) -> None:
        if video:
            write_landmark_video(path, source, faces, every)
            return
        with atomic_write(path) as file:
            overlay(some if photo is None else shown, photo).save(file, "png")

    writers = {folder / f"{name}.html": write_view} if settings["view"] else {}
    return {**writers, folder / picture_name(source, name): write_picture}
