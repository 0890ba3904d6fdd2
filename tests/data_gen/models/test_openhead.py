"""The embedded open head: laws of the asset and of its loader."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from places import SHARED

from data_gen.build_openhead.tables import IDENTITY_PRIOR, LANDMARKS
from data_gen.models.openhead import OPENHEAD, load_openhead, read_openhead
from deepmds_keras.errors import InputError
from deepmds_keras.files import read_table

FLIP = np.array([-1.0, 1.0, 1.0])


@pytest.fixture(scope="module")
def model():
    return load_openhead()


@pytest.fixture(scope="module")
def arrays():
    return read_openhead()


def needs(path: Path) -> Path:
    if not path.exists():
        pytest.skip(f"needs {path.name}, which does not come with the package")
    return path


# --- the asset ---


def test_mirroring_twice_changes_nothing(arrays):
    mirror = arrays["mirror"]
    assert (mirror[mirror] == np.arange(len(mirror))).all()


def test_mean_head_is_mirror_symmetric(model, arrays):
    np.testing.assert_allclose(model.mean[arrays["mirror"]] * FLIP, model.mean, atol=1e-4)


def test_nose_tip_is_where_the_basel_face_model_has_it(model):
    np.testing.assert_allclose(model.mean[model.landmarks["bfm72"][28]], [0, 4.4, 131], atol=1e-4)


def test_subject_looks_along_z_with_its_left_at_positive_x(model, arrays):
    right_eye, left_eye = (model.mean[arrays["part"] == part].mean(0) for part in (1, 2))
    chin, brow = model.mean[model.landmarks["ibug68"][[8, 19]]]
    assert right_eye[0] < 0 < left_eye[0]
    assert chin[1] < brow[1]
    assert right_eye[2] > model.mean[:, 2].mean()


def test_triangles_face_outwards(model):
    a, b, c = np.moveaxis(model.mean[model.triangles], 1, 0)
    assert np.einsum("ti,ti->", a, np.cross(b, c)) > 0  # six times the enclosed volume
    nose = (model.triangles == model.landmarks["bfm72"][28]).any(1)
    assert (np.cross(b - a, c - a)[nose, 2] > 0).all()


def test_identity_components_descend_and_are_orthogonal(model):
    flat = model.identity_basis_times_sd.reshape(model.n_identity, -1)
    gram = flat @ flat.T
    sd = np.sqrt(np.diag(gram))
    assert model.n_identity == 199
    assert (np.diff(sd) <= 0).all()
    np.testing.assert_allclose(gram / np.outer(sd, sd), np.eye(199), atol=2e-3)


def test_a_head_and_its_mirror_image_are_equally_likely(model, arrays):
    basis = model.identity_basis_times_sd
    mirrored = basis[:, arrays["mirror"]] * FLIP
    vertices = np.concatenate(list(model.landmarks.values()))
    own, other = (b[:, vertices].reshape(len(b), -1) for b in (basis, mirrored))
    covariance = own.T @ own
    np.testing.assert_allclose(other.T @ other, covariance, atol=1e-9 * covariance.max())


def test_sample_covariance_of_landmarks_is_that_of_the_basis(model):
    landmarks = model.restrict(model.landmarks["bfm72"])
    _, faces = landmarks.sample(20_000, np.random.default_rng(0))
    basis = landmarks.identity_basis_times_sd.reshape(199, -1)
    expected = basis.T @ basis
    found = np.cov(faces.reshape(len(faces), -1).T)
    assert np.linalg.norm(found - expected) < 0.03 * np.linalg.norm(expected)


def test_open_jaw_lowers_the_chin_and_not_the_brows(model):
    weights = np.array(model.expression_names) == "jawOpen"
    assert weights.sum() == 1
    moved = model.shape(np.zeros(1), weights.astype(float)) - model.mean
    chin, brow = moved[model.landmarks["ibug68"][[8, 19]]]
    assert chin[1] < -5
    assert np.abs(brow).max() < 0.5


def test_every_expression_moves_something(model):
    assert len(model.expression_names) == len(model.expression_basis) == 51
    assert (np.abs(model.expression_basis).max((1, 2)) > 0.5).all()


def test_landmarks_are_unique_and_closed_under_mirroring(model, arrays):
    for scheme, count in (("bfm72", 72), ("ibug68", 68)):
        vertices = set(model.landmarks[scheme].tolist())
        assert len(vertices) == count
        assert set(arrays["mirror"][list(vertices)].tolist()) == vertices


@pytest.mark.parametrize("scheme", ["bfm72", "ibug68"])
def test_landmark_tables_and_asset_agree(model, scheme):
    from data_gen.landmarks import load_vertices

    expected = load_vertices(scheme).vertices["openhead"]
    np.testing.assert_array_equal(expected, model.landmarks[scheme])


@pytest.mark.parametrize("scheme", ["bfm72", "ibug68"])
def test_asset_has_the_landmarks_of_the_build_table(model, arrays, scheme):
    rows = [row for row in read_table(LANDMARKS) if row["scheme"] == scheme]
    assert [int(row["landmark"]) for row in rows] == list(range(1, len(rows) + 1))
    expected = [int(row["base_vertex"]) for row in rows]
    np.testing.assert_array_equal(arrays["base_vertex"][model.landmarks[scheme]], expected)


def test_prior_table_is_complete():
    rows = read_table(IDENTITY_PRIOR)
    sd = np.array([float(row["sd"]) for row in rows])
    assert len({row["parameter"] for row in rows}) == len(rows) == 174
    assert (sd > 0).all() and (sd <= 0.45).all()
    paired = [row for row in rows if row["kind"].startswith("pair_")]
    assert all("/l-" in row["target_positive"] for row in paired)


# --- against the models that it was made after ---


def unit_landmarks(faces: np.ndarray) -> np.ndarray:
    """Similarity-aligned `(n, 72, 3)` landmarks; outer canthi of the mean 1 apart."""
    mean = faces.mean(0) - faces.mean((0, 1))
    mean /= np.linalg.norm(mean[0] - mean[56])
    centred = faces - faces.mean(1, keepdims=True)
    u, singular, vt = np.linalg.svd(np.einsum("nki,kj->nij", centred, mean))
    scale = singular.sum(1) / np.einsum("nki,nki->n", centred, centred)
    return centred @ (u @ vt) * scale[:, None, None]


def test_landmarks_vary_as_much_as_in_ict_facekit(model):
    path = needs(SHARED / "ict-facekit" / "ict_light.npz")
    rng = np.random.default_rng(0)
    with np.load(path, allow_pickle=False) as ict:
        vertices = ict["landmarks72"]
        basis = ict["identity"][:, vertices].astype(float)
        real = ict["mean"][vertices] + np.tensordot(rng.standard_normal((3000, 100)), basis, 1)
    _, ours = model.restrict(model.landmarks["bfm72"]).sample(3000, rng)
    sd_ours, sd_real = (np.sqrt(unit_landmarks(x).var(0).sum(1)) for x in (ours, real))
    ratio = sd_ours / sd_real
    assert 0.9 < np.median(ratio) < 1.1
    assert ratio.min() > 0.6 and ratio.max() < 1.5


@pytest.mark.slow
def test_build_repeats_the_first_trial(model):
    """Up to the origin; the trial sampled no mirror images, so its mean is a bit asymmetric."""
    with np.load(needs(SHARED / "openhead" / "open_head_199_f16.npz"), allow_pickle=False) as trial:
        np.testing.assert_array_equal(trial["tri"], model.triangles)
        np.testing.assert_array_equal(trial["L72"], model.landmarks["bfm72"])
        np.testing.assert_array_equal(trial["L68"], model.landmarks["ibug68"])
        np.testing.assert_array_equal(trial["ex_basis"], model.expression_basis)
        shift = model.mean - trial["mean"]
        basis = trial["id_basis"].astype(float)
    assert np.abs(shift - shift.mean(0)).max() < 0.25  # mm
    ours = model.identity_basis_times_sd.reshape(199, -1)
    trial = basis.reshape(199, -1)
    for a, b in ((ours, trial), (trial, ours)):
        spanned = a @ np.linalg.qr(b.T)[0]
        assert (spanned**2).sum() > 0.999 * (a**2).sum()
    at = model.landmarks["bfm72"]
    ours = model.identity_basis_times_sd[:, at].reshape(199, -1)
    trial = basis[:, at].reshape(199, -1)
    expected = trial.T @ trial
    assert np.linalg.norm(ours.T @ ours - expected) < 0.02 * np.linalg.norm(expected)


# --- the loader ---


def test_missing_file_is_named(tmp_path):
    with pytest.raises(InputError, match=r"no\.npz does not exist; it must be an open head model"):
        load_openhead(tmp_path / "no.npz")


@pytest.mark.parametrize("kept", [0, 1, 1000, 200_000])
def test_truncated_file_raises(tmp_path, kept):
    path = tmp_path / "cut.npz"
    path.write_bytes(OPENHEAD.read_bytes()[:kept])
    with pytest.raises(InputError, match=r"cut\.npz must be an open head model"):
        load_openhead(path)


def test_damaged_file_raises(tmp_path):
    content = bytearray(OPENHEAD.read_bytes())
    content[100_000:100_100] = bytes(100)
    path = tmp_path / "damaged.npz"
    path.write_bytes(content)
    with pytest.raises(InputError, match=r"damaged\.npz"):
        load_openhead(path)


def test_lone_array_raises(tmp_path):
    np.save(tmp_path / "lone.npy", np.zeros(3))
    with pytest.raises(InputError, match=r"lone\.npy must be an open head model"):
        load_openhead(tmp_path / "lone.npy")


class Bomb:
    def __reduce__(self):
        return (pytest.fail, ("a pickle of the file was run",))


@pytest.mark.parametrize(
    ("key", "value", "message"),
    [
        ("mean", None, "Received one without mean"),
        ("mean", np.array([Bomb()], object), "an array of objects"),
        ("mean", np.zeros((4, 2)), r"mean must have the shape \(V, 3\) and hold floats"),
        ("mean", np.zeros((4, 3)), r"identity_basis_times_sd must have the shape \(K, V, 3\)"),
        ("mean", np.full((3765, 3), np.nan), "mean must be finite"),
        ("triangles", np.array([[0, 1, 3765]]), "triangles must be vertex numbers below 3765"),
        ("triangles", np.zeros((5, 3)), r"triangles must .* hold integers.*float64"),
        ("landmarks72", np.zeros(71, int), r"landmarks72 must have the shape \(72\)"),
        ("landmarks72", np.full(72, 3765), "landmarks bfm72 must be vertex numbers below 3765"),
        ("expression_names", np.array(["a"]), r"expression_names must have the shape \(E\)"),
        ("mask_lips", np.zeros(3, int), r"mask_lips must have the shape \(V\)"),
    ],
)
def test_foreign_content_raises(tmp_path, arrays, key, value, message):
    changed = {k: v for k, v in arrays.items() if k != key}
    if value is not None:
        changed[key] = value
    path = tmp_path / "foreign.npz"
    np.savez(path, **changed)
    with pytest.raises(InputError, match=rf"foreign\.npz.*{message}"):
        load_openhead(path)
