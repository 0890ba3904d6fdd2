"""Photos and landmarks to faces from Python: the same as by the command, in the right order."""

import numpy as np
import pytest
from PIL import Image
from writers.heads import drawn_heads

import deepmds_keras
from data_gen.models.openhead import load_openhead
from data_gen.views.photo_views import sample_photo_views
from deepmds_keras import InputError, predict_landmarks, predict_photo
from deepmds_keras.alignment import align
from deepmds_keras.landmarks.conversion import convert
from deepmds_keras.lifting.lifter import LandmarkLifter
from deepmds_keras.lifting.network import SIZES, initial_weights
from deepmds_keras.metrics import mse
from deepmds_keras.normalisation import normalise


@pytest.fixture(scope="module")
def drawn():
    """Landmarks in pixels and true shapes of faces that no weights have seen."""
    model, rng = load_openhead(), np.random.default_rng(79)
    views, shapes, _ = sample_photo_views(model, "ibug68", 40, rng, detector_sd=0.5)
    return 3 * views * (1, -1) + (700, 500), shapes


@pytest.fixture(scope="module")
def lifter(tmp_path_factory):
    """File of a lifter as training begins with it, which knows the face model already."""
    _, shapes, _ = sample_photo_views(load_openhead(), "ibug68", 2000, np.random.default_rng(80))
    shapes = normalise(shapes)
    begun = LandmarkLifter(68)
    shapes = (shapes - shapes.mean(1, keepdims=True)).swapaxes(1, 2)
    begun.weights_ = initial_weights(shapes, SIZES["small"], 0)
    begun.training_sd_, begun.history_ = 0.01, []
    path = tmp_path_factory.mktemp("lifter") / "lifter.npz"
    begun.save(path)
    return str(path)


@pytest.fixture(scope="module")
def two_faces(apart):
    """A photo of two open heads."""
    images, _ = apart(drawn_heads)
    return Image.fromarray(np.hstack(images[[2, 4]]))


def test_given_landmarks_give_shapes_near_the_truth_and_say_how_near(drawn, lifter):
    landmarks, shapes = drawn
    faces = predict_landmarks(landmarks, model=lifter)
    assert {face.scheme for face in faces} == {"ibug68"}
    truth, found = normalise(shapes), np.stack([face.shape for face in faces])
    mean = np.broadcast_to(truth.mean(0), truth.shape)
    assert mse(align(found, truth), truth).mean() < 0.5 * mse(align(mean, truth), truth).mean()
    assert all(face.std.shape == (68, 3) and (face.std > 0).all() for face in faces)
    (scaled,) = predict_landmarks(landmarks[0], model=lifter, interocular=90)
    ratio = np.ptp(scaled.shape[:, 0]) / np.ptp(faces[0].shape[:, 0])
    assert np.allclose(scaled.std, ratio * faces[0].std)


def test_depth_in_the_image_is_that_of_the_face_as_it_is_turned(drawn, lifter):
    for face in predict_landmarks(drawn[0], model=lifter):
        assert np.allclose(face.image_xyz[:, :2], face.landmarks)
        posed = face.pose.scale * face.shape @ face.pose.rotation.T
        assert np.allclose(face.image_xyz[:, 2], posed[:, 2])
        seen = posed[:, :2] + face.pose.translation
        assert np.allclose(face.residual, np.linalg.norm(seen * (1, -1) - face.landmarks, axis=1))
        nose, ears = face.image_xyz[30, 2], face.image_xyz[[0, 16], 2]
        assert nose > ears.mean(), "z grows towards the viewer"


def test_other_landmarks_are_taken_by_their_number_or_by_name(drawn):
    landmarks = drawn[0][:3]
    inner = convert(landmarks, "ibug68", "ibug51")
    assert predict_landmarks(inner)[0].scheme == "ibug51"
    assert predict_landmarks(inner[0], scheme="ibug51")[0].name == "face"
    (by_paper,) = predict_landmarks(landmarks[0], model="deepmds")
    assert by_paper.scheme == "ibug51" and by_paper.std is None


def test_flipped_landmarks_are_refused(drawn):
    with pytest.raises(InputError, match="^landmarks"):
        predict_landmarks(drawn[0] * (1, -1))


def test_a_photo_may_be_a_file_an_image_or_an_array(two_faces, tmp_path):
    path = tmp_path / "two.png"
    two_faces.save(path)
    faces = predict_photo(path, detector="dlib")
    assert [face.name for face in faces] == ["two-1", "two-2"]
    assert faces[0].landmarks[:, 0].mean() < faces[1].landmarks[:, 0].mean(), "left to right"
    for other in (two_faces, np.array(two_faces)):
        again = predict_photo(other, detector="dlib")
        assert np.array_equal([f.shape for f in again], [f.shape for f in faces])
        assert again[0].photo is None


def test_a_photo_without_a_face_has_none():
    assert predict_photo(Image.new("RGB", (200, 200)), detector="dlib") == []
    with pytest.raises(InputError, match="detector must be one of"):
        predict_photo(Image.new("RGB", (200, 200)), detector="eyes")


def test_names_are_found_without_a_module():
    assert {"predict_photo", "predict_landmarks"} <= {*dir(deepmds_keras)}
