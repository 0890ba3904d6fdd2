"""Faces of all sizes, by a made-up detector that sees only large ones."""

import numpy as np
import pytest
from scipy.ndimage import find_objects, label

from deepmds_keras.tool.detection.small_faces import find_faces


def detector(lowest=0.1, score=0.9):
    """Finds the white squares whose side is at least a tenth of what it is given."""

    def find_boxes(image):
        squares = find_objects(label(image[..., 0] == 255)[0])
        boxes = [(x.start, y.start, x.stop, y.stop, score) for y, x in squares]
        seen = [b for b in boxes if b[2] - b[0] >= lowest * max(image.shape[:2])]
        return np.array(seen, float).reshape(-1, 5)

    def find(image):
        boxes = find_boxes(image)
        corners = np.stack([boxes[:, [0, 1]], boxes[:, [2, 3]]], axis=1)
        return np.concatenate([corners, 0 * corners[..., :1]], 2), boxes[:, 4]

    return find, find_boxes


def white_squares(*squares, shape=(1200, 1600, 3)):
    image = np.zeros(shape, np.uint8)
    for left, top, side in squares:
        image[top : top + side, left : left + side] = 255
    return image


@pytest.mark.parametrize("size", [1, 3])
def test_large_and_small_faces_are_found_once_wherever_they_are(size):
    squares = [(600, 420, 400), (0, 0, 70), (1530, 1130, 70), (205, 700, 130), (1200, 100, 90)]
    squares = [tuple(size * number for number in square) for square in squares]
    image = white_squares(*squares, shape=(1200 * size, 1600 * size, 3))
    points, scores = find_faces(image, *detector())
    expected = sorted([[x, y, 0], [x + side, y + side, 0]] for x, y, side in squares)
    assert sorted(points.tolist()) == expected and (scores == 0.9).all()


@pytest.mark.parametrize(
    ("before", "tiles", "n_found"),
    [([(310, 290, 90), (800, 500, 400)], 0, 2), ([(310, 290, 90), (500, 900, 90)], 16, 3),
     ([(700, 290, 90)], 16, 3), ([], 16, 3)],
)  # fmt: skip
def test_in_a_video_faces_are_found_where_they_were_and_if_one_is_lost_everywhere(
    before, tiles, n_found
):
    image = white_squares((300, 300, 90), (800, 520, 400), (1300, 100, 90))
    corners = [[[x, y], [x + side, y + side]] for x, y, side in before]
    find, find_boxes = detector()
    searched = []

    def count(tile):
        searched.append(tile)
        return find_boxes(tile)

    points, _ = find_faces(image, find, count, np.reshape(corners, (-1, 2, 2)))
    assert (len(searched), len(points)) == (tiles, n_found)
    whole, _ = find_faces(image, find, find_boxes)
    assert all(point in whole.tolist() for point in points.tolist())


def test_a_small_face_must_be_found_again_with_a_good_score():
    image = white_squares((300, 300, 90))
    (find, find_boxes), (_, unsure) = detector(), detector(score=0.6)
    assert len(find_faces(image, find, unsure)[0]) == 1
    assert len(find_faces(image, detector(score=0.6)[0], unsure)[0]) == 0
    nothing = detector(lowest=0.5)[0]  # finds nothing in the crop
    assert len(find_faces(image, nothing, find_boxes)[0]) == 0
    large = white_squares((300, 300, 600))
    assert len(find_faces(large, detector(score=0.6)[0], unsure)[0]) == 1
    assert find_faces(white_squares(), find, find_boxes)[0].shape == (0, 2, 3)
