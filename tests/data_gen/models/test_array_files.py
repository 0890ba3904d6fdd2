"""Pickles and MATLAB files: arrays come back, nothing is run, and damage is refused."""

import os
import pickle

import numpy as np
import pytest
from scipy.io import loadmat, savemat
from scipy.sparse import coo_array, csc_matrix, csr_matrix
from writers.pickles import PYTHON2, Calls, chumpy_pickle

from data_gen.models.array_files import load_plain_pickle, read_mat
from deepmds_keras.errors import InputError

DENSE = np.array([[0, 1.5, 0, 2], [0, 0, 0, 0], [3, 0, 4, 0]])
PROTOCOLS = pytest.mark.parametrize("protocol", range(pickle.HIGHEST_PROTOCOL + 1))


def load(tmp_path, data):
    (tmp_path / "file.pkl").write_bytes(data)
    return load_plain_pickle(tmp_path / "file.pkl")


@PROTOCOLS
def test_arrays_sparse_matrices_and_chumpy_come_back(tmp_path, protocol):
    arrays = [np.arange(6.0).reshape(2, 3).T, np.array([1, 2], ">i4"), np.float32(2), np.eye(2) > 0]
    sparse = [kind(DENSE) for kind in (csr_matrix, csc_matrix, coo_array)]

    def value(ch):
        plain = {"text": "ä", "list": [1, 2.5, None, True], "arrays": arrays, "sparse": sparse}
        return plain | {"held": ch(x=np.eye(2)), "none": ch(a=1)}

    content = load(tmp_path, chumpy_pickle(value, protocol))
    assert content["text"] == "ä" and content["list"] == [1, 2.5, None, True]
    for array, expected in zip(content["arrays"], arrays, strict=True):
        np.testing.assert_array_equal(array, expected)
    for matrix in content["sparse"]:
        np.testing.assert_array_equal(matrix.toarray(), DENSE)
    np.testing.assert_array_equal(content["held"], np.eye(2))
    assert content["none"] is None


def test_python_2_wrote_bytes_as_text(tmp_path):
    content = load(tmp_path, PYTHON2)
    np.testing.assert_array_equal(content["a"], [1.5, -2])
    assert content["name"] == "r\xe9"


@PROTOCOLS
@pytest.mark.parametrize("function", [os.mkdir, os.system, eval, getattr, bytearray])
def test_a_pickle_that_calls_anything_is_refused_and_never_run(tmp_path, protocol, function):
    harm = tmp_path / "harm"
    shell = {os.system: f"mkdir {harm}", eval: f"__import__('os').mkdir({str(harm)!r})"}
    hostile = Calls(function, shell.get(function, str(harm)))
    for data in (
        pickle.dumps({"f": hostile}, protocol),
        pickle.dumps(np.array([hostile, 1], object), protocol),
        chumpy_pickle(lambda ch: ch(x=np.eye(2), other=hostile), protocol),
    ):
        with pytest.raises(InputError, match="file.pkl: .* asks for .* nothing was run"):
            load(tmp_path, data)
    assert not harm.exists()


def forged(**state):
    """A sparse matrix with another state, whose readers would go beyond its ends."""
    matrix = csr_matrix(np.eye(3, 4))
    matrix.__dict__.update(state)
    return pickle.dumps(matrix, 2)


@pytest.mark.parametrize(
    "data",
    [
        b"Please sign the licence first.\n",
        b"\x80\x02]q\x00h\x00a.",  # a list that contains itself
        PYTHON2.replace(b"K\x02\x85c", b"K\x03\x85c"),  # a shape of more numbers than there are
        pickle.dumps(np.ndarray),
        pickle.dumps(np.array([None, "a"])),
        *(forged(indices=np.array(indices)) for indices in ([0, 1, 4], [0, -1, 2])),
        *(forged(indptr=np.array(indptr)) for indptr in ([0, 1, 2, 9], [0, 2, 1, 3], [0, 1, 3])),
        b"\x80\x02cchumpy\nC\nN}U\x0c__setstate__Ns\x86b.",  # which alters the class
        b"\x80\x02cscipy.sparse\ncsr_matrix\nN}U\x08__init__Ns\x86b.",
    ],
)
def test_damaged_and_foreign_pickles_are_refused(tmp_path, data):
    with pytest.raises(InputError, match="file.pkl: must"):
        load(tmp_path, data)
    next_file = load(tmp_path, pickle.dumps(csr_matrix(DENSE)))
    np.testing.assert_array_equal(next_file.toarray(), DENSE)


KINDS = ("f8", "f4", "i1", "u1", "i2", "u2", "i4", "u4", "i8", "u8")
ARRAYS = {f"of_{kind}": np.arange(12).reshape(3, 4).astype(kind) for kind in KINDS} | {
    "three_axes": np.random.default_rng(0).normal(size=(2, 3, 4)),
    "a": np.uint8([[1, 2, 3]]),  # its name and numbers fit into short elements
    "none": np.empty((0, 3)),
    "a_name_of_the_most_characters_31": np.arange(6.0).reshape(2, 3),
}
OTHERS = {"text": "words", "cell": np.array([[1, "a"]], object), "complex": np.array([[1 + 2j]])}


@pytest.mark.parametrize("compressed", [False, True])
def test_a_matlab_file_is_read_as_scipy_reads_it_and_cut_short_it_is_refused(tmp_path, compressed):
    file = tmp_path / "a.mat"
    savemat(file, OTHERS | ARRAYS, do_compression=compressed)
    arrays, expected = read_mat(file, [*ARRAYS]), loadmat(file)
    assert arrays.keys() == ARRAYS.keys()
    for name, array in arrays.items():
        assert array.dtype == ARRAYS[name].dtype
        np.testing.assert_array_equal(array, expected[name])
    for name in ("absent", *OTHERS):
        with pytest.raises(InputError, match=f"a.mat: must hold .* without {name}"):
            read_mat(file, ["a", name])
    whole = file.read_bytes()
    for n in (*range(0, len(whole), 97), len(whole) - 1):
        file.write_bytes(whole[:n])
        with pytest.raises(InputError, match="a.mat: must"):
            read_mat(file, [*ARRAYS])
