"""Heads through landmarks: near the true surface, on the landmarks, and read back."""

import numpy as np
import pytest
from places import SHARED
from scipy.spatial.transform import Rotation

from data_gen.build_openhead.surface import write_surface
from data_gen.models.openhead import load_openhead
from data_gen.models.registry import load_model
from data_gen.views.photo_views import sample_expressive
from deepmds_keras.camera import head_pose
from deepmds_keras.files import read_npz
from deepmds_keras.predict.faces import Face
from deepmds_keras.predict.mesh_files import MESH_SUFFIXES, write_mesh
from deepmds_keras.predict.surface import (
    FILE,
    fit_surfaces,
    surface_landmarks,
    surface_triangles,
)
from experiments.pretrained.surface import measure


@pytest.fixture(scope="module")
def heads():
    model = load_openhead()
    return model.shape(*sample_expressive(model, 8, np.random.default_rng(0)))


def test_the_file_in_the_package_is_what_the_head_model_gives(tmp_path):
    write_surface(tmp_path / "made.npz")
    made, shipped = (read_npz(path) for path in (tmp_path / "made.npz", FILE))
    assert FILE.stat().st_size < 600_000
    assert made.keys() == shipped.keys()
    for name, array in made.items():
        array, other = array.astype(float), shipped[name].astype(float)
        if name == "basis":  # the sign of an axis is anything, and a byte may be rounded up or down
            other *= np.sign((array * other).sum((1, 2), keepdims=True))
        assert np.abs(array - other).max() <= (1 if name == "basis" else 1e-3), name


@pytest.mark.parametrize("scheme", ["ibug51", "ibug68", "bfm72"])
def test_a_head_lies_on_its_landmarks_and_nearer_to_the_true_one_than_the_mean(heads, scheme):
    own = surface_landmarks(scheme)
    found = fit_surfaces(heads[:, own], scheme)
    assert found.shape == heads.shape
    assert np.linalg.norm(found[:, own] - heads[:, own], axis=2).mean() < 0.6
    front = load_openhead().mean[:, 2] > 60
    mean = fit_surfaces(heads[:, own].mean(0, keepdims=True), scheme)
    off, off_mean = (np.linalg.norm((a - heads)[:, front], axis=2).mean() for a in (found, mean))
    assert off < 0.6 * off_mean


def test_frame_and_unit_are_those_of_the_landmarks(heads):
    landmarks = heads[:, surface_landmarks("ibug51")]
    turn = Rotation.from_euler("yx", (20, 10), degrees=True).as_matrix()
    moved = 0.006 * landmarks @ turn + (3, -2, 1)
    expected = 0.006 * fit_surfaces(landmarks, "ibug51") @ turn + (3, -2, 1)
    assert np.abs(fit_surfaces(moved, "ibug51") - expected).max() < 1e-4


def test_many_faces_are_fitted_as_each_alone(heads):
    landmarks = np.tile(heads[:, surface_landmarks("bfm72")], (40, 1, 1))
    together = fit_surfaces(landmarks, "bfm72")
    assert np.abs(together[-1] - fit_surfaces(landmarks[-1:], "bfm72")[0]).max() < 1e-3


@pytest.mark.parametrize("model", ["openhead", "ict"])
def test_distances_from_the_true_surface_are_less_than_those_of_the_mean_head(model):
    data = SHARED / "ict-facekit"
    if model == "ict" and not data.exists():
        pytest.skip("no ICT-FaceKit in ../shared")
    exact, disturbed, lifted, detected = measure(load_model(model, data), 6)
    for _, mean, mesh, _ in (exact, disturbed, lifted):
        assert mesh < mean
    assert exact[2] < 0.85 * exact[1]
    assert exact[3] < 2
    assert exact[2] < lifted[2] < detected[2], "the less is known the farther off"


@pytest.mark.parametrize("suffix", MESH_SUFFIXES)
def test_a_mesh_is_read_back(tmp_path, heads, suffix):
    shape = heads[0][surface_landmarks("ibug51")]
    face = Face("é", "é.jpg", None, "ibug51", shape[:, :2] * (1, -1), shape, "mm",
                head_pose(shape[:, :2], shape), ("a note",))  # fmt: skip
    path = tmp_path / f"x{suffix}"
    write_mesh(path, face, {"name": "own"})
    lines = path.read_text(encoding="ascii").splitlines()
    if suffix == ".mesh.ply":
        end = lines.index("end_header")
        assert {"element vertex 3765", "element face 7240"} <= {*lines[:end]}
        vertices = np.array([line.split() for line in lines[end + 1 : end + 3766]], float)
        triangles = np.array([line.split() for line in lines[end + 3766 :]], int)
        assert (triangles[:, 0] == 3).all()
        triangles = triangles[:, 1:]
    else:
        vertices = np.array([line.split()[1:] for line in lines if line[0] == "v"], float)
        triangles = np.array([line.split()[1:] for line in lines if line[0] == "f"], int) - 1
    assert "a note" in "\n".join(lines)
    assert "mm" in "\n".join(lines)
    assert np.allclose(vertices, fit_surfaces(shape[None], "ibug51")[0], atol=1e-4)
    assert np.array_equal(triangles, surface_triangles())
