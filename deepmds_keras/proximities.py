"""Proximities of a pair of 2D landmarks: the input of the dissimilarity net."""

import numpy as np

from deepmds_keras.errors import InputError, check_choice
from deepmds_keras.validation import as_numbers

VARIANTS = {"paper": 6, "released": 5}  # name: features of a pair


def pair_features(views: np.ndarray, variant: str = "paper") -> np.ndarray:
    """Symmetric proximities of every pair of landmarks of every face.

    `"paper"` (section "Deep Learning Dissimilarity"): for each of x and y the absolute difference,
    then the products, then exp(-absolute difference). `"released"` (the authors' code): products,
    exponentials and the Euclidean distance.

    Args:
        views: `(n, L, 2)` or `(L, 2)` landmarks, normalised.
        variant: `"paper"` (6 features) or `"released"` (5).

    Returns:
        `(n, P, F)` or `(P, F)` float32, pairs `i < j` in `scipy.spatial.distance.pdist` order.

    Raises:
        InputError: Unknown variant, or views of another shape or kind.
    """
    views = as_numbers(views, "views").astype(np.float32)
    if views.ndim not in (2, 3) or views.shape[-1] != 2:
        raise InputError(f"views must have shape (n, L, 2) or (L, 2). Received {views.shape}.")
    first, second = np.triu_indices(views.shape[-2], 1)
    return proximities(views[..., first, :], views[..., second, :], variant)


def proximities(first: np.ndarray, second: np.ndarray, variant: str) -> np.ndarray:
    """Features `(…, P, F)` of the pairs `first[k], second[k]`, float32 `(…, P, 2)` each."""
    check_choice(variant, "variant", VARIANTS)
    difference = np.abs(first - second)
    product = first * second
    if variant == "paper":
        return np.concatenate([difference, product, np.exp(-difference)], axis=-1)
    distance = np.sqrt(np.sum(np.square(difference), axis=-1, keepdims=True))
    return np.concatenate([product, np.exp(-difference), distance], axis=-1)
