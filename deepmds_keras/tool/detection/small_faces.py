"""Faces of all sizes in an image, by a detector that looks at a small copy of what it is given.

MediaPipe's detector sees 128 x 128 pixels: it misses faces that span less than a tenth of the
image, and places the landmarks of those a little larger less well. So it also looks at overlapping
tiles of the image, and again at a crop around each face that is small.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

Find = Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]

# Faces whose points span less of the image's longer side get a second look. On photos of eight
# people made smaller, their shapes move by 0.005 without it where the points span 0.2, by 0.011
# where they span 0.16; with it by 0.004 at any size.
_SMALL = 1 / 6
# Tiles of this part of each side, so many along each: they overlap by a sixth of the image, so that
# every small face lies in one as a whole.
_TILE, _N_TILES = 3 / 8, 4
_SEARCHED_SIDE = 1024  # pixels: a tile has three times what the detector sees
_CROP = 3  # side of the crop around a face, in sides of the face
_SAME = 0.5  # of the smaller of two boxes that lies in the other, if they are of one face
# A face found in a tile is found again in its crop, and the higher of the two scores is at least
# this. Of 109 candidates in 25 pictures without a face, in four orientations, one was found again,
# a cat, with 0.62; upright faces in photos had 0.77 or more.
_CERTAIN = 0.75


def find_faces(
    image: np.ndarray,
    find: Find,
    find_boxes: Callable[[np.ndarray], np.ndarray],
    before: np.ndarray | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """Points of all faces, large or small.

    Args:
        image: `(H, W, 3)` uint8 RGB.
        find: Gives, from such an image, points `(n, L, 3)` in pixels and scores `(n,)` of its
            large faces.
        find_boxes: Gives, from such an image, `(n, 5)` boxes: left, top, right, bottom in pixels,
            score.
        before: Points `(n, L, 2 or 3)` of the faces in the frame before, in a video. They are
            looked for where they were; only if one is not there, or if there are none, are the
            tiles searched.

    Returns:
        `(n, L, 3)` and `(n,)` as from `find`; of a small face the higher of its two scores.
    """
    points, scores = find(image)
    boxes = _boxes(points, scores)
    is_large = _sides(boxes) >= _SMALL * max(image.shape[:2])
    large = points[is_large], scores[is_large], boxes[is_large]
    if before is not None and len(before):
        seen = _boxes(before, np.zeros(len(before)))
        found = _with_small(image, *large, np.concatenate([boxes[~is_large], seen]), find)
        now = _boxes(*found)
        if all((_overlaps(now, box) > _SAME).any() for box in seen):
            return found
    candidates = np.concatenate([boxes[~is_large], _boxes_in_tiles(image, find_boxes)])
    return _with_small(image, *large, candidates, find)


def _with_small(
    image: np.ndarray,
    points: np.ndarray,
    scores: np.ndarray,
    taken: np.ndarray,
    candidates: np.ndarray,
    find: Find,
) -> tuple[np.ndarray, np.ndarray]:
    """Points and scores of large faces, whose boxes are taken, and of the candidates that hold."""
    found = [(points, scores)]
    for box in candidates[np.argsort(-candidates[:, 4], kind="stable")]:
        if (_overlaps(taken, box) > _SAME).any():
            continue
        points, scores = _find_in_crop(image, box, find)
        boxes = _boxes(points, scores)
        same = _overlaps(boxes, box)
        if same.max(initial=0) > _SAME:
            i = same.argmax()
            score, other = max(box[4], scores[i]), (_overlaps(taken, boxes[i]) > _SAME).any()
            if score >= _CERTAIN and not other:
                found.append((points[[i]], np.array([score])))
                taken = np.vstack([taken, boxes[i]])
    all_points, all_scores = zip(*found, strict=True)
    return np.concatenate(all_points), np.concatenate(all_scores)


def _boxes_in_tiles(image: np.ndarray, find_boxes: Callable) -> np.ndarray:
    """`(n, 5)` boxes in the image that are found in its tiles."""
    # Every third pixel, say, is as good as the mean of nine, and ten times as fast.
    factor = max(1, max(image.shape[:2]) // _SEARCHED_SIDE)
    reduced = np.ascontiguousarray(image[::factor, ::factor])
    height, width = (round(_TILE * side) for side in reduced.shape[:2])
    tops, lefts = (
        np.linspace(0, (1 - _TILE) * side, _N_TILES).astype(int) for side in reduced.shape[:2]
    )
    found = [np.empty((0, 5))]
    for top in tops:
        for left in lefts:
            boxes = find_boxes(reduced[top : top + height, left : left + width])
            found.append((boxes + (left, top, left, top, 0)) * (factor, factor, factor, factor, 1))
    return np.concatenate(found)


def _find_in_crop(image: np.ndarray, box: np.ndarray, find: Find) -> tuple[np.ndarray, np.ndarray]:
    """What `find` gives for a square around a box; black beyond the image."""
    side = round(_CROP * _sides(box[None])[0])
    left, top = (round(middle - side / 2) for middle in (box[:2] + box[2:4]) / 2)
    crop = np.zeros((side, side, 3), np.uint8)
    part = image[max(top, 0) : max(top + side, 0), max(left, 0) : max(left + side, 0)]
    y, x = max(-top, 0), max(-left, 0)
    crop[y : y + part.shape[0], x : x + part.shape[1]] = part
    points, scores = find(crop)
    return points + np.array([left, top, 0], points.dtype), scores


def _boxes(points: np.ndarray, scores: np.ndarray) -> np.ndarray:
    """`(n, 5)` boxes around points `(n, L, 3)`, with scores."""
    return np.column_stack([points[..., :2].min(1), points[..., :2].max(1), scores])


def _sides(boxes: np.ndarray) -> np.ndarray:
    """The longer side of each box, pixels."""
    return (boxes[:, 2:4] - boxes[:, :2]).max(1)


def _overlaps(boxes: np.ndarray, box: np.ndarray) -> np.ndarray:
    """`(n,)` areas that boxes share with one, relative to the smaller of the two."""
    shared = np.minimum(boxes[:, 2:4], box[2:4]) - np.maximum(boxes[:, :2], box[:2])
    areas = (boxes[:, 2:4] - boxes[:, :2]).prod(1)
    return shared.clip(0).prod(1) / np.minimum(areas, (box[2:4] - box[:2]).prod())
