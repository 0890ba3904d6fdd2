"""Faces are followed: each keeps its number while it moves, and nobody takes another's."""

import numpy as np
import pytest

from deepmds_keras.video.following import follow_faces

FACE = np.random.default_rng(0).uniform(0, 100, (51, 2))
RATE = 25


def at(*places):
    """Faces of about 100 pixels, each moved to the right by so many pixels."""
    return np.stack([FACE + (x, 0) for x in places]) if places else np.zeros((0, 51, 2))


def times(n):
    return np.arange(n) / RATE


def test_two_faces_that_pass_each_other_in_turns_of_order_keep_their_numbers():
    left, right = np.linspace(0, 150, 40), np.linspace(400, 250, 40)
    frames = [
        at(a, b) if i % 3 else at(b, a) for i, (a, b) in enumerate(zip(left, right, strict=True))
    ]
    tracks = follow_faces(frames, times(40))
    for i, numbers in enumerate(tracks):
        assert list(numbers) == ([2, 1] if i % 3 else [1, 2])


def test_the_nearest_pairs_win_though_the_first_face_could_take_another():
    """Of all pairs the second number and the first face are nearest; not of both pairs together."""
    tracks = follow_faces([at(0, 60), at(35, 95)], times(2))
    assert [list(numbers) for numbers in tracks] == [[1, 2], [1, 2]]


@pytest.mark.parametrize(("lost", "expected"), [(20, 1), (30, 2)])
def test_a_face_that_is_lost_for_less_than_a_second_keeps_its_number(lost, expected):
    frames = [at(0), *[at()] * lost, at(10)]
    tracks = follow_faces(frames, times(len(frames)))
    assert [len(t) for t in tracks] == [1, *[0] * lost, 1]
    assert tracks[-1] == [expected]


def test_of_frames_seconds_apart_the_one_before_counts():
    assert [list(t) for t in follow_faces([at(0), at(20), at(40)], [0, 3, 6])] == [[1], [1], [1]]


def test_somebody_elsewhere_or_of_another_size_is_somebody_else():
    assert follow_faces([at(0), at(150)], times(2))[1] == [2]
    assert follow_faces([at(0), 5 * at(0)], times(2))[1] == [2]
    numbers = follow_faces([at(0), at(0, 300), at(300, 600)], times(3))
    assert [list(t) for t in numbers] == [[1], [1, 2], [2, 3]]


def test_the_unit_of_the_landmarks_does_not_matter():
    frames = [at(0, 300), at(310, 10), at(20, 500)]
    small = follow_faces([1e-3 * faces for faces in frames], times(3))
    assert [list(t) for t in follow_faces(frames, times(3))] == [list(t) for t in small]
    assert follow_faces([], []) == []
