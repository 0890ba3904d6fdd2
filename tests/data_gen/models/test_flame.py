"""FLAME as users have it: known values come back, the jaw turns, and bad files are refused."""

import hashlib
import os
import pickle

import numpy as np
import pytest
from places import SHARED
from scipy.linalg import expm
from scipy.sparse import coo_matrix, csc_matrix
from scipy.spatial import ConvexHull
from writers.pickles import chumpy_pickle

from data_gen.formats.ply import read_ply
from data_gen.models.flame import Flame, load_flame, read_flame, skin
from data_gen.models.flame_embedding import load_embedding
from deepmds_keras.errors import InputError

TF_FLAME = SHARED / "tf_flame"
needs_shared = pytest.mark.skipif(not TF_FLAME.is_dir(), reason="../shared/tf_flame is absent")
V = 60  # vertices of the synthetic head, a ball of 10 cm
JAW_JOINT = np.array([0, -0.02, 0.0])


@pytest.fixture(scope="module")
def ball():
    """Vertices in metres, and triangles counter-clockwise from outside."""
    direction = np.random.default_rng(0).normal(size=(V, 3))
    vertices = 0.1 * direction / np.linalg.norm(direction, axis=1, keepdims=True)
    triangles = ConvexHull(vertices).simplices
    a, b, c = vertices[triangles.T]
    inwards = np.einsum("td,td->t", np.cross(b - a, c - a), a + b + c) < 0
    triangles[inwards] = triangles[inwards][:, ::-1]
    return vertices, triangles


@pytest.fixture
def arrays(ball):
    """`generic_model.pkl` in its layout, on another mesh."""
    rng = np.random.default_rng(1)
    vertices, triangles = ball
    weights = rng.dirichlet(np.ones(5), V)
    weights[vertices[:, 1] < -0.05] = np.eye(5)[2]  # the chin follows the jaw
    regressor = rng.dirichlet(np.ones(V), 5)
    regressor[2] = regressor_of(vertices, JAW_JOINT)
    return {
        "v_template": vertices,
        "f": triangles.astype(np.uint32),
        "shapedirs": rng.normal(size=(V, 3, 400)) * 1e-3,
        "posedirs": rng.normal(size=(V, 3, 36)) * 1e-5,
        "J_regressor": csc_matrix(regressor),
        "J": regressor @ vertices,
        "kintree_table": np.array([[2**32 - 1, 0, 1, 1, 1], range(5)], np.uint32),
        "weights": weights,
        "bs_style": "lbs",
        "bs_type": "lrotmin",
    }


@pytest.fixture
def embedding(ball):
    rng = np.random.default_rng(2)
    faces = rng.integers(0, len(ball[1]), 51).astype(np.uint32)
    return {"lmk_face_idx": faces, "lmk_b_coords": rng.dirichlet(np.ones(3), 51)}


def regressor_of(vertices, point):
    """Weights that sum to 1 of vertices whose weighted mean is a point."""
    system = np.vstack([vertices.T, np.ones(V)])
    return np.linalg.lstsq(system, np.append(point, 1), rcond=None)[0]


def write(folder, arrays, embedding, name="generic_model.pkl", protocol=2, chumpy=()):
    """The two files; some arrays as objects of chumpy, which is not there when they are read."""
    (folder / "flame_static_embedding.pkl").write_bytes(pickle.dumps(embedding, 0))
    (folder / name).parent.mkdir(parents=True, exist_ok=True)
    (folder / name).write_bytes(
        chumpy_pickle(
            lambda ch: {key: ch(x=a) if key in chumpy else a for key, a in arrays.items()}, protocol
        )
    )
    return folder / name


def reference_face(arrays, shape, pose, translation):
    """One face by homogeneous matrices, joint by joint and vertex by vertex, in metres."""
    at_rest = arrays["v_template"] + arrays["shapedirs"][..., : len(shape)] @ shape
    joints = arrays["J_regressor"].toarray() @ at_rest
    rotations = [expm(np.cross(np.eye(3), turn)) for turn in pose]
    features = np.concatenate([(rotation - np.eye(3)).ravel() for rotation in rotations[1:]])
    posed = at_rest + arrays["posedirs"] @ features
    world = []
    for joint, parent in enumerate(arrays["kintree_table"][0].astype(int)):
        local = np.eye(4)
        local[:3, :3] = rotations[joint]
        local[:3, 3] = joints[joint] - (joints[parent] if joint else 0)
        world.append(world[parent] @ local if joint else local)
    for joint in range(5):
        world[joint] = world[joint] @ np.block(
            [[np.eye(3), -joints[joint][:, None]], [np.zeros((1, 3)), 1]]
        )
    face = np.empty((V, 3))
    for vertex in range(V):
        blend = sum(arrays["weights"][vertex, joint] * world[joint] for joint in range(5))
        face[vertex] = (blend @ np.append(posed[vertex], 1))[:3]
    return face + translation


class TestModel:
    def test_metres_become_millimetres_and_bases_are_split(self, tmp_path, arrays, embedding):
        model = load_flame(write(tmp_path, arrays, embedding))
        offsets = np.moveaxis(arrays["shapedirs"], -1, 0) * 1000
        np.testing.assert_allclose(model.mean[:V], arrays["v_template"] * 1000)
        np.testing.assert_allclose(model.identity_basis_times_sd[:, :V], offsets[:300], rtol=1e-6)
        np.testing.assert_allclose(model.expression_basis[:100, :V], offsets[300:], rtol=1e-6)
        assert model.name == "flame"
        assert model.expression_names[:2] == ("expression_001", "expression_002")
        assert model.expression_names[99:] == ("expression_100", "jaw_x", "jaw_y", "jaw_z")
        assert model.expression_basis.shape == (103, V + 51, 3)

    def test_landmarks_of_any_face_are_points_within_its_triangles(
        self, tmp_path, arrays, embedding
    ):
        model = load_flame(write(tmp_path, arrays, embedding))
        rng = np.random.default_rng(0)
        faces = model.shape(rng.normal(size=(3, 300)), rng.normal(size=(3, 103)))
        corners = arrays["f"][embedding["lmk_face_idx"]]
        for face in faces:
            for landmark, vertex in enumerate(model.landmarks["ibug51"]):
                expected = embedding["lmk_b_coords"][landmark] @ face[corners[landmark]]
                np.testing.assert_allclose(face[vertex], expected, atol=1e-4)
        assert model.triangles.max() < V <= model.landmarks["ibug51"].min()

    def test_triangles_face_outwards_and_landmarks_stay_with_their_corners(
        self, tmp_path, arrays, embedding
    ):
        outwards = load_flame(write(tmp_path, arrays, embedding))
        np.testing.assert_array_equal(outwards.triangles, arrays["f"])
        arrays["f"] = arrays["f"][:, ::-1]
        embedding["lmk_b_coords"] = embedding["lmk_b_coords"][:, ::-1]
        turned = load_flame(write(tmp_path, arrays, embedding))
        np.testing.assert_array_equal(turned.triangles, outwards.triangles)
        np.testing.assert_allclose(turned.mean, outwards.mean)

    @pytest.mark.parametrize("protocol", [0, 2, 4])
    def test_chumpy_objects_sparse_and_old_names_make_the_same_model(
        self, tmp_path, arrays, embedding, protocol
    ):
        plain = load_flame(write(tmp_path, arrays, embedding))
        older = {"v_template": "default_v", "J_regressor": "joint_regressor"}
        older |= {"posedirs": "blendshapes", "J": "joints"}
        arrays = {older.get(key, key): value for key, value in arrays.items()}
        arrays["joint_regressor"] = coo_matrix(arrays["joint_regressor"])
        chumpy = ("default_v", "shapedirs", "blendshapes", "weights")
        other = load_flame(write(tmp_path, arrays, embedding, "o.pkl", protocol, chumpy))
        for field in ("mean", "identity_basis_times_sd", "expression_basis", "triangles"):
            np.testing.assert_array_equal(getattr(other, field), getattr(plain, field))

    def test_the_npz_and_the_pickle_agree(self, tmp_path, arrays, embedding):
        plain = load_flame(write(tmp_path, arrays, embedding))
        arrays["J_regressor"] = arrays["J_regressor"].toarray()
        np.savez(tmp_path / "flame.npz", **arrays)
        other = load_flame(tmp_path / "flame.npz")
        np.testing.assert_array_equal(other.expression_basis, plain.expression_basis)
        np.testing.assert_array_equal(other.mean, plain.mean)

    @pytest.mark.parametrize(
        "name", ["generic_model.pkl", "FLAME2020/generic_model.pkl", "FLAME2023/flame2023.pkl"]
    )
    def test_the_model_is_found_in_a_folder_and_the_embedding_above_it(
        self, tmp_path, arrays, embedding, name
    ):
        write(tmp_path, arrays, embedding, name)
        assert load_flame(tmp_path).n_vertices == V + 51

    def test_the_hash_is_of_both_files(self, tmp_path, arrays, embedding):
        file = write(tmp_path, arrays, embedding)
        digest = hashlib.sha256(file.read_bytes())
        digest.update((tmp_path / "flame_static_embedding.pkl").read_bytes())
        assert load_flame(file).sha256 == digest.hexdigest()


class TestSkin:
    @pytest.fixture
    def flame(self, tmp_path, arrays, embedding):
        return read_flame(write(tmp_path, arrays, embedding))

    def test_faces_are_those_of_a_plain_evaluation(self, flame, arrays):
        rng = np.random.default_rng(0)
        shape, pose = rng.normal(size=(4, 400)), rng.normal(size=(4, 5, 3)) * 0.3
        translation = rng.normal(size=(4, 3)) * 50
        pose[0] = 0
        faces = skin(flame, shape, pose, translation)
        expected = [
            reference_face(arrays, *one)
            for one in zip(shape, pose, translation / 1000, strict=True)
        ]
        np.testing.assert_allclose(faces, np.array(expected) * 1000, atol=1e-4)

    def test_without_pose_faces_are_those_of_the_linear_model(self, tmp_path, flame):
        model = load_flame(tmp_path)
        rng = np.random.default_rng(0)
        identity, expression = rng.normal(size=(2, 300)), rng.normal(size=(2, 100))
        faces = skin(flame, np.hstack([identity, expression]), np.zeros((2, 5, 3)))
        np.testing.assert_allclose(faces, model.shape(identity, expression)[:, :V], atol=1e-4)

    def test_the_root_turns_the_face_as_a_whole(self, flame):
        pose = np.zeros((1, 5, 3))
        pose[0, 0] = [0.3, -0.8, 0.4]
        turned, rest = skin(flame, np.zeros((1, 0)), pose)[0], flame.template
        spread = [np.linalg.norm(x[:, None] - x, axis=-1) for x in (turned, rest)]
        np.testing.assert_allclose(*spread, atol=1e-9)
        assert np.abs(turned - rest).max() > 50

    def test_jaw_x_opens_the_mouth(self, tmp_path, arrays, flame):
        model = load_flame(tmp_path)
        chin = (arrays["weights"][:, 2] == 1) & (arrays["v_template"][:, 2] > 0.03)
        assert chin.any()
        jaw_x = model.expression_basis[model.expression_names.index("jaw_x"), :V]
        assert (jaw_x[chin, 1] < -2).all()

    @pytest.mark.parametrize(
        ("angle", "low", "high"), [(0.05, 0.02, 0.03), (0.1, 0.045, 0.055), (0.2, 0.09, 0.11)]
    )
    @pytest.mark.parametrize("axis", range(3))
    def test_the_linear_jaw_misses_the_true_one_by_half_the_angle(
        self, tmp_path, arrays, flame, angle, low, high, axis
    ):
        pose = np.zeros((1, 5, 3))
        pose[0, 2, axis] = angle
        true = skin(flame, np.zeros((1, 0)), pose)[0] - flame.template
        linear = load_flame(tmp_path).expression_basis[100 + axis, :V] * angle / 0.1
        lever = np.delete(arrays["v_template"] - JAW_JOINT, axis, axis=1)
        turning = (arrays["weights"][:, 2] == 1) & (np.linalg.norm(lever, axis=1) > 0.03)
        assert turning.sum() > 5
        miss = np.linalg.norm(linear - true, axis=1) / np.linalg.norm(true, axis=1)
        assert low < miss[turning].min() and miss[turning].max() < high

    def test_other_numbers_of_joints_and_coefficients_are_refused(self, flame):
        with pytest.raises(InputError, match="at most 400 coefficients a face. Received 401"):
            skin(flame, np.zeros((1, 401)), np.zeros((1, 5, 3)))
        for shape in ((1, 4, 3), (2, 5, 3), (1, 15)):
            with pytest.raises(InputError, match=r"pose must be \(1, 5, 3\). Received"):
                skin(flame, np.zeros((1, 10)), np.zeros(shape))


class TestBadFiles:
    @pytest.mark.parametrize(
        ("key", "change", "message"),
        [
            ("v_template", None, "must be FLAME.*Received no v_template"),
            ("weights", None, "must be FLAME.*Received no weights"),
            ("v_template", lambda a: a[:-1], r"f must number|must be numbers \(59"),
            ("v_template", lambda a: a * 1000, "v_template must be a head in metres"),
            ("v_template", lambda a: a[:0], "v_template must be numbers"),
            ("v_template", lambda a: [[1], [2, 3]], "v_template must be numbers.*Received list"),
            ("v_template", lambda a: np.where(a > 0.05, np.nan, a), "v_template must be finite"),
            ("shapedirs", lambda a: a[..., :300], r"shapedirs must be numbers \(60, 3, 400\)"),
            ("posedirs", lambda a: a[..., :27], r"posedirs must be numbers \(60, 3, 36\)"),
            ("posedirs", lambda a: {"a": 1}, "posedirs must be numbers.*Received dict"),
            ("weights", lambda a: a * 2, "weights must not be negative, and sum to 1"),
            ("weights", lambda a: a - np.eye(5)[[0] * V] + np.eye(5)[[1] * V], "weights must not"),
            ("J_regressor", lambda a: a[:4], r"J_regressor must be numbers \(5, 60\)"),
            ("J_regressor", lambda a: csc_matrix((5, 10**5)), "J_regressor must be numbers"),
            ("f", lambda a: a + 1, "f must number 60 vertices from 0.*Received uint32, from 1"),
            ("f", lambda a: a.astype(float), "f must number 60 vertices from 0.*Received float64"),
            ("f", lambda a: a.astype(int) - 1, "f must number 60 vertices from 0.*from -1"),
            ("f", lambda a: np.hstack([a, a]), r"f must be numbers \(116, 3\)"),
            ("kintree_table", lambda a: a[::-1], "kintree_table must give each joint's parent"),
            ("kintree_table", lambda a: a * 0, "kintree_table must give each joint's parent"),
            ("kintree_table", lambda a: a[:, [0, 2, 1, 3, 4]], "kintree_table must give"),
        ],
    )
    def test_bad_contents_are_refused(self, tmp_path, arrays, embedding, key, change, message):
        value = arrays.pop(key)
        if change:
            arrays[key] = change(value)
        with pytest.raises(InputError, match=f"generic_model.pkl: .*({message})"):
            load_flame(write(tmp_path, arrays, embedding))

    @pytest.mark.parametrize("sentinel", [np.int64(-1), np.int64(2**32 - 1), np.uint64(2**64 - 1)])
    def test_any_sign_of_no_parent_is_known(self, tmp_path, arrays, embedding, sentinel):
        table = arrays["kintree_table"].astype(sentinel.dtype)
        table[0, 0] = sentinel
        flame = read_flame(write(tmp_path, arrays | {"kintree_table": table}, embedding))
        assert isinstance(flame, Flame)
        assert flame.parents.tolist() == [-1, 0, 1, 1, 1]

    def test_a_hostile_pickle_is_refused_and_never_run(self, tmp_path, arrays, embedding):
        class Hostile:
            def __reduce__(self):
                return os.mkdir, (str(tmp_path / "harm"),)

        file = write(tmp_path, arrays | {"bs_style": Hostile()}, embedding)
        with pytest.raises(InputError, match="generic_model.pkl: .*mkdir.*nothing was run"):
            load_flame(file)
        assert not (tmp_path / "harm").exists()

    def test_objects_in_an_npz_and_a_truncated_npz_are_refused(self, tmp_path, arrays, embedding):
        write(tmp_path, arrays, embedding, "elsewhere.pkl")
        file = tmp_path / "flame.npz"
        arrays["J_regressor"] = np.array(arrays["J_regressor"], object)
        np.savez(file, **arrays)
        with pytest.raises(InputError, match="flame.npz must be an npz file of plain arrays"):
            load_flame(file)
        os.truncate(file, file.stat().st_size // 2)
        with pytest.raises(InputError, match="flame.npz: must be"):
            load_flame(file)

    def test_without_the_embedding_the_message_names_it_and_its_source(
        self, tmp_path, arrays, embedding
    ):
        file = write(tmp_path, arrays, embedding)
        (tmp_path / "flame_static_embedding.pkl").unlink()
        match = "must hold flame_static_embedding.pkl.*github.com/TimoBolkart/TF_FLAME"
        with pytest.raises(InputError, match=match):
            load_flame(file)

    def test_an_embedding_of_another_mesh_is_refused(self, tmp_path, arrays, embedding):
        embedding["lmk_face_idx"][7] = len(arrays["f"])
        match = "generic_model.pkl: .*at least 117. Received 116.*flame_static_embedding.pkl"
        with pytest.raises(InputError, match=match):
            load_flame(write(tmp_path, arrays, embedding))


class TestEmbedding:
    @pytest.mark.parametrize(
        ("changes", "message"),
        [
            ({"lmk_face_idx": None}, "lmk_face_idx must be 51 or 68 triangle numbers"),
            ({"lmk_face_idx": np.arange(50)}, "lmk_face_idx must be 51 or 68"),
            ({"lmk_face_idx": np.arange(51) - 1}, "lmk_face_idx must be 51 or 68.*from -1"),
            ({"lmk_face_idx": np.arange(51.0)}, "lmk_face_idx must be 51 or 68.*float64"),
            ({"lmk_b_coords": [1, 2]}, r"lmk_b_coords must be of shape \(51, 3\). Received list"),
            ({"lmk_b_coords": np.ones((51, 2)) / 2}, "lmk_b_coords must be of shape"),
            ({"lmk_b_coords": np.ones((51, 3)) * 0.33}, "lmk_b_coords must not be negative"),
            ({"lmk_b_coords": np.tile([1.5, -0.5, 0], (51, 1))}, "lmk_b_coords must not be neg"),
            ({"lmk_b_coords": np.full((51, 3), np.nan)}, "lmk_b_coords must not be negative"),
        ],
    )
    def test_bad_contents_are_refused(self, tmp_path, embedding, changes, message):
        file = tmp_path / "flame_static_embedding.pkl"
        file.write_bytes(pickle.dumps(embedding | changes))
        with pytest.raises(InputError, match=f"flame_static_embedding.pkl: {message}"):
            load_embedding(tmp_path)

    def test_the_last_51_of_68_are_taken(self, tmp_path, embedding):
        longer = {
            "lmk_face_idx": np.append(np.arange(17), embedding["lmk_face_idx"]),
            "lmk_b_coords": np.vstack([np.tile([1.0, 0, 0], (17, 1)), embedding["lmk_b_coords"]]),
        }
        (tmp_path / "flame_static_embedding_68.pkl").write_bytes(pickle.dumps(longer))
        found = load_embedding(tmp_path)
        np.testing.assert_array_equal(found.triangles, embedding["lmk_face_idx"])
        np.testing.assert_array_equal(found.weights, embedding["lmk_b_coords"])

    @needs_shared
    def test_the_public_embedding_on_the_public_template(self):
        """Figures measured apart from this program on TF_FLAME's files, millimetres."""
        vertices, triangles = read_ply(TF_FLAME / "template.ply")
        assert vertices.shape == (5023, 3) and triangles.shape == (9976, 3)
        points = load_embedding(TF_FLAME).points(vertices * 1000, triangles)
        np.testing.assert_allclose(np.ptp(points, axis=0), [114.7, 94.2, 57.4], atol=0.05)
        assert np.linalg.norm(points[19] - points[28]) == pytest.approx(91.5, abs=0.05)
        assert points.max() - points.min() == pytest.approx(133.1, abs=0.05)
        assert points[:5, 0].max() < 0 < points[5:10, 0].min()  # the subject's right brow first

    @needs_shared
    def test_points_of_many_meshes_are_those_of_each(self):
        vertices, triangles = read_ply(TF_FLAME / "template.ply")
        embedding = load_embedding(TF_FLAME / "flame_static_embedding.pkl")
        many = np.stack([vertices, 2 * vertices + 1])[:, None]
        found = embedding.points(many, triangles)
        assert found.shape == (2, 1, 51, 3)
        np.testing.assert_allclose(found[0, 0], embedding.points(vertices, triangles))
        np.testing.assert_allclose(found[1, 0], 2 * found[0, 0] + 1)
