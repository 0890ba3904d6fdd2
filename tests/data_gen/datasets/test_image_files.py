"""Files of images: read like one array, written whole, and known again by their checksums."""

import numpy as np
import pytest

from data_gen.datasets import image_files
from data_gen.datasets.image_files import ImageFiles
from deepmds_keras.errors import InputError


@pytest.fixture
def images():
    return np.random.default_rng(0).integers(0, 255, (10, 8, 8, 3), np.uint8)


@pytest.fixture
def files(images, tmp_path, monkeypatch):
    monkeypatch.setattr(image_files, "FACES_PER_FILE", 4)
    files = ImageFiles(tmp_path, 10, 8)
    for number, faces in enumerate(files.ranges()):
        rows = slice(faces.start, faces.stop)
        files.save(number, images[rows], np.float32(np.arange(20).reshape(10, 1, 2)[rows]))
    return files


def test_it_is_indexed_like_an_array(files, images):
    assert len(files) == 10
    assert [len(faces) for faces in files.ranges()] == [4, 4, 2]
    for faces in (slice(3, 9), slice(None), np.array([9, 0, 5, 5]), slice(8, 20)):
        assert np.array_equal(files[faces], images[faces])
    with pytest.raises(IndexError):
        files[np.array([10])]


def test_landmarks_lie_beside_the_images(files):
    for faces in (range(10), range(3), range(3, 8), range(4), range(8, 10), range(4, 8)):
        expected = np.arange(20).reshape(10, 1, 2)[faces.start : faces.stop]
        assert np.array_equal(files.landmarks(faces), expected)


def test_nothing_half_written_remains(files, tmp_path):
    names = [f"000{k}{end}" for k in range(3) for end in ("-landmarks.npy", ".npy")]
    assert sorted(path.name for path in tmp_path.iterdir()) == names


def test_a_changed_or_missing_file_is_named(files, tmp_path):
    checksums = files.checksums()
    files.check(checksums)
    path = tmp_path / "0001.npy"
    content = bytearray(path.read_bytes())
    content[200] ^= 1
    path.write_bytes(content)
    with pytest.raises(InputError, match=r"0001.npy was changed since it was made. Delete it"):
        files.check(checksums)
    path.unlink()
    with pytest.raises(InputError, match=r"0001.npy must hold images. Received No such file"):
        files.check(checksums)


@pytest.mark.parametrize("content", [b"", b"text", b"\x80\x04N."])
def test_a_file_of_another_kind_is_refused(files, tmp_path, content):
    (tmp_path / "0000.npy").write_bytes(content)
    with pytest.raises(InputError, match="0000.npy must be a file of images"):
        files[:2]


def test_a_file_of_another_shape_is_refused(files, tmp_path):
    np.save(tmp_path / "0002.npy", np.zeros((3, 8, 8, 3), np.uint8))
    with pytest.raises(InputError, match=r"uint8 \(2, 8, 8, 3\)"):
        files[9:]
