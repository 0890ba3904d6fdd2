"""Pictures of faces: the landmarks where the photo has them, any name, bounded in size."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from faces import mean_landmarks

from deepmds_keras.geometry.camera import head_pose
from deepmds_keras.geometry.units import normalise
from deepmds_keras.tool.command.overlay import cut_out, overlay
from deepmds_keras.tool.predict.faces import Face


@pytest.fixture(scope="module")
def face():
    shape = normalise(mean_landmarks("bfm72"))
    view = 400 * shape[:, :2] + (300, -700)
    photo = Path("photo.jpg")
    pose = head_pose(view, shape)
    return Face("photo", photo, photo, "bfm72", view * (1, -1), shape, "normalised", pose)


def is_near(picture, points, colour):
    """Which points have a pixel of about this colour next to them."""
    near = (np.abs(np.asarray(picture).astype(int) - colour) < 40).all(-1)
    return np.array([near[y - 3 : y + 4, x - 3 : x + 4].any() for x, y in points.astype(int)])


def test_dots_lie_on_the_landmarks_and_lines_on_the_shape(face):
    wide = replace(face, xyz=face.xyz * (1.3, 1, 1))
    picture = overlay([wide], np.zeros((900, 700, 3), np.uint8))
    photo = np.zeros((900, 700, 3), np.uint8)
    cutout = cut_out(photo, wide.landmarks_3d[:, :2], side=1200, least=600)
    assert is_near(picture, cutout.place(wide.landmarks), (255, 208, 0)).all()
    assert is_near(picture, cutout.place(wide.seen_shape), (255, 148, 72)).mean() > 0.8


def test_a_small_face_is_shown_large_and_beside_it_from_another_side(face):
    pose = replace(face.pose, scale=face.pose.scale / 8, translation=face.pose.translation / 8)
    small = replace(face, landmarks=face.landmarks / 8, pose=pose)
    picture = np.asarray(overlay([small], np.zeros((200, 200, 3), np.uint8)))
    assert picture.shape[1] == 2 * picture.shape[0] >= 1000
    for half, least in zip(np.split(picture, 2, axis=1), (0.35, 0.7), strict=True):
        rows, _ = np.nonzero((half == (255, 208, 0)).all(-1))
        assert np.ptp(rows) > least * len(picture)
    flat = replace(small, xyz=small.xyz * (1, 1, 0))
    other = np.asarray(overlay([flat], np.zeros((200, 200, 3), np.uint8)))
    assert (other != picture)[:, len(picture) :].any(), "where depth shows"


def test_all_faces_of_a_photo_are_in_its_picture_and_it_is_no_larger_than_needed(face):
    photo = np.zeros((3000, 4000, 3), np.uint8)
    faces = [replace(face, landmarks=face.landmarks + (x, 0),
                     pose=replace(face.pose, translation=face.pose.translation + (x, 0)))
             for x in (0, 3000)]  # fmt: skip
    one, two = (overlay(some, photo) for some in (faces[:1], faces))
    assert two.size == (1200 + two.height // 2, two.height) and two.height < 1200
    left, right = np.split(np.asarray(two)[:, :1200], 2, axis=1)
    assert (left == (255, 208, 0)).all(-1).any() and (right == (255, 208, 0)).all(-1).any()
    assert one.height == 600


def test_without_a_photo_each_face_has_two_tiles(face):
    faces = [replace(face, photo=None, landmarks=face.landmarks + 1000 * i) for i in range(8)]
    faces[1].landmarks[5] = np.nan  # missing
    picture = np.asarray(overlay(faces, None))
    tiles = [tile for row in np.split(picture, 3) for tile in np.split(row, 6, axis=1)]
    assert [bool((tile < 250).any()) for tile in tiles] == [True] * 16 + [False] * 2


@pytest.mark.parametrize("name", ["a$b", "顔\udcff\n<b>", "long" * 60])
def test_any_name_can_be_drawn_and_equal_faces_give_equal_pictures(face, name):
    assert overlay([replace(face, name=name)], None) == overlay([replace(face, name=name)], None)
