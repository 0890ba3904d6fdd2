"""What a surface hides from its viewer."""

import numpy as np

from data_gen.views.hidden import hidden_landmarks


def plates(gap):
    """A small square in front of a large one, and points on the large one."""
    square = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], float)
    front, back = 10 * square + (0, 0, gap), 40 * square
    points = np.array([[5, 5, 0], [-9, 2, 0], [15, 0, 0], [0, -30, 0]], float)
    triangles = np.array([[0, 1, 2], [0, 2, 3]])
    return np.concatenate([front, back, points]), np.concatenate([triangles, triangles + 4])


def test_what_is_behind_a_surface_is_hidden():
    points, triangles = plates(30)
    hidden = hidden_landmarks(points, triangles, np.arange(12))
    assert hidden.tolist() == [False] * 8 + [True, True, False, False]


def test_what_is_in_front_or_little_behind_is_seen():
    for gap in (-30, 1.5):
        points, triangles = plates(gap)
        assert not hidden_landmarks(points, triangles, np.arange(8, 12)).any()
    assert hidden_landmarks(points, triangles, np.arange(8, 12), behind=1).any()


def test_triangles_seen_edge_on_hide_nothing():
    points, triangles = plates(30)
    points[:4] = points[:4][:, [2, 1, 0]] * (0, 1, 1) + (5, 0, 100)
    assert not hidden_landmarks(points, triangles, np.array([8])).any()
