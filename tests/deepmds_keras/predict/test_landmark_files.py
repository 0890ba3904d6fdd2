"""Files of landmarks: every layout gives the same numbers, and a bad file gets one clear line."""

import json
import pickle

import numpy as np
import pytest
from writers.landmark_files import DEPTH, FACES, LAYOUTS, ONE, WIDE, long_rows, pts, table, written

from deepmds_keras import InputError
from deepmds_keras.landmarks.conversion import face_sizes
from deepmds_keras.predict.landmark_files import read_faces, read_landmarks


@pytest.mark.parametrize("layout", LAYOUTS)
def test_every_layout_gives_the_same_numbers(tmp_path, layout):
    name, content, expected = LAYOUTS[layout]
    points = read_landmarks(written(tmp_path, name, content))
    assert points.dtype == float
    np.testing.assert_allclose(points, expected, rtol=1e-12)


@pytest.mark.parametrize("n", face_sizes())
def test_every_number_of_landmarks_is_read_as_array_and_as_rows(tmp_path, n):
    faces = np.random.default_rng(n).uniform(1, 500, size=(2, n, 2))
    assert np.array_equal(read_landmarks(written(tmp_path, "f.npy", faces)), faces)
    rows = read_landmarks(written(tmp_path, "f.csv", table(faces.reshape(2, -1))))
    np.testing.assert_allclose(rows, faces, rtol=1e-12)


def test_y_that_grows_upwards_is_turned_down(tmp_path):
    path = written(tmp_path, "f.npy", FACES)
    assert np.array_equal(read_landmarks(path, y_up=True), FACES * [1, -1])
    assert np.array_equal(np.load(path), FACES)


def test_faces_called_like_missing_values_stay_apart(tmp_path):
    rows = [("null", *r[1:]) if r[0] == "face 1" else r for r in long_rows()]
    points = read_landmarks(written(tmp_path, "f.csv", table(rows, "face,number,x,y")))
    np.testing.assert_allclose(points, FACES, rtol=1e-12)


MESH = np.random.default_rng(1).uniform(0.2, 0.7, (3, 468, 2))


@pytest.mark.parametrize("n", [468, 478])
@pytest.mark.parametrize("key", [None, "faceLandmarks"])
def test_fractions_of_mediapipe_become_pixels(tmp_path, n, key):
    faces = np.random.default_rng(n).uniform(0, 1.1, (2, n, 3))
    named = [[dict(zip("xyz", point, strict=True)) for point in face] for face in faces.tolist()]
    for content, expected in ((named, faces), (named[0], faces[:1]), ([named[0]], faces[:1])):
        path = written(tmp_path, "f.json", json.dumps({key: content} if key else content))
        points = read_landmarks(path, image_size=(640, 480))
        np.testing.assert_allclose(points, expected[..., :2] * (640, 480))
    with pytest.raises(InputError, match="seem to be fractions of the image, as MediaPipe"):
        read_landmarks(path)


def test_an_image_size_for_pixels_is_refused_and_small_units_of_other_schemes_are_not(tmp_path):
    with pytest.raises(InputError, match="up to 4.*: leave --image-size out"):
        read_landmarks(written(tmp_path, "f.npy", FACES), image_size=(640, 480))
    path = written(tmp_path, "f.npy", FACES / 1000)
    np.testing.assert_array_equal(read_landmarks(path), FACES / 1000)


GAPS = np.concatenate([FACES[:1] * np.nan, FACES, FACES[:2] * np.nan])
WITH_GAPS = {
    "array": ("f.npy", GAPS),
    "face a row, NaN": ("f.csv", table(GAPS.reshape(6, -1))),
    "face a row, empty": ("f.csv", table(GAPS.reshape(6, -1)).replace("nan", "") + "\n\n"),
    "named": ("f.csv", table([[i, *row] for i, row in enumerate(GAPS.reshape(6, -1))],
              ",".join(["frame", *(f"{a}{i}" for i in range(68) for a in "xy")]))),
    "landmark a row": ("f.csv", table(long_rows(GAPS), "face,number,x,y")),
    "JSON of NaN": ("f.json", json.dumps(GAPS.tolist())),
    "JSON of null": ("f.json", json.dumps([None, *FACES.tolist(), None, None])),
    "records": (
        "f.json",
        json.dumps({"faces": [{"landmarks": f} for f in [None, *FACES.tolist(), None, None]]}),
    ),
}  # fmt: skip


@pytest.mark.parametrize("layout", WITH_GAPS)
def test_faces_of_nan_are_gaps_and_stay_in_their_place(tmp_path, layout):
    name, content = WITH_GAPS[layout]
    points, faults = read_faces(written(tmp_path, name, content))
    np.testing.assert_allclose(points, GAPS, rtol=1e-12)
    assert faults == {}


def test_faces_that_cannot_be_used_are_told_and_the_others_read(tmp_path):
    faces = np.repeat(FACES, 3, 0)
    faces[1, 5, 0], faces[3], faces[4, :, 1], faces[6, 0] = np.nan, 7, 2, 1e12
    points, faults = read_faces(written(tmp_path, "f.npy", faces))
    wanted = {1: "in landmark 6 of 68", 3: "one point 68 times", 4: "straight line", 6: "1e+12, "}
    assert [*faults] == [*wanted]
    assert all(text in faults[face] for face, text in wanted.items())
    good = np.isin(np.arange(9), [*wanted], invert=True)
    np.testing.assert_array_equal(points[good], faces[good])
    assert np.isnan(points[~good]).all()

    rows = [["a" if face == 2 else cell for cell in row] for face, row in enumerate(WIDE)]
    for text in (table(rows), table(rows, ",".join(f"{a}{i}" for i in range(68) for a in "xy"))):
        points, faults = read_faces(written(tmp_path, "f.csv", text))
        assert [*faults] == [2] and "Received 'a' in line" in faults[2]
        np.testing.assert_allclose(points[:2], FACES[:2], rtol=1e-12)
    long = long_rows()
    long[70] = (*long[70][:3], "")
    points, faults = read_faces(written(tmp_path, "f.csv", table(long, "face,number,x,y")))
    assert [*faults] == [1] and "empty cell in line 72" in faults[1]


def replaced(row, number=4):
    rows = [tuple(point) for point in ONE[0]]
    rows[number] = row
    return table(rows, "x,y")


REFUSED = {
    "text": ("f.csv", replaced(("a", 3)), "'a' in line 6"),
    "empty cell": ("f.csv", "# c\n" + replaced(("", 3)), "empty cell in line 7"),
    "empty line within": ("f.csv", replaced(()), "empty cell in line 6"),
    "infinity": ("f.csv", replaced(("inf", 3)), "'inf' in line 6"),
    "too great a number": ("f.csv", replaced(("1e400", 3)), "'1e400' in line 6"),
    "a cell more": ("f.csv", replaced((1, 2, 3)), "2 cells a row.* Received 3 in line 6"),
    "cells more": ("f.csv", table(np.ones((68, 3)), "x,y"), "2 cells a row.* Received 3 in line 2"),
    "three unnamed": ("f.csv", table(np.ones((68, 3))), "Received 3 columns without a header"),
    "other names": ("f.csv", table(ONE[0], "a,b"), "Received the first line 'a, b'"),
    "x without y": ("f.csv", table(np.ones((1, 51)), ",".join(f"x{i}" for i in range(51))), "y1"),
    "faces untold": (
        "f.csv",
        table([r[2:] for r in long_rows()], "x,y"),
        "204 rows, and no column face",
    ),
    "one landmark less": (
        "f.csv",
        table(long_rows()[:-1], "face,number,x,y"),
        "68, and 67 for the face 'face 2'",
    ),
    "other order": ("f.csv", table(long_rows()[::-1], "face,number,x,y"), "another order"),
    "wrong count in rows": ("f.csv", table(ONE[0, :5]), "Received 5 rows"),
    "comments only": ("f.csv", "# nothing\n", "no rows"),
    "header only": ("f.csv", "x,y\n", "must be a table"),
    "binary": ("f.csv", bytes(range(256)), "binary data"),
    "open quote": ("f.csv", 'x,y\n"1,2\n3,4\n', "must be a table"),
    "endless cell": ("f.csv", "x" * 200_000 + ",y\n", "field limit"),
    "empty table": ("f.csv", "", "empty file"),
    "empty array": ("f.npy", b"", "empty file"),
    "empty JSON": ("f.json", "", "empty file"),
    "empty points": ("f.pts", "", "empty file"),
    "no such format": ("f.txt", table(ONE[0]), "must end in .csv"),
    "NaN": (
        "f.npy",
        np.where(FACES[1, 5, 0] == FACES, np.nan, FACES),
        "face 2 of 3, must .*landmark 6 of 68",
    ),
    "nothing but gaps": ("f.npy", FACES * np.nan, "nothing but gaps"),
    "fractions": ("f.npy", np.ones((468, 2)) * 0.5, "must spread out"),
    "fractions of MediaPipe": ("f.npy", MESH, "or --image-size W H be given"),
    "huge numbers": ("f.npy", FACES * 1e200, "below 1e"),
    "wrong count": ("f.npy", FACES[:, :5], "51, 68, 72, 468 or 478 landmarks a face. Received 5"),
    "no faces": ("f.npy", FACES[:0], "Received none"),
    "no points": ("f.npy", FACES[:, :0], "Received 0"),
    "axes swapped": ("f.npy", FACES.transpose(0, 2, 1), r"\(3, 2, 68\)"),
    "a number": ("f.npy", np.array(3.0), r"Received \(\)"),
    "complex": ("f.npy", FACES + 1j, "complex"),
    "text as array": ("f.npy", np.full((68, 2), "1"), "text"),
    "one point": ("f.npy", np.ones((68, 2)), "one point 68 times"),
    "a line": ("f.npy", np.outer(np.arange(68.0), [1, 2]), "straight line"),
    "no array": ("f.npy", "version", "NumPy's format"),
    "points cut short": ("f.pts", pts(ONE[0])[:-300], "cut short"),
    "points with text": ("f.pts", pts(ONE[0]).replace("{\n", "{\nabc 3\n"), "'abc 3' in line 4"),
    "points with a third": ("f.pts", pts(DEPTH[0] * [1, 2, 3]), "in line 4"),
    "points too many": ("f.pts", pts(np.ones((194, 2))), "Received 194"),
    "points with NaN": ("f.pts", pts([(np.nan, 1), *ONE[0, 1:]]), "nan"),
    "JSON cut short": ("f.json", json.dumps(FACES.tolist())[:-5], "must be JSON"),
    "JSON too deep": ("f.json", "[" * 100_000, "must be JSON"),
    "JSON ragged": ("f.json", "[[1, 2], [3]]", "lists of other lengths"),
    "JSON of text": ("f.json", json.dumps([["1", "2"]] * 68), "text"),
    "JSON with null": ("f.json", json.dumps([[1, None]] * 68), "null"),
    "JSON with NaN": ("f.json", json.dumps([[1.0, np.nan]] * 68), "nan"),
    "JSON without landmarks": ("f.json", '{"points": []}', 'keys "faces", "landmarks"'),
    "JSON without x": ("f.json", json.dumps([{"y": 1}] * 68), "null"),
    "JSON record without": ("f.json", '{"faces": [{"name": 1}]}', "null"),
}


@pytest.mark.parametrize("fault", REFUSED)
def test_a_bad_file_gets_one_line_that_names_it_and_the_fault(tmp_path, fault):
    name, content, said = REFUSED[fault]
    with pytest.raises(InputError, match=said) as caught:
        read_landmarks(written(tmp_path, name, content))
    message = str(caught.value)
    assert message.startswith((f"{tmp_path / name} ", f"{tmp_path / name}, face "))
    assert "\n" not in message
    assert len(message) < len(str(tmp_path)) + 250


def test_a_file_of_objects_is_refused_and_not_executed(tmp_path):
    ran = tmp_path / "ran"

    class Evil:
        def __reduce__(self):
            return open, (str(ran), "w")

    path = tmp_path / "f.npy"
    np.save(path, np.array([Evil()], object), allow_pickle=True)
    pickled = written(tmp_path, "g.npy", pickle.dumps(Evil()))
    for file in (path, pickled):
        with pytest.raises(InputError, match="NumPy's format"):
            read_landmarks(file)
    assert not ran.exists()


def test_a_header_that_claims_more_than_the_file_has_takes_no_memory(tmp_path):
    path = written(tmp_path, "f.npy", FACES)
    honest, claim = b"(3, 68, 2), }       ", b"(30000000, 68, 2), }"
    assert honest in path.read_bytes()
    path.write_bytes(path.read_bytes().replace(honest, claim))
    with pytest.raises(InputError, match="NumPy's format"):
        read_landmarks(path)


def test_files_that_are_too_large_missing_or_no_files_are_refused(tmp_path):
    large = tmp_path / "f.npy"
    with open(large, "wb") as file:
        file.truncate((1 << 29) + 1)
    with pytest.raises(InputError, match="at most 512 MiB. Received 536,870,913 bytes"):
        read_landmarks(large)
    with pytest.raises(InputError, match="does not exist"):
        read_landmarks(tmp_path / "none.csv")
    (tmp_path / "folder.csv").mkdir()
    with pytest.raises(InputError, match="a folder or device"):
        read_landmarks(tmp_path / "folder.csv")
