"""A scheme that tables alone describe is converted, read, judged and drawn like the others."""

import shutil

import numpy as np
import pytest

from deepmds_keras import InputError, landmarks
from deepmds_keras.landmarks import load_scheme, load_schemes
from deepmds_keras.landmarks.conversion import convert, scheme_of
from deepmds_keras.landmarks.y_axis import check_y_axis
from deepmds_keras.predict.landmark_files import read_landmarks
from deepmds_keras.predict.outputs import wireframe_edges

TABLES = {
    "five.csv": """number,name,group,mirror
1,right_eye_outer_corner,right_eye,2
2,left_eye_outer_corner,left_eye,1
3,nose_tip,nose,3
4,right_mouth_corner,outer_mouth,5
5,left_mouth_corner,outer_mouth,4
""",
    "five_polylines.csv": "polyline,landmarks\n1,1-3-2\n2,4-5\n",
    "five_ibug68.csv": "number,ibug68\n1,37\n2,46\n3,31\n4,49\n5,55\n",
}
FACE = np.array([(10.0, 20.0), (50.0, 21.0), (30.0, 40.0), (18.0, 60.0), (42.0, 61.0)])


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """The tables of the package and those of a scheme of 5 landmarks."""
    folder = shutil.copytree(landmarks.FOLDER, tmp_path / "landmarks")
    for name, text in TABLES.items():
        (folder / name).write_text(text)
    with (folder / "schemes.csv").open("a") as file:
        file.write("five,five,1,5,\n")
    monkeypatch.setattr(landmarks, "FOLDER", folder)
    load_schemes.cache_clear()
    yield folder
    load_schemes.cache_clear()


def test_its_landmarks_are_picked_out_of_other_schemes_and_put_into_them(folder):
    assert scheme_of(5) == "five"
    ibug68 = np.random.default_rng(0).random((3, 68, 2))
    expected = ibug68[:, [36, 45, 30, 48, 54]]
    np.testing.assert_array_equal(convert(ibug68, "ibug68", "five"), expected)
    np.testing.assert_array_equal(
        convert(expected, "five", "ibug51", missing="nan")[:, [19, 28, 13, 31, 37]], expected
    )
    assert not np.isnan(convert(np.zeros((478, 3)), "mediapipe", "five")).any()
    with pytest.raises(InputError, match=r"landmarks without 63 of the 68: 1-30, 32-36"):
        convert(expected, "five", "ibug68")


@pytest.mark.parametrize("name", ["face.npy", "rows.csv", "face.csv", "face.pts", "face.json"])
def test_files_of_its_landmarks_are_read(folder, name):
    path = folder / name
    points = [f"{x} {y}" for x, y in FACE]
    if name == "face.npy":
        np.save(path, FACE)
    elif name == "face.pts":
        path.write_text("\n".join(["{", *(f"{x + 0.5} {y + 0.5}" for x, y in FACE), "}"]))
    elif name == "face.json":
        path.write_text(str(FACE.tolist()))
    else:
        path.write_text((" " if name == "rows.csv" else "\n").join(points))
    np.testing.assert_array_equal(read_landmarks(path), FACE[None])


def test_its_faces_are_judged_and_drawn(folder):
    check_y_axis(FACE, "five", "face.csv")
    with pytest.raises(InputError, match="face.csv: y must grow downwards"):
        check_y_axis(FACE * (1, -1), "five", "face.csv")
    scheme = load_scheme("five")
    assert scheme.index("nose_tip") == 2
    assert wireframe_edges(scheme).tolist() == [[0, 2], [1, 2], [3, 4]]


@pytest.mark.parametrize(
    ("name", "old", "new", "received"),
    [
        ("schemes.csv", "five,five,1,5,", "five,five,1,6,", "numbers other than 1 to 6"),
        ("five.csv", "nose,3", "nose,7", "KeyError: 7"),
        ("five_ibug68.csv", "3,31", "3,tip", "'tip'"),
        ("five_polylines.csv", "4-5", "4-five", "'five'"),
    ],
)
def test_tables_that_do_not_fit_are_refused_with_the_scheme(folder, name, old, new, received):
    path = folder / name
    path.write_text(path.read_text().replace(old, new))
    with pytest.raises(InputError, match=f"tables of the scheme five in .*{received}"):
        load_schemes()
