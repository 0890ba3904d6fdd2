"""Schemes of other objects: a table gives names, pairs and lines; contradictions are named."""

import numpy as np
import pytest

from deepmds_keras import InputError, convert, load_scheme
from deepmds_keras.landmarks import unnamed
from deepmds_keras.landmarks.y_axis import check_y_axis

STOOL = """# of a stool
number,name,mirror
3,front_right_leg,4
4,front_left_leg,3
5,back_leg,
6,seat,6
"""


@pytest.fixture
def stool(tmp_path):
    """Writes the table, perhaps changed, its lines and points of iBUG; gives its path."""

    def write(old="", new="", lines="1,3-6-4\n2,5-6\n", ibug68=None):
        path = tmp_path / "stool.csv"
        path.write_text(STOOL.replace(old, new) if old else STOOL)
        (tmp_path / "stool_polylines.csv").write_text("polyline,landmarks\n" + lines)
        if ibug68:
            (tmp_path / "stool_ibug68.csv").write_text(ibug68)
        return path

    return write


def test_a_table_gives_numbers_names_pairs_and_lines(stool):
    scheme = load_scheme(stool())
    assert scheme.numbers == (3, 4, 5, 6) and scheme.names[3] == "seat" and not scheme.is_face
    assert scheme.mirror.tolist() == [1, 0, 2, 3] and scheme.polylines == ((0, 3, 1), (2, 3))
    assert load_scheme(scheme.name) is scheme
    points = np.random.default_rng(0).random((5, 4, 2))
    assert np.array_equal(convert(points, scheme.name, scheme.name), points)
    assert check_y_axis(points * (1, -1), scheme.name, "points") == {}


def test_a_table_that_was_changed_is_read_again(stool):
    before = load_scheme(stool())
    after = load_scheme(stool("back_leg", "rear_leg"))
    assert (before.names[2], after.names[2]) == ("back_leg", "rear_leg")


def test_a_table_with_points_of_ibug_is_a_face_and_converts(stool):
    path = stool(ibug68="number,ibug68\n3,37\n4,46\n5,31\n6,58\n")
    assert load_scheme(path).is_face
    points = np.random.default_rng(0).random((2, 68, 2))
    np.testing.assert_array_equal(convert(points, "ibug68", str(path)), points[:, [36, 45, 30, 57]])


def test_corners_of_the_eyes_are_found_by_their_points_of_ibug(stool):
    with pytest.raises(InputError, match="iBUG's landmarks 37 and 46. Received .*stool.csv"):
        load_scheme(stool()).eye_corners()
    assert load_scheme(stool(ibug68="number,ibug68\n4,37\n3,46\n")).eye_corners() == (1, 0)
    names = load_scheme("bfm72").names
    corners = [names.index(f"{side}_eye_outer_corner") for side in ("right", "left")]
    assert load_scheme("bfm72").eye_corners() == tuple(corners)


@pytest.mark.parametrize(
    ("name", "n", "last", "face"),
    [(unnamed(14), 14, "landmark_14", False), ("mediapipe", 468, "landmark_467", True)],
)
def test_landmarks_without_names_are_named_by_their_numbers(name, n, last, face):
    scheme = load_scheme(name)
    assert len(scheme) == len(scheme.names) == len(scheme.groups) == n
    assert scheme.names[-1] == last and scheme.is_face is face
    assert scheme.polylines == () and scheme.mirror.tolist() == [*range(n)]


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"old": "5,back", "new": "7,back"}, r"consecutive numbers. Received \[3, 4, 7, 6\]"),
        ({"old": "seat", "new": "back_leg"}, "a different name. Received back_leg again for"),
        ({"old": "seat", "new": ""}, "each landmark a different name. Received none for"),
        (
            {"old": "left_leg,3", "new": "left_leg,5"},
            "mirror, each with the other. Received 4 for .* 3",
        ),
        (
            {"old": "number,name", "new": "id,name"},
            "columns number and name.* Received KeyError: 'number'",
        ),
        ({"old": "3,front", "new": "three,front"}, "columns number and name.* Received ValueError"),
        ({"old": STOOL.partition("mirror\n")[2]}, "consecutive"),
        ({"lines": "1\n"}, "values such as 1-2-3"),
        ({"lines": "1,3-9\n"}, "_polylines.csv must join .* Received 9, which"),
        ({"ibug68": "number,ibug\n3,37\n"}, "number and ibug68. Received KeyError: 'ibug68'"),
        (
            {"ibug68": "number,ibug68\n9,37\n"},
            "_ibug68.csv must have a different number .* from 3 to 6",
        ),
        (
            {"ibug68": "number,ibug68\n3,69\n"},
            "_ibug68.csv must have a different ibug68 .* from 1 to 68",
        ),
        ({"ibug68": "number,ibug68\n3,37\n4,37\n"}, r"different ibug68 .* \[37, 37\]"),
    ],
)
def test_tables_that_contradict_each_other_are_refused(stool, changes, message):
    with pytest.raises(InputError, match=f"stool.*{message}"):
        load_scheme(stool(**changes))


def test_what_is_neither_a_scheme_nor_a_table_is_refused(tmp_path):
    with pytest.raises(InputError, match="none.csv must be a table"):
        load_scheme(tmp_path / "none.csv")
    for name in ("stool", "unnamed-0", ".", "..", "/"):
        with pytest.raises(InputError, match=rf"or your own table \(CSV\). Received '{name}'"):
            load_scheme(name)
