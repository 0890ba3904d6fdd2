"""FLAME as users have it: known values come back, the jaw turns, and bad files are refused."""

import hashlib
import pickle
from dataclasses import replace

import numpy as np
import pytest
from places import SHARED
from scipy.linalg import expm
from scipy.sparse import coo_matrix, csc_matrix
from writers.models import flame_arrays
from writers.pickles import chumpy_pickle
from writers.scans import hull

from data_gen.landmark_fitting import LandmarkFitter
from data_gen.mesh_files import read_ply
from data_gen.models.flame import load_embedding, load_flame, read_flame, skin
from data_gen.models.registry import load_model
from deepmds_keras.errors import InputError

V = 60  # vertices of the synthetic head, a ball of 10 cm
JAW_JOINT = np.array([0, -0.02, 0.0])


@pytest.fixture(scope="module")
def ball():
    """Vertices in metres, and triangles counter-clockwise from outside."""
    direction = np.random.default_rng(0).normal(size=(V, 3))
    vertices = 0.1 * direction / np.linalg.norm(direction, axis=1, keepdims=True)
    return vertices, hull(vertices)


@pytest.fixture
def arrays(ball):
    """`generic_model.pkl` in its layout, on another mesh."""
    rng = np.random.default_rng(1)
    vertices, triangles = ball
    weights = rng.dirichlet(np.ones(5), V)
    weights[vertices[:, 1] < -0.05] = np.eye(5)[2]  # the chin follows the jaw
    regressor = rng.dirichlet(np.ones(V), 5)
    system = np.vstack([vertices.T, np.ones(V)])
    regressor[2] = np.linalg.lstsq(system, np.append(JAW_JOINT, 1), rcond=None)[0]
    return flame_arrays(
        vertices,
        triangles,
        shapedirs=rng.normal(size=(V, 3, 400)) * 1e-3,
        posedirs=rng.normal(size=(V, 3, 36)) * 1e-5,
        J_regressor=csc_matrix(regressor),
        weights=weights,
    )


@pytest.fixture
def embedding(ball):
    rng = np.random.default_rng(2)
    faces = rng.integers(0, len(ball[1]), 51).astype(np.uint32)
    return {"lmk_face_idx": faces, "lmk_b_coords": rng.dirichlet(np.ones(3), 51)}


def write(folder, arrays, embedding, name="generic_model.pkl", protocol=2, chumpy=()):
    """The two files; some arrays as objects of chumpy, which is not there when they are read."""
    (folder / "flame_static_embedding.pkl").write_bytes(pickle.dumps(embedding, 0))
    (folder / name).parent.mkdir(parents=True, exist_ok=True)
    held = lambda ch: {k: ch(x=a) if k in chumpy else a for k, a in arrays.items()}  # noqa: E731
    (folder / name).write_bytes(chumpy_pickle(held, protocol))
    return folder / name


def reference_face(arrays, pose):
    """The mean face by homogeneous matrices, joint by joint and vertex by vertex, in metres."""
    joints = arrays["J_regressor"].toarray() @ arrays["v_template"]
    rotations = [expm(np.cross(np.eye(3), turn)) for turn in pose]
    features = np.concatenate([(rotation - np.eye(3)).ravel() for rotation in rotations[1:]])
    posed = arrays["v_template"] + arrays["posedirs"] @ features
    world = []
    for joint, parent in enumerate(arrays["kintree_table"][0].astype(int)):
        local = np.eye(4)
        local[:3, :3] = rotations[joint]
        local[:3, 3] = joints[joint] - (joints[parent] if joint else 0)
        world.append(world[parent] @ local if joint else local)
    for joint in range(5):
        back = np.block([[np.eye(3), -joints[joint][:, None]], [np.zeros((1, 3)), 1]])
        world[joint] = world[joint] @ back
    blends = np.einsum("vj,jde->vde", arrays["weights"], np.array(world))
    return np.einsum("vde,ve->vd", blends, np.column_stack([posed, np.ones(V)]))[:, :3]


def test_metres_become_millimetres_and_landmarks_are_points_within_triangles(
    tmp_path, arrays, embedding
):
    file = write(tmp_path, arrays, embedding, "a/b/flame2023.pkl")
    model = load_model("flame", tmp_path, "ibug51")
    offsets = np.moveaxis(arrays["shapedirs"], -1, 0) * 1000
    np.testing.assert_allclose(model.mean[:V], arrays["v_template"] * 1000)
    np.testing.assert_allclose(model.identity_basis_times_sd[:, :V], offsets[:300], rtol=1e-6)
    np.testing.assert_allclose(model.expression_basis[:100, :V], offsets[300:], rtol=1e-6)
    assert model.expression_names[99:] == ("expression_100", "jaw_x", "jaw_y", "jaw_z")
    np.testing.assert_array_equal(model.triangles, arrays["f"])
    rng = np.random.default_rng(0)
    faces = model.shape(rng.normal(size=(3, 300)), rng.normal(size=(3, 103)))
    corners = faces[:, arrays["f"][embedding["lmk_face_idx"]]]
    expected = np.einsum("lc,nlcd->nld", embedding["lmk_b_coords"], corners)
    np.testing.assert_allclose(faces[:, model.landmarks["ibug51"]], expected, atol=1e-4)
    both = file.read_bytes() + (tmp_path / "flame_static_embedding.pkl").read_bytes()
    assert model.sha256 == hashlib.sha256(both).hexdigest()


def test_the_prior_of_the_expressions_is_that_of_principal_components(tmp_path, arrays, embedding):
    model = load_flame(write(tmp_path, arrays, embedding))
    assert model.expression_sd == 1  # not 0.3, as of blendshapes, though they have names
    pixels = model.shape(np.zeros(300), np.eye(103)[0])[model.landmarks["ibug51"], :2]
    fits = [
        LandmarkFitter(m, n_identity=5).fit(pixels).expression
        for m in (model, replace(model, expression_sd=1.0), replace(model, expression_sd=0.3))
    ]
    np.testing.assert_array_equal(fits[0], fits[1])
    assert np.abs(fits[0] - fits[2]).max() > 0.01


@pytest.mark.parametrize("layout", ["npz", 0, 2, 4])
def test_every_layout_makes_the_same_model(tmp_path, arrays, embedding, layout):
    plain = load_flame(write(tmp_path, arrays, embedding))
    arrays["f"] = arrays["f"][:, ::-1]  # wound inwards
    embedding["lmk_b_coords"] = embedding["lmk_b_coords"][:, ::-1]
    older = {"v_template": "default_v", "J_regressor": "joint_regressor", "posedirs": "blendshapes"}
    arrays = {older.get(key, key): value for key, value in arrays.items()}
    if layout == "npz":
        write(tmp_path, arrays, embedding)
        arrays["joint_regressor"] = arrays["joint_regressor"].toarray()
        np.savez(tmp_path / "o.npz", **arrays)
        other = load_flame(tmp_path / "o.npz")
    else:
        arrays["joint_regressor"] = coo_matrix(arrays["joint_regressor"])
        chumpy = ("default_v", "shapedirs", "blendshapes", "weights")
        other = load_flame(write(tmp_path, arrays, embedding, "o.pkl", layout, chumpy))
    for field in ("mean", "identity_basis_times_sd", "expression_basis", "triangles"):
        np.testing.assert_allclose(getattr(other, field), getattr(plain, field), atol=1e-6)


def test_faces_are_those_of_a_plain_evaluation(tmp_path, arrays, embedding):
    pose = np.random.default_rng(0).normal(size=(4, 5, 3)) * 0.3
    pose[0] = 0
    faces = skin(read_flame(write(tmp_path, arrays, embedding)), pose)
    expected = [reference_face(arrays, one) * 1000 for one in pose]
    np.testing.assert_allclose(faces, expected, atol=1e-4)


@pytest.mark.parametrize("angle", [0.05, 0.1, 0.2])
@pytest.mark.parametrize("axis", range(3))
def test_the_linear_jaw_misses_the_true_one_by_half_the_angle(
    tmp_path, arrays, embedding, angle, axis
):
    model = load_flame(write(tmp_path, arrays, embedding))
    linear = model.expression_basis[100 + axis, :V] * angle / 0.1
    pose = np.zeros((5, 3))
    pose[2, axis] = angle
    true = (reference_face(arrays, pose) - arrays["v_template"]) * 1000
    lever = np.delete(arrays["v_template"] - JAW_JOINT, axis, axis=1)
    chin = arrays["weights"][:, 2] == 1
    turning = chin & (np.linalg.norm(lever, axis=1) > 0.03)
    assert turning.sum() > 5
    miss = np.linalg.norm(linear - true, axis=1) / np.linalg.norm(true, axis=1)
    assert 0.4 * angle < miss[turning].min() and miss[turning].max() < 0.6 * angle
    front = chin & (arrays["v_template"][:, 2] > 0.03)
    assert axis != 0 or (front.any() and (linear[front, 1] < 0).all())  # jaw_x opens the mouth


@pytest.mark.parametrize(
    ("key", "change", "message"),
    [
        ("v_template", lambda a: a * 1000, "v_template must be a head in metres"),
        ("shapedirs", lambda a: a[..., :300], r"shapedirs are numbers \(60, 3, 400\)"),
        ("weights", lambda a: a * 2, "weights must not be negative, and sum to 1"),
        ("f", lambda a: a + 1, "triangles must number 60 vertices from 0"),
        ("kintree_table", lambda a: a[:, [0, 2, 1, 3, 4]], "kintree_table must give"),
    ],
)
def test_bad_contents_are_refused(tmp_path, arrays, embedding, key, change, message):
    arrays[key] = change(arrays[key])
    with pytest.raises(InputError, match=f"generic_model.pkl: .*({message})"):
        load_flame(write(tmp_path, arrays, embedding))


@pytest.mark.parametrize(
    ("key", "change"),
    [
        ("lmk_face_idx", None),
        ("lmk_face_idx", lambda a: a[:50]),
        ("lmk_face_idx", lambda a: a.astype(float)),
        ("lmk_face_idx", lambda a: a + 1000),
        ("lmk_b_coords", lambda a: a * 2),
        ("lmk_b_coords", lambda a: a - [1, -1, 0]),
        ("lmk_b_coords", lambda a: "text"),
    ],
)
def test_a_bad_embedding_is_refused(tmp_path, arrays, embedding, key, change):
    value = embedding.pop(key)
    if change:
        embedding[key] = change(value)
    with pytest.raises(InputError, match="flame_static_embedding.pkl"):
        load_flame(write(tmp_path, arrays, embedding))


def test_of_68_landmarks_the_last_51_count_and_a_missing_embedding_is_named(
    tmp_path, arrays, embedding
):
    more = {key: np.concatenate([a[:17], a]) for key, a in embedding.items()}
    file = write(tmp_path, arrays, more)
    loaded = load_embedding(file)
    np.testing.assert_array_equal(loaded.triangles, embedding["lmk_face_idx"])
    np.testing.assert_array_equal(loaded.weights, embedding["lmk_b_coords"])
    (tmp_path / "flame_static_embedding.pkl").unlink()
    with pytest.raises(InputError, match="flame_static_embedding.pkl.*TimoBolkart/TF_FLAME"):
        load_flame(file)


@pytest.mark.skipif(not (SHARED / "tf_flame").is_dir(), reason="../shared/tf_flame is absent")
def test_the_public_embedding_lies_on_the_public_template():
    vertices, triangles = read_ply(SHARED / "tf_flame" / "template.ply")
    points = load_embedding(SHARED / "tf_flame").points(vertices, triangles) * 1000
    assert points.shape == (51, 3)
    np.testing.assert_allclose(points[13], [0.3, -9.4, 75.8], atol=0.1)  # the tip of the nose
    assert points[:5, 0].max() < 0 < points[5:10, 0].min()  # brows, the right one first
