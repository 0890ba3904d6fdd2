"""The lowest floor: files appear whole or not at all, and bad ones are named on one line."""

import ast
import errno
import warnings
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from PIL import Image

from deepmds_keras.errors import InputError
from deepmds_keras.files import (
    atomic_write,
    map_npy,
    read_arrays,
    read_npz,
    read_table,
    write_arrays,
    write_bytes,
)
from deepmds_keras.tool.detection.photos import open_photo


def test_what_is_not_written_to_the_end_leaves_what_was_there(tmp_path):
    path = tmp_path / "new" / ("a" * 255)  # as long as names may be
    write_bytes(path, b"old")
    with pytest.raises(RuntimeError), atomic_write(path) as file:
        file.write(b"half")
        raise RuntimeError
    assert [*path.parent.iterdir()] == [path] and path.read_bytes() == b"old"
    with pytest.raises(InputError, match="must be a file to write. Received a folder"):
        write_bytes(tmp_path, b"")


@pytest.mark.parametrize(
    ("error", "number", "cause"),
    [
        (OSError("121 requested and 0 written"), errno.ENOSPC, "No space left"),  # NumPy's words
        (OSError(errno.EFBIG, "File too large"), errno.EFBIG, "File too large"),
        (OSError("encoder error -2"), errno.EIO, "encoder error -2"),
    ],
)
def test_what_cannot_be_written_says_why_and_leaves_nothing(tmp_path, error, number, cause):
    with pytest.raises(OSError, match=cause) as raised, atomic_write(tmp_path / "file"):
        raise error
    assert raised.value.errno == number
    assert raised.value.filename == str(tmp_path / "file")
    assert not [*tmp_path.iterdir()]


def test_threads_that_read_change_nothing_of_the_process(tmp_path):
    """Each reader would otherwise restore what another one had set."""
    write_arrays(tmp_path / "a.npz", {"a": np.eye(3)}, {})
    np.save(tmp_path / "a.npy", np.eye(3))
    Image.new("RGB", (40, 40)).save(tmp_path / "a.png")
    readers = [(read_npz, "a.npz"), (map_npy, "a.npy"), (open_photo, "a.png")]
    before = [*warnings.filters], Image.MAX_IMAGE_PIXELS
    with ThreadPoolExecutor(3) as threads:
        for read, name in readers:
            assert len([*threads.map(read, [tmp_path / name] * 300)]) == 300
    assert ([*warnings.filters], Image.MAX_IMAGE_PIXELS) == before


def test_headers_are_read_although_python_fails_to_evaluate_one_at_first(tmp_path, monkeypatch):
    """As up to 3.11.7 at times, in threads."""
    write_arrays(tmp_path / "a.npz", {"a": np.eye(3)}, {})
    np.save(tmp_path / "a.npy", np.eye(3))
    evaluate, fails = ast.literal_eval, [True]

    def evaluate_at_the_second_time(text):
        fails[0] = not fails[0]
        if not fails[0]:
            raise SystemError("AST constructor recursion depth mismatch (before=33, after=30)")
        return evaluate(text)

    monkeypatch.setattr(ast, "literal_eval", evaluate_at_the_second_time)
    np.testing.assert_array_equal(read_npz(tmp_path / "a.npz")["a"], np.eye(3))
    np.testing.assert_array_equal(map_npy(tmp_path / "a.npy"), np.eye(3))


def test_rows_of_a_table_come_without_comments_and_byte_order_mark(tmp_path):
    path = tmp_path / "table.csv"
    path.write_text('\ufeff# a, b\nnumber,name\n1,"a, b"\n# c\n2,#\n', encoding="utf-8")
    assert read_table(path) == [{"number": "1", "name": "a, b"}, {"number": "2", "name": "#"}]
    for bad in (tmp_path, tmp_path / "none"):
        with pytest.raises(InputError, match=f"{bad} must be a table"):
            read_table(bad)


@pytest.mark.parametrize("compressed", [True, False])
def test_arrays_come_back_and_damage_is_refused(tmp_path, compressed):
    path = tmp_path / "inner" / "a.npz"
    arrays = {"a/b": np.eye(9), "c": np.arange(4, dtype=">i2"), "d": np.zeros((0, 3), "<U5")}
    write_arrays(path, arrays, {"x": [1, None, "ä"]}, compressed=compressed)
    held, description = read_arrays(path)
    assert description == {"x": [1, None, "ä"]} and held.keys() == arrays.keys()
    for name, array in arrays.items():
        assert held[name].dtype == array.dtype and held[name].shape == array.shape
        assert held[name].tobytes() == array.tobytes()
    path.write_bytes(path.read_bytes()[:-30])
    with pytest.raises(InputError, match="a.npz must be a model. Received BadZipFile"):
        read_npz(path, "a model")
    with pytest.raises(InputError, match="b.npz does not exist; it must be a model"):
        read_npz(tmp_path / "b.npz", "a model")


def test_objects_are_refused(tmp_path):
    np.save(tmp_path / "a.npy", np.array([None]), allow_pickle=True)
    np.savez(tmp_path / "a.npz", a=np.array([None]))
    for read, name in ((map_npy, "a.npy"), (read_npz, "a.npz")):
        with pytest.raises(InputError, match=f"{name} must be .* an array of objects"):
            read(tmp_path / name)


def test_no_changed_bit_of_an_archive_goes_unnoticed(tmp_path):
    # Repeated rows are packed so that a changed bit can end the stream where the array would end.
    path, array = tmp_path / "a.npz", np.repeat(np.random.default_rng(0).random((1, 216)), 10, 0)
    write_arrays(path, {"a": np.float32(array)}, {})
    whole, content = path.read_bytes(), read_npz(path)
    for bit in range(0, 8 * len(whole), 3):
        changed = bytearray(whole)
        changed[bit // 8] ^= 1 << bit % 8
        path.write_bytes(changed)
        try:
            unnoticed = read_npz(path)
        except InputError:
            continue
        assert unnoticed.keys() == content.keys(), bit
        assert all(np.array_equal(unnoticed[key], content[key]) for key in content), bit
