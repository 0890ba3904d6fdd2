"""Image files: photos that may be damaged, and those of a data set, read like one array."""

import struct

import numpy as np
import pytest
from PIL import Image

from data_gen.datasets import image_files
from data_gen.datasets.image_files import ImageFiles, read_image
from deepmds_keras.errors import InputError

IMAGES = np.random.default_rng(0).integers(0, 255, (10, 8, 8, 3), np.uint8)
LANDMARKS = np.float32(np.arange(20).reshape(10, 1, 2))


@pytest.fixture
def files(tmp_path, monkeypatch):
    monkeypatch.setattr(image_files, "FACES_PER_FILE", 4)
    files = ImageFiles(tmp_path, 10, 8)
    for number, faces in enumerate(files.ranges()):
        rows = slice(faces.start, faces.stop)
        files.save(number, IMAGES[rows], LANDMARKS[rows])
    return files


def test_they_are_indexed_like_an_array(files, tmp_path):
    assert len(files) == 10
    for faces in (slice(3, 9), slice(None), np.array([9, 0, 5, 5]), slice(8, 20)):
        assert np.array_equal(files[faces], IMAGES[faces])
    with pytest.raises(IndexError):
        files[np.array([10])]
    assert np.array_equal(files.landmarks(), LANDMARKS)
    names = [f"000{k}{end}" for k in range(3) for end in ("-landmarks.npy", ".npy")]
    assert sorted(path.name for path in tmp_path.iterdir()) == names


@pytest.mark.parametrize("name", ["0001.npy", "0001-landmarks.npy"])
def test_a_changed_or_missing_file_is_named(files, tmp_path, name):
    checksums = files.checksums()
    files.check(checksums)
    path = tmp_path / name
    path.write_bytes(path.read_bytes()[:-1] + b"\xff")
    with pytest.raises(InputError, match=f"{name} was changed since it was written. Delete"):
        files.check(checksums)
    path.unlink()
    with pytest.raises(InputError, match=f"{name} must be a file of images or landmarks"):
        files.check(checksums)


@pytest.mark.parametrize("content", [b"", b"text", b"\x80\x04N."])
def test_a_file_of_another_kind_or_shape_is_refused(files, tmp_path, content):
    (tmp_path / "0000.npy").write_bytes(content)
    with pytest.raises(InputError, match="0000.npy must be a file of images"):
        files[:2]
    np.save(tmp_path / "0002.npy", np.zeros((3, 8, 8, 3), np.uint8))
    with pytest.raises(InputError, match=r"0002.npy must have shape \(2, 8, 8, 3\)"):
        files[9:]


def test_an_image_of_any_colours_becomes_rgb(tmp_path):
    for mode in ("RGB", "L", "P", "1"):
        image = Image.fromarray(IMAGES[0]).convert(mode)
        image.save(tmp_path / "a.bmp")
        expected = np.array(image.convert("RGB"))
        assert np.array_equal(read_image(tmp_path / "a.bmp", ("BMP", "PNG")), expected)


def test_a_damaged_image_is_refused(tmp_path):
    file = tmp_path / "a.bmp"
    Image.fromarray(IMAGES[0]).save(file)
    whole = file.read_bytes()
    bomb = bytearray(whole)
    struct.pack_into("<ii", bomb, 18, 60_000, 60_000)  # width and height
    for content in (b"", b"text", whole[:54], whole[:-1], b"GIF89a" + whole, bytes(bomb)):
        file.write_bytes(content)
        with pytest.raises(InputError, match=f"{file}: must be a whole BMP or PNG image. Received"):
            read_image(file, ("BMP", "PNG"))
    file.unlink()
    with pytest.raises(InputError, match=f"{file}: must be .*No such file"):
        read_image(file, ("BMP",))
