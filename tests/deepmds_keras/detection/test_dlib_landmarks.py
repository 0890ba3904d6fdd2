"""dlib's landmarks: on photos and drawn heads; what is missing or no model is named."""

import itertools
import sys
from functools import cache

import numpy as np
import pytest
from PIL import Image
from places import SHARED
from writers.heads import drawn_heads, nme

from deepmds_keras.detection import dlib_landmarks
from deepmds_keras.detection.dlib_landmarks import DlibLandmarks, find_shape_predictor
from deepmds_keras.errors import InputError
from deepmds_keras.landmarks import load_scheme

EYES_AND_MOUTH = slice(36, 42), slice(42, 48), slice(48, 68)


@cache
def detector():
    return DlibLandmarks(find_shape_predictor())


@pytest.fixture(scope="module")
def find():
    return detector().detect


@pytest.fixture(scope="module")
def find_all():
    return detector().detect_all


@pytest.fixture(scope="module")
def heads(apart):
    return apart(drawn_heads)


def test_landmarks_of_photos_are_where_they_were_marked(find):
    paths = sorted((SHARED / "tf_flame").glob("*.jpeg"))
    if not paths:
        pytest.skip("../shared is absent")
    found = np.array([find(np.array(Image.open(path).convert("RGB"))) for path in paths])
    truth = np.array([np.load(path.with_name(f"{path.stem}_lmks.npy")) for path in paths])
    assert nme(found[:, 17:], truth).max() < 0.03


def test_every_photo_has_an_upright_face(find):
    paths = sorted((SHARED / "photos").glob("photo*"))
    if not paths:
        pytest.skip("../shared is absent")
    for path in paths:
        image = np.array(Image.open(path).convert("RGB"))
        landmarks = find(image)
        right_eye, left_eye, mouth = (landmarks[rows].mean(0) for rows in EYES_AND_MOUTH)
        assert right_eye[0] < mouth[0] < left_eye[0]
        assert max(right_eye[1], left_eye[1]) < mouth[1] < landmarks[8, 1] < len(image)


def test_landmarks_of_drawn_heads_are_those_of_the_model(find, heads):
    images, truth = heads
    found = np.array([find(image) for image in images])
    assert nme(found[:, 17:], truth).max() < 0.06
    chin = found[:, 8] - truth[:, 16]  # from under the nose: the jaw line comes first
    assert (chin[:, 1] > 0.4 * np.ptp(truth[..., 1], axis=1)).all()


def test_a_mirrored_image_has_mirrored_landmarks(find, heads):
    # Were the middle of the first pixel anything but (0.5, 0.5), all points would move alike.
    mirror = load_scheme("ibug68").mirror
    images, _ = heads
    offsets = []
    for image in images:
        mirrored = find(image[:, ::-1])[mirror]
        offsets.append(find(image)[:, 0] - (image.shape[1] - mirrored[:, 0]))
    assert abs(np.mean(offsets)) / 2 < 0.25


def test_the_largest_face_is_taken(find, heads):
    image, truth = heads[0][2], heads[1][2]
    small = np.full_like(image, 255)
    small[64:192, 64:192] = np.array(Image.fromarray(image).resize((128, 128)))
    for pair, shift in ([image, small], 0), ([small, image], 256):
        found = find(np.concatenate(pair, axis=1))[None, 17:] - (shift, 0)
        assert nme(found, truth[None])[0] < 0.06


def test_a_face_too_small_for_the_detector_is_found_in_the_doubled_image(find, heads):
    image, truth = heads[0][2], heads[1][2]
    small = np.array(Image.fromarray(image).resize((64, 64), Image.Resampling.LANCZOS))
    assert not detector()._find_faces(small, 0)
    assert nme(find(small)[None, 17:], truth[None] * 64 / 256)[0] < 0.08


def test_every_face_is_found_the_largest_first(find_all, find, heads):
    image, truth = heads[0][2], heads[1][2]
    small = np.full_like(image, 255)
    small[64:192, 64:192] = np.array(Image.fromarray(image).resize((128, 128)))
    row = np.concatenate([small, image, small[::-1]], axis=1)
    found = find_all(row)
    assert found.shape == (2, 68, 2)  # none is upside down
    places = np.stack([truth + (256, 0), truth / 2 + 64])
    assert nme(found[:, 17:], places).max() < 0.06
    assert np.array_equal(found[0], find(row))


def test_a_face_is_found_once_whatever_its_size(find_all, heads):
    for image, side in itertools.product(heads[0], (80, 150, 400)):
        scaled = np.array(Image.fromarray(image).resize((side, side), Image.Resampling.LANCZOS))
        assert len(find_all(scaled)) == 1


@pytest.mark.slow
def test_a_large_image_is_searched_when_made_smaller_and_marked_as_it_is(find, heads, monkeypatch):
    canvas = np.full((2500, 4900, 3), 255, np.uint8)
    large = canvas.copy()
    large[1000:2024, 3000:4024] = np.array(Image.fromarray(heads[0][2]).resize((1024, 1024)))
    small = canvas.copy()
    small[1000:1090, 3000:3090] = np.array(Image.fromarray(heads[0][2]).resize((90, 90)))
    searched, search = [], detector()._find_faces

    def spy(image, doublings):
        searched.append(image.shape[0] * image.shape[1] * 4**doublings)
        return search(image, doublings)

    monkeypatch.setattr(detector(), "_find_faces", spy)
    assert nme(find(large)[None, 17:], 4 * heads[1][2:3] + (3000, 1000))[0] < 0.06
    assert len(searched) == 1
    assert searched[0] == pytest.approx(dlib_landmarks.SEARCHED_PIXELS, rel=0.01)
    assert nme(find(small)[None, 17:], 90 / 256 * heads[1][2:3] + (3000, 1000))[0] < 0.06
    assert searched[1:] == [searched[0], 2500 * 4900]  # never larger than the image itself


def test_no_face_is_none(find, find_all):
    blank = np.full((120, 90, 3), 255, np.uint8)
    assert find(blank) is None
    assert find_all(blank).shape == (0, 68, 2)


@pytest.mark.parametrize(
    "image",
    [np.zeros((9, 9), np.uint8), np.zeros((9, 9, 4), np.uint8), np.zeros((9, 9, 3))],
    ids=["grey", "alpha", "float"],
)
def test_another_kind_of_image_is_refused(find, image):
    with pytest.raises(InputError, match=r"image must be RGB, uint8 \(H, W, 3\). Received"):
        find(image)


def test_a_file_that_is_not_the_model_is_refused(tmp_path, find):
    path = tmp_path / "model.dat"
    whole = find_shape_predictor().read_bytes()
    for content in (b"", b"text", whole[:100], whole[:1_000_000], whole[:-1]):
        path.write_bytes(content)
        with pytest.raises(InputError, match=r"model.dat must be dlib's shape_predictor_68.*whole"):
            DlibLandmarks(path)


def test_the_model_of_five_landmarks_is_refused(find):
    five = find_shape_predictor().with_name("shape_predictor_5_face_landmarks.dat")
    with pytest.raises(InputError, match="must have 68 landmarks. Received 5"):
        DlibLandmarks(five)


def test_a_missing_model_says_where_to_get_it(tmp_path, monkeypatch):
    for path in (tmp_path, tmp_path / "absent.dat"):
        with pytest.raises(InputError, match=rf"{path} must be dlib's shape_predictor_68"):
            find_shape_predictor(path)
    monkeypatch.setitem(sys.modules, "face_recognition_models", None)
    monkeypatch.setattr(dlib_landmarks, "_DEBIAN_FOLDER", tmp_path)
    with pytest.raises(InputError, match=r"pip install face_recognition_models.*libdlib-data"):
        find_shape_predictor()
    debian = tmp_path / "shape_predictor_68_face_landmarks.dat"
    debian.touch()
    assert find_shape_predictor() == debian


def test_missing_dlib_says_how_to_install_it(monkeypatch):
    monkeypatch.setitem(sys.modules, "dlib", None)
    with pytest.raises(InputError, match=r"pip install 'deepmds-keras\[dlib\]'"):
        DlibLandmarks()
