"""The images of a data set as files of some hundred each, read like one array."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from deepmds_keras.errors import InputError
from deepmds_keras.files import atomic_write, map_npy, sha256_of

FACES_PER_FILE = 500
_LANDMARKS = "-landmarks"  # in the name of the file beside one of images


class ImageFiles:
    """The images of a data set on disk, indexed like one array `(n, size, size, 3)` uint8.

    Only the pages that are asked for are read.

    Args:
        folder: Of the files.
        n: Images in all.
        size: Width and height of the images in pixels.
    """

    def __init__(self, folder: str | Path, n: int, size: int):
        self.folder, self.n, self.size = Path(folder), n, size
        self._arrays: dict[int, np.ndarray] = {}

    def __len__(self) -> int:
        return self.n

    def __getitem__(self, faces) -> np.ndarray:
        """Images of the faces with these numbers, an array or a slice."""
        numbers = np.arange(self.n)[faces]
        images = np.empty((len(numbers), self.size, self.size, 3), np.uint8)
        files = numbers // FACES_PER_FILE
        for file in np.unique(files):
            rows = np.flatnonzero(files == file)
            images[rows] = self._file(int(file))[numbers[rows] % FACES_PER_FILE]
        return images

    def ranges(self) -> list[range]:
        """Faces of each file."""
        starts = range(0, self.n, FACES_PER_FILE)
        return [range(start, min(start + FACES_PER_FILE, self.n)) for start in starts]

    def paths(self, file: int) -> tuple[Path, Path]:
        """Where the images of a file and their landmarks are, or will be."""
        return self.folder / f"{file:04}.npy", self.folder / f"{file:04}{_LANDMARKS}.npy"

    def save(self, file: int, images: np.ndarray, landmarks: np.ndarray) -> None:
        """Write one file of images, after their landmarks, each whole or not at all."""
        images_path, landmarks_path = self.paths(file)
        for path, array in ((landmarks_path, landmarks), (images_path, images)):
            with atomic_write(path) as opened:
                np.save(opened, array)

    def landmarks(self, faces: range) -> np.ndarray:
        """Pixel positions of the landmarks of some faces, `(n, L, 2)`."""
        first, last = faces.start // FACES_PER_FILE, (faces.stop - 1) // FACES_PER_FILE
        rows = []
        for file in range(first, last + 1):
            path = self.paths(file)[1]
            rows.append(map_npy(path, "a file of images or their landmarks"))
            needed = (len(self.ranges()[file]), *rows[0].shape[1:2], 2)
            if rows[-1].shape != needed or rows[-1].dtype.kind != "f":
                raise InputError(
                    f"{path} must hold landmarks, floats {needed}. "
                    f"Received {rows[-1].dtype} {rows[-1].shape}."
                )
        start = first * FACES_PER_FILE
        return np.concatenate(rows)[faces.start - start : faces.stop - start]

    def checksums(self) -> dict[str, str]:
        """sha256 of every file of images, and of landmarks, by name."""
        digests = {}
        for file in range(len(self.ranges())):
            for path, held in zip(self.paths(file), ("images", "landmarks"), strict=True):
                try:
                    digests[path.name] = sha256_of([path])
                except OSError as error:
                    reason = error.strerror
                    raise InputError(f"{path} must hold {held}. Received {reason}.") from None
        return digests

    def check(self, checksums: dict[str, str]) -> None:
        """Compare the files with what was written.

        Raises:
            InputError: A file is missing or was changed; delete it and make the images again.
        """
        for name, digest in self.checksums().items():
            images = name.replace(_LANDMARKS, "")
            if name != images and name not in checksums:
                continue  # of an earlier version, which had checksums of images alone
            if checksums.get(name) != digest:
                both = f", {images}" * (name != images)
                raise InputError(
                    f"{self.folder / name} was changed since it was made. Delete it{both} and the "
                    "record of the stage that made it, and run again."
                )

    def _file(self, file: int) -> np.ndarray:
        if file not in self._arrays:
            path = self.paths(file)[0]
            needed = (len(self.ranges()[file]), self.size, self.size, 3)
            array = map_npy(path, "a file of images or their landmarks")
            if array.shape != needed or array.dtype != np.uint8:
                raise InputError(
                    f"{path} must hold images, uint8 {needed}. "
                    f"Received {array.dtype} {array.shape}."
                )
            self._arrays[file] = array
        return self._arrays[file]
