"""The embedded open head: laws of the asset and of its loader."""

from __future__ import annotations

import numpy as np
import pytest

from data_gen.build_openhead.cut import LANDMARKS
from data_gen.landmarks import load_vertices
from data_gen.models.openhead import read_openhead
from deepmds_keras.files import read_table
from deepmds_keras.geometry.alignment import align

FLIP = np.array([-1.0, 1.0, 1.0])


@pytest.fixture(scope="module")
def arrays():
    return read_openhead()


def test_the_mean_head_is_symmetric_and_where_the_basel_face_model_has_it(head, arrays):
    mirror = arrays["mirror"]
    assert (mirror[mirror] == np.arange(len(mirror))).all()
    np.testing.assert_allclose(head.mean[mirror] * FLIP, head.mean, atol=1e-4)
    np.testing.assert_allclose(head.mean[head.landmarks["bfm72"][28]], [0, 4.4, 131], atol=1e-4)
    right_eye, left_eye = (head.mean[arrays["part"] == part].mean(0) for part in (1, 2))
    chin, brow = head.mean[head.landmarks["ibug68"][[8, 19]]]
    assert right_eye[0] < 0 < left_eye[0]
    assert chin[1] < brow[1]
    assert right_eye[2] > head.mean[:, 2].mean()


def test_identity_components_descend_are_orthogonal_and_know_no_side(head, arrays):
    basis = head.identity_basis_times_sd
    flat = basis.reshape(head.n_identity, -1)
    gram = flat @ flat.T
    sd = np.sqrt(np.diag(gram))
    assert head.n_identity == 199
    assert (np.diff(sd) <= 0).all()
    np.testing.assert_allclose(gram / np.outer(sd, sd), np.eye(199), atol=2e-3)
    vertices = np.concatenate(list(head.landmarks.values()))
    given, mirrored = (
        b[:, vertices].reshape(len(b), -1) for b in (basis, basis[:, arrays["mirror"]] * FLIP)
    )
    covariance = given.T @ given
    np.testing.assert_allclose(mirrored.T @ mirrored, covariance, atol=1e-9 * covariance.max())


@pytest.mark.parametrize(("scheme", "count"), [("bfm72", 72), ("ibug68", 68)])
def test_landmarks_are_those_of_the_tables_and_closed_under_mirroring(head, arrays, scheme, count):
    vertices = head.landmarks[scheme]
    assert len(set(vertices.tolist())) == count
    assert set(arrays["mirror"][vertices].tolist()) == set(vertices.tolist())
    np.testing.assert_array_equal(load_vertices(scheme).vertices["openhead"], vertices)
    rows = [row for row in read_table(LANDMARKS) if row["scheme"] == scheme]
    assert [int(row["landmark"]) for row in rows] == list(range(1, count + 1))
    assert [int(row["base_vertex"]) for row in rows] == arrays["base_vertex"][vertices].tolist()


def test_landmarks_vary_as_much_as_in_ict_facekit(head, ict):
    def sds(face_model):
        faces = face_model.at_landmarks("bfm72").sample(3000, np.random.default_rng(0))[1]
        mean = faces.mean(0) - faces.mean((0, 1))
        return align(faces, mean / np.linalg.norm(mean[0] - mean[56])).std(0)

    ratio = np.sqrt((sds(head) ** 2).sum(1) / (sds(ict) ** 2).sum(1))
    assert 0.9 < np.median(ratio) < 1.1
    assert ratio.min() > 0.6 and ratio.max() < 1.5
