"""Several views of each of some subjects: what a ring of images is drawn from."""

from __future__ import annotations

import numpy as np

from data_gen.datasets.dataset import Dataset, dataset_of
from data_gen.models.morphable_model import MorphableModel
from data_gen.views.projections import sample_cameras
from deepmds_keras.errors import InputError


def make_rings(
    model: MorphableModel,
    n_subjects: int,
    images_per_subject: int,
    expression: np.ndarray,
    rng: np.random.Generator,
    *,
    scheme: str = "ibug51",
    protocol: str = "paper",
) -> Dataset:
    """Sample subjects of standard-normal identity, each in some expressions and views.

    Sanyal et al. 2019 (RingNet, arXiv:1905.06817) learn from rings of photos, all but one of which
    show the same person: the identity is what they share, expression and pose are what they do not.

    Args:
        model: Morphable model with landmarks of the scheme and expressions.
        n_subjects: Number of different identities.
        images_per_subject: Faces of each.
        expression: `(n, E)` expression weights, n the product of the two numbers.
        rng: Source of the random numbers.
        scheme: Landmark scheme.
        protocol: As for `projections.sample_cameras`.

    Returns:
        n faces; face i is of subject i // images_per_subject.

    Raises:
        InputError: No subjects or images, weights of another shape, a model without expressions or
            without landmarks of that scheme, or an unknown protocol.
    """
    if min(n_subjects, images_per_subject) < 1:
        raise InputError(
            "n_subjects and images_per_subject must be at least 1. "
            f"Received {n_subjects} and {images_per_subject}."
        )
    if scheme not in model.landmarks:
        raise InputError(
            f"scheme must be one of {', '.join(model.landmarks)} for {model.name}. "
            f"Received {scheme!r}."
        )
    if model.expression_basis is None:
        raise InputError(f"{model.name} must have an expression basis. Received none.")
    n = n_subjects * images_per_subject
    expression = np.asarray(expression, np.float32)
    if expression.shape != (n, len(model.expression_basis)):
        raise InputError(
            f"expression must have shape ({n}, {len(model.expression_basis)}), a row for each "
            f"image. Received {expression.shape}."
        )
    if not np.isfinite(expression).all():
        raise InputError("expression must be finite. Received NaN or infinity.")
    cameras = sample_cameras(n, rng, protocol)
    of_subjects = rng.standard_normal((n_subjects, model.n_identity)).astype(np.float32)
    identity = np.repeat(of_subjects, images_per_subject, axis=0)
    landmarks = model.restrict(model.landmarks[scheme]).shape(identity, expression)
    description = {
        "model": model.name,
        "model_sha256": model.sha256,
        "scheme": scheme,
        "protocol": protocol,
        "images_per_subject": images_per_subject,
    }
    return dataset_of(landmarks, cameras, description, identity=identity, expression=expression)
