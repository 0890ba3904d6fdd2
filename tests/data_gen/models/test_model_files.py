"""Face model files as users have them: known values come back, and bad files are refused."""

import hashlib
import json
import re

import numpy as np
import pytest
from places import SHARED
from writers.models import write_bfm2009, write_h5, write_ict_folder, write_ict_npz, write_mat

from data_gen.landmarks import load_basel_anchors, load_vertices
from data_gen.models import ict
from data_gen.models.basel import load_bfm2009, load_bfm2017
from data_gen.models.ict import KEPT, N_VERTICES, load_ict
from data_gen.models.registry import MODELS, find_model, load_model, model_files, open_models
from deepmds_keras.errors import InputError

K = 5  # components of the synthetic models
SD = np.array([50.0, 20.0, 9.0, 4.0, 1.0])  # mm; not equal to their squares
CUBE = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], float)
QUADS = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]


@pytest.fixture(scope="module")
def columns(head):
    """Orthonormal columns, as every Basel model has them."""
    rng = np.random.default_rng(0)
    return np.linalg.qr(rng.normal(size=(3 * head.n_vertices, K)))[0].astype(np.float32)


def offsets(columns):
    return (columns * SD).T.reshape(K, -1, 3)


@pytest.fixture
def mat_arrays(head, columns):
    """`01_MorphableModel.mat` in its layout: micrometres, s.d.s, clockwise triangles from 1."""
    n = 3 * head.n_vertices
    return {
        "shapeMU": (head.mean.reshape(n, 1) * 1000).astype(np.float32),
        "shapePC": columns,
        "shapeEV": (SD * 1000).astype(np.float32)[:, None],
        "texMU": np.full((n, 1), 51, np.float32),
        "texPC": columns,
        "texEV": np.full((K, 1), 25.5, np.float32),
        "tl": (head.triangles[:, [0, 2, 1]] + 1).astype(np.int32),
    }


@pytest.fixture
def h5_arrays(head, columns):
    """A 2017 file in its layout: mm, variances, triangles `(3, T)` from 0, named landmarks."""
    points = [
        {"id": name, "coordinates": head.mean[vertex["openhead"]].tolist(), "uncertainty": {}}
        for name, vertex in load_basel_anchors().items()
    ]
    points.append({"id": "left.nasolabial_fold.center", "coordinates": [30, -19, 100]})
    arrays = {
        "shape/representer/points": head.mean.T.astype(np.float32),
        "shape/representer/cells": head.triangles.T.astype(np.uint32),
        "metadata/landmarks/json": json.dumps(points),
    }
    flat = np.ones(head.mean.size)
    for group, mean in {"shape": head.mean.ravel(), "expression": flat, "color": flat / 5}.items():
        arrays[f"{group}/model/mean"] = mean.astype(np.float32)
        arrays[f"{group}/model/pcaBasis"] = columns
        arrays[f"{group}/model/pcaVariance"] = (SD**2).astype(np.float32)
    return arrays


@pytest.fixture
def ict_arrays(monkeypatch):
    """ICT's layout, but three identities: a cube of quads, and quads of gums and shells."""
    monkeypatch.setattr(ict, "N_IDENTITY", 3)
    rng = np.random.default_rng(0)
    mean = rng.normal(size=(N_VERTICES, 3))
    mean[:8] = CUBE
    gums, shells = ([start + i for i in range(4)] for start in (14_062, 24_591))
    return {
        "mean": mean,
        "identity": rng.normal(size=(3, N_VERTICES, 3)),
        "expression": rng.normal(size=(2, N_VERTICES, 3)),
        "expression_names": ["browDown_L", "jawOpen"],
        "faces": [*QUADS, gums, (0, 1, *gums[:2]), shells],
    }


def triangle_cycles(triangles):
    """Triangles as a set that forgets where each starts, but not which way it turns."""
    start = triangles.argmin(axis=1)[:, None]
    return set(map(tuple, np.take_along_axis(triangles, (start + np.arange(3)) % 3, axis=1)))


def test_bfm2009_comes_back_in_millimetres_and_standard_deviations(
    tmp_path, head, columns, mat_arrays
):
    file = write_mat(tmp_path, mat_arrays)
    model = load_bfm2009(file)
    np.testing.assert_allclose(model.mean, head.mean, atol=1e-4)
    np.testing.assert_allclose(model.identity_basis_times_sd, offsets(columns), atol=1e-5)
    np.testing.assert_allclose(model.colour_mean, 0.2, rtol=1e-6)
    np.testing.assert_allclose(model.colour_basis_times_sd, columns.T.reshape(K, -1, 3) / 10, 1e-5)
    assert triangle_cycles(model.triangles) == triangle_cycles(head.triangles)
    assert model.landmarks == {}  # known on the whole mesh only
    assert model.sha256 == hashlib.sha256(file.read_bytes()).hexdigest()


def test_bfm2009_has_the_landmarks_of_the_table(tmp_path):
    places = np.random.default_rng(0).normal(0, 50, (72, 3))
    model = load_model("bfm2009", write_bfm2009(tmp_path, places).parent)
    np.testing.assert_allclose(model.mean[model.landmarks["bfm72"]], places, atol=1e-4)


@pytest.mark.parametrize(
    ("key", "change", "message"),
    [
        ("texEV", lambda a: a[:-1], "texEV must have"),
        ("tl", lambda a: a - 1, "tl must count vertices from 1. Received 0."),
        ("tl", lambda a: a + 1, "triangles must number"),
    ],
)
def test_sizes_of_bfm2009_that_disagree_are_refused(tmp_path, mat_arrays, key, change, message):
    mat_arrays[key] = change(mat_arrays[key])
    with pytest.raises(InputError, match=f"01_MorphableModel.mat: .*{message}"):
        load_bfm2009(write_mat(tmp_path, mat_arrays))


def test_bfm2017_comes_back_with_the_variance_rooted(tmp_path, head, columns, h5_arrays):
    model = load_model("bfm2017", write_h5(tmp_path, h5_arrays).parent)
    np.testing.assert_allclose(model.mean, head.mean, atol=1e-4)
    for basis in (model.identity_basis_times_sd, model.expression_basis):
        np.testing.assert_allclose(basis, offsets(columns), atol=1e-5)
    np.testing.assert_allclose(model.colour_mean, 0.2, rtol=1e-6)
    assert triangle_cycles(model.triangles) == triangle_cycles(head.triangles)
    np.testing.assert_array_equal(model.shape(np.zeros(K)), model.mean)
    np.testing.assert_allclose(model.shape(np.zeros(K), np.zeros(K)), model.mean + 1)
    on_skin = np.setdiff1d(np.arange(72), [4, 53])  # the pupils are not on the skin
    expected = head.landmarks["bfm72"][on_skin]
    np.testing.assert_array_equal(model.landmarks["bfm72"][on_skin], expected)


def test_bfm2017_may_lack_landmarks_colours_and_expressions(tmp_path, h5_arrays):
    text = h5_arrays["metadata/landmarks/json"]
    shape = {key: value for key, value in h5_arrays.items() if key.startswith("shape")}
    model = load_bfm2017(write_h5(tmp_path, shape))
    assert model.expression_basis is None and model.colour_mean is None
    with pytest.raises(InputError, match="landmarks bfm72 are known. Received one of 3765"):
        load_model("bfm2017", tmp_path)
    for value in (np.bytes_(text), np.frombuffer(text.encode(), np.uint8), [text]):
        file = write_h5(tmp_path, shape | {"metadata/landmarks/json": value})
        assert len(load_bfm2017(file).landmarks["bfm72"]) == 72


@pytest.mark.parametrize(
    ("key", "change"),
    [
        ("shape/model/pcaVariance", lambda a: -a),
        ("shape/representer/cells", lambda a: a + 1),
        ("shape/representer/points", lambda a: a[:, 1:]),
        ("metadata/landmarks/json", lambda a: re.sub(r"\[.*?]", "[NaN, 0, 0]", a)),
    ],
)
def test_bad_contents_of_bfm2017_are_refused(tmp_path, h5_arrays, key, change):
    h5_arrays[key] = change(h5_arrays[key])
    with pytest.raises(InputError, match="nomouth.h5: .*must"):
        load_bfm2017(write_h5(tmp_path, h5_arrays))


def test_ict_is_the_same_from_the_official_folder_and_the_compiled_file(tmp_path, ict_arrays):
    folder = write_ict_folder(tmp_path, ict_arrays)
    model = load_ict(folder)
    compiled = load_ict(write_ict_npz(tmp_path, ict_arrays))
    for name in ("mean", "identity_basis_times_sd", "expression_basis", "triangles"):
        np.testing.assert_array_equal(getattr(model, name), getattr(compiled, name))
    assert model.expression_names == compiled.expression_names == ("browDown_L", "jawOpen")
    assert model.landmarks.keys() == compiled.landmarks.keys() == {"bfm72", "ibug68", "ibug51"}
    np.testing.assert_allclose(model.mean, ict_arrays["mean"][KEPT] * 10, rtol=1e-6)
    expected = ict_arrays["identity"][:, KEPT] * 10
    np.testing.assert_allclose(model.identity_basis_times_sd, expected, atol=1e-4)
    a, b, c = model.mean[model.triangles.T]  # of the cube alone, two of each quad, outwards
    normals = np.cross(b - a, c - a)
    assert (np.einsum("td,td->t", normals, a + b + c) > 0).all()
    assert np.linalg.norm(normals, axis=1).sum() / 2 == pytest.approx(6 * 20**2)
    for scheme, vertices in model.landmarks.items():
        np.testing.assert_array_equal(KEPT[vertices], load_vertices(scheme).vertices["ict"])
    (folder / "identity001.obj").write_bytes((folder / "identity000.obj").read_bytes())
    assert load_ict(folder).sha256 != model.sha256


@pytest.mark.skipif(not (SHARED / "ict-facekit").is_dir(), reason="../shared/ict-facekit is absent")
def test_the_compiled_file_of_ict_has_the_vertices_that_are_kept_of_the_folder():
    """Gums must not be painted as teeth, nor the shells about the eyes as their white."""
    with np.load(SHARED / "ict-facekit" / "ict_light.npz") as file:
        np.testing.assert_array_equal(file["vertex_index"], KEPT)


def test_a_malformed_folder_of_ict_is_refused(tmp_path, ict_arrays):
    folder = write_ict_folder(tmp_path, ict_arrays)
    vertices = "v 1 2 3\n" * N_VERTICES
    for name, text in (
        ("generic_neutral_mesh", f"{vertices}f 1 2 99999\n"),
        ("generic_neutral_mesh", f"{vertices}f 1 2 {10**30}\n"),
        ("identity002", vertices[8:]),
        ("identity001", None),
    ):
        path = folder / f"{name}.obj"
        whole = path.read_bytes()
        path.unlink() if text is None else path.write_text(text)
        with pytest.raises(InputError, match=f"{folder}.*must"):
            load_ict(folder)
        path.write_bytes(whole)


@pytest.mark.parametrize(
    "changes",
    [
        {"vertex_index": KEPT[::-1]},
        {"triangles": np.array([[0, 1, 21_614]])},
        {"mean": np.full((21_614, 3), "a")},
    ],
)
def test_a_malformed_npz_of_ict_is_refused(tmp_path, ict_arrays, changes):
    with pytest.raises(InputError, match="ict_light.npz.* must"):
        load_ict(write_ict_npz(tmp_path, ict_arrays, **changes))


@pytest.mark.parametrize("name", [*(name for name in MODELS if name != "openhead"), "nobody"])
def test_a_missing_model_says_what_is_looked_for_and_where_to_get_it(tmp_path, name):
    message = "MODEL must be one of" if name == "nobody" else f"DATA= must be .*{name}.*https://"
    for path in (None, "", tmp_path, tmp_path / "absent"):
        with pytest.raises(InputError, match=message):
            load_model(name, path)


def test_files_are_looked_for_two_folders_deep_and_must_be_one(tmp_path):
    for name in ("a/FaceXModel/generic_neutral_mesh.obj", "b/model2019_bfm.h5"):
        (tmp_path / name).parent.mkdir(parents=True)
        (tmp_path / name).touch()
    assert find_model("bfm2019", tmp_path) == tmp_path / "b" / "model2019_bfm.h5"
    meshes = tmp_path / "a" / "FaceXModel"
    for path in (tmp_path, tmp_path / "a", meshes, meshes / "generic_neutral_mesh.obj"):
        assert find_model("ict", path) == meshes
        assert model_files("ict", path) == [meshes / "generic_neutral_mesh.obj"]
    assert open_models(tmp_path) == (["openhead", "ict"], [])
    for path in (None, tmp_path / "b", tmp_path / "b" / "model2019_bfm.h5"):
        assert open_models(path) == (["openhead"], ["ict"])
    (tmp_path / "model2019_bfm.h5").touch()
    assert find_model("bfm2019", tmp_path) == tmp_path / "model2019_bfm.h5"
    for folder in "cd":
        (tmp_path / folder).mkdir()
        (tmp_path / folder / "01_MorphableModel.mat").touch()
    with pytest.raises(InputError, match="Received .*c/01_.*, .*d/01_"):
        find_model("bfm2009", tmp_path)
