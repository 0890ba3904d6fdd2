"""FaceMesh's points of faces in images, and the 51 landmarks of them."""

import csv
import shutil
import sys
import zipfile
from types import ModuleType

import numpy as np
import pytest
from PIL import Image
from places import MEDIAPIPE, ROOT, SHARED, python
from writers.heads import CANTHI, NOSE_TIP, nme

from deepmds_keras.errors import InputError
from deepmds_keras.landmarks import load_scheme
from deepmds_keras.tool.detection import mediapipe_landmarks
from deepmds_keras.tool.detection.mediapipe_landmarks import (
    LANDMARKER,
    MediaPipeLandmarks,
    detect,
    has_mediapipe,
    landmarks51,
    shared_detector,
)
from deepmds_keras.tool.detection.photos import open_photo

LEFT_BROW = slice(5, 10)
installed = pytest.mark.skipif(not MEDIAPIPE, reason="MediaPipe is not installed")


@pytest.fixture(scope="module")
def points(heads):
    """Of the heads, the first head again and a blank image."""
    if not MEDIAPIPE:
        pytest.skip("MediaPipe is not installed")
    return detect([*heads[0], heads[0][0], np.full((90, 120, 3), 255, np.uint8)])


def pixels(points, which="corrected"):
    """`(n, 51, 2)`, y down."""
    return landmarks51(points, which)[..., :2] * (1, -1)


def numbers(which):
    """`(51,)` the point of FaceMesh that each landmark is."""
    count = np.zeros((1, 468, 3))
    count[..., 0] = np.arange(468)
    return landmarks51(count, which)[0, :, 0].astype(int)


def test_landmarks_of_drawn_heads_are_those_of_the_model(points, heads):
    images, truth = heads
    assert points.shape == (len(images) + 2, 468, 3)
    assert nme(pixels(points[: len(images)]), truth).max() < 0.06


def test_a_blank_image_has_no_points_and_no_image_leaves_a_trace(points):
    assert np.isnan(points[-1]).all() and np.isfinite(points[:-1]).all()
    # In a mode for video they would depend on the image before.
    assert np.array_equal(points[0], points[-2])
    assert detect([]).shape == (0, 468, 3)


@installed
def test_places_in_a_large_image_are_in_its_pixels(heads, monkeypatch):
    detector = shared_detector()
    assert not len(detector.detect_all(np.zeros((33_000, 32, 3), np.uint8)))  # OpenCV would abort
    image, truth = heads[0][2].repeat(2, 0).repeat(2, 1), 2 * heads[1][2]
    monkeypatch.setattr(mediapipe_landmarks, "_LONGEST_SIDE", len(image) // 2)
    (found,) = detector.detect_all(image)
    assert nme(pixels(found[None]), truth[None]).max() < 0.06


@installed
def test_every_face_is_found_the_largest_first(heads):
    image, truth = heads[0][2], heads[1][2]
    small = np.full_like(image, 255)
    small[64:192, 64:192] = np.array(Image.fromarray(image).resize((128, 128)))
    row, blank = np.concatenate([small, image], axis=1), np.full((90, 120, 3), 255, np.uint8)
    find = MediaPipeLandmarks().detect_all
    both, one, none = map(find, (row, image, blank))
    assert [len(faces) for faces in (both, one, none)] == [2, 1, 0]
    assert both.dtype == np.float32 and none.shape == (0, 468, 3)
    assert nme(pixels(both), np.stack([truth + (256, 0), truth / 2 + 64])).max() < 0.06
    assert nme(pixels(one), truth[None])[0] < 0.06
    assert np.array_equal(find(row), both)
    assert np.array_equal(find(row[:, ::-1][:, ::-1]), both), "pixels need not lie in order"


@installed
def test_each_face_has_its_score_which_is_lower_where_it_lies(heads):
    image = heads[0][2]
    row = np.concatenate([image, np.rot90(image)], axis=1)
    detector = MediaPipeLandmarks()
    faces, scores = detector.detect_scored(row)
    assert scores.shape == (len(faces),) and (scores > 0.3).all()
    upright = scores[faces[..., 0].mean(1) < 256]
    assert upright.max() > 0.9
    assert detector.detect_scored(np.rot90(image, 2))[1].max(initial=0) < upright.max()


def test_depth_grows_towards_the_viewer_on_the_scale_of_x(points, heads):
    frontal = landmarks51(points[2:3])[0]
    eyes = frontal[CANTHI]
    protrusion = (frontal[NOSE_TIP, 2] - eyes[:, 2].mean()) / np.ptp(eyes[:, 0])
    assert 0.3 < protrusion < 0.7


def test_the_authors_left_brow_begins_one_point_too_far_out():
    corrected, authors = numbers("corrected")[LEFT_BROW], numbers("authors")[LEFT_BROW]
    assert np.array_equal(corrected[1:], authors[:-1])
    assert load_scheme("ibug51").names[LEFT_BROW.start] == "left_brow_5"


def test_the_authors_list_is_the_published_one_less_one():
    path = SHARED / "landmarks" / "mediapipe51_authors.csv"
    if not path.is_file():
        pytest.skip("../shared is absent")
    with path.open() as file:
        published = [
            int(row["mediapipe_index_1based_as_published"]) for row in csv.DictReader(file)
        ]
    assert np.array_equal(numbers("authors") + 1, published)


@installed
def test_points_are_those_of_mediapipe_0_10_21():
    # Ends of the eyes and of the mouth, nose tip: by its FaceMesh, in the same photo.
    known = [
        [194.78, 100.84, -3.92],
        [256.52, 104.08, -4.30],
        [201.74, 139.35, -7.11],
        [245.98, 142.11, -7.24],
        [224.00, 131.36, 23.12],
    ]
    (face,) = shared_detector().detect_all(open_photo(ROOT / "docs/pictures/astronaut.jpg"))
    np.testing.assert_allclose(face[[33, 263, 61, 291, 1]], known, atol=3e-4 * 104)  # its height


@installed
def test_depth_is_the_same_whatever_the_image_is_padded_to():
    photo = open_photo(ROOT / "docs/pictures/astronaut.jpg")[:300, 60:360]
    image = Image.fromarray(photo).rotate(-35, Image.Resampling.BICUBIC)
    depths = []
    for size in ((300, 300), (300, 600), (600, 300)):
        canvas = Image.new("RGB", size)
        canvas.paste(image, ((size[0] - 300) // 2, (size[1] - 300) // 2))
        (face,) = shared_detector().detect_all(np.array(canvas))
        depths.append(face[:, 2])
    assert np.ptp(depths, axis=0).max() < 0.02 * np.ptp(depths[0])


@installed
def test_it_loads_no_tensorflow_and_is_silent():
    code = """
import sys
from deepmds_keras.tool.detection.mediapipe_landmarks import shared_detector
from deepmds_keras.tool.detection.photos import open_photo
print(len(shared_detector().detect_all(open_photo("docs/pictures/portraits.jpg"))))
print({"tensorflow", "cv2", "matplotlib", "jax"} & {*sys.modules})
"""
    done = python("-c", code)
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.split() == ["3", "set()"]


def test_what_is_not_installed_is_named_in_one_line(monkeypatch):
    monkeypatch.setitem(sys.modules, "mediapipe", None)
    assert not has_mediapipe()
    needed = r"MediaPipe 0.10.30 or later must be installed: .*pip install '.\[mediapipe\]'"
    with pytest.raises(InputError, match=needed) as refused:
        MediaPipeLandmarks()
    assert "\n" not in str(refused.value)
    monkeypatch.setitem(sys.modules, "mediapipe", ModuleType("mediapipe"))  # an old one
    with pytest.raises(InputError, match=f"{needed}.* AttributeError: .*tasks"):
        MediaPipeLandmarks()


@installed
def test_a_landmarker_of_the_user_takes_the_place_of_the_package(tmp_path, heads):
    (tmp_path / "text.task").write_bytes(b"no model")
    with zipfile.ZipFile(tmp_path / "zipped.task", "w") as bundle:
        bundle.writestr("face_detector.tflite", b"no model")
    for name, received in {
        "none.task": "No such file",
        ".": "directory",
        "text.task": "not a zip file",
        "zipped.task": "",
    }.items():
        needed = f"{tmp_path / name} must be a MediaPipe face landmarker. Received: .*{received}"
        with pytest.raises(InputError, match=needed) as refused:
            MediaPipeLandmarks(tmp_path / name)
        assert "\n" not in str(refused.value)
    path = shutil.copy(LANDMARKER, tmp_path)
    image = heads[0][2]
    expected = shared_detector().detect_all(image)
    np.testing.assert_array_equal(MediaPipeLandmarks(path).detect_all(image), expected)
