"""CelebA: the usual layouts are read, and what is wrong with a folder is named."""

import pytest

from data_gen.datasets.celeba import find_images
from deepmds_keras.errors import InputError

NUMBERS = [0, 0, 0, 0, 0, 1, 1, 2, 2, 2, 2, 2]  # train, valid, test
LINES = [f"{name:06}.jpg {number}" for name, number in enumerate(NUMBERS, 1)]
CSV = ["image_id,partition", *(line.replace(" ", ",") for line in LINES)]


def write(root, images, table, lines, n=12):
    (root / images).mkdir(parents=True)
    paths = [root / images / f"{number:06}.jpg" for number in range(1, n + 1)]
    for path in paths:
        path.touch()
    (root / table).parent.mkdir(exist_ok=True)
    (root / table).write_text("\n".join([*lines, "  "]))
    return paths


@pytest.mark.parametrize(
    ("images", "table", "lines"),
    [
        ("img_align_celeba", "list_eval_partition.txt", LINES),
        ("Img/img_align_celeba", "Eval/list_eval_partition.txt", LINES),
        ("img_align_celeba/img_align_celeba", "list_eval_partition.csv", CSV),
    ],
)
def test_images_are_those_of_the_test_partition_or_all(tmp_path, images, table, lines):
    paths = write(tmp_path, images, table, lines, n=9)
    for name in ("._000008.jpg", "Thumbs.db", "000010.jpg.part", "00008.jpg"):
        (tmp_path / images / name).touch()
    assert find_images(tmp_path) == paths[7:]
    (tmp_path / table).unlink()
    assert find_images(tmp_path) == paths


@pytest.mark.parametrize(
    ("lines", "message"),
    [
        ([*LINES[:3], "000004.jpg 3"], "line 4 must be .* Received '000004.jpg 3'"),
        ([*CSV, "a,b"], "line 14 must be"),
        (LINES[:7], "the test partition, 2. Received 12 images, none of them"),
    ],
)
def test_a_list_that_does_not_say_which_images_are_for_testing_is_refused(tmp_path, lines, message):
    with pytest.raises(InputError, match=f"{tmp_path}: must hold CelebA, unpacked"):
        find_images(tmp_path)
    write(tmp_path, "img_align_celeba", "list_eval_partition.txt", lines)
    with pytest.raises(InputError, match=message):
        find_images(tmp_path)
    (tmp_path / "list_eval_partition.txt").write_bytes(b"\xff\xfe\x00binary")
    with pytest.raises(InputError, match="list_eval_partition.txt: must be CelebA's list"):
        find_images(tmp_path)
