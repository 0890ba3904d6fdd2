"""FaceMesh's points: by the worker in an environment of its own, and the 51 landmarks of them."""

import csv
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from places import MEDIAPIPE, SHARED
from writers.heads import CANTHI, NOSE_TIP, drawn_heads, nme

from deepmds_keras.detection.mediapipe_landmarks import (
    VARIABLE,
    detect,
    detect_all,
    find_python,
    landmarks51,
)
from deepmds_keras.io.errors import InputError
from deepmds_keras.landmarks import load_scheme

LEFT_BROW = slice(5, 10)


@pytest.fixture(scope="module")
def python():
    """Interpreter of the environment with MediaPipe."""
    if not MEDIAPIPE.exists():
        pytest.skip(f"{MEDIAPIPE} is absent: make setup-mediapipe")
    return MEDIAPIPE


@pytest.fixture(scope="module")
def heads(apart):
    return apart(drawn_heads)


@pytest.fixture(scope="module")
def points(python, heads, tmp_path_factory):
    """Of the heads as one stack, the first head again and a blank image, as files."""
    folder = tmp_path_factory.mktemp("mediapipe")
    paths = [folder / name for name in ("heads.npy", "head.png", "blank.png")]
    images, _ = heads
    np.save(paths[0], images)
    Image.fromarray(images[0]).save(paths[1])
    Image.new("RGB", (90, 120), "white").save(paths[2])
    done = []
    found = detect(paths, python, done.append)
    assert sum(done) == len(images) + 2
    return found


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


def test_an_image_has_the_same_points_in_a_stack_and_in_a_file(points):
    # In FaceMesh's video mode they would depend on the image before.
    assert np.array_equal(points[0], points[-2])


def test_every_face_is_found_the_largest_first(python, heads, tmp_path):
    image, truth = heads[0][2], heads[1][2]
    small = np.full_like(image, 255)
    small[64:192, 64:192] = np.array(Image.fromarray(image).resize((128, 128)))
    row, blank = np.concatenate([small, image], axis=1), np.full((90, 120, 3), 255, np.uint8)
    path = tmp_path / "stack.npy"
    np.save(path, np.stack([image, image]))
    done = []
    found = detect_all([row, path, blank], python, progress=done.append)
    assert [faces.shape for faces in found] == [(n, 468, 3) for n in (2, 1, 1, 0)]
    assert sum(done) == 4
    assert nme(pixels(found[0]), np.stack([truth + (256, 0), truth / 2 + 64])).max() < 0.06
    assert nme(pixels(found[1]), truth[None])[0] < 0.06
    assert np.array_equal(detect([path], python), np.concatenate(found[1:3]))
    assert len(detect_all([row], python, max_faces=1)[0]) == 1


def test_no_images_have_no_faces(python):
    assert detect_all([], python) == []
    assert detect([], python).shape == (0, 468, 3)


def test_what_is_no_image_or_no_number_of_faces_is_refused(python):
    with pytest.raises(InputError, match=r"image must be RGB, uint8 \(H, W, 3\). Received float64"):
        detect_all([np.zeros((8, 8, 3))], python)
    with pytest.raises(InputError, match="max_faces must be at least 1. Received 0"):
        detect_all([], python, max_faces=0)


def test_depth_grows_towards_the_viewer_on_the_scale_of_x(points, heads):
    frontal = landmarks51(points[2:3])[0]
    eyes = frontal[CANTHI]
    protrusion = (frontal[NOSE_TIP, 2] - eyes[:, 2].mean()) / np.ptp(eyes[:, 0])
    assert 0.3 < protrusion < 0.7


def test_photos_by_the_corrected_list_and_by_the_authors(python):
    paths = sorted((SHARED / "tf_flame").glob("*.jpeg"))
    if not paths:
        pytest.skip("../shared is absent")
    found = detect(paths, python)
    truth = np.array([np.load(path.with_name(f"{path.stem}_lmks.npy")) for path in paths])
    assert nme(pixels(found), truth).mean() < 0.03
    assert 0.045 < nme(pixels(found, "authors"), truth).mean() < 0.057


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("stack.npy", np.zeros((2, 8, 8, 3))),
        ("stack.npy", np.zeros((8, 8, 3), np.uint8)),
        ("stack.npy", b"neither"),
        ("photo.jpg", b"neither"),
        ("absent.png", None),
    ],
    ids=["float stack", "one image", "broken stack", "broken photo", "absent"],
)
def test_an_input_that_is_no_image_is_named(python, tmp_path, name, content):
    path = tmp_path / name
    if isinstance(content, bytes):
        path.write_bytes(content)
    elif content is not None:
        np.save(path, content)
    with pytest.raises(InputError, match=rf"^{path} must be images: .*Received"):
        detect([path], python)


def test_a_pickle_is_never_run(python, tmp_path):
    path = tmp_path / "stack.npy"
    np.save(path, np.array([{}]), allow_pickle=True)
    with pytest.raises(InputError, match="must be images"):
        detect([path], python)


def test_what_progress_raises_ends_the_worker(python, tmp_path):
    path = tmp_path / "stack.npy"
    np.save(path, np.zeros((30, 8, 8, 3), np.uint8))

    def stop(n):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        detect([path], python, stop)


def test_the_interpreter_is_what_is_named_then_the_variable_then_beside(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    beside = Path(".venv-mediapipe/bin/python")
    by_variable, named = tmp_path / "variable", tmp_path / "named"
    for path in (beside, by_variable, named):
        path.parent.mkdir(parents=True, exist_ok=True)
        path.symlink_to(sys.executable)
    monkeypatch.setenv(VARIABLE, str(by_variable))
    assert find_python(named) == named
    assert find_python() == by_variable
    monkeypatch.delenv(VARIABLE)
    assert find_python() == beside


def test_a_missing_environment_says_in_one_line_what_makes_it(tmp_path):
    text = tmp_path / "text"
    text.write_text("no program")
    for path in (tmp_path / "absent" / "python", tmp_path, text):
        for call in (find_python, lambda path: detect([], path)):
            with pytest.raises(InputError, match=rf"^{path} must be a Python that runs") as refused:
                call(path)
            message = str(refused.value)
            assert "make setup-mediapipe" in message
            assert "python3.11 -m venv" in message
            assert "pip install mediapipe==0.10.21" in message
            assert VARIABLE in message
            assert "\n" not in message


def test_an_environment_without_mediapipe_says_what_is_missing():
    with pytest.raises(InputError, match=r"make setup-mediapipe.*No module named 'mediapipe'$"):
        detect([], sys.executable)


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
