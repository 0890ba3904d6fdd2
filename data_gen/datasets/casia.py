"""CASIA-3D FaceV1 as distributed: scans of 123 people, each an image and a cloud of points.

4,624 scans by a Minolta Vivid 910, 2004. The data set is licensed and no part of it is here. The
knowledge about its files comes from public programs that read them.
"""

import functools
import re
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.spatial import KDTree
from scipy.spatial.transform import Rotation

from data_gen.datasets.image_files import read_image
from data_gen.mesh_files import read_asc_points, read_vrml_points
from data_gen.models.mesh import vertex_normals
from data_gen.models.openhead import load_openhead
from data_gen.registration import icp, thinned
from deepmds_keras.errors import InputError, brief, naming
from deepmds_keras.files import read_table, write_bytes

_COLUMNS = ("subject", "scan", "use", "condition")
MIN_POINTS = 500
EXTENT = (50.0, 1000.0)  # mm, from a part of a face to a person at a desk
FACE_RADIUS = 140.0  # mm about the middle of the face, which keeps the whole head's front

# In order of preference, if a scan has several.
_READERS = {".wrl": read_vrml_points, ".asc": read_asc_points}
_IMAGES = (".bmp", ".png", ".jpg", ".jpeg")
_NAME = re.compile(r"[0-9]{3}-[0-9]{3}")
_USE = {"yes": True, "1": True, "no": False, "0": False}
# Without commas or double quotes, which make a spreadsheet quote the whole line.
_COMMENTS = """\
# The scans of CASIA-3D FaceV1 in the folder: edit this table to choose those that are used.
# use: yes or no. condition: what the scan shows - any name or none.
# The paper uses the 3937 of 4624 scans 'with expressions' - 32.0 of the 37 or 38 a subject - but
# does not list them. That is many more than show an expression alone.
# No public source tells what a scan number shows. The literature has for each subject about five
# illuminations; five expressions (smile - laugh - anger - surprise - eyes closed); these again
# under light from the side; poses; and poses with a smile. None of this is verified. Hence every
# scan is used until this table says otherwise.
"""
# Search for the face: a thinned-out mean face starts with its nose at the most frontal point of
# each band of the scan's height, rotated by each yaw.
_FACE_POINTS, _SCAN_POINTS, _ITERATIONS, _TRIM = 200, 6000, 12, 0.7
_BAND_MM, _FACE_MM, _NOSE_TIP = 35.0, 85.0, 13
_YAWS = (-50.0, 0.0, 50.0)  # degrees
_HALF_TURN = np.array([1.0, -1.0, -1.0])


@dataclass(frozen=True)
class CasiaScan:
    """The files of one scan.

    Attributes:
        name: Subject, of three digits, and number of the scan, such as `"001-004"`.
        condition: What it shows, according to the index; may be empty.
    """

    name: str
    image: Path
    points: Path
    condition: str = ""


def find_scans(root: str | Path, report: Callable[[str], object] = print) -> list[CasiaScan]:
    """All scans below a folder that have both an image and points, by subject and number.

    Files are recognised by name alone, `001-001.wrl` or `.asc` and `001-001.bmp`, `.png` or
    `.jpg`, in upper or lower case, however the archives were unpacked. Of several copies the first
    path is used.

    Args:
        report: Called with a sentence about skipped files, if there are any.

    Raises:
        InputError: There is no scan.
    """
    files = [path for path in Path(root).rglob("*") if _NAME.fullmatch(path.stem)]
    clouds, images = _first_by_stem(files, [*_READERS]), _first_by_stem(files, _IMAGES)
    names = sorted(clouds.keys() & images.keys())
    if not names:
        raise InputError(
            f"{root}: must hold CASIA-3D FaceV1: 3D-Face-WRL/001/001-001.wrl and "
            "3D-Face-BMP/001/001-001.bmp, in folders of any depth. "
            f"Received {len(clouds)} scans and {len(images)} images, with no name in common."
        )
    for what, paths, missing in (("scans", clouds, "image"), ("images", images, "scan")):
        alone = sorted(paths.keys() - {*names})
        if alone:
            report(f"{root}: {len(alone)} {what} have no {missing}, such as {paths[alone[0]]}.")
    return [CasiaScan(name, images[name], clouds[name]) for name in names]


def write_index(path: str | Path, scans: Iterable[CasiaScan]) -> None:
    """Write a table of the scans, `subject,scan,use,condition`, all with `use` yes, for editing."""
    rows = (f"{scan.name[:3]},{int(scan.name[4:])},yes,\n" for scan in scans)
    write_bytes(Path(path), "".join([_COMMENTS, ",".join(_COLUMNS), "\n", *rows]).encode())


def read_index(path: str | Path, scans: Iterable[CasiaScan]) -> list[CasiaScan]:
    """The scans that a table as from `write_index` says to use, with their conditions.

    Args:
        path: The table. A scan that it does not list is not used; numbers may have lost leading
            zeros in a spreadsheet.

    Returns:
        The chosen scans, by name.

    Raises:
        InputError: The table cannot be read, has other columns, lists a scan twice or one that does
            not exist, has a `use` that is not yes, no, 1 or 0, or chooses none.
    """
    unlisted, chosen = {scan.name: scan for scan in scans}, []
    for row in read_table(Path(path)):
        if {*row} != {*_COLUMNS} or None in row.values():
            raise InputError(
                f"{path}: must have columns {','.join(_COLUMNS)}. Received the row {brief(row)}."
            )
        subject, number, use, condition = (row[column].strip() for column in _COLUMNS)
        name = f"{subject.zfill(3)}-{number.zfill(3)}"
        if name not in unlisted or use.lower() not in _USE:
            raise InputError(
                f"{path}: must list existing scans, each once, with use yes, no, 1 or 0. "
                f"Received {brief(name)} and {brief(repr(use))}."
            )
        scan = unlisted.pop(name)
        if _USE[use.lower()]:
            chosen.append(replace(scan, condition=condition))
    if not chosen:
        raise InputError(f"{path}: must use at least one scan. Received none.")
    return sorted(chosen, key=lambda scan: scan.name)


def load_scan(scan: CasiaScan) -> tuple[np.ndarray, np.ndarray]:
    """The image `(H, W, 3)` uint8 RGB, and the points `(n, 3)` float64 mm as from `face_points`.

    Raises:
        InputError: A file is damaged or of another kind, or the points are not a scan in mm.
    """
    image = read_image(scan.image, ("BMP", "PNG", "JPEG"))
    points = _READERS[scan.points.suffix.lower()](scan.points)
    with naming(scan.points):
        return image, face_points(points)


def face_points(points: np.ndarray) -> np.ndarray:
    """Points around the face, in our frame: +x to the right as the scanner sees it, +z towards it.

    Two right-handed camera frames are in use: this one, +y up, and +y down with +z away. They
    differ by half a turn about x; the files do not document which one they use. Hence a mean face
    is registered to the points both ways, and the lower residual decides. It also locates the face;
    otherwise shoulders or clothes would mislead the registration. The rest is cut off.

    Args:
        points: `(n, 3)` millimetres, seen along z.

    Returns:
        `(m, 3)` float64, those within `FACE_RADIUS` of the middle of the face, in their order. The
        only motion applied is half a turn about the file's origin, or none.

    Raises:
        InputError: Too few points, or an extent that is not a person's in mm.
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
    # Stray points may lie anywhere beyond.
    inner = points[((points >= low) & (points <= high)).all(1)]
    thin = thinned(inner, _SCAN_POINTS)
    ways = [(*_find_face(thin * turn), turn) for turn in (np.ones(3), _HALF_TURN)]
    _, middle, turn = min(ways, key=lambda way: way[0])
    turned = points * turn
    with np.errstate(over="ignore"):  # of stray points
        return turned[np.linalg.norm(turned - middle, axis=1) < FACE_RADIUS]


def _find_face(points: np.ndarray) -> tuple[float, np.ndarray]:
    """Residual in mm of the mean face on points of our frame, and the middle of it there."""
    face, tree = _mean_face(), KDTree(points)
    bands = ((points[:, 1] - points[:, 1].min()) // _BAND_MM).astype(int)
    order = np.lexsort((-points[:, 2], bands))
    fronts = points[order[np.unique(bands[order], return_index=True)[1]]]
    turns = Rotation.from_euler("y", np.reshape(_YAWS, (-1, 1)), degrees=True).as_matrix()
    search = functools.partial(icp, face, tree, trim=_TRIM, max_iterations=_ITERATIONS)
    starts = [(turn, front - turn @ face[0]) for front in fronts for turn in turns]
    results = (search(rotation=turn, translation=shift) for turn, shift in starts)
    best = min(results, key=lambda result: result.rms)
    return best.rms, best.translation  # the middle of the landmarks is the mean face's origin


@functools.cache
def _mean_face() -> np.ndarray:
    """Points of the open head's face, relative to the landmarks' middle, the nose tip first."""
    head = load_openhead()
    landmarks = head.mean[head.landmarks["ibug51"]]
    middle, nose = (landmarks.max(0) + landmarks.min(0)) / 2, landmarks[_NOSE_TIP]
    front = vertex_normals(head.mean, head.triangles)[:, 2] > 0.2
    face = head.mean[front & (np.linalg.norm(head.mean - nose, axis=1) < _FACE_MM)]
    return np.vstack([nose, thinned(face, _FACE_POINTS)]) - middle


def _first_by_stem(files: list[Path], suffixes: Sequence[str]) -> dict[str, Path]:
    """For each stem, the file with the most preferred suffix, and then the first path."""
    known = [path for path in files if path.suffix.lower() in suffixes]
    known.sort(key=lambda path: (suffixes.index(path.suffix.lower()), path))
    return {path.stem: path for path in reversed(known)}
