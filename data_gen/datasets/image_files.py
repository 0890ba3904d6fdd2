"""Image files: photos of data sets from elsewhere, and the rendered images of a data set."""

import io
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from PIL import Image

from deepmds_keras.errors import InputError, brief
from deepmds_keras.files import atomic_write, map_npy, sha256_of

FACES_PER_FILE = 500
_LANDMARKS = "-landmarks"  # in the name of the file that belongs to one of images


def read_image(path: Path, formats: Sequence[str]) -> np.ndarray:
    """An image from outside, `(H, W, 3)` uint8 RGB.

    Args:
        formats: Pillow's names of the formats that it may have.

    Raises:
        InputError: It is missing, damaged, of another format, or has so many pixels, 180 million,
            that Pillow suspects an attack.
    """
    try:
        # From memory, so that nothing is allocated for content that a header only claims.
        with Image.open(io.BytesIO(path.read_bytes()), formats=formats) as opened:
            return np.array(opened.convert("RGB"))
    except Exception as error:  # Pillow raises many kinds for a damaged file
        raise InputError(
            f"{path}: must be a whole {' or '.join(formats)} image. "
            f"Received {type(error).__name__}: {brief(error)}"
        ) from None


class ImageFiles:
    """The images of a data set on disk, indexed like one array `(n, size, size, 3)` uint8.

    Only the requested pages are read.
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
        """Paths of the images of a file and of their landmarks."""
        return self.folder / f"{file:04}.npy", self.folder / f"{file:04}{_LANDMARKS}.npy"

    def save(self, file: int, images: np.ndarray, landmarks: np.ndarray) -> None:
        """Write one file of images, after their landmarks, each whole or not at all."""
        images_path, landmarks_path = self.paths(file)
        for path, array in ((landmarks_path, landmarks), (images_path, images)):
            with atomic_write(path) as opened:
                np.save(opened, array)

    def landmarks(self) -> np.ndarray:
        """Pixel positions of the landmarks of all faces, `(n, L, 2)`."""
        rows = []
        for file in range(len(self.ranges())):
            rows.append(map_npy(self.paths(file)[1], "a file of landmarks"))
            n_landmarks = rows[0].shape[1] if rows[0].ndim > 1 else 0
            self._check(file, rows[-1], (n_landmarks, 2), "f")
        return np.concatenate(rows)

    def checksums(self) -> dict[str, str]:
        """sha256 of every file of images, and of landmarks, by name."""
        paths = [path for file in range(len(self.ranges())) for path in self.paths(file)]
        for path in paths:
            if not path.is_file():
                raise InputError(f"{path} must be a file of images or landmarks. Received none.")
        return {path.name: sha256_of([path]) for path in paths}

    def check(self, checksums: dict[str, str]) -> None:
        """Compare the files with the checksums of what was written.

        Raises:
            InputError: A file is missing or was changed; delete it and render the images again.
        """
        for name, digest in self.checksums().items():
            if checksums.get(name) != digest:
                raise InputError(
                    f"{self.folder / name} was changed since it was written. Delete the images, "
                    "their landmarks and the record of the step that wrote them, and run again."
                )

    def _file(self, file: int) -> np.ndarray:
        if file not in self._arrays:
            array = map_npy(self.paths(file)[0], "a file of images")
            self._arrays[file] = self._check(file, array, (self.size, self.size, 3), "u")
        return self._arrays[file]

    def _check(self, file: int, array: np.ndarray, shape: tuple, kind: str) -> np.ndarray:
        needed = (len(self.ranges()[file]), *shape)
        if array.shape != needed or array.dtype.kind != kind:
            raise InputError(
                f"{self.paths(file)[kind == 'f']} must have shape {needed}. "
                f"Received {array.dtype} {array.shape}."
            )
        return array
