"""FaceMesh's points of faces in images, and the 51 landmarks of them."""

import csv
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from PIL import Image
from places import MEDIAPIPE, SHARED
from writers.heads import CANTHI, NOSE_TIP, drawn_heads, nme

from deepmds_keras.detection.mediapipe_landmarks import MediaPipeLandmarks, detect, landmarks51
from deepmds_keras.errors import InputError
from deepmds_keras.landmarks import load_scheme
from deepmds_keras.photos import open_photo

LEFT_BROW = slice(5, 10)
installed = pytest.mark.skipif(not MEDIAPIPE, reason="MediaPipe is not installed")


@pytest.fixture(scope="module")
def heads(apart):
    return apart(drawn_heads)


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


def test_a_blank_image_has_no_points(points):
    assert np.isnan(points[-1]).all()
    assert np.isfinite(points[:-1]).all()


def test_an_image_has_the_same_points_whatever_came_before(points):
    # In FaceMesh's video mode they would depend on the image before.
    assert np.array_equal(points[0], points[-2])


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
    assert len(MediaPipeLandmarks(max_faces=1).detect_all(row)) == 1


@installed
def test_threads_take_turns(heads):
    find = MediaPipeLandmarks().detect_all
    alone = [find(image) for image in heads[0]]
    with ThreadPoolExecutor(4) as threads:
        assert all(map(np.array_equal, threads.map(find, [*heads[0]] * 3), alone * 3))


@installed
def test_no_images_have_no_faces():
    assert detect([]).shape == (0, 468, 3)


@installed
def test_what_is_no_image_is_refused():
    with pytest.raises(InputError, match=r"image must be RGB, uint8 \(H, W, 3\). Received float64"):
        detect([np.zeros((8, 8, 3))])


def test_no_number_of_faces_is_refused():
    with pytest.raises(InputError, match="max_faces must be at least 1. Received 0"):
        MediaPipeLandmarks(max_faces=0)


def test_depth_grows_towards_the_viewer_on_the_scale_of_x(points, heads):
    frontal = landmarks51(points[2:3])[0]
    eyes = frontal[CANTHI]
    protrusion = (frontal[NOSE_TIP, 2] - eyes[:, 2].mean()) / np.ptp(eyes[:, 0])
    assert 0.3 < protrusion < 0.7


@installed
def test_photos_by_the_corrected_list_and_by_the_authors():
    paths = sorted((SHARED / "tf_flame").glob("*.jpeg"))
    if not paths:
        pytest.skip("../shared is absent")
    found = detect(map(open_photo, paths))
    truth = np.array([np.load(path.with_name(f"{path.stem}_lmks.npy")) for path in paths])
    assert nme(pixels(found), truth).mean() < 0.03
    assert 0.045 < nme(pixels(found, "authors"), truth).mean() < 0.057


def test_both_lists_name_51_points_of_the_468():
    for which in ("corrected", "authors"):
        assert len(set(numbers(which))) == 51
        assert 0 <= numbers(which).min() <= numbers(which).max() < 468


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


def test_the_corrected_list_is_symmetric(points):
    """Each landmark's mirror image on a frontal head is the point of its counterpart."""
    frontal = pixels(points[2:3])[0]
    mirror = load_scheme("ibug51").mirror
    middle = frontal[:, 0].mean()
    width = np.ptp(frontal[CANTHI, 0])
    mirrored = np.stack([2 * middle - frontal[mirror, 0], frontal[mirror, 1]], axis=1)
    assert np.linalg.norm(mirrored - frontal, axis=1).max() < 0.1 * width


def test_y_is_turned_up_and_z_kept():
    points = np.random.default_rng(0).random((2, 468, 3))
    landmarks = landmarks51(points)
    assert np.array_equal(landmarks, points[:, numbers("corrected")] * (1, -1, 1))


def test_an_unknown_list_or_other_points_are_refused():
    with pytest.raises(
        InputError, match="which must be one of corrected, authors. Received 'left'"
    ):
        landmarks51(np.zeros((1, 468, 3)), "left")
    with pytest.raises(InputError, match=r"shape \(n, 468, 3\). Received \(478, 3\)"):
        landmarks51(np.zeros((478, 3)))
