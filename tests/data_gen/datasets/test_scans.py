"""Scans of synthetic faces, and the landmarks that the paper's pipeline finds on them."""

import numpy as np
import pytest
from scipy.spatial import KDTree

from data_gen.datasets.dataset import dataset_of
from data_gen.fitting.ground_truth import GroundTruth
from data_gen.models.registry import load_model
from data_gen.views.projections import Cameras, in_camera_frame, rotations
from deepmds_keras.camera import camera_angles
from deepmds_keras.errors import InputError

N = 7


def make_scans():
    """Two of three subjects of a stand-in, in a process that may draw."""
    from data_gen.datasets.scans_standin import ScansStandin

    source = ScansStandin(load_model("openhead", scheme="ibug51"), 3, N, [0, 5])
    again = ScansStandin(load_model("openhead", scheme="ibug51"), 3, N, [0, 5])
    counts = [source.scans_of(subject) for subject in range(3)]
    return source.subject(0), again.subject(1), source.subject(1), counts


@pytest.fixture(scope="module")
def model():
    return load_model("openhead", scheme="ibug51")


@pytest.fixture(scope="module")
def scans(apart):
    return apart(make_scans)


def test_scans_are_spread_evenly_and_each_subject_is_the_same_whenever_it_is_made(scans):
    _, again, once, counts = scans
    assert counts == [3, 2, 2]
    for one, other in zip(once, again, strict=True):
        assert one.name == other.name
        assert np.array_equal(one.image, other.image)
        assert np.array_equal(one.points, other.points)


def test_subjects_differ_more_than_the_expressions_of_one(scans):
    first, _, second, _ = scans
    assert [scan.condition for scan in first] == ["neutral", "smile", "laugh"]
    eyes = [s.truth[[19, 22, 25, 28]] for s in (*first, *second)]
    own = np.abs(eyes[0] - eyes[1]).mean()
    assert np.abs(eyes[0] - eyes[3]).mean() > 3 * own


def test_points_lie_on_the_face_that_the_photo_shows(scans):
    """The camera is found from the landmarks in the photo; with it they must fall on the scan."""
    for scan in scans[0]:
        centred = scan.truth - scan.truth.mean(0)
        affine = np.linalg.lstsq(centred, scan.pixels * (1, -1), rcond=None)[0].T
        u, size, vt = np.linalg.svd(affine, full_matrices=False)
        assert size[1] / size[0] > 0.9  # the photo scales both axes alike
        rows = u @ vt
        turn = np.vstack([rows, np.cross(*rows)])
        posed = scan.truth @ turn.T
        # Eyes may be holes, brows in hair are not; noise is 0.2 mm and a point every millimetre.
        seen = KDTree(scan.points).query(posed[[10, 11, 12, 13, 16, 34]])[0]
        assert np.median(seen) < 4
        depth = scan.points[:, 2]
        assert depth.max() > np.median(depth) + 20  # the nose is towards the viewer


def test_the_photo_shows_a_face_on_white(scans):
    image = scans[0][0].image
    assert image.shape == (320, 320, 3)
    assert (image[:, :5] == 255).all()
    pixels = np.int64(scans[0][0].pixels)
    assert (image[pixels[:, 1], pixels[:, 0]] < 255).any(1).all()


@pytest.fixture(scope="module")
def ideal(model):
    """A scan without noise of a face whose landmarks are detected without error."""
    rng = np.random.default_rng(0)
    identity, weights = 0.7 * rng.standard_normal(100), np.zeros(len(model.expression_basis))
    weights[model.expression_names.index("jawOpen")] = 0.5
    shape = model.shape(identity, weights)
    camera = Cameras(np.zeros(1, int), *np.array([[12.0], [-6.0], [3.0], [0.0]]))
    posed = in_camera_frame(shape[None], camera)[0]
    front = posed[posed[:, 2] > np.median(posed[:, 2]) - 20] + (5.0, -8.0, 900.0)
    landmarks = shape[model.landmarks["ibug51"]]
    views = dataset_of(landmarks[None], camera, {}).views[0].astype(float)
    return views * (2.0, -2.0) + 300, front, landmarks, camera


def test_the_truth_is_found_where_the_detector_makes_no_error(model, ideal):
    pixels, points, landmarks, camera = ideal
    found = GroundTruth(model).register(pixels, points)
    distance = np.linalg.norm(found.landmarks - landmarks, axis=1)
    assert np.median(distance) < 2 and distance.max() < 12
    assert np.allclose(found.fit.camera.rotation, rotations(camera)[0], atol=0.08)
    assert found.icp.converged and found.icp.rms < 1.5
    # Every landmark is a point of the scan, brought back into the frame of the model.
    rotation, translation = found.model_to_scan
    back = found.landmarks @ rotation.T + translation
    assert KDTree(points).query(back)[0].max() < 1e-6


def test_a_scan_of_something_else_is_refused(model, ideal):
    pixels, points, *_ = ideal
    rng = np.random.default_rng(0)
    ball = rng.standard_normal((5000, 3))
    ball *= 300 / np.linalg.norm(ball, axis=1, keepdims=True)
    with pytest.raises(InputError, match="registration must converge to within 4 mm. Received"):
        GroundTruth(model).register(pixels, ball + (0, 0, 900))
    with pytest.raises(InputError):
        GroundTruth(model).register(pixels, points[:2])


def test_angles_are_those_that_rotations_were_made_of():
    rng = np.random.default_rng(0)
    angles = rng.uniform(-60, 60, (3, 50))
    cameras = Cameras(np.zeros(50, int), *angles, np.zeros(50))
    assert np.allclose(camera_angles(rotations(cameras)), angles)


def test_models_are_shifted_to_where_flame_has_its_nose(model):
    nose = model.mean[model.landmarks["ibug51"][13]]
    assert np.allclose(nose, [0.3, -9.4, 75.8])
    as_bfm = load_model("openhead")
    assert np.allclose(np.ptp(as_bfm.mean, axis=0), np.ptp(model.mean, axis=0))
