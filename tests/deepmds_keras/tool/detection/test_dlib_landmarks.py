"""dlib's landmarks: on photos and drawn heads; what is missing is named."""

import itertools
import sys

import numpy as np
import pytest
from PIL import Image
from writers.heads import nme

from deepmds_keras.errors import InputError
from deepmds_keras.landmarks import load_scheme
from deepmds_keras.tool.detection import dlib_landmarks
from deepmds_keras.tool.detection.dlib_landmarks import (
    DlibLandmarks,
    find_shape_predictor,
    shared_detector,
)


@pytest.fixture(scope="module")
def find():
    return shared_detector().detect_all


def test_landmarks_of_drawn_heads_are_those_of_the_model(find, heads):
    images, truth = heads
    landmarks = np.array([find(image)[0] for image in images])
    assert nme(landmarks[:, 17:], truth).max() < 0.06
    chin = landmarks[:, 8] - truth[:, 16]  # from under the nose: the jaw line comes first
    assert (chin[:, 1] > 0.4 * np.ptp(truth[..., 1], axis=1)).all()


def test_a_mirrored_image_has_mirrored_landmarks(find, heads):
    # Were the middle of the first pixel anything but (0.5, 0.5), all points would move alike.
    mirror = load_scheme("ibug68").mirror
    offsets = []
    for image in heads[0]:
        mirrored = find(image[:, ::-1])[0][mirror]
        offsets.append(find(image)[0, :, 0] - (image.shape[1] - mirrored[:, 0]))
    assert abs(np.mean(offsets)) / 2 < 0.25


def test_every_face_is_found_once_whatever_its_size_the_largest_first(find, heads):
    image, truth = heads[0][2], heads[1][2]
    small = np.full_like(image, 255)
    small[64:192, 64:192] = np.array(Image.fromarray(image).resize((128, 128)))
    landmarks = find(np.concatenate([small, image, small[::-1]], axis=1))
    assert landmarks.shape == (2, 68, 2)  # none is upside down
    assert nme(landmarks[:, 17:], np.stack([truth + (256, 0), truth / 2 + 64])).max() < 0.06
    for image, side in itertools.product(heads[0], (80, 150, 400)):
        scaled = np.array(Image.fromarray(image).resize((side, side), Image.Resampling.LANCZOS))
        assert len(find(scaled)) == 1
    assert find(np.full((120, 90, 3), 255, np.uint8)).shape == (0, 68, 2)


def test_a_large_image_is_searched_when_made_smaller_and_marked_as_it_is(find, heads, monkeypatch):
    image, truth = heads[0][2], heads[1][2]
    monkeypatch.setattr(dlib_landmarks, "SEARCHED_PIXELS", 120**2)
    wide = np.concatenate([np.full_like(image, 255), image], axis=1)
    for large, place in ((image, truth), (wide, truth + (256, 0))):
        assert nme(find(large)[:, 17:], place[None])[0] < 0.06


def test_what_is_missing_or_damaged_says_where_to_get_it(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "face_recognition_models", None)
    monkeypatch.setattr(dlib_landmarks, "_DEBIAN_FOLDER", tmp_path)
    with pytest.raises(InputError, match=r"pip install face_recognition_models.*libdlib-data"):
        find_shape_predictor()
    debian = tmp_path / "shape_predictor_68_face_landmarks.dat"
    debian.write_bytes(b"text")
    assert find_shape_predictor() == debian
    with pytest.raises(InputError, match=r"68_face_landmarks.dat must be undamaged"):
        DlibLandmarks()
