"""Pickles are read as data: known values come back, and nothing in a file is ever run."""

import builtins
import os
import pickle
import sys
import tracemalloc
from collections import OrderedDict

import numpy as np
import pytest
from places import SHARED
from scipy.sparse import coo_matrix, csc_array, csc_matrix, csr_matrix, issparse
from writers.pickles import LYING, PYTHON2, Calls, chumpy_pickle

from data_gen.formats.plain_pickle import load_plain_pickle
from deepmds_keras.errors import InputError

PROTOCOLS = range(pickle.HIGHEST_PROTOCOL + 1)


def write(folder, data):
    file = folder / "file.pkl"
    file.write_bytes(data)
    return file


def reread(folder, value, protocol):
    return load_plain_pickle(write(folder, pickle.dumps(value, protocol)))


@pytest.mark.parametrize("protocol", PROTOCOLS)
class TestData:
    def test_containers_strings_and_numbers_come_back(self, tmp_path, protocol):
        value = {
            "list": [1, -2.5, None, True, 10**30],
            2: {"nested": ({3}, frozenset([4]), (), (5, 6), (7, 8, 9), (0, 1, 2, 3))},
            "text": "naïve\r\n\N{GREEK SMALL LETTER BETA}",
            "bytes": (b"\x00\xff", b""),
        }
        nested = [[3], [4], [], [5, 6], [7, 8, 9], [0, 1, 2, 3]]
        expected = value | {2: {"nested": nested}, "bytes": [b"\x00\xff", b""]}
        assert reread(tmp_path, value, protocol) == expected
        assert reread(tmp_path, OrderedDict(value), protocol) == expected

    @pytest.mark.parametrize(
        "array",
        [
            np.arange(24.0).reshape(2, 3, 4),
            np.asfortranarray(np.arange(24, dtype=np.uint32).reshape(2, 3, 4)),
            np.arange(24.0).reshape(2, 3, 4).transpose(1, 2, 0),
            np.arange(6, dtype=">i2"),
            np.array([True, False]),
            np.array(["a", "bc"]),
            np.array([b"a", b"bc"]),
            np.empty((0, 3)),
            np.array(1.5),
        ],
        ids=lambda a: f"{a.dtype.str}{a.shape}",
    )
    def test_arrays_come_back_writable_and_in_native_byte_order(self, tmp_path, protocol, array):
        found = reread(tmp_path, [array, array], protocol)
        np.testing.assert_array_equal(found[0], array)
        assert found[0].dtype == array.dtype.newbyteorder("=")
        assert found[0].flags.writeable
        assert found[0] is found[1]

    def test_scalars_of_numpy_come_back(self, tmp_path, protocol):
        found = reread(tmp_path, [np.float32(1.5), np.int64(-3), np.bool_(True)], protocol)
        assert found == [1.5, -3, True]
        assert isinstance(found[0], np.float32)

    @pytest.mark.parametrize("kind", [csr_matrix, csc_matrix, coo_matrix, csc_array])
    def test_sparse_matrices_come_back(self, tmp_path, protocol, kind):
        dense = np.array([[0, 1.5, 0, 2], [0, 0, 0, 0], [3, 0, 4, 0]])
        found = reread(tmp_path, {"J_regressor": kind(dense)}, protocol)["J_regressor"]
        assert issparse(found)
        np.testing.assert_array_equal(found.toarray(), dense)

    @pytest.mark.parametrize("module", ["scipy.sparse.csc", "scipy.sparse"])
    def test_sparse_matrices_of_older_scipy_come_back(self, tmp_path, protocol, module):
        dense = np.eye(3, 4)
        data = pickle.dumps(csc_matrix(dense), min(protocol, 3))
        old = data.replace(b"scipy.sparse._csc\n", module.encode() + b"\n")
        assert old != data
        found = load_plain_pickle(write(tmp_path, old))
        np.testing.assert_array_equal(found.toarray(), dense)

    def test_chumpy_objects_become_the_arrays_that_they_hold(self, tmp_path, protocol):
        x = np.arange(6.0).reshape(2, 3)

        def make(chumpy):
            plain = chumpy(x=x, _dirty_vars={"x"}, _depends_on_deps={"r": {"value": None}})
            return {"plain": plain, "twice": chumpy(x=plain), "sum": chumpy(a=plain, b=1)}

        found = load_plain_pickle(write(tmp_path, chumpy_pickle(make, protocol)))
        assert "chumpy" not in sys.modules
        np.testing.assert_array_equal(found["plain"], x)
        np.testing.assert_array_equal(found["twice"], x)
        np.testing.assert_array_equal(found["sum"].pop("a"), x)
        assert found["sum"] == {"b": 1}

    @pytest.mark.parametrize(
        ("function", "name"),
        [(os.system, "system"), (builtins.eval, "eval"), (getattr, "getattr"), (bytearray, "byte")],
    )
    @pytest.mark.parametrize("where", ["alone", "array", "chumpy"])
    def test_anything_else_is_refused_and_never_run(
        self, tmp_path, protocol, function, name, where
    ):
        harm = tmp_path / "harm"
        arguments = {
            "system": (f"mkdir {harm}",),
            "eval": (f"__import__('os').mkdir({str(harm)!r})",),
            "getattr": ("", "join"),
            "byte": (10**13,),
        }[name]
        hostile = Calls(function, *arguments)
        data = {
            "alone": lambda: pickle.dumps({"f": hostile}, protocol),
            "array": lambda: pickle.dumps(np.array([hostile, 1], object), protocol),
            "chumpy": lambda: chumpy_pickle(lambda ch: ch(x=np.eye(2), other=hostile), protocol),
        }[where]()
        with pytest.raises(InputError, match=f"file.pkl: .* asks for .*{name}.*nothing was run"):
            load_plain_pickle(write(tmp_path, data))
        assert not harm.exists()
        if where == "alone" and name in ("system", "eval"):
            pickle.loads(data)
            assert harm.exists()  # the file was indeed hostile

    def test_arrays_of_objects_are_refused(self, tmp_path, protocol):
        with pytest.raises(InputError, match="file.pkl: must hold arrays of plain numbers.*'O8'"):
            reread(tmp_path, [np.array([None, "a"])], protocol)

    def test_structured_arrays_are_refused(self, tmp_path, protocol):
        with pytest.raises(InputError, match="must hold arrays of plain numbers.*'V12'"):
            reread(tmp_path, np.zeros(2, [("a", "f8"), ("b", "i4")]), protocol)

    def test_functions_and_classes_are_refused(self, tmp_path, protocol):
        for value in (np.ndarray, {"a": [np.dtype]}):
            with pytest.raises(InputError, match=r"must hold data only. Received a bare name"):
                reread(tmp_path, value, protocol)

    def test_a_truncated_file_is_refused(self, tmp_path, protocol):
        data = pickle.dumps({"a": np.arange(50.0), "b": [1, 2]}, protocol)
        for n in range(0, len(data), 7):
            with pytest.raises(InputError, match=f"file.pkl: .*Received a file .* {n} bytes"):
                load_plain_pickle(write(tmp_path, data[:n]))


def test_python_2_wrote_bytes_as_text(tmp_path):
    found = load_plain_pickle(write(tmp_path, PYTHON2))
    np.testing.assert_array_equal(found["a"], [1.5, -2])
    assert found["name"] == "r\xe9"


def test_modules_of_either_numpy_are_known(tmp_path):
    array = np.arange(3.0)
    for protocol, function in ((2, b"multiarray"), (5, b"numeric")):
        data = pickle.dumps(array, protocol)
        old, new = b"numpy.core." + function, b"numpy._core." + function
        assert old in data or new in data
        if protocol == 5:
            data = data[:2] + data[11:]  # without the length of the frame
            old, new = (bytes([0x8C, len(name)]) + name for name in (old, new))
        for of, to in ((old, new), (new, old)):
            found = load_plain_pickle(write(tmp_path, data.replace(of, to)))
            np.testing.assert_array_equal(found, array)


def test_line_ends_that_became_crlf_are_repaired(tmp_path):
    value = {"text": "a\r\nb", "numbers": [1, 2.5], "array": np.arange(2570, 2580, dtype=np.uint16)}
    data = chumpy_pickle(lambda ch: value | {"chumpy": ch(x=np.eye(2))}, 0)
    assert b"\r" not in data
    found = load_plain_pickle(write(tmp_path, data.replace(b"\n", b"\r\n")))
    assert found["text"] == value["text"] and found["numbers"] == value["numbers"]
    np.testing.assert_array_equal(found["array"], value["array"])
    np.testing.assert_array_equal(found["chumpy"], np.eye(2))


@pytest.mark.skipif(not SHARED.is_dir(), reason="../shared is absent")
def test_line_ends_of_the_public_embedding_are_repaired(tmp_path):
    file = SHARED / "tf_flame" / "flame_static_embedding.pkl"
    intact = load_plain_pickle(file)
    data = file.read_bytes()
    assert b"\r" not in data
    found = load_plain_pickle(write(tmp_path, data.replace(b"\n", b"\r\n")))
    assert found.keys() == intact.keys() == {"lmk_face_idx", "lmk_b_coords"}
    for key, array in intact.items():
        np.testing.assert_array_equal(found[key], array)


def test_crlf_in_the_bytes_of_a_binary_pickle_is_left_alone(tmp_path):
    array = np.frombuffer(b"\r\n" * 4)
    for protocol in (1, 2, 4):
        assert reread(tmp_path, array, protocol).tobytes() == array.tobytes()


def forged(**state):
    """Pickle of a sparse matrix with another state."""
    matrix = csr_matrix(np.eye(3, 4))
    matrix.__dict__.update(state)
    return pickle.dumps(matrix, 2)


@pytest.mark.parametrize(
    "state",
    [
        {"indices": np.array([0, 1, 4])},
        {"indices": np.array([0, -1, 2])},
        {"indices": np.array([0.0, 1.0, 2.0])},
        {"indptr": np.array([0, 1, 2, 9])},
        {"indptr": np.array([0, 2, 1, 3])},
        {"indptr": np.array([1, 2, 2, 3])},
        {"indptr": np.array([0, 1, 3])},
        {"data": np.ones(2)},
        {"data": np.ones((3, 2))},
        {"_shape": (3, -4)},
        {"_shape": (10**12, 4)},
        {"_shape": "ab"},
        {"indptr": None},
    ],
)
def test_a_sparse_matrix_that_contradicts_itself_is_refused(tmp_path, state):
    with pytest.raises(InputError, match="file.pkl: must be a whole Python pickle"):
        load_plain_pickle(write(tmp_path, forged(**state)))


@pytest.mark.parametrize(
    "data",
    [
        b"",
        b"Please sign the licence first.\n",
        b"version https://git-lfs.github.com/spec/v1\n",
        b"\x80\x63.",
        b"\x80\x02.",
        b"PK\x03\x04",
        bytes(range(256)),
        b"\x80\x02]q\x00h\x00a.",  # a list that contains itself
        b"\x80\x02" + b"]" * 50000 + b"a" * 49999 + b".",
        b"\x80\x02cnumpy\ndtype\n)R.",
        PYTHON2.replace(b"K\x02\x85c", b"K\x03\x85c"),  # a shape of more numbers than there are
        PYTHON2.replace(b"K\x02\x85c", b"M\xff\xff\x85c"),
        PYTHON2.replace(b"f8", b"f7"),
        b"\x80\x02P1\n.",
        b"\x80\x02\x82\x01.",
        b"\x80\x05\x97.",
    ],
)
def test_damaged_and_foreign_files_are_refused(tmp_path, data):
    with pytest.raises(InputError, match=f"file.pkl: must be a .*Received .* {len(data)} bytes"):
        load_plain_pickle(write(tmp_path, data))


@pytest.mark.parametrize("data", LYING.values(), ids=LYING.keys())
def test_a_file_that_claims_to_be_huge_costs_no_memory(tmp_path, data):
    file = write(tmp_path, data)
    tracemalloc.start()
    try:
        with pytest.raises(InputError, match="file.pkl: must be a whole Python pickle"):
            load_plain_pickle(file)
        assert tracemalloc.get_traced_memory()[1] < 1e6
    finally:
        tracemalloc.stop()


def test_what_is_shared_is_read_once(tmp_path):
    value = [1]
    for _ in range(100):
        value = [value, value]  # 2^100 ways to the innermost
    found = reread(tmp_path, value, 4)
    assert found[0] is found[1]


def test_a_file_cannot_change_how_the_next_is_read(tmp_path):
    names = ("numpy\ndtype", "numpy.core.multiarray\n_reconstruct", "__builtin__\nset", "chumpy\nC")
    for name in names:
        for state in (b"}U\x09__slots__Ns", b"N}U\x0c__setstate__Ns\x86"):
            data = b"\x80\x02c" + name.encode() + b"\n" + state + b"b."
            with pytest.raises(InputError, match="file.pkl"):
                load_plain_pickle(write(tmp_path, data))
    np.testing.assert_array_equal(reread(tmp_path, np.eye(2), 2), np.eye(2))


def test_a_missing_file_is_refused(tmp_path):
    for path in (tmp_path / "absent.pkl", tmp_path):
        with pytest.raises(InputError, match=f"{path}: must be a pickle that can be read"):
            load_plain_pickle(path)
