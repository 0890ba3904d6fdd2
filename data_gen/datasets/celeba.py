"""CelebA as it is distributed: 202,599 photos of celebrities, aligned by their eyes.

Liu et al. 2015, doi:10.1109/ICCV.2015.425. The data set is for research only and none of it is
here. Its own five landmarks a face are too few for this method and are not read.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from data_gen.datasets.photo_files import read_image
from deepmds_keras.errors import InputError

PARTITIONS = ("train", "valid", "test")  # as numbered in the file, from 0
_IMAGES = "img_align_celeba"
_PARTITION = "list_eval_partition"
# Where archives are unpacked to: the official folders, torchvision's, and those of either.
_FOLDERS = ("", "Img", "celeba", "CelebA", "celeba/Img", "CelebA/Img")
_NAME = re.compile(r"[0-9]{6}\.jpg")
_LINE = re.compile(r"([0-9]{6}\.jpg)[\s,]+([0-2])")
_CSV_HEADER = "image_id,partition"  # of Kaggle's copy


@dataclass(frozen=True)
class CelebaImage:
    """Where one image is.

    Attributes:
        name: Of its file, such as `"000001.jpg"`.
        path: The file.
        partition: One of `PARTITIONS`, or None where the data set came without that list.
    """

    name: str
    path: Path
    partition: str | None = None


def find_images(folder: str | Path, partition: str = "test") -> list[CelebaImage]:
    """The aligned images of one partition, by name.

    Args:
        folder: Holds `img_align_celeba/000001.jpg` and, there or under `Eval/`,
            `list_eval_partition.txt` or Kaggle's `.csv` of it; or holds the folder `celeba` or
            `CelebA` which does; or is `img_align_celeba` itself. Images may be missing.
        partition: One of `PARTITIONS`.

    Returns:
        The images of the partition that there are. Without the list all images, whose `partition`
        is None then.

    Raises:
        InputError: No such folder, no images, none of that partition, or a malformed list.
    """
    if partition not in PARTITIONS:
        raise InputError(
            f"partition must be one of {', '.join(PARTITIONS)}. Received {partition!r}."
        )
    folder = Path(folder)
    images = _image_folder(folder)
    names = sorted(path.name for path in images.iterdir() if _NAME.fullmatch(path.name))
    if not names:
        raise InputError(
            f"{images}: must hold 000001.jpg to 202599.jpg, or some of them. Received none."
        )
    file = _partition_file(folder, images)
    if file is None:
        return [CelebaImage(name, images / name) for name in names]
    listed = _read_partitions(file)
    found = [
        CelebaImage(name, images / name, partition)
        for name in names
        if listed.get(name) == partition
    ]
    if not found:
        raise InputError(
            f"{images}: must hold images that {file.name} puts into the partition {partition}. "
            f"Received {len(names)} images, none of them."
        )
    return found


def load_image(record: CelebaImage) -> np.ndarray:
    """The image, `(H, W, 3)` uint8 RGB.

    Raises:
        InputError: The file is gone, damaged or no JPEG or PNG image.
    """
    try:
        return read_image(record.path, ("JPEG", "PNG"))
    except ValueError as error:
        raise InputError(f"{record.path}: must be a whole JPEG image. Received {error}") from None


def _image_folder(folder: Path) -> Path:
    if not folder.is_dir():
        raise InputError(f"{folder}: must be the folder of CelebA. Received no folder.")
    if folder.name == _IMAGES and not (folder / _IMAGES).is_dir():
        return folder
    for place in _FOLDERS:
        images = folder / place / _IMAGES
        if images.is_dir():
            # Kaggle's archive has the folder within another of the same name.
            return images / _IMAGES if (images / _IMAGES).is_dir() else images
    for place in _FOLDERS:
        archive = folder / place / f"{_IMAGES}.zip"
        if archive.is_file():
            raise InputError(
                f"{archive}: must be unpacked, beside where it is. Received it packed."
            )
    raise InputError(
        f"{folder}: must hold CelebA: {_IMAGES}/000001.jpg etc. and {_PARTITION}.txt. "
        f"Received a folder without {_IMAGES}."
    )


def _partition_file(folder: Path, images: Path) -> Path | None:
    for place in (images.parent, images.parent.parent, folder):
        for name in (f"{_PARTITION}.txt", f"Eval/{_PARTITION}.txt", f"{_PARTITION}.csv"):
            if (place / name).is_file():
                return place / name
    return None


def _read_partitions(file: Path) -> dict[str, str]:
    """Partition of each image by its name."""
    try:
        lines = file.read_text(encoding="utf-8-sig").splitlines()
    except (OSError, ValueError) as error:
        raise InputError(f"{file}: must be CelebA's list. Received {error}.") from error
    partitions = {}
    for number, line in enumerate(lines, 1):
        if not line.strip() or (number == 1 and line.strip() == _CSV_HEADER):
            continue
        match = _LINE.fullmatch(line.strip())
        if match is None:
            raise InputError(
                f"{file}: line {number} must be the name of an image and 0, 1 or 2, such as "
                f"'000001.jpg 0'. Received {line[:60]!r}."
            )
        partitions[match[1]] = PARTITIONS[int(match[2])]
    return partitions
