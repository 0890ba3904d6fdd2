"""The few largest eigenvalues of many symmetric matrices at once."""

from __future__ import annotations

import numpy as np

_STEPS = 18  # the Gram matrices of faces need 12 to 18
_RESIDUAL = 1e-13
_ROUNDING = 1e-14  # both relative to the norm of the matrix


def leading_eigenpairs(matrices: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Largest eigenvalues and their eigenvectors, to rounding those of `numpy.linalg.eigh`.

    Lanczos' method with full reorthogonalisation (Golub & Van Loan, Matrix Computations, chapter
    10) where its answer is proven right, `eigh` for the other matrices. The result for a matrix
    does not depend on those beside it.

    Args:
        matrices: `(n, L, L)`, symmetric.
        count: Eigenvalues of each.

    Returns:
        `(n, count)` eigenvalues in descending order and `(n, L, count)` eigenvectors of length 1.
    """
    # SciPy's eigh(subset_by_index=) would make the batched solver a fifth slower on one core, and
    # its threads would wait for each other, since it holds Python's lock.
    n, size, _ = matrices.shape
    if size > _STEPS > count:
        values, vectors, proven = _lanczos(matrices, count)
    else:
        values, vectors = np.empty((n, count)), np.empty((n, size, count))
        proven = np.zeros(n, bool)
    if not proven.all():
        all_values, all_vectors = np.linalg.eigh(matrices[~proven])
        top = slice(None, -count - 1, -1)
        values[~proven], vectors[~proven] = all_values[:, top], all_vectors[..., top]
    return values, vectors


def _lanczos(matrices, count):
    """Ritz values, Ritz vectors and whether they are proven to be the largest eigenpairs."""
    n, size, _ = matrices.shape
    squared_norms = np.einsum("nij,nij->n", matrices, matrices)
    norms = np.sqrt(squared_norms)
    basis = np.zeros((n, _STEPS + 1, size))
    diagonal, beside = np.empty((n, _STEPS)), np.empty((n, _STEPS))
    # A start that no symmetry of a face leaves as it is: its Krylov space would miss eigenvectors.
    start = matrices @ np.random.default_rng(0).standard_normal(size)
    basis[:, 0] = _unit(start, _ROUNDING * norms)[0]
    for step in range(_STEPS):
        image = matrices @ basis[:, step, :, None]
        diagonal[:, step] = np.einsum("ni,ni->n", basis[:, step], image[..., 0])
        known = basis[:, : step + 1]
        for _ in range(2):  # once would leave rounding errors that grow
            image -= np.swapaxes(known, 1, 2) @ (known @ image)
        basis[:, step + 1], beside[:, step] = _unit(image[..., 0], _ROUNDING * norms)
    reduced, steps = np.zeros((n, _STEPS, _STEPS)), np.arange(_STEPS)
    reduced[:, steps, steps] = diagonal
    reduced[:, steps[1:], steps[:-1]] = beside[:, :-1]
    values, vectors = np.linalg.eigh(reduced)  # reads the lower triangle only
    values, vectors = values[:, ::-1], vectors[..., ::-1]
    last = beside[:, -1]
    residuals = last * np.abs(vectors[:, -1, :count]).max(1)
    # In this basis, completed, the matrix is the reduced one, a rest, and `last` to couple them.
    # Without the coupling no other eigenvalue exceeds the next Ritz value or the norm of the rest,
    # and the coupling adds no more than itself (Weyl's inequality).
    rest = squared_norms - np.square(diagonal).sum(1) - 2 * np.square(beside).sum(1)
    others = np.maximum(values[:, count], np.sqrt(np.maximum(rest, 0))) + last
    proven = (residuals <= _RESIDUAL * norms) & (others < values[:, count - 1])
    vectors = np.swapaxes(basis[:, :-1], 1, 2) @ vectors[..., :count]
    return values[:, :count].copy(), vectors, proven


def _unit(vectors, rounding):
    """Vectors over their lengths, and the lengths; zeros where there is only rounding error."""
    lengths = np.sqrt(np.einsum("ni,ni->n", vectors, vectors))
    lengths[lengths <= rounding] = 0
    return vectors / np.where(lengths > 0, lengths, np.inf)[:, None], lengths
