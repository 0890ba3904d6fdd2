"""Faces that the lifting network is trained on."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from deepmds_keras.errors import InputError
from deepmds_keras.geometry.units import centre_and_scale
from deepmds_keras.lifting.inputs import LEAST_VISIBLE, prepare_views, standardise
from deepmds_keras.streams import Stream
from deepmds_keras.validation import check_faces

_HELD_OUT = 10  # one in so many of the faces given
_MOST_HELD_OUT = 1000
_FACES_OF_BASIS = 10_000
_FEW_SHAPES = 50
_SAME = 2e-6  # five times what rounding to float32 moves a shape, ten extents from the origin


@dataclass(frozen=True, eq=False)
class Faces:
    """Views as from `prepare_views`, and their true shapes: float32, landmarks last.

    Attributes:
        views: `(n, 2, L)` centred, of unit root mean square radius, 0 where not visible.
        visible: `(n, L)` 1 or 0.
        sd: `(n, L)` standard deviation of the errors of a coordinate.
        shapes: `(n, 3, L)` as from `centre_and_scale`.
    """

    views: np.ndarray
    visible: np.ndarray
    sd: np.ndarray
    shapes: np.ndarray

    def __len__(self) -> int:
        return len(self.views)

    def __getitem__(self, faces) -> Faces:
        return Faces(*(array[faces] for array in vars(self).values()))


def read_faces(views, shapes, landmark_sd, n_landmarks: int) -> Faces:
    """Faces of views `(n, L, 2)` and true shapes `(n, L, 3)`, both in any scale and place.

    Raises:
        InputError: As for `prepare_views`, or unequal numbers of faces.
    """
    seen = prepare_views(views, n_landmarks, landmark_sd=landmark_sd)
    sd = np.zeros_like(seen.visible) if seen.sd is None else seen.sd
    shapes = centre_and_scale(check_faces(shapes, "shapes", 3, n_landmarks))
    if len(seen.views) != len(shapes):
        raise InputError(
            f"views and shapes must be of the same faces. Received {len(seen.views)} views and "
            f"{len(shapes)} shapes."
        )
    shapes = np.asarray(np.swapaxes(shapes, 1, 2), np.float32)
    return Faces(seen.views, seen.visible, sd, shapes)


def disturb(faces: Faces, missing: float, noise: float, rng: np.random.Generator) -> Faces:
    """The faces with errors added to their landmarks, and some landmarks hidden.

    Args:
        missing: Largest share to hide; each face draws a share up to it, and keeps six landmarks.
        noise: Largest standard deviation of the errors; each face draws one up to it.
        rng: Random generator; it draws the same amount whatever the other arguments.
    """
    n, n_landmarks = faces.visible.shape
    share = missing * rng.random((n, 1))
    turn = rng.random((n, n_landmarks))
    added = noise * rng.random((n, 1))
    errors = added[:, None] * rng.standard_normal(faces.views.shape)
    if not missing and not noise:
        return faces
    hidden = np.minimum(share * n_landmarks, faces.visible.sum(1, keepdims=True) - LEAST_VISIBLE)
    places = np.where(faces.visible > 0, turn, 2).argsort(1).argsort(1)
    visible = np.where(places < np.floor(hidden), 0, faces.visible)
    views, _, radius = standardise(faces.views + errors, visible)
    sd = np.sqrt(faces.sd**2 + added**2) / radius
    views, visible, sd = (np.asarray(array, np.float32) for array in (views, visible, sd))
    return Faces(views, visible, sd, faces.shapes)


class Source(NamedTuple):
    """Where the faces of a training come from.

    Attributes:
        shapes: `(n, 3, L)`, whose principal components initialise the network.
        held_out: Faces to check the network on, disturbed like those in training.
        block: Function of the number of a block and of faces that returns that many faces.
        identified_by: Arrays by which a checkpoint knows the faces: all of them, or the first that
            were sampled.
    """

    shapes: np.ndarray
    held_out: Faces
    block: Callable[[int, int], Faces]
    identified_by: tuple[np.ndarray, ...]


def given_faces(faces: Faces, missing: float, noise: float, seed: int) -> Source:
    """Faces in memory; training sees all of them equally often, but for a tenth held out.

    All views of a shape are held out together: by other views of it they would be known.
    """
    _, first, shape_of = np.unique(
        shape_numbers(faces.shapes), return_index=True, return_inverse=True
    )
    n_shapes = len(first)
    if n_shapes < _FEW_SHAPES:
        warnings.warn(
            f"{n_shapes} different shapes are few to learn from, {_FEW_SHAPES} or more are needed: "
            "measure the error on shapes that were not given.",
            stacklevel=3,
        )
    turns = np.random.default_rng([seed, Stream.LIFTING_SPLIT]).permutation(n_shapes).argsort()
    # Shapes in the order in which they come, so that equal ones need not lie together.
    turn_of = turns[first.argsort().argsort()[shape_of]]
    order = turn_of.argsort(kind="stable")
    # Of fewer than ten shapes none can be spared.
    counts = np.bincount(turn_of)[: n_shapes // _HELD_OUT].cumsum()
    n_held_out = counts[counts <= max(_MOST_HELD_OUT, counts[:1].sum())].max(initial=0)
    training = faces[order[n_held_out:]]
    checked = faces[order[:n_held_out]] if n_held_out else faces
    check_rng = np.random.default_rng([seed, Stream.LIFTING_CHECK])

    def block(index: int, n: int) -> Faces:
        from deepmds_keras.training import face_order  # which imports TensorFlow

        rng = np.random.default_rng([seed, Stream.LIFTING_TRAINING, index])
        return disturb(training[face_order(len(training), n, seed, index)], missing, noise, rng)

    held_out = disturb(checked, missing, noise, check_rng)
    return Source(training.shapes, held_out, block, tuple(vars(faces).values()))


def shape_numbers(shapes: np.ndarray) -> np.ndarray:
    """Number of each of the float32 arrays, the same where they are equal up to rounding."""
    flat = shapes.reshape(len(shapes), -1)
    directions = np.random.default_rng(0).standard_normal((8, flat.shape[1]), np.float32)
    numbers = np.zeros(len(flat), int)
    # Gaps along any direction part them; the lines of a grid would part equal ones too.
    for places in directions @ flat.T / flat.shape[1] ** 0.5:
        order = np.lexsort((places, numbers))
        parted = (np.diff(numbers[order]) > 0) | (np.diff(places[order]) > _SAME)
        numbers[order] = np.append(0, parted.cumsum())
    return numbers


def distinct_shapes(shapes: np.ndarray) -> np.ndarray:
    """The first of each of the shapes `(n, L, 3)`, however turned; all centred and of one size.

    A shape and its mirror image are two.
    """
    # Random sums of landmarks are as long, and span the same volume, however a shape is turned.
    sums = np.random.default_rng(0).standard_normal((8, shapes.shape[1]))
    sums /= np.linalg.norm(sums, axis=1, keepdims=True)
    moved = sums @ shapes
    same = np.column_stack([np.linalg.norm(moved, axis=2), np.linalg.det(moved[:, :3])])
    _, first = np.unique(shape_numbers(same.astype(np.float32)), return_index=True)
    return shapes[np.sort(first)]


def sampled_faces(
    sample: Callable, n_landmarks: int, missing: float, noise: float, seed: int
) -> Source:
    """Faces that a function samples; none is seen twice."""

    def draw(n, *stream):
        rng = np.random.default_rng([seed, *stream])
        sampled = sample(n, rng)
        items = len(sampled) if isinstance(sampled, tuple | list) else 1
        if items != 3:
            raise InputError(
                "views, if a function, must return views, shapes and landmark_sd. "
                f"Received {items} of them."
            )
        faces = read_faces(*sampled, n_landmarks)
        if len(faces) != n:
            raise InputError(
                f"views, if a function, must return as many faces as asked for, {n}. "
                f"Received {len(faces)}."
            )
        return disturb(faces, missing, noise, rng)

    held_out = draw(_MOST_HELD_OUT, Stream.LIFTING_CHECK)
    shapes = draw(_FACES_OF_BASIS, Stream.LIFTING_BASIS).shapes
    first = (*vars(held_out).values(), shapes)
    return Source(shapes, held_out, lambda index, n: draw(n, Stream.LIFTING_TRAINING, index), first)
