"""FaceMesh's points of faces in images, and the 51 landmarks of them."""

import csv
import subprocess
import sys
from types import ModuleType, SimpleNamespace

import numpy as np
import pytest
from PIL import Image
from places import MEDIAPIPE, ROOT, SHARED
from writers.heads import CANTHI, NOSE_TIP, drawn_heads, nme

from deepmds_keras.errors import InputError
from deepmds_keras.landmarks import load_scheme
from deepmds_keras.tool.detection.mediapipe_landmarks import (
    MediaPipeLandmarks,
    detect,
    has_face_mesh,
    landmarks51,
)

LEFT_BROW = slice(5, 10)
IMAGE = np.zeros((40, 80, 3), np.uint8)
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


def test_a_blank_image_has_no_points_and_no_image_leaves_a_trace(points):
    assert np.isnan(points[-1]).all() and np.isfinite(points[:-1]).all()
    # In FaceMesh's video mode they would depend on the image before.
    assert np.array_equal(points[0], points[-2])
    assert detect([]).shape == (0, 468, 3)


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


@pytest.fixture
def later(monkeypatch):
    """Puts a later MediaPipe in place: `later(n_points, error)`, which keeps what it was given."""

    def later(n_points=478, error=None):
        point = SimpleNamespace(x=0.5, y=0.25, z=-0.125)

        def create(options):
            package.given = options
            if error is not None:
                raise error
            faces = [[SimpleNamespace(**vars(point) | {"x": i / 1000}) for i in range(n_points)]]
            return SimpleNamespace(detect=lambda image: SimpleNamespace(face_landmarks=faces))

        package = ModuleType("mediapipe")
        package.ImageFormat = SimpleNamespace(SRGB=1)
        package.Image = lambda image_format, data: (image_format, data)
        package.tasks = SimpleNamespace(
            BaseOptions=dict,
            vision=SimpleNamespace(
                FaceLandmarkerOptions=dict,
                FaceLandmarker=SimpleNamespace(create_from_options=create),
            ),
        )
        monkeypatch.setitem(sys.modules, "mediapipe", package)
        return package

    return later


@installed
def test_face_mesh_is_all_that_is_loaded_and_it_is_silent():
    code = """
import sys
import numpy as np
from deepmds_keras.tool.detection.mediapipe_landmarks import shared_detector
print(len(shared_detector().detect_all(np.full((40, 80, 3), 255, np.uint8))))
names = {name for name in sys.modules if name.split(".")[0] == "mediapipe"}
print({name for name in names if not name.startswith("mediapipe.python._framework_bindings")})
print({"tensorflow", "cv2", "matplotlib", "jax"} & {*sys.modules})
"""
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.split() == ["0", "set()", "set()"]


def test_what_is_not_installed_is_named_in_one_line(tmp_path, monkeypatch, later):
    path = tmp_path / "face.task"
    path.write_bytes(b"a model")
    later(error=TypeError("create(): incompatible function arguments"))
    with pytest.raises(InputError, match="0.10.30 or later.*TypeError: create"):
        MediaPipeLandmarks(path)
    monkeypatch.setitem(sys.modules, "mediapipe", None)
    assert not has_face_mesh()
    with pytest.raises(InputError, match="0.10.30 or later"):
        MediaPipeLandmarks(path)
    with pytest.raises(InputError, match=r"repository, pip install '.\[mediapipe\]'") as refused:
        MediaPipeLandmarks()
    assert "\n" not in str(refused.value)


def test_a_landmarker_gives_the_468_points_before_the_irises(tmp_path, later):
    package = later()
    (tmp_path / "face.task").write_bytes(b"a model")
    (face,) = MediaPipeLandmarks(tmp_path / "face.task", max_faces=3).detect_all(IMAGE)
    assert package.given == {"base_options": {"model_asset_buffer": b"a model"}, "num_faces": 3}
    assert face.shape == (468, 3)
    np.testing.assert_allclose(face[:, 0], np.arange(468) / 1000 * 80, rtol=1e-6)
    np.testing.assert_allclose(face[:, 1:], [[0.25 * 40, 0.125 * 80]] * 468)


def test_a_landmarker_that_cannot_be_read_is_named(tmp_path, later):
    path = tmp_path / "face.task"
    with pytest.raises(InputError, match=r"face.task must be a face landmarker.*No such file"):
        MediaPipeLandmarks(path)
    with pytest.raises(InputError, match=r"must be a face landmarker.*directory"):
        MediaPipeLandmarks(tmp_path)
    path.write_bytes(b"no model")
    later(error=RuntimeError("Unable to open\nzip archive."))
    message = r"face.task must be a face landmarker.*RuntimeError: Unable to open zip archive\.$"
    with pytest.raises(InputError, match=message):
        MediaPipeLandmarks(path)
    later(n_points=21)
    with pytest.raises(InputError, match=r"face.task must be .* Received: 21 points a face"):
        MediaPipeLandmarks(path).detect_all(IMAGE)
