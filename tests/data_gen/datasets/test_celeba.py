"""CelebA: every layout in which it is had is read, and what is amiss is named."""

from collections import Counter

import numpy as np
import pytest
from PIL import Image

from data_gen.datasets.celeba import PARTITIONS, CelebaImage, find_images, load_image
from deepmds_keras.errors import InputError

NAMES = [f"{number:06d}.jpg" for number in range(1, 13)]
NUMBERS = [0, 0, 0, 0, 0, 1, 1, 2, 2, 2, 2, 2]  # train, valid, test
LINES = [f"{name} {number}" for name, number in zip(NAMES, NUMBERS, strict=True)]
CSV = ["image_id,partition", *(line.replace(" ", ",") for line in LINES)]


@pytest.fixture
def root(tmp_path):
    return tmp_path


def write_images(folder, names=NAMES):
    folder.mkdir(parents=True)
    for name in names:
        (folder / name).touch()


def write_list(file, lines=LINES):
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text("\n".join(lines) + "\n")


def names_of(images):
    return [image.name for image in images]


@pytest.mark.parametrize(
    ("images", "table", "given"),
    [
        ("img_align_celeba", "list_eval_partition.txt", "."),
        ("Img/img_align_celeba", "Eval/list_eval_partition.txt", "."),
        ("CelebA/Img/img_align_celeba", "CelebA/Eval/list_eval_partition.txt", "."),
        ("celeba/img_align_celeba", "celeba/list_eval_partition.txt", "."),
        ("celeba/img_align_celeba", "celeba/list_eval_partition.txt", "celeba"),
        ("celeba/img_align_celeba", "celeba/list_eval_partition.txt", "celeba/img_align_celeba"),
        ("img_align_celeba/img_align_celeba", "list_eval_partition.csv", "."),
        ("img_align_celeba/img_align_celeba", "list_eval_partition.csv", "img_align_celeba"),
    ],
)
def test_every_layout_gives_the_same_images(root, images, table, given):
    write_images(root / images)
    write_list(root / table, CSV if table.endswith("csv") else LINES)
    found = find_images(root / given)
    assert names_of(found) == NAMES[7:]
    assert [image.path for image in found] == [root / images / name for name in NAMES[7:]]
    assert {image.partition for image in found} == {"test"}


def test_partitions_share_out_all_images_in_order(root):
    write_images(root / "img_align_celeba")
    write_list(root / "list_eval_partition.txt", LINES[::-1])
    parts = [find_images(root, partition) for partition in PARTITIONS]
    assert [len(part) for part in parts] == [5, 2, 5]
    assert names_of(sum(parts, [])) == NAMES
    with pytest.raises(InputError, match="must be one of train, valid, test. Received 'dev'"):
        find_images(root, "dev")


def test_without_the_list_all_images_are_found_and_have_no_partition(root):
    write_images(root / "img_align_celeba")
    found = find_images(root)
    assert names_of(found) == NAMES
    assert Counter(image.partition for image in found) == {None: len(NAMES)}


def test_other_files_and_missing_images_are_passed_over(root):
    write_images(root / "img_align_celeba", NAMES[:9])
    for name in ("._000008.jpg", "Thumbs.db", "000010.jpg.part", "00008.jpg"):
        (root / "img_align_celeba" / name).touch()
    write_list(root / "list_eval_partition.txt", ["", *LINES, "  "])
    assert names_of(find_images(root)) == NAMES[7:9]


def test_what_is_not_the_data_set_is_refused(root):
    with pytest.raises(InputError, match="nowhere: must be the folder of CelebA. Received no"):
        find_images(root / "nowhere")
    with pytest.raises(InputError, match="Received a folder without img_align_celeba"):
        find_images(root)
    (root / "Img").mkdir()
    (root / "Img" / "img_align_celeba.zip").touch()
    with pytest.raises(InputError, match=r"Img/img_align_celeba.zip: must be unpacked"):
        find_images(root)
    (root / "img_align_celeba").mkdir()
    with pytest.raises(InputError, match="must hold 000001.jpg to 202599.jpg, or some"):
        find_images(root)


@pytest.mark.parametrize(
    ("lines", "message"),
    [
        ([*LINES[:3], "000004.jpg 3"], "line 4 must be .* Received '000004.jpg 3'"),
        ([*LINES[:2], "000003.jpg"], "line 3 must be"),
        (["202599", *LINES], "line 1 must be"),
        ([*CSV, "a,b"], "line 14 must be"),
        (["<html>"], "line 1 must be"),
        (LINES[:7], "partition test. Received 12 images, none of them"),
    ],
)
def test_a_list_that_does_not_say_which_images_are_for_testing_is_refused(root, lines, message):
    write_images(root / "img_align_celeba")
    write_list(root / "list_eval_partition.txt", lines)
    with pytest.raises(InputError, match=message):
        find_images(root)
    (root / "list_eval_partition.txt").write_bytes(b"\xff\xfe\x00binary")
    with pytest.raises(InputError, match="list_eval_partition.txt: must be CelebA's list"):
        find_images(root)


def test_an_image_is_read_as_it_is(root):
    pixels = np.zeros((218, 178, 3), np.uint8)
    pixels[:100, :, 0] = 200
    pixels[100:, 90:, 2] = 150
    Image.fromarray(pixels).save(root / "000001.jpg", quality=95)
    Image.fromarray(pixels).convert("L").save(root / "000002.jpg")
    image = load_image(CelebaImage("000001.jpg", root / "000001.jpg"))
    assert image.dtype == np.uint8
    assert np.abs(image.astype(int) - pixels).mean() < 2
    assert load_image(CelebaImage("000002.jpg", root / "000002.jpg")).shape == (218, 178, 3)


def test_a_damaged_image_is_named(root):
    noise = np.random.default_rng(0).integers(0, 255, (218, 178, 3), np.uint8)
    file = root / "000007.jpg"
    Image.fromarray(noise).save(file)
    whole = file.read_bytes()
    for content in (b"", b"not an image", whole[: len(whole) // 2], whole[:30], b"GIF89a" + whole):
        file.write_bytes(content)
        with pytest.raises(InputError, match="000007.jpg: must be a whole JPEG image. Received"):
            load_image(CelebaImage(file.name, file))
    file.unlink()
    with pytest.raises(InputError, match="000007.jpg: must be .*No such file"):
        load_image(CelebaImage(file.name, file))


def test_an_image_that_claims_to_be_huge_is_refused_unread(root, monkeypatch):
    file = root / "000001.jpg"
    Image.new("RGB", (400, 300)).save(file)
    monkeypatch.setattr(Image, "MAX_IMAGE_PIXELS", 100_000)
    with pytest.raises(InputError, match="000001.jpg: must be .*120000 pixels"):
        load_image(CelebaImage(file.name, file))
