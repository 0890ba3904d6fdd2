"""Face model files as users have them: known values come back, and bad files are refused."""

import hashlib
import json
import os
import pickle
import shutil

import numpy as np
import pytest
from places import SHARED
from writers.models import write_h5, write_ict_folder, write_ict_npz, write_mat, write_obj

from data_gen.landmarks import load_basel_anchors, load_vertices
from data_gen.models import ict
from data_gen.models.bfm2009 import load_bfm2009
from data_gen.models.bfm2017 import load_bfm2017
from data_gen.models.ict import load_ict
from data_gen.models.openhead import load_openhead
from data_gen.models.registry import MODELS, load_model
from deepmds_keras.errors import InputError

K = 5  # components of the synthetic models
SD = np.array([50.0, 20.0, 9.0, 4.0, 1.0])  # mm; unlike its own square everywhere but at the end


@pytest.fixture(scope="module")
def head():
    return load_openhead()


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
    means = {"shape": head.mean.ravel(), "expression": np.full(head.mean.size, 0.25)}
    means["color"] = np.full(head.mean.size, 0.2)
    for group, mean in means.items():
        arrays[f"{group}/model/mean"] = mean.astype(np.float32)
        arrays[f"{group}/model/pcaBasis"] = columns
        arrays[f"{group}/model/pcaVariance"] = (SD**2).astype(np.float32)
        arrays[f"{group}/model/noiseVariance"] = np.zeros(1, np.float32)
    return arrays


@pytest.fixture
def ict_arrays():
    """A cube of quads in ICT's layout, centimetres; vertices 8 and 9 belong to no face."""
    corners = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], float)
    rng = np.random.default_rng(0)
    vertices = np.concatenate([corners, [[0, 0, 0], [0.5, 0, 0]]])
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    return {
        "mean": vertices,
        "identity": rng.normal(size=(100, 10, 3)).round(4),
        "expression": rng.normal(size=(2, 10, 3)).round(4),
        "expression_names": ["browDown_L", "jawOpen"],
        "quads": quads,
    }


class TestBfm2009:
    def test_values_come_back_in_millimetres_and_standard_deviations(
        self, tmp_path, head, columns, mat_arrays
    ):
        write_mat(tmp_path, mat_arrays)
        model = load_bfm2009(tmp_path)
        assert model.name == "bfm2009"
        np.testing.assert_allclose(model.mean, head.mean, atol=1e-4)
        np.testing.assert_allclose(model.identity_basis_times_sd, offsets(columns), atol=1e-5)
        assert model.identity_basis_times_sd.dtype == np.float32
        norms = np.linalg.norm(model.identity_basis_times_sd.reshape(K, -1), axis=1)
        np.testing.assert_allclose(norms, SD, rtol=1e-4)
        np.testing.assert_allclose(model.colour_mean, 0.2, rtol=1e-6)
        norms = np.linalg.norm(model.colour_basis_times_sd.reshape(K, -1), axis=1)
        np.testing.assert_allclose(norms, 0.1, rtol=1e-4)

    def test_triangles_count_from_0_and_turn_outwards(self, tmp_path, head, mat_arrays):
        model = load_bfm2009(write_mat(tmp_path, mat_arrays))
        assert triangle_cycles(model.triangles) == triangle_cycles(head.triangles)

    def test_landmarks_are_given_for_the_full_mesh_only(self, tmp_path, mat_arrays):
        assert load_bfm2009(write_mat(tmp_path, mat_arrays)).landmarks == {}
        n = 53490
        full = {
            "shapeMU": np.random.default_rng(0).normal(size=(3 * n, 1)).astype(np.float32),
            "shapePC": np.ones((3 * n, 1), np.float32),
            "shapeEV": np.ones((1, 1), np.float32),
            "tl": np.array([[1, 2, n]]),
        }
        full |= {f"tex{key[5:]}": full[key] for key in ("shapeMU", "shapePC", "shapeEV")}
        model = load_model("bfm2009", write_mat(tmp_path, full).parent)
        expected = load_vertices("bfm72").vertices["bfm2009"]
        np.testing.assert_array_equal(model.landmarks["bfm72"], expected)

    @pytest.mark.parametrize("key", ["shapeMU", "shapePC", "shapeEV", "texMU", "tl"])
    def test_a_missing_key_is_named(self, tmp_path, mat_arrays, key):
        del mat_arrays[key]
        with pytest.raises(InputError, match=f"01_MorphableModel.mat: .* without {key}"):
            load_bfm2009(write_mat(tmp_path, mat_arrays))

    @pytest.mark.parametrize(
        ("key", "change", "message"),
        [
            ("shapeMU", lambda a: a[:-1], "shapeMU, shapePC, shapeEV must have shapes"),
            ("shapePC", lambda a: a[:-3], "shapeMU, shapePC, shapeEV must have shapes"),
            ("shapeEV", lambda a: a[:-1], "shapeMU, shapePC, shapeEV must have shapes"),
            ("texEV", lambda a: a[:-1], "texMU, texPC, texEV must have shapes"),
            ("tl", lambda a: a - 1, "count the 3765 vertices from 1. .* from 0 to 3764"),
            ("tl", lambda a: a + 1, "count the 3765 vertices from 1. .* from 2 to 3766"),
            ("tl", lambda a: a[:, :2], r"must be \(T, 3\)"),
            ("tl", lambda a: a[:0], r"must be \(T, 3\)"),
            ("shapePC", lambda a: a * np.nan, "bfm2009: identity_basis_times_sd must be finite"),
            ("shapeEV", lambda a: np.array([{"a": 1}], object), "shapeEV must be an array of num"),
        ],
    )
    def test_sizes_that_disagree_are_refused(self, tmp_path, mat_arrays, key, change, message):
        mat_arrays[key] = change(mat_arrays[key])
        with pytest.raises(InputError, match=f"01_MorphableModel.mat: .*{message}"):
            load_bfm2009(write_mat(tmp_path, mat_arrays))

    def test_a_truncated_file_is_refused(self, tmp_path, mat_arrays):
        file = write_mat(tmp_path, mat_arrays)
        os.truncate(file, file.stat().st_size // 2)
        with pytest.raises(InputError, match="must be a whole MATLAB file"):
            load_bfm2009(file)

    def test_matlab_7_3_is_refused_by_name(self, tmp_path):
        file = tmp_path / "01_MorphableModel.mat"
        file.write_bytes(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(512) + b"\x89HDF\r\n")
        with pytest.raises(InputError, match=r"Received v7.3 \(HDF5\)"):
            load_bfm2009(file)


class TestBfm2017:
    def test_values_come_back_with_the_variance_rooted(self, tmp_path, head, columns, h5_arrays):
        write_h5(tmp_path, h5_arrays)
        model = load_bfm2017(tmp_path)
        np.testing.assert_allclose(model.mean, head.mean, atol=1e-4)
        np.testing.assert_allclose(model.identity_basis_times_sd, offsets(columns), atol=1e-5)
        np.testing.assert_allclose(model.expression_basis, offsets(columns), atol=1e-5)
        np.testing.assert_allclose(model.expression_mean, 0.25)
        np.testing.assert_allclose(model.colour_mean, 0.2, rtol=1e-6)
        assert triangle_cycles(model.triangles) == triangle_cycles(head.triangles)

    def test_the_neutral_face_leaves_the_expression_mean_out(self, tmp_path, h5_arrays):
        model = load_bfm2017(write_h5(tmp_path, h5_arrays))
        np.testing.assert_array_equal(model.shape(np.zeros(K)), model.mean)
        smiling = model.shape(np.zeros(K), np.zeros(K))
        np.testing.assert_allclose(smiling, model.mean + 0.25)

    def test_landmarks_are_found_by_the_names_in_the_file(self, tmp_path, head, h5_arrays):
        model = load_model("bfm2017", write_h5(tmp_path, h5_arrays))
        on_skin = np.setdiff1d(np.arange(72), [4, 53])  # the pupils are not on the skin
        np.testing.assert_array_equal(
            model.landmarks["bfm72"][on_skin], head.landmarks["bfm72"][on_skin]
        )

    def test_names_are_read_as_bytes_and_characters_too(self, tmp_path, h5_arrays):
        text = h5_arrays["metadata/landmarks/json"]
        found = []
        for value in (text, np.bytes_(text), np.frombuffer(text.encode(), np.uint8), [text]):
            h5_arrays["metadata/landmarks/json"] = value
            found.append(load_bfm2017(write_h5(tmp_path, h5_arrays)).landmarks["bfm72"])
        assert all((f == found[0]).all() for f in found)

    def test_bfm2019_is_found_by_its_own_file_name(self, tmp_path, h5_arrays):
        write_h5(tmp_path, h5_arrays, "model2019_bfm.h5")
        assert load_model("bfm2019", tmp_path).name == "bfm2019"
        with pytest.raises(InputError, match="model2017-1_bfm_nomouth.h5"):
            load_model("bfm2017", tmp_path)

    def test_without_known_landmarks_the_model_has_none(self, tmp_path, h5_arrays):
        del h5_arrays["metadata/landmarks/json"]
        file = write_h5(tmp_path, h5_arrays)
        assert load_bfm2017(file).landmarks == {}
        with pytest.raises(InputError, match="landmarks bfm72 are known. Received one of 3765"):
            load_model("bfm2017", file)

    def test_colour_and_expression_may_be_absent(self, tmp_path, h5_arrays):
        shape_only = {k: v for k, v in h5_arrays.items() if not k.startswith(("color", "expr"))}
        model = load_bfm2017(write_h5(tmp_path, shape_only))
        assert model.expression_basis is None and model.colour_mean is None

    @pytest.mark.parametrize(
        ("key", "change", "message"),
        [
            ("shape/model/pcaBasis", None, "an array of numbers shape/model/pcaBasis"),
            ("shape/representer/cells", None, "an array of numbers shape/representer/cells"),
            ("shape/model/mean", lambda a: a[:-3], "shape/model mean, pcaBasis, pcaVariance must"),
            ("shape/model/pcaVariance", lambda a: a[1:], r"\(3n, k\)"),
            ("shape/model/pcaVariance", lambda a: -a, "must not be negative"),
            ("shape/representer/cells", lambda a: a.T, r"must be \(3, T\)"),
            ("shape/representer/cells", lambda a: a + 1, "count 3765 vertices from 0"),
            ("shape/representer/points", lambda a: a[:, 1:], r"must be \(3, 3765\)"),
            ("shape/model/mean", lambda a: "text", "an array of numbers shape/model/mean"),
            ("metadata/landmarks/json", lambda a: a[:-5], "must list id and coordinates"),
        ],
    )
    def test_bad_contents_are_refused(self, tmp_path, h5_arrays, key, change, message):
        value = h5_arrays.pop(key)
        if change:
            h5_arrays[key] = change(value)
        with pytest.raises(InputError, match=f"nomouth.h5: .*{message}"):
            load_bfm2017(write_h5(tmp_path, h5_arrays))

    def test_other_vertices_of_expression_are_refused(self, tmp_path, h5_arrays):
        for key in ("mean", "pcaBasis"):
            h5_arrays[f"expression/model/{key}"] = h5_arrays[f"expression/model/{key}"][:-3]
        with pytest.raises(InputError, match="expression/model must have the 3765 vertices"):
            load_bfm2017(write_h5(tmp_path, h5_arrays))

    def test_a_truncated_file_is_refused(self, tmp_path, h5_arrays):
        file = write_h5(tmp_path, h5_arrays)
        os.truncate(file, file.stat().st_size // 2)
        with pytest.raises(InputError, match="must be a whole HDF5 file"):
            load_bfm2017(file)

    def test_another_name_is_refused(self, tmp_path):
        with pytest.raises(InputError, match="bfm2017, bfm2019. Received 'bfm2020'"):
            load_bfm2017(tmp_path, "bfm2020")


class TestIct:
    def test_official_folder_and_compiled_file_agree(self, tmp_path, ict_arrays):
        write_ict_folder(tmp_path, ict_arrays)
        official = load_ict(tmp_path)
        compiled = load_ict(write_ict_npz(tmp_path, ict_arrays))
        np.testing.assert_allclose(official.mean, compiled.mean, atol=1e-5)
        for name in ("identity_basis_times_sd", "expression_basis"):
            np.testing.assert_allclose(getattr(official, name), getattr(compiled, name), atol=1e-4)
        assert official.expression_names == compiled.expression_names
        assert triangle_cycles(official.triangles) == triangle_cycles(compiled.triangles)

    def test_centimetres_become_millimetres_and_offsets_are_kept(self, tmp_path, ict_arrays):
        model = load_ict(write_ict_folder(tmp_path, ict_arrays))
        np.testing.assert_allclose(model.mean, ict_arrays["mean"] * 10)
        np.testing.assert_allclose(
            model.identity_basis_times_sd, ict_arrays["identity"] * 10, atol=1e-4
        )
        assert model.expression_names == ("browDown_L", "jawOpen")

    def test_quads_become_two_triangles_that_face_outwards(self, tmp_path, ict_arrays):
        model = load_ict(write_ict_folder(tmp_path, ict_arrays))
        assert model.triangles.shape == (12, 3)
        a, b, c = model.mean[model.triangles.T]
        normals = np.cross(b - a, c - a)
        assert (np.einsum("td,td->t", normals, a + b + c) > 0).all()
        assert np.linalg.norm(normals, axis=1).sum() / 2 == pytest.approx(6 * 20**2)

    def test_landmarks_follow_the_original_numbering_into_a_part_of_the_mesh(self, tmp_path):
        schemes = {name: load_vertices(name).vertices["ict"] for name in ("bfm72", "ibug68")}
        used = np.union1d(*schemes.values())
        mean = np.random.default_rng(0).normal(size=(len(used), 3)) + 5
        arrays = {
            "mean": mean,
            "identity": np.zeros((1, len(used), 3)),
            "expression": np.zeros((1, len(used), 3)),
            "expression_names": ["jawOpen"],
            "quads": [(0, 1, 2, 3)],
        }
        model = load_ict(write_ict_npz(tmp_path, arrays, vertex_index=used))
        for name, vertices in schemes.items():
            np.testing.assert_array_equal(used[model.landmarks[name]], vertices)

    def test_landmarks_of_the_official_folder_are_its_own(self, tmp_path, ict_arrays, monkeypatch):
        n = 26719
        ict_arrays |= {"mean": np.random.default_rng(0).normal(size=(n, 3)).round(3)}
        monkeypatch.setattr(ict, "N_IDENTITY", 1)
        ict_arrays |= {"identity": np.zeros((1, n, 3)), "expression": np.zeros((0, n, 3))}
        ict_arrays["expression_names"] = []
        folder = write_ict_folder(tmp_path, ict_arrays)
        official = load_vertices("ibug68").vertices["ict"].tolist()
        (folder / "vertex_indices.json").write_text(json.dumps({"idx_to_landmark_verts": official}))
        landmarks = load_model("ict", folder).landmarks
        assert landmarks["ibug68"].tolist() == official
        np.testing.assert_array_equal(landmarks["bfm72"], load_vertices("bfm72").vertices["ict"])
        other = {"idx_to_landmark_verts": official[::-1]}
        (folder / "vertex_indices.json").write_text(json.dumps(other))
        with pytest.raises(InputError, match="vertex_indices.json: .* Received others"):
            load_ict(folder)

    @pytest.mark.skipif(not SHARED.is_dir(), reason="../shared is absent")
    def test_the_real_compiled_file_has_its_own_landmarks(self):
        model = load_model("ict", SHARED)
        with np.load(SHARED / "ict-facekit" / "ict_light.npz") as file:
            np.testing.assert_array_equal(model.landmarks["bfm72"], file["landmarks72"])
            np.testing.assert_array_equal(model.landmarks["ibug68"], file["landmarks68"])
            np.testing.assert_array_equal(model.triangles, file["triangles"])
        canthi = model.mean[model.landmarks["ibug68"][[36, 45]]]
        assert np.linalg.norm(canthi[0] - canthi[1]) == pytest.approx(89.3, abs=0.5)

    def test_an_obj_of_another_mesh_is_refused(self, tmp_path, ict_arrays):
        folder = write_ict_folder(tmp_path, ict_arrays)
        write_obj(folder / "identity001.obj", ict_arrays["mean"][:-1])
        with pytest.raises(
            InputError, match="identity001.obj: must have the 10 vertices.*Received"
        ):
            load_ict(folder)

    @pytest.mark.parametrize(
        ("text", "message"),
        [
            ("v 1 2\n", "three coordinates a vertex"),
            ("v 1 2 x\n", "three coordinates a vertex"),
            ("hello\n", "must be an OBJ file with vertices. Received none"),
            ("v 1 2 3\nf 1 2 3\n", "must number 1 vertices from 0. Received 0 to 2"),
            ("v 1 2 3\nf 1 a 3\n", "faces must be vertex numbers"),
            ("v 1 2 3\n", "triangles must be"),
        ],
    )
    def test_a_malformed_obj_is_refused(self, tmp_path, ict_arrays, text, message):
        folder = write_ict_folder(tmp_path, ict_arrays)
        (folder / "generic_neutral_mesh.obj").write_text(text)
        with pytest.raises(InputError, match=f"generic_neutral_mesh.obj: .*{message}"):
            load_ict(folder)

    @pytest.mark.parametrize("missing", ["identity000", "identity057", "identity099"])
    def test_a_folder_without_one_of_its_identities_is_refused(self, tmp_path, ict_arrays, missing):
        folder = write_ict_folder(tmp_path, ict_arrays)
        (folder / f"{missing}.obj").unlink()
        with pytest.raises(InputError, match=f"identity000.obj to .* the name {missing}.obj"):
            load_ict(folder)

    @pytest.mark.parametrize(
        ("changes", "message"),
        [
            ({"mean": np.zeros((10, 2))}, r"must be \(V, 3\) and \(V,\)"),
            ({"vertex_index": np.arange(9)}, r"must be \(V, 3\) and \(V,\)"),
            ({"vertex_index": np.arange(10)[::-1]}, "vertex_index must ascend"),
            ({"triangles": np.array([[0, 1, 10]])}, "must number 10 vertices from 0"),
            ({"identity": np.zeros((100, 9, 3))}, r"must hold \(10, 3\) numbers a component"),
            ({"expression_names": np.array(["a"])}, "must name 2 expressions. Received 1"),
            ({"mean": np.full((10, 3), "a")}, "mean of type <U1"),
            ({"mean": np.array([[None]], object)}, "an array of objects"),
        ],
    )
    def test_a_malformed_npz_is_refused(self, tmp_path, ict_arrays, changes, message):
        file = write_ict_npz(tmp_path, ict_arrays, **changes)
        with pytest.raises(InputError, match=f"ict_light.npz.* {message}"):
            load_ict(file)

    def test_a_truncated_npz_is_refused(self, tmp_path, ict_arrays):
        file = write_ict_npz(tmp_path, ict_arrays)
        os.truncate(file, file.stat().st_size // 2)
        with pytest.raises(InputError, match="must be an npz file"):
            load_ict(file)


class Hostile:
    """Makes a folder when it is unpickled."""

    def __init__(self, path):
        self.path = str(path)

    def __reduce__(self):
        return os.mkdir, (self.path,)


LICENSED = [name for name in MODELS if name not in ("openhead", "flame")]  # that is a pickle


@pytest.mark.parametrize("name", LICENSED)
@pytest.mark.parametrize("protocol", [0, 2, 4])
def test_a_pickle_is_refused_and_never_run(tmp_path, name, protocol):
    harm = tmp_path / "harm"
    file = tmp_path / "model"
    file.write_bytes(pickle.dumps([Hostile(harm)], protocol=protocol))
    with pytest.raises(InputError, match=f"{file}: .*Received a Python pickle.*not opened"):
        load_model(name, file)
    assert not harm.exists()
    pickle.loads(file.read_bytes())
    assert harm.exists()  # the file was indeed hostile


def test_objects_inside_an_npz_are_refused_and_never_run(tmp_path, ict_arrays):
    harm = tmp_path / "harm"
    file = write_ict_npz(tmp_path, ict_arrays, mean=np.array([Hostile(harm)], object))
    with pytest.raises(InputError, match="an array of objects"):
        load_ict(file)
    assert not harm.exists()


@pytest.mark.parametrize("name", LICENSED)
def test_a_text_file_is_refused(tmp_path, name):
    file = tmp_path / "model"
    file.write_text("Please sign the licence first.\n")
    with pytest.raises(InputError, match=f"{file}: must be an? .* file that begins with b'Please"):
        load_model(name, file)


@pytest.mark.parametrize("name", LICENSED)
def test_an_empty_file_is_refused(tmp_path, name):
    file = tmp_path / "model"
    file.touch()
    with pytest.raises(InputError, match="begins with b''"):
        load_model(name, file)


@pytest.mark.parametrize(
    ("name", "filename", "source"),
    [
        ("ict", "FaceXModel", "github.com/ICT-VGL/ICT-FaceKit"),
        ("bfm2009", "01_MorphableModel.mat", "faces.dmi.unibas.ch"),
        ("bfm2017", "model2017-1_bfm_nomouth.h5", "faces.dmi.unibas.ch"),
        ("bfm2019", "model2019_bfm.h5", "faces.dmi.unibas.ch"),
    ],
)
def test_a_missing_model_says_what_is_looked_for_and_where_to_get_it(
    tmp_path, name, filename, source
):
    for path in (None, "", tmp_path, tmp_path / "absent"):
        with pytest.raises(InputError, match=f"DATA=.*{filename}.*{source}"):
            load_model(name, path)


def test_the_open_head_needs_no_path():
    assert load_model("openhead").name == "openhead"


def test_an_unknown_model_is_refused():
    with pytest.raises(InputError, match="MODEL must be one of openhead.* Received 'nobody'"):
        load_model("nobody", "x")


def test_the_hash_is_that_of_the_file(tmp_path, mat_arrays, ict_arrays):
    file = write_mat(tmp_path, mat_arrays)
    assert load_bfm2009(file).sha256 == hashlib.sha256(file.read_bytes()).hexdigest()
    folder = write_ict_folder(tmp_path, ict_arrays)
    before = load_ict(folder).sha256
    shutil.copy(folder / "identity000.obj", folder / "identity001.obj")
    assert load_ict(folder).sha256 != before


def triangle_cycles(triangles):
    """Triangles as a set that forgets where each starts, but not which way it turns."""
    start = triangles.argmin(axis=1)[:, None]
    return set(map(tuple, np.take_along_axis(triangles, (start + np.arange(3)) % 3, axis=1)))
