"""Test faces from photos, with or without scans; a face counts if every step succeeded.

The work is done in pieces, in parallel, and resumes after a stop.
"""

import shutil
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from itertools import chain, islice
from pathlib import Path

import numpy as np

from data_gen.datasets.dataset import Dataset, save_dataset
from deepmds_keras.errors import InputError
from deepmds_keras.files import atomic_write, read_arrays, write_arrays
from deepmds_keras.geometry.camera import camera_angles
from deepmds_keras.geometry.views import Cameras
from deepmds_keras.tool.detection.dlib_landmarks import shared_detector
from experiments.inputs import image_files, in_photos
from experiments.progress import Progress
from experiments.run import Run
from experiments.tasks import unordered

USED = "used"  # status of a scan, or photo, that gave a test face

# Function of a run and the number of a piece: yields the name of each photo, the photo or why it
# cannot be read, and what else is known about it.
Source = Callable[[Run, int], Iterator[tuple[str, np.ndarray | InputError, object]]]
# Function of a run, a photo, the 68 landmarks detected in it and what else is known: returns the
# columns of the table; InputError says why there are none.
Fit = Callable[[Run, np.ndarray, np.ndarray, object], dict[str, np.ndarray]]


def find_faces(
    run: Run, kind: str, pieces: Path, sizes: Sequence[int], source: Source, fit: Fit
) -> dict:
    """Write the test set, its images, and the table `<kind>s.npz`.

    The table has the name and status of every photo; its other columns are about those that gave a
    test face.

    Args:
        kind: `"scan"` or `"photo"`.
        pieces: Folder with a file for each finished piece, which is not done again.
        sizes: Number of photos of each piece.
        source, fit: Functions that other processes import. The columns from `fit` are `image`,
            `(size, size, 3)` uint8 around the face, `crop_landmarks`, `(L, 2)` pixels in it,
            `view`, the input of methods, `(L, 2)`, `landmarks`, `(L, 3)` millimetres, and the
            `rotation` of the camera.

    Returns:
        For the record: the number of photos by status, and the images' checksums.

    Raises:
        InputError: No photo gave a test face.
    """
    missing = [k for k in range(len(sizes)) if not _table_file(pieces, k).exists()]
    done = sum(sizes) - sum(sizes[k] for k in missing)
    tasks = ((run, pieces, k, source, fit) for k in missing)
    with Progress(kind, sum(sizes), done) as bar:
        for piece in unordered(run.jobs, _search_piece, tasks):
            bar.update(sizes[piece])

    parts = [read_arrays(_table_file(pieces, piece))[0] for piece in range(len(sizes))]
    keys = dict.fromkeys(chain.from_iterable(parts))
    table = {key: np.concatenate([part[key] for part in parts if key in part]) for key in keys}
    statuses = dict(Counter(_brief(status) for status in table["status"]))
    if USED not in statuses:
        raise InputError(
            f"At least one {kind} must give a test face. Received {len(table['status'])}: "
            + "; ".join(f"{count} {status}" for status, count in statuses.items())
        )
    files = image_files(run, "test", statuses[USED])
    images = chain.from_iterable(np.load(_images_file(pieces, k)) for k in range(len(sizes)))
    for file, faces in enumerate(files.ranges()):
        landmarks = np.float32(table["crop_landmarks"][faces.start : faces.stop])
        files.save(file, np.stack([*islice(images, len(faces))]), landmarks)
    save_dataset(run.work / "test.npz", _test_set(run, table))
    write_arrays(run.work / f"{kind}s.npz", table, {})
    shutil.rmtree(pieces)
    for status, count in statuses.items():
        print(f"  {count} {status}")
    return {f"{kind}s": statuses, "checksums": {"test": files.checksums()}}


def _search_piece(run: Run, pieces: Path, piece: int, source: Source, fit: Fit) -> int:
    names, statuses, faces = [], [], []
    for name, image, known in source(run, piece):
        names.append(name)
        try:
            faces.append(_face(run, image, known, fit))
            statuses.append(USED)
        except InputError as error:
            statuses.append(str(error))
    with atomic_write(_images_file(pieces, piece)) as file:
        np.save(file, np.array([columns.pop("image") for columns in faces]))
    keys = dict.fromkeys(chain.from_iterable(faces))
    table = {key: np.stack([columns[key] for columns in faces if key in columns]) for key in keys}
    table |= {"name": np.array(names), "status": np.array(statuses)}
    write_arrays(_table_file(pieces, piece), table, {})  # last: it stands for both
    return piece


def _face(run: Run, image: np.ndarray | InputError, known: object, fit: Fit) -> dict:
    if isinstance(image, InputError):
        raise InputError(f"unreadable: {image}")
    detected = next(iter(shared_detector().detect_all(image)), None)
    if detected is None:
        raise InputError("no face found")
    return fit(run, image, detected, known)


def _table_file(pieces: Path, piece: int) -> Path:
    return pieces / f"{piece:04}.npz"


def _images_file(pieces: Path, piece: int) -> Path:
    return _table_file(pieces, piece).with_suffix(".npy")


def _test_set(run: Run, table: dict[str, np.ndarray]) -> Dataset:
    views, landmarks = np.float32(table["view"]), np.float32(table["landmarks"])
    n = len(views)
    cameras = Cameras(np.zeros(n, int), *camera_angles(table["rotation"]), np.zeros(n))
    none = np.empty((n, 0), np.float32)
    description = {"model": run.model, "scheme": run.scheme, "truth": "found"}
    return in_photos(run, Dataset(none, none, landmarks, views, cameras, description))


def _brief(status: str) -> str:
    """A status without the details."""
    return str(status).split(". ")[0].split(": ")[0]
