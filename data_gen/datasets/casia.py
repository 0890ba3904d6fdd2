"""CASIA-3D FaceV1 as it is distributed: scans of 123 people, each an image and a cloud of points.

4,624 scans by a Minolta Vivid 910, 2004. The data set is licensed and none of it is here. What is
known of its files comes from public programs that read them.
"""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from data_gen.datasets.photo_files import read_image
from data_gen.formats.vrml import read_asc_points, read_vrml_points
from deepmds_keras.errors import InputError, brief
from deepmds_keras.files import read_table, write_bytes

LAYOUT = "3D-Face-WRL/001/001-001.wrl and 3D-Face-BMP/001/001-001.bmp, in folders of any depth"
COLUMNS = ("subject", "scan", "use", "condition")
MIN_POINTS = 500
EXTENT = (50.0, 1000.0)  # mm, from a part of a face to a person at a desk

# The preferred first, where a scan has several.
_READERS = {".wrl": read_vrml_points, ".asc": read_asc_points}
_IMAGES = (".bmp", ".png", ".jpg", ".jpeg")
_STEM = re.compile(r"([0-9]{3})-([0-9]{3})")
_USE = {"yes": True, "1": True, "no": False, "0": False}
# Without commas or double quotes, for which a spreadsheet would put the whole line into quotes.
_COMMENTS = """\
# The scans of CASIA-3D FaceV1 that were found: edit this table to choose those that are used.
# use: yes or no. condition: what the scan shows - any name or none.
# The paper uses the 3937 of 4624 scans 'with expressions' - 32.0 of the 37 or 38 a subject - but
# does not list them. That is many more than show an expression alone.
# No public source tells what a scan number shows. The literature has for each subject about five
# illuminations; five expressions (smile - laugh - anger - surprise - eyes closed); these again
# under light from the side; poses; and poses with a smile. None of this is verified. Hence every
# scan is used until this table says otherwise.
"""

_CELL, _PATCH_RADIUS, _PATCHES = 8.0, 40.0, 300  # mm, mm
_MIN_CELLS_IN_PATCH = 20  # of about 78
_FLAT = 0.1  # mm, what is less has no vote
_MIN_MAJORITY = 0.55  # of the patches


@dataclass(frozen=True)
class CasiaScan:
    """Where one scan is.

    Attributes:
        subject: Three digits, such as `"001"`.
        scan: Its number among those of the subject, from 1.
        image: The photograph.
        points: The cloud of points.
        condition: What it shows, from the index; empty where that does not say.
    """

    subject: str
    scan: int
    image: Path
    points: Path
    condition: str = ""


def find_scans(root: str | Path, report: Callable[[str], object] = print) -> list[CasiaScan]:
    """All scans below a folder that have both an image and points, by subject and number.

    Files are known by their names alone, `001-001.wrl` or `.asc` and `001-001.bmp`, `.png` or
    `.jpg`, in any case, whichever way the archives were unpacked. Of several copies the first path
    is taken.

    Args:
        root: Folder that holds the data set.
        report: Called with a sentence about the files that are left out, if there are any.

    Raises:
        InputError: There is no such folder, or no scan in it.
    """
    root = Path(root)
    if not root.is_dir():
        raise InputError(f"{root}: must be the folder of CASIA-3D FaceV1. Received no folder.")
    files = [path for path in root.rglob("*") if _STEM.fullmatch(path.stem) and path.is_file()]
    clouds, cloud_copies = _first_by_stem(files, [*_READERS])
    images, image_copies = _first_by_stem(files, _IMAGES)
    copies = cloud_copies + image_copies
    if copies:
        report(f"{root}: {len(copies)} further copies are not used, such as {copies[0]}.")
    paired = sorted(clouds.keys() & images.keys())
    for what, found, missing in (("scans", clouds, "image"), ("images", images, "scan")):
        alone = sorted(found.keys() - {*paired})
        if alone and paired:
            report(f"{root}: {len(alone)} {what} have no {missing}, such as {found[alone[0]]}.")
    if not paired:
        raise InputError(
            f"{root}: must hold CASIA-3D FaceV1: {LAYOUT}. "
            f"Received {len(clouds)} scans and {len(images)} images, no two of one name."
        )
    return [
        CasiaScan(stem[:3], int(stem[4:]), image=images[stem], points=clouds[stem])
        for stem in paired
    ]


def write_index(path: str | Path, scans: Iterable[CasiaScan]) -> None:
    """Write a table of the scans, `subject,scan,use,condition`, all to be used, for a user to edit.

    Raises:
        InputError: There is such a file, which a user may have edited.
    """
    path = Path(path)
    if path.exists():
        raise InputError(f"{path}: must not exist yet; delete it to have it made anew.")
    table = io.StringIO(_COMMENTS)
    table.seek(0, io.SEEK_END)
    writer = csv.writer(table, lineterminator="\n")
    writer.writerow(COLUMNS)
    writer.writerows((scan.subject, scan.scan, "yes", scan.condition) for scan in scans)
    write_bytes(path, table.getvalue().encode())


def read_index(path: str | Path, scans: Iterable[CasiaScan]) -> list[CasiaScan]:
    """The scans that a table such as `write_index` writes says to use, with their conditions.

    Args:
        path: The table. A scan that it does not list is not used; numbers may have lost their
            zeros in a spreadsheet.
        scans: Those that were found.

    Returns:
        The chosen ones, in the order of `scans`.

    Raises:
        InputError: The table cannot be read, has other columns, lists a scan twice or one that was
            not found, has a `use` that is not yes, no, 1 or 0, or chooses none.
    """
    path, scans = Path(path), list(scans)
    found = {(scan.subject, scan.scan) for scan in scans}
    conditions: dict[tuple[str, int], str | None] = {}  # None is not to be used
    rows = read_table(path)
    for row in rows:
        if {*row} != {*COLUMNS} or None in row.values():
            raise InputError(
                f"{path}: must have columns {','.join(COLUMNS)}. Received the row {brief(row)}."
            )
        key = _key(path, row["subject"], row["scan"])
        if key not in found:
            received = brief(f"{key[0]}-{key[1]:03d}")
            raise InputError(f"{path}: must list scans that exist. Received {received}.")
        if key in conditions:
            raise InputError(
                f"{path}: must list a scan once. Received {key[0]}-{key[1]:03d} twice."
            )
        use = _USE.get(row["use"].strip().lower())
        if use is None:
            received = brief(repr(row["use"]))
            raise InputError(f"{path}: use must be yes, no, 1 or 0. Received {received}.")
        conditions[key] = row["condition"].strip() if use else None
    chosen = [
        replace(scan, condition=condition)
        for scan in scans
        if (condition := conditions.get((scan.subject, scan.scan))) is not None
    ]
    if not chosen:
        raise InputError(f"{path}: must use at least one scan. Received {len(rows)} rows, none.")
    return chosen


def load_scan(scan: CasiaScan) -> tuple[np.ndarray, np.ndarray]:
    """The image `(H, W, 3)` uint8 RGB, and the points `(n, 3)` float64 mm as from `to_world`.

    Raises:
        InputError: A file is damaged or is none of the kind, or the points are not a scan in mm.
    """
    try:
        image = read_image(scan.image, ("BMP", "PNG", "JPEG"))
    except ValueError as error:
        raise InputError(
            f"{scan.image}: must be a whole BMP, PNG or JPEG image. Received {error}."
        ) from error
    points = _READERS[scan.points.suffix.lower()](scan.points)
    try:
        return image, to_world(points)
    except InputError as error:
        raise InputError(f"{scan.points}: {error}") from None


def to_world(points: np.ndarray) -> np.ndarray:
    """Turns a scan into our frame: +x to the right as the scanner sees it, +y up, +z towards it.

    Two right-handed frames of a camera are in use: this one, where what is seen has z < 0, and +y
    down with +z away, where it has z > 0. They differ by half a turn about x. Which of them a file
    has is not documented, so its points decide: what is seen of a person mostly bulges towards the
    scanner. A paraboloid is fitted to each of many patches of 40 mm radius, and the majority tells
    the side. On two head models in all poses up to profile, with and without shoulders, holes,
    noise and stray points, at least 62 % of the patches are right. The fall of depth from the
    middle to the rim is no sign: shoulders and chest at the rim lie in front of the neck.

    Only half a turn or none is applied, about the origin of the file, where the scanner stays if
    it was there. Whether a scan is mirrored, or lies on its side, cannot be told from points.

    Args:
        points: `(n, 3)` millimetres, seen along z.

    Returns:
        `(n, 3)` float64. What is in our frame already comes back as it is.

    Raises:
        InputError: Too few points, an extent that is not a person's in mm, or too many patches that
            bulge the other way.
    """
    points = np.asarray(points, np.float64)
    if len(points) < MIN_POINTS:
        raise InputError(f"points must be at least {MIN_POINTS}. Received {len(points)}.")
    low, high = np.percentile(points, (2, 98), axis=0)
    extent = (high - low).max()
    if not EXTENT[0] <= extent <= EXTENT[1]:
        raise InputError(
            f"points must extend over {EXTENT[0]:g} to {EXTENT[1]:g} mm. Received {extent:.3g}."
        )
    # Beyond lie stray points, some of them anywhere.
    bulge = _bulge_towards_z(points[((points >= low) & (points <= high)).all(1)])
    towards, away = (bulge > _FLAT).sum(), (bulge < -_FLAT).sum()
    if max(towards, away) < _MIN_MAJORITY * (len(bulge) + 1):
        raise InputError(
            "points must be of a surface that bulges towards the scanner. "
            f"Received one of which {towards} patches bulge along z and {away} against it."
        )
    return points if towards > away else points * (1.0, -1.0, -1.0)


def _bulge_towards_z(points: np.ndarray) -> np.ndarray:
    """Height in mm of the middle of each patch above its rim: least-squares paraboloids."""
    cells = _cell_means(points)
    rng = np.random.default_rng(0)
    centres = cells[rng.choice(len(cells), min(_PATCHES, len(cells)), replace=False)]
    offsets = (cells - centres[:, None]) / (_PATCH_RADIUS, _PATCH_RADIUS, 1.0)
    x, y, z = np.moveaxis(offsets, 2, 0)
    within = x**2 + y**2 < 1
    terms = np.stack([np.ones_like(x), x, y, x * x, x * y, y * y], axis=2) * within[..., None]
    transposed = np.swapaxes(terms, 1, 2)
    inverse = np.linalg.pinv(transposed @ terms, hermitian=True)
    fits = (inverse @ (transposed @ z[..., None]))[..., 0]
    return -(fits[:, 3] + fits[:, 5])[within.sum(1) >= _MIN_CELLS_IN_PATCH] / 2


def _cell_means(points: np.ndarray) -> np.ndarray:
    """Means of the points of each square cell across the view, so that all areas count alike."""
    column, row = np.floor(points[:, :2] / _CELL).astype(np.int64).T
    _, cell = np.unique(column * (np.ptp(row) + 1) + row, return_inverse=True)
    sums = [np.bincount(cell, values) for values in points.T]
    return np.stack(sums, axis=1) / np.bincount(cell)[:, None]


def _first_by_stem(files: list[Path], suffixes: list[str]) -> tuple[dict[str, Path], list[Path]]:
    """The file of each stem that has the first of the suffixes and paths; and the others."""
    ranked = sorted(
        (suffixes.index(suffix), path)
        for path in files
        if (suffix := path.suffix.lower()) in suffixes
    )
    first: dict[str, Path] = {}
    others = [path for _, path in ranked if first.setdefault(path.stem, path) != path]
    return first, others


def _key(path: Path, subject: str, scan: str) -> tuple[str, int]:
    try:
        return f"{int(subject):03d}", int(scan)
    except ValueError as error:
        reason = brief(error)
        raise InputError(f"{path}: subject and scan must be numbers. Received {reason}.") from None
