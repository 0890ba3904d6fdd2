"""The closed-form shape fit against eos-py, an independent C++ implementation."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from deepmds_keras.baselines.aldrian import solve_shape
from deepmds_keras.camera import affine_cameras, orthographic_cameras

eos = pytest.importorskip("eos", reason="needs eos-py: pip install .[eos]", exc_type=ImportError)

N_LANDMARKS, N_COMPONENTS = 30, 6


@pytest.fixture
def model():
    """Mean `(L, 3)`, orthonormal basis `(3L, K)` and variances `(K,)` of a small face model."""
    rng = np.random.default_rng(0)
    basis = np.linalg.qr(rng.normal(size=(3 * N_LANDMARKS, N_COMPONENTS)))[0]
    return rng.normal(0, 40, (N_LANDMARKS, 3)), basis, np.linspace(30, 5, N_COMPONENTS) ** 2


@pytest.fixture
def views(model):
    """Noisy views of a few faces, in pixels."""
    mean, basis, variances = model
    rng = np.random.default_rng(1)
    coefficients = rng.standard_normal((4, N_COMPONENTS))
    shapes = mean + ((coefficients * np.sqrt(variances)) @ basis.T).reshape(4, -1, 3)
    camera = np.array([[2.0, 0.1, -0.4, 250], [0.2, 1.9, 0.3, 240]])
    seen = shapes @ camera[:, :3].T + camera[:, 3]
    return seen + rng.normal(0, 2, seen.shape)


def basis_times_sd(basis, variances):
    return (basis * np.sqrt(variances)).T.reshape(len(variances), -1, 3)


@pytest.mark.parametrize("regularisation", [0.5, 3.0, 30.0])
@pytest.mark.parametrize("noise", [1.0, 5.0])
def test_shape_solve_agrees_with_eos(model, views, regularisation, noise):
    mean, basis, variances = model
    cameras = affine_cameras(views, np.stack([mean] * len(views)))
    ours = solve_shape(
        cameras, views, mean, basis_times_sd(basis, variances), 1 / noise**2, regularisation
    )
    pca = eos.morphablemodel.PcaModel(
        np.float32(mean.ravel()), np.float32(basis), np.float32(variances), [[0, 1, 2]]
    )
    for view, camera, coefficients in zip(views, cameras, ours, strict=True):
        # Positional arguments, since the weight is called `lambda`; an empty base face is the mean.
        theirs = eos.fitting.fit_shape_to_landmarks_linear(
            pca,
            np.float32(np.vstack([camera, [0, 0, 0, 1]])),
            [np.float32(point) for point in view],
            list(range(N_LANDMARKS)),
            np.float32([]),
            regularisation,
            None,
            noise,
            0.0,
        )
        np.testing.assert_allclose(coefficients, theirs, rtol=1e-4, atol=1e-5)


def test_orthographic_camera_agrees_with_eos(model):
    """On exact views: with noise eos makes the affine rows orthonormal in a way of its own."""
    mean, *_ = model
    rotation = Rotation.from_euler("yxz", [40, 15, -20], degrees=True).as_matrix()
    view = 1.7 * mean @ rotation[:2].T + [250, 240]
    theirs = eos.fitting.estimate_orthographic_projection_linear(
        [np.float32(point) for point in view],
        [np.float32([*point, 1]) for point in mean],
        False,
        None,
    )
    scaled = theirs.s * np.hstack([theirs.R[:2], [[theirs.tx], [theirs.ty]]])
    (ours,), (scale,), (shift,) = orthographic_cameras(view[None], mean[None])
    ours = np.hstack([scale * ours[:2], shift[:, None]])
    np.testing.assert_allclose(ours, scaled, rtol=1e-4, atol=1e-4)
