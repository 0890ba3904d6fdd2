"""Flipped axes are distinguished from faces that lean, turn or nod."""

import numpy as np
import pytest
from faces import cameras, mean_landmarks

from deepmds_keras.errors import InputError
from deepmds_keras.geometry.views import project
from deepmds_keras.landmarks import convert, load_scheme
from deepmds_keras.landmarks.y_axis import check_y_axis, quarter_turns

DOWN = np.array((1, -1))


def seen(yaw=0.0, pitch=0.0, roll=0.0, scheme="bfm72", field_of_view=0.0):
    """The open head's landmarks in an image, `(n, L, 2)`: x right, y down."""
    seen_by = cameras(yaw, pitch, roll, field_of_view)
    return project(np.stack([mean_landmarks(scheme)] * len(seen_by)), seen_by) * DOWN


@pytest.mark.parametrize("scheme", ["bfm72", "ibug68", "ibug51"])
def test_faces_that_lean_turn_and_nod_pass(scheme):
    angles = np.meshgrid(np.linspace(-90, 90, 13), np.linspace(-40, 40, 5), np.arange(-60, 61, 30))
    yaw, pitch, roll = (angle.ravel() for angle in angles)
    check_y_axis(seen(yaw, pitch, roll, scheme), scheme, "views")
    check_y_axis(seen(yaw, pitch, roll, scheme, 40.0), scheme, "views")
    from_behind = seen(yaw=np.array((-100.0, 100.0)), scheme=scheme)
    check_y_axis(from_behind, scheme, "views")


@pytest.mark.parametrize("scheme", ["bfm72", "ibug68", "ibug51"])
def test_y_that_grows_upwards_is_refused_at_any_turn(scheme):
    angles = np.meshgrid(np.linspace(-90, 90, 7), (-20, 0, 20), np.arange(-60, 61, 30))
    for face in seen(*(angle.ravel() for angle in angles), scheme) * DOWN:
        with pytest.raises(InputError, match="a.csv: y must point down; pass --y-up"):
            check_y_axis(face, scheme, "a.csv")


def test_a_mirrored_face_is_refused_unless_it_is_nearly_in_profile():
    for yaw in (-60, 0, 45):
        for roll in (-60, 0, 60):
            mirrored = seen(yaw, 0, roll) * (-1, 1)
            swapped = seen(yaw, 0, roll)[:, load_scheme("bfm72").mirror]
            for faces in (mirrored, swapped):
                with pytest.raises(InputError, match="a.csv: x must .* swap right.*a mirrored"):
                    check_y_axis(faces, "bfm72", "a.csv")


def test_a_face_turned_by_180_degrees_is_no_matter_of_axes():
    for roll in (140, 180, 220):
        with pytest.raises(InputError, match="a.csv: the face must be upright; turn it"):
            check_y_axis(seen(roll=roll), "bfm72", "a.csv")


def test_a_batch_is_judged_by_its_majority():
    odd = np.concatenate([seen(), seen(yaw=30), seen() * DOWN, seen() * DOWN])
    assert [*check_y_axis(odd, "bfm72", "a.npy")] == [2, 3]
    with pytest.raises(InputError, match="a.npy, face 3 of 5: y must"):
        check_y_axis(np.concatenate([odd, seen() * DOWN]), "bfm72", "a.npy")


def test_size_and_place_of_the_face_do_not_matter():
    for scale, shift in ((1e-3, 0.0), (1e3, -5e4)):
        check_y_axis(seen(roll=50) * scale + shift, "bfm72", "a.csv")
        with pytest.raises(InputError, match="--y-up"):
            check_y_axis(seen(roll=50) * DOWN * scale + shift, "bfm72", "a.csv")


def test_points_of_mediapipe_are_judged_by_those_that_are_ibugs():
    points = convert(seen(scheme="ibug51"), "ibug51", "mediapipe", missing="nan")
    points = np.concatenate([points, np.full((1, 10, 2), np.nan)], 1)  # with irises
    check_y_axis(points, "mediapipe", "a.npy")
    with pytest.raises(InputError, match="--y-up"):
        check_y_axis(points * DOWN, "mediapipe", "a.npy")


def test_faces_without_all_of_eyes_and_mouth_are_not_judged_but_those_without_a_jaw_are():
    faces = np.concatenate([seen() * DOWN, seen()])
    faces[0, 3] = np.nan
    check_y_axis(faces, "bfm72", "a.npy")
    jawless = seen(scheme="ibug68")
    jawless[:, :17] = np.nan
    check_y_axis(jawless, "ibug68", "a.npy")
    assert quarter_turns(jawless[..., ::-1] * DOWN, "ibug68").tolist() == [-1]
    with pytest.raises(InputError, match="--y-up"):
        check_y_axis(jawless * DOWN, "ibug68", "a.npy")


def test_quarter_turns_bring_faces_upright():
    rolls = np.array((0, 40, -40, 50, 90, 130, -50, -90, -130, 180))
    turns = quarter_turns(seen(roll=rolls), "bfm72")
    # A head that leans to its own right has turned to the left in the image.
    np.testing.assert_array_equal(turns % 4, np.array((0, 0, 0, -1, -1, -1, 1, 1, 1, 2)) % 4)
    nodding = seen(np.array((-80, 0, 80)), np.array((30, -40, -30)), 0)
    assert not quarter_turns(nodding, "bfm72").any()
    assert not quarter_turns(np.full((1, 72, 2), np.nan), "bfm72").any()
