"""Files of landmarks: every layout gives the same numbers, and a bad file gets one clear line."""

import json

import numpy as np
import pytest

from deepmds_keras import InputError
from deepmds_keras.landmarks import face_sizes
from deepmds_keras.lifting.inputs import prepare_views
from deepmds_keras.tool.predict.landmark_files import read_faces, read_landmarks

FACES = np.random.default_rng(0).uniform(1, 500, (3, 68, 2))
ONE = FACES[:1]
DEPTH = np.full((3, 68, 1), 7.0)


def table(rows, header=None, separator=","):
    lines = [separator.join(str(cell) for cell in row) for row in rows]
    return "\n".join([*([header] if header else []), *lines]) + "\n"


def long_rows(faces=FACES):
    return [(f"face {i}", j + 18, *point) for i, f in enumerate(faces) for j, point in enumerate(f)]


def pts(points):
    return f"version: 1\nn_points:  {len(points)}\n{{\n{table(points, separator=' ')}}}\n"


def written(folder, name, content):
    path = folder / name
    if isinstance(content, np.ndarray):
        np.save(path, content)
    else:
        path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return path


def wide(faces, success=()):
    """A table as OpenFace writes it, with its columns in millimetres too."""
    axes = [f"{axis}_{i}" for axis in "xyXYZ" for i in range(68)]
    rows = [
        [i + 1, 0, *success[i : i + 1], *face.T.ravel(), *[7] * 204] for i, face in enumerate(faces)
    ]
    return table(rows, ", ".join(["frame", "face_id", *["success"] * bool(success), *axes]), ", ")


def named(faces):
    return [[dict(zip("xyz", point, strict=False)) for point in face] for face in faces.tolist()]


COLUMNS = table(ONE[0], "x,y")
LAYOUTS = {
    "semicolons": ("f.csv", COLUMNS.replace(",", ";"), ONE),
    "tabs": ("f.csv", COLUMNS.replace(",", "\t"), ONE),
    "decimal commas": ("f.csv", COLUMNS.replace(",", ";").replace(".", ","), ONE),
    "decimal commas, tabs": ("f.csv", COLUMNS.replace(",", "\t").replace(".", ","), ONE),
    "UTF-16": ("f.csv", COLUMNS.encode("utf-16"), ONE),
    "blank lines between": ("f.csv", COLUMNS.replace("\n", "\r\r\n"), ONE),
    "empty rows of a spreadsheet": ("f.csv", COLUMNS + ",\n" * 3, ONE),
    "OpenFace": ("f.csv", wide(FACES), FACES),
    "with z": ("f.csv", table(np.hstack([ONE[0], DEPTH[0]]), "x,y,z"), ONE),
    "coordinates first": ("f.npy", FACES.swapaxes(1, 2), FACES),
    "coordinates first, depth": ("f.npy", np.dstack([FACES, DEPTH])[1].T, FACES[1:2]),
    "TensorFlow.js": ("f.json", json.dumps([{"box": {}, "keypoints": f} for f in named(ONE)]), ONE),
    "columns": ("f.csv", table(ONE[0], "x,y"), ONE),
    "comments, empty lines": ("f.csv", f'# a, "b" c\n\n{table(ONE[0], "x,y")}\n\n', ONE),
    "capitals, Windows, BOM": (
        "F.CSV",
        b"\xef\xbb\xbf" + table(ONE[0], "X , Y").replace("\n", "\r\n").encode(),
        ONE,
    ),
    "many faces": ("f.csv", table(long_rows(), "face,number,x,y"), FACES),
    "beside the shape": (
        "f.csv",
        table([(1, 2, 3, *point) for point in ONE[0]], "x,y,z,image_x,image_y"),
        ONE,
    ),
    "array": ("f.npy", FACES, FACES),
    "array of one": ("f.npy", ONE[0], ONE),
    "array with depth": ("f.npy", np.dstack([FACES, DEPTH]), FACES),
    "array of other bytes": ("f.npy", np.asfortranarray(FACES.astype(">f8")), FACES),
    "points of 300-W": ("f.pts", pts(ONE[0] + 0.5), ONE),
    "JSON": ("f.json", json.dumps(ONE[0].tolist()), ONE),
    "JSON of faces": ("f.json", json.dumps(FACES.tolist()), FACES),
    **{
        f"JSON with {faces}, {face}": (
            "f.json",
            json.dumps({faces: [{face: points, "name": "a"} for points in named(FACES)]}),
            FACES,
        )
        for faces, face in (
            *(("faces", "landmarks"), ("multi_face_landmarks", "landmark")),
            *(("face_landmarks", "faceLandmarks"), ("multiFaceLandmarks", "keypoints")),
        )
    },
}


@pytest.mark.parametrize("layout", LAYOUTS)
def test_every_layout_gives_the_same_numbers(tmp_path, layout):
    name, content, expected = LAYOUTS[layout]
    points = read_landmarks(written(tmp_path, name, content))
    assert points.dtype == float
    np.testing.assert_allclose(points, expected, rtol=1e-12)


@pytest.mark.parametrize("n", face_sizes())
def test_every_number_of_landmarks_is_read_and_y_turned_down_if_asked_for(tmp_path, n):
    faces = np.random.default_rng(n).uniform(1, 500, size=(2, n, 2))
    path = written(tmp_path, "f.npy", faces)
    assert np.array_equal(read_landmarks(path), faces)
    assert np.array_equal(read_landmarks(path, y_up=True), faces * [1, -1])
    assert np.array_equal(np.load(path), faces)


def test_faces_called_like_missing_values_stay_apart(tmp_path):
    rows = [("null", *r[1:]) if r[0] == "face 1" else r for r in long_rows()]
    points = read_landmarks(written(tmp_path, "f.csv", table(rows, "face,number,x,y")))
    np.testing.assert_allclose(points, FACES, rtol=1e-12)


@pytest.mark.parametrize("n", [468, 478])
@pytest.mark.parametrize("key", [None, "faceLandmarks"])
def test_fractions_of_mediapipe_become_pixels(tmp_path, n, key):
    faces = np.random.default_rng(n).uniform(0, 1.1, (2, n, 3))
    every = named(faces)
    for content, expected in ((every, faces), (every[0], faces[:1]), (every[:1], faces[:1])):
        path = written(tmp_path, "f.json", json.dumps({key: content} if key else content))
        points = read_landmarks(path, image_size=(640, 480))
        np.testing.assert_allclose(points, expected[..., :2] * (640, 480))
    with pytest.raises(InputError, match="or pass --image-size W H. .* multiply x by its width"):
        read_landmarks(path)


@pytest.mark.parametrize("size", [1920, (1080,), (1920, 0), (1920, -1080), (1, np.nan), "1x2"])
def test_what_is_no_image_size_is_refused(tmp_path, size):
    with pytest.raises(InputError, match="image_size must be"):
        read_landmarks(written(tmp_path, "f.npy", FACES / 1000), image_size=size)


def test_an_image_size_for_pixels_is_refused_and_small_units_about_a_middle_are_not(tmp_path):
    with pytest.raises(InputError, match=r"up to 4.*: omit --image-size"):
        read_landmarks(written(tmp_path, "f.npy", FACES), image_size=(640, 480))
    small = (FACES - FACES.mean(1, keepdims=True)) / 1000
    path = written(tmp_path, "f.npy", small)
    np.testing.assert_array_equal(read_landmarks(path), small)


@pytest.mark.parametrize("n", [51, 68])
def test_fractions_of_a_wide_image_are_not_taken_for_pixels(tmp_path, n):
    """Some points may lie beyond the image."""
    fractions = FACES[:, :n] / (1920, 1080) - (0, 0.05)
    path = written(tmp_path, "f.npy", fractions)
    with pytest.raises(InputError, match="or pass --image-size W H"):
        read_landmarks(path)
    in_pixels = read_landmarks(path, image_size=(1920, 1080))
    np.testing.assert_allclose(in_pixels, fractions * (1920, 1080))


@pytest.mark.parametrize("stray", [2.5, 50])
def test_a_stray_coordinate_does_not_make_pixels_of_fractions(tmp_path, stray):
    fractions = FACES / (1920, 1080)
    fractions[1, 9, 0] = stray
    path = written(tmp_path, "f.npy", fractions)
    with pytest.raises(InputError, match="or pass --image-size W H"):
        read_landmarks(path)
    points, faults, _ = read_faces(path, image_size=(1920, 1080))
    assert faults == {1: f"must have fractions of the image. Received {stray:g}"}
    assert np.isnan(points[1]).all()
    np.testing.assert_allclose(points[[0, 2]], FACES[[0, 2]])


def test_unusable_faces_are_named_in_order_whatever_their_fault(tmp_path):
    fractions = np.repeat(FACES / 1000, 3, 0)
    fractions[2, 0], fractions[7] = 5, 0.5
    path = written(tmp_path, "f.npy", fractions)
    assert [*read_faces(path, image_size=(640, 480))[1]] == [2, 7]


@pytest.mark.parametrize("narrow", [1e-2, 1e-3, 1e-4, 1e-6, 1e-8])
@pytest.mark.parametrize("missing", [0, 30])
def test_a_face_is_a_gap_exactly_if_the_lifter_would_refuse_it(tmp_path, narrow, missing):
    faces = FACES[:, 17:].copy()
    faces[1] = (faces[1] - 250) * (1, narrow) @ ((0.6, 0.8), (-0.8, 0.6)) + 250
    faces[1, :missing] = np.nan
    points, faults, _ = read_faces(written(tmp_path, "f.npy", faces))
    try:
        prepare_views(faces, 51)
    except InputError:
        assert [*faults] == [1] and "on one line" in faults[1]
    else:
        assert not faults
    prepare_views(points[~np.isnan(points).all((1, 2))], 51)


GAPS = np.concatenate([FACES[:1] * np.nan, FACES, FACES[:2] * np.nan])
NULLS = [None, *FACES.tolist(), None, None]
WITH_GAPS = {
    "array": ("f.npy", GAPS),
    "frames without success": (
        "f.csv",
        wide(np.nan_to_num(GAPS, nan=5.0), (*[0, 1, 1, 1, 0], "0.0")),
    ),
    "table of NaN": ("f.csv", table(long_rows(GAPS), "face,number,x,y")),
    "empty cells": ("f.csv", table(long_rows(GAPS), "face,number,x,y").replace("nan", "") + "\n\n"),
    "JSON of NaN": ("f.json", json.dumps(GAPS.tolist())),
    "JSON of null": ("f.json", json.dumps(NULLS)),
    "records": ("f.json", json.dumps({"faces": [{"landmarks": face} for face in NULLS]})),
}


@pytest.mark.parametrize("layout", WITH_GAPS)
def test_faces_of_nan_are_gaps_and_stay_in_their_place(tmp_path, layout):
    name, content = WITH_GAPS[layout]
    points, faults, _ = read_faces(written(tmp_path, name, content))
    np.testing.assert_allclose(points, GAPS, rtol=1e-12)
    assert faults == {}


def test_faces_that_cannot_be_used_are_named_and_the_others_read(tmp_path):
    faces = np.repeat(FACES, 3, 0)
    faces[1, 5:, 0], faces[3], faces[4, :, 1], faces[6, 0] = np.nan, 7, 2, 1e12
    points, faults, _ = read_faces(written(tmp_path, "f.npy", faces))
    expected = {
        1: "at least 6 landmarks. Received 5",
        3: "all 68 landmarks coincide",
        4: "on one line",
        6: "1e+12, ",
    }
    assert [*faults] == [*expected]
    assert all(text in faults[face] for face, text in expected.items())
    good = np.isin(np.arange(9), [*expected], invert=True)
    np.testing.assert_array_equal(points[good], faces[good])
    assert np.isnan(points[~good]).all()
    for cell, text in (("12 px", "text"), ("inf", "infinity"), ("1e400", "inf")):
        rows = long_rows()
        rows[70] = (*rows[70][:2], cell, rows[70][3])
        points, faults, _ = read_faces(written(tmp_path, "f.csv", table(rows, "face,number,x,y")))
        assert [*faults] == [1] and text in faults[1] and "landmark 3 of 68" in faults[1]
        np.testing.assert_allclose(points[[0, 2]], FACES[[0, 2]], rtol=1e-12)


def test_landmarks_may_be_missing(tmp_path):
    rows, faces, records = long_rows(), FACES.tolist(), FACES.tolist()
    rows[70] = (*rows[70][:2], "", rows[70][3])
    faces[1][2], records[1][2] = None, [None, None]  # as `deepmds predict` writes it
    for name, content in (
        ("f.csv", table(rows, "face,number,x,y")),
        ("f.csv", table(rows, "face,number,x,y").replace(",,", ",NA,")),
        ("f.json", json.dumps(faces)),
        ("f.json", json.dumps({"faces": [{"landmarks": face} for face in records]})),
    ):
        points, faults, _ = read_faces(written(tmp_path, name, content))
        missing = np.isnan(points).all(2)
        assert not faults and np.argwhere(missing).tolist() == [[1, 2]]
        np.testing.assert_allclose(points[~missing], FACES[~missing], rtol=1e-12)


def test_the_last_landmarks_may_be_missing(tmp_path):
    """51 rows with numbers and 17 without are 68 landmarks, not 51."""
    content = "x,y\n" + table(ONE[0, :51]) + ",\n" * 17
    points = read_landmarks(written(tmp_path, "f.csv", content))
    assert points.shape == (1, 68, 2) and np.isnan(points[0, 51:]).all()


def test_landmarks_that_were_not_seen_stay_missing(tmp_path):
    """Their places in a table of this program are estimates, and have no residual."""
    rows = [(*point, "nan" if 36 <= i < 48 else 0.1) for i, point in enumerate(ONE[0])]
    content = table(rows, "image_x,image_y,residual")
    missing = np.isnan(read_landmarks(written(tmp_path, "f.csv", content))[0]).all(1)
    assert np.flatnonzero(missing).tolist() == [*range(36, 48)]


@pytest.mark.parametrize("layout", ["array with depth", "with z", "coordinates first, depth"])
def test_a_coordinate_that_is_not_used_is_named(tmp_path, layout):
    name, content, _ = LAYOUTS[layout]
    assert "z of the landmarks is not used" in read_faces(written(tmp_path, name, content))[2][0]
    assert read_faces(written(tmp_path, "g.npy", FACES))[2] == []


REFUSED = {
    "two faces of 300-W": ("f.pts", 2 * pts(ONE[0]), "must hold one face. Received several"),
    "columns twice": ("f.csv", table(np.ones((68, 4)), "x,y,x,y"), "each once"),
    "one axis longer": (
        "f.csv",
        wide(FACES).replace("y_67", "y_x"),
        "equally many columns of each",
    ),
    "two keys": ("f.json", '{"faces": [], "landmarks": []}', "Received faces and landmarks"),
    "millimetres alone": (
        "f.csv",
        wide(FACES).replace(" x_", " u_").replace(" y_", " v_"),
        "with columns x, y;",
    ),
    "points instead of commas": (
        "f.csv",
        COLUMNS.replace(",", ";").replace(".", ",5."),
        "text or infinity in landmark 1",
    ),
    "no header": ("f.csv", table(ONE[0]), "a header with columns x, y; save numbers without"),
    "other names": ("f.csv", table(ONE[0], "a,b"), "Received the first line 'a,b'"),
    "cells more": (
        "f.csv",
        table(np.ones((68, 3)), "x,y"),
        "2 cells per row.* Received 3 in row 1",
    ),
    "faces not named": (
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
    "no such format": ("f.txt", table(ONE[0]), "must end in .csv"),
    "infinity": (
        "f.npy",
        np.where(FACES[1, 5, 0] == FACES, np.inf, FACES),
        "face 2 of 3, must .*landmark 6 of 68",
    ),
    "only gaps": ("f.npy", FACES * np.nan, "only gaps"),
    "huge numbers": ("f.npy", FACES * 1e200, "below 1e"),
    "wrong count": ("f.npy", FACES[:, :5], "51, 68, 72, 468 or 478 landmarks per face. Received 5"),
    "no faces": ("f.npy", FACES[:0], "at least one face. Received none"),
    "JSON without faces": ("f.json", '{"faceLandmarks": []}', "at least one face. Received none"),
    "axes swapped": ("f.npy", FACES.transpose(1, 2, 0), "landmarks per face. Received 2"),
    "complex": ("f.npy", FACES + 1j, "complex"),
    "text as array": ("f.npy", np.full((68, 2), "1"), "numbers. Received dtype"),
    "a line": ("f.npy", np.outer(np.arange(68.0), [1, 2]), "on one line"),
    "no array": ("f.npy", "version", "NumPy's format"),
    "points miscounted": ("f.pts", pts(ONE[0]).replace("  68", " 67"), "states, 67. Received 68"),
    "points too many": ("f.pts", pts(np.ones((194, 2))), "Received 194"),
    "JSON ragged": ("f.json", "[[1, 2], [3]]", "rows of unequal lengths"),
    "JSON ragged in one face": ("f.json", "[[[1, 2], [3]]]", "rows of unequal lengths"),
    "JSON with null": ("f.json", json.dumps([[1, None]] * 68), "only gaps"),
    "JSON without landmarks": ("f.json", '{"points": []}', "keys faces, landmarks"),
    "JSON record without": ("f.json", '{"faces": [{"name": 1}]}', "Received none of them"),
    "JSON of null": ("f.json", "[null, [null]]", "only null"),
}


@pytest.mark.parametrize("fault", REFUSED)
def test_a_bad_file_gets_one_line_that_names_it_and_the_fault(tmp_path, fault):
    name, content, message = REFUSED[fault]
    with pytest.raises(InputError, match=message) as caught:
        read_landmarks(written(tmp_path, name, content))
    message = str(caught.value)
    assert message.startswith((f"{tmp_path / name} ", f"{tmp_path / name}, face "))
    assert "\n" not in message
    assert len(message) < len(str(tmp_path)) + 250


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
