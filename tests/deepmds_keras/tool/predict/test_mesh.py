"""Heads through landmarks: near the true surface, and on the landmarks."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from data_gen.build_openhead.components import write_surface
from data_gen.views import sample_expressive
from deepmds_keras.files import read_npz
from deepmds_keras.tool.predict.mesh import FILE, fit_surfaces, surface_landmarks
from experiments.pretrained.surface import measure


@pytest.fixture(scope="module")
def heads(head):
    return head.shape(*sample_expressive(head, 8, np.random.default_rng(0)))


def test_the_file_in_the_package_is_what_the_head_model_gives(tmp_path):
    write_surface(tmp_path / "built.npz")
    built, shipped = (read_npz(path) for path in (tmp_path / "built.npz", FILE))
    assert FILE.stat().st_size < 600_000
    assert built.keys() == shipped.keys()
    for name, array in built.items():
        array, other = array.astype(float), shipped[name].astype(float)
        if name == "basis":  # the sign of an axis is anything, and a byte may be rounded up or down
            other *= np.sign((array * other).sum((1, 2), keepdims=True))
        assert np.abs(array - other).max() <= (1 if name == "basis" else 1e-3), name


@pytest.mark.parametrize("scheme", ["ibug51", "ibug68", "bfm72"])
def test_a_head_lies_on_its_landmarks_and_nearer_to_the_true_one_than_the_mean(head, heads, scheme):
    numbers = surface_landmarks(scheme)
    fitted = fit_surfaces(heads[:, numbers], scheme)
    assert fitted.shape == heads.shape
    assert np.linalg.norm(fitted[:, numbers] - heads[:, numbers], axis=2).mean() < 0.6
    front = head.mean[:, 2] > 60
    mean = fit_surfaces(heads[:, numbers].mean(0, keepdims=True), scheme)
    off, off_mean = (np.linalg.norm((a - heads)[:, front], axis=2).mean() for a in (fitted, mean))
    assert off < 0.6 * off_mean


def test_frame_and_unit_are_those_of_the_landmarks(heads):
    landmarks = heads[:, surface_landmarks("ibug51")]
    turn = Rotation.from_euler("yx", (20, 10), degrees=True).as_matrix()
    moved = 0.006 * landmarks @ turn + (3, -2, 1)
    expected = 0.006 * fit_surfaces(landmarks, "ibug51") @ turn + (3, -2, 1)
    assert np.abs(fit_surfaces(moved, "ibug51") - expected).max() < 1e-4


@pytest.mark.parametrize("model", ["head", "ict"])
def test_distances_from_the_true_surface_are_less_than_those_of_the_mean_head(request, model):
    rows = measure(request.getfixturevalue(model), 6)
    exact, disturbed, lifted, detected = ([*row.values()] for row in rows)
    for _, mean, mesh, _ in (exact, disturbed, lifted):
        assert mesh < mean
    assert exact[2] < 0.85 * exact[1]
    assert exact[3] < 2
    assert exact[2] < lifted[2] < detected[2], "the less is known the farther off"
