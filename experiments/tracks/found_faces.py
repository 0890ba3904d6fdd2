"""Test sets of what was found in scans or photos: of those in which nothing failed."""

from __future__ import annotations

import shutil
from collections import Counter
from collections.abc import Callable, Iterator
from itertools import islice

import numpy as np

from data_gen.datasets.dataset import Dataset, save_dataset
from deepmds_keras.io.archives import write_arrays
from deepmds_keras.io.errors import InputError
from experiments.inputs import USED, crop_files
from experiments.run import Run


def save_test_set(
    run: Run,
    kind: str,
    table: dict[str, np.ndarray],
    images: Iterator[np.ndarray],
    make: Callable[[np.ndarray], Dataset],
) -> dict:
    """Write the test set, its images, and the table of all that was looked at.

    Args:
        run: The run.
        kind: `"scan"` or `"photo"`; the table is written to `<kind>s.npz`.
        table: A row each; `status` says which gave a test face, `crop_landmarks` are pixels.
        images: Of those that did, `(size, size, 3)` uint8 each.
        make: From `(n,)` bool, which rows gave a test face, to the test set.

    Returns:
        For the record: how many of which status, and the images' checksums.

    Raises:
        InputError: None gave a test face.
    """
    used = table["status"] == USED
    statuses = _counted(table["status"])
    if not used.any():
        raise InputError(
            f"At least one {kind} must give a test face. Received {len(used)}, of which: "
            + "; ".join(f"{n} {status}" for status, n in statuses.items())
        )
    files = crop_files(run, int(used.sum()))
    landmarks = np.float32(table["crop_landmarks"][used])
    for file, faces in enumerate(files.ranges()):
        rows = slice(faces.start, faces.stop)
        files.save(file, np.stack([*islice(images, len(faces))]), landmarks[rows])
    # What methods made of another test set, as of an index since edited, is of no use.
    shutil.rmtree(run.work / "predictions", ignore_errors=True)
    save_dataset(run.work / "test.npz", make(used))
    write_arrays(run.work / f"{kind}s.npz", table, {})
    return {f"{kind}s": statuses, "checksums": {"test": files.checksums()}}


def _counted(status: np.ndarray) -> dict[str, int]:
    """Number of each status, the details left out."""
    return dict(Counter(str(reason).split(". ")[0].split(": ")[0] for reason in status))
