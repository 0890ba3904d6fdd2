"""The lowest floor: files appear whole or not at all, and bad ones are named on one line."""

import errno

import numpy as np
import pytest

from deepmds_keras.errors import InputError
from deepmds_keras.files import (
    atomic_write,
    map_npy,
    read_arrays,
    read_npz,
    read_table,
    sha256_of,
    write_arrays,
    write_bytes,
)


def test_what_is_not_written_to_the_end_leaves_what_was_there(tmp_path):
    path = tmp_path / "new" / "file"
    write_bytes(path, b"old")
    with pytest.raises(RuntimeError), atomic_write(path) as file:
        file.write(b"half")
        raise RuntimeError
    assert [p.name for p in path.parent.iterdir()] == ["file"]
    assert path.read_bytes() == b"old"


def test_a_full_disk_names_the_file_and_leaves_nothing(tmp_path):
    with pytest.raises(OSError) as raised, atomic_write(tmp_path / "file"):
        raise OSError("121 requested and 0 written")  # as NumPy says it
    assert raised.value.errno == errno.ENOSPC
    assert raised.value.filename == str(tmp_path / "file")
    assert not [*tmp_path.iterdir()]


def test_a_name_may_be_as_long_as_names_may_be_and_a_folder_is_no_file(tmp_path):
    write_bytes(tmp_path / ("a" * 255), b"")
    with pytest.raises(InputError, match="must be a file to write. Received a folder"):
        write_bytes(tmp_path, b"")


def test_checksum_is_of_all_files_in_order(tmp_path):
    for name, content in (("a", b"ab"), ("b", b"c"), ("c", b"abc")):
        (tmp_path / name).write_bytes(content)
    one, two, both = (tmp_path / name for name in "abc")
    assert sha256_of([one, two]) == sha256_of([both]) != sha256_of([two, one])


def test_rows_of_a_table_come_without_comments_and_byte_order_mark(tmp_path):
    path = tmp_path / "table.csv"
    path.write_text('\ufeff# a, b\nnumber,name\n1,"a, b"\n# c\n2,#\n', encoding="utf-8")
    assert read_table(path) == [{"number": "1", "name": "a, b"}, {"number": "2", "name": "#"}]
    for bad in (tmp_path, tmp_path / "none"):
        with pytest.raises(InputError, match=f"{bad} must be a table"):
            read_table(bad)


@pytest.mark.parametrize("compressed", [True, False])
def test_arrays_come_back_and_damage_is_refused_in_the_words_of_who_reads(tmp_path, compressed):
    path, arrays = tmp_path / "a.npz", {"a/b": np.eye(9), "c": np.arange(4)}
    write_arrays(path, arrays, {"x": [1]}, compressed=compressed)
    found, description = read_arrays(path)
    assert description == {"x": [1]} and found.keys() == arrays.keys()
    assert all(np.array_equal(found[key], arrays[key]) for key in arrays)
    path.write_bytes(path.read_bytes()[:-30])
    with pytest.raises(InputError, match="a.npz must be a model. Received BadZipFile"):
        read_npz(path, "a model")
    with pytest.raises(InputError, match="b.npz does not exist; it must be a model"):
        read_npz(tmp_path / "b.npz", "a model")


def test_objects_are_refused(tmp_path):
    np.save(tmp_path / "a.npy", np.array([None]), allow_pickle=True)
    np.savez(tmp_path / "a.npz", a=np.array([None]))
    for read, name in ((map_npy, "a.npy"), (read_npz, "a.npz")):
        with pytest.raises(InputError, match=f"{name} must be .* Received"):
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
