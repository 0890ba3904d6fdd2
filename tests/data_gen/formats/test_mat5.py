"""MATLAB files: numbers come back as SciPy wrote and reads them, and damage is refused."""

import struct

import numpy as np
import pytest
from scipy.io import loadmat, savemat

from data_gen.formats.mat5 import read_mat
from deepmds_keras.errors import InputError

RNG = np.random.default_rng(0)
KINDS = ("f8", "f4", "i1", "u1", "i2", "u2", "i4", "u4", "i8", "u8")
ARRAYS = {f"of_{kind}": RNG.uniform(0, 100, (3, 4)).astype(kind) for kind in KINDS} | {
    "three_axes": RNG.normal(size=(2, 3, 4)),
    "one": np.float64([[1.5]]),
    "a": np.uint8([[1, 2, 3]]),  # its name and numbers fit into short elements
    "none": np.empty((0, 3)),
    "logical": np.array([[True, False]]),
    "a_name_of_the_most_characters_31": np.arange(6.0).reshape(2, 3),
}
OTHERS = {
    **{"text": "words", "cell": np.array([[1, "a"]], object), "struct": {"a": 1}},
    **{"complex": np.array([[1 + 2j]])},
}


@pytest.mark.parametrize("compressed", [False, True])
def test_every_kind_of_number_comes_back(tmp_path, compressed):
    file = tmp_path / "a.mat"
    savemat(file, ARRAYS | OTHERS, do_compression=compressed)
    found, expected = read_mat(file, [*ARRAYS]), loadmat(file)
    assert found.keys() == ARRAYS.keys()
    for name, array in ARRAYS.items():
        assert found[name].shape == expected[name].shape == array.shape
        assert found[name].dtype == (np.uint8 if name == "logical" else array.dtype)
        np.testing.assert_array_equal(found[name], array)


def test_only_what_is_asked_for_is_read(tmp_path):
    file = tmp_path / "a.mat"
    savemat(file, ARRAYS | OTHERS)
    assert read_mat(file, ["one", "absent"]).keys() == {"one"}
    assert read_mat(file, [*OTHERS]) == dict.fromkeys(OTHERS)


def big_endian(name, numbers, stored):
    """A file of one array of doubles, as a workstation of old wrote it."""
    body = np.asarray(numbers).T.astype(f">{stored[1]}").tobytes()
    name = struct.pack(">II", 1, len(name)) + name.encode().ljust(-(-len(name) // 8) * 8, b"\0")
    content = struct.pack(">IIIIIIii", 6, 8, 6, 0, 5, 8, *numbers.shape) + name
    content += struct.pack(">II", stored[0], len(body)) + body
    content = content.ljust(-(-len(content) // 8) * 8, b"\0")
    return b"MATLAB 5.0".ljust(124) + b"\1\0MI" + struct.pack(">II", 14, len(content)) + content


@pytest.mark.parametrize("stored", [(9, "f8"), (3, "i2"), (2, "u1")])
def test_the_other_byte_order_and_doubles_stored_as_integers_are_read(tmp_path, stored):
    numbers = np.arange(15.0).reshape(3, 5)
    (tmp_path / "a.mat").write_bytes(big_endian("a_longer_name", numbers, stored))
    found = read_mat(tmp_path / "a.mat", ["a_longer_name"])["a_longer_name"]
    assert found.dtype == float
    np.testing.assert_array_equal(found, numbers)
    np.testing.assert_array_equal(loadmat(tmp_path / "a.mat")["a_longer_name"], numbers)


@pytest.mark.parametrize("compressed", [False, True])
def test_a_file_cut_short_anywhere_is_refused(tmp_path, compressed):
    file = tmp_path / "a.mat"
    savemat(file, {"x": RNG.normal(size=(4, 5))}, do_compression=compressed)
    whole = file.read_bytes()
    for n in (*range(0, 127, 25), *range(129, len(whole), 7), len(whole) - 1):
        file.write_bytes(whole[:n])
        with pytest.raises(InputError, match="a.mat: must be a whole MATLAB file"):
            read_mat(file, ["x"])
    with pytest.raises(
        InputError, match="absent.mat: must be a MATLAB file. Received No such file"
    ):
        read_mat(tmp_path / "absent.mat", ["x"])


@pytest.mark.parametrize(
    ("place", "value", "message"),
    [
        (132, 10**9, "needs 1000000136"),
        (136, 99, "begins with the types"),
        (160, 10**6, "an array"),  # the first dimension
        (160, -1 % 2**32, "an array"),
        (176, 99, "numbers of type 99"),
        (180, 2**31, "needs"),
    ],
)
def test_a_damaged_tag_is_refused(tmp_path, place, value, message):
    file = tmp_path / "a.mat"
    savemat(file, {"x": np.ones((4, 5))})
    content = bytearray(file.read_bytes())
    struct.pack_into("<I", content, place, value)
    file.write_bytes(content)
    with pytest.raises(InputError, match=message):
        read_mat(file, ["x"])


def test_what_is_no_array_is_passed_over(tmp_path):
    file = tmp_path / "a.mat"
    savemat(file, {"x": np.ones((4, 5)), "y": np.ones((2, 2))})
    content = bytearray(file.read_bytes())
    struct.pack_into("<I", content, 128, 99)
    file.write_bytes(content)
    assert read_mat(file, ["x", "y"]).keys() == {"y"}
