"""CelebA as distributed: 202,599 photos of celebrities, aligned by their eyes.

Liu et al. 2015, doi:10.1109/ICCV.2015.425. The data set is for research only and no part of it is
here. Its five landmarks per face are too few for this method and are not read.
"""

import re
from pathlib import Path

from deepmds_keras.errors import InputError, brief

_IMAGES, _PARTITION = "img_align_celeba", "list_eval_partition"
_TEST = "2"  # number of the test partition
_NAME = re.compile(r"[0-9]{6}\.jpg")
_LINE = re.compile(r"([0-9]{6}\.jpg)[\s,]+([0-2])")
_CSV_HEADER = "image_id,partition"  # of Kaggle's copy


def find_images(folder: str | Path) -> list[Path]:
    """The available aligned images of the test partition, by name.

    Args:
        folder: Contains the folder `img_align_celeba` (or `Img/` with it, or Kaggle's, nested in
            another of that name) and `list_eval_partition.txt` (or `Eval/` with it, or Kaggle's
            `.csv`). Without the list all images are returned.

    Raises:
        InputError: No such folder, no images, none of that partition, or a malformed list.
    """
    folder = Path(folder)
    places = [folder / place / _IMAGES for place in (_IMAGES, "", "Img")]
    images = next(filter(Path.is_dir, places), None)
    files = images.iterdir() if images else ()
    names = sorted(path.name for path in files if _NAME.fullmatch(path.name))
    if not names:
        raise InputError(
            f"{folder}: must hold CelebA, unpacked: {_IMAGES}/000001.jpg to 202599.jpg, or some of "
            f"them, and {_PARTITION}.txt. Received no such image."
        )
    lists = (f"{_PARTITION}.txt", f"Eval/{_PARTITION}.txt", f"{_PARTITION}.csv")
    file = next((folder / name for name in lists if (folder / name).is_file()), None)
    if file is not None:
        partitions, n_images = _read_partitions(file), len(names)
        names = [name for name in names if partitions.get(name) == _TEST]
        if not names:
            raise InputError(
                f"{images}: must hold images that {file.name} puts into the test partition, "
                f"{_TEST}. Received {n_images} images, none of them."
            )
    return [images / name for name in names]


def _read_partitions(file: Path) -> dict[str, str]:
    """Number of the partition of each image by its name."""
    try:
        lines = file.read_text(encoding="utf-8-sig").split("\n")
    except (OSError, ValueError) as error:
        raise InputError(f"{file}: must be CelebA's list. Received {brief(error)}.") from None
    partitions = {}
    for number, line in enumerate(map(str.strip, lines), 1):
        if match := _LINE.fullmatch(line):
            partitions[match[1]] = match[2]
        elif line and (number, line) != (1, _CSV_HEADER):
            raise InputError(
                f"{file}: line {number} must be the name of an image and 0, 1 or 2, such as "
                f"'000001.jpg 0'. Received {brief(repr(line))}."
            )
    return partitions
