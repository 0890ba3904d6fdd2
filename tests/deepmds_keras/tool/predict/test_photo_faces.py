"""Any detector finds the landmarks of photos, whichever side is up; its errors are known."""

import os

import numpy as np
import pytest
from PIL import Image
from places import MEDIAPIPE, ROOT, python

from deepmds_keras import FaceLifter, LandmarkLifter, convert
from deepmds_keras.files import read_npz, read_table
from deepmds_keras.geometry.units import rms_radius
from deepmds_keras.landmarks import DETECTOR_ERRORS
from deepmds_keras.tool.detection import detector_sd, to_ibug
from deepmds_keras.tool.detection.mediapipe_landmarks import shared_detector
from deepmds_keras.tool.predict.photo_faces import find_upright

# A face of 68 landmarks, all but its eyes and mouth in one place.
FACE = np.zeros((68, 2))
FACE[36:42], FACE[42:48], FACE[48:] = (-1, -1), (1, -1), (0, 1)


@pytest.mark.parametrize("unsure", [0.0, 0.8])
@pytest.mark.parametrize("quarters", [0, 1, 2, 3])
def test_a_photo_that_lies_on_its_side_is_turned_and_its_landmarks_turned_back(quarters, unsure):
    """A detector of a white spot in the left upper quarter of a photo that is higher than wide."""
    looked_at = []

    def detect(photo):
        looked_at.append(photo.shape)
        y, x = np.argwhere(photo[..., 0]).mean(0) + 0.5
        height, width = photo.shape[:2]
        upright = height > width and x < width / 2 and y < height / 2
        # One that is wrong, and less sure, where the photo is not upright.
        score = 0.95 if upright else unsure
        return FACE[None] + ((x, y) if upright else (3, 3)), np.array([score])

    photo = np.zeros((120, 90, 3), np.uint8)
    photo[30:32, 20:24] = 255
    photo = np.rot90(photo, -quarters)
    faces, scores = find_upright(photo, detect, "ibug68")
    assert len(looked_at) == (4 if quarters else 1), "what is found upright is not turned"
    y, x = np.argwhere(photo[..., 0]).mean(0) + 0.5
    turned = FACE @ np.linalg.matrix_power([[0, 1], [-1, 0]], quarters)
    np.testing.assert_allclose(faces, turned[None] + (x, y), atol=1e-9)
    assert scores == [0.95]


@pytest.mark.parametrize(
    ("as_stored", "turned", "taken"),
    [((0.8, 0), (0.7, 0), 0), ((0.6, 0), (0.74, 0), 0), ((0.6, 0), (0.8, 0), 1),
     ((0.8, 1), (0.78, 0), 1), ((0.8, 1), (0.95, 1), 0)],
)  # fmt: skip
def test_a_turn_must_bring_an_upright_face_that_scores_well(as_stored, turned, taken):
    def detect(photo):
        score, lies = turned if photo.shape[0] > photo.shape[1] else as_stored
        return FACE[None] @ np.linalg.matrix_power([[0, 1], [-1, 0]], lies), np.array([score])

    _, scores = find_upright(np.zeros((60, 90, 3), np.uint8), detect, "ibug68")
    assert scores == [(as_stored, turned)[taken][0]]


@pytest.mark.parametrize("score", [1.0, np.nan])
def test_faces_come_from_left_to_right_with_their_scores(score):
    places = np.array([300.0, 20, 100])

    def detect(photo):
        return places[:, None, None] + FACE, np.array([score, 0.1, 0.2])

    faces, scores = find_upright(np.zeros((50, 400, 3), np.uint8), detect, "ibug68")
    assert [*faces[:, 0, 0]] == [20, 100, 300]
    np.testing.assert_array_equal(scores, [0.1, 0.2, score])
    none = np.empty((0, 68, 2)), np.empty(0)
    found = find_upright(np.zeros((9, 9, 3)), lambda _: none, "ibug68")
    assert [len(each) for each in found] == [0, 0]


@pytest.fixture(scope="module")
def head():
    """A square of the astronaut's face, whose inner landmarks span 0.45 of it."""
    return Image.open(ROOT / "docs/pictures/astronaut.jpg").crop((157, 57, 291, 191))


@pytest.fixture(scope="module")
def predict():
    if not MEDIAPIPE:
        pytest.skip("MediaPipe is not installed")
    return FaceLifter("mediapipe").predict


def placed(head, side, *corners):
    photo = Image.new("RGB", (1200, 1200), (118, 121, 116))
    for corner in corners:
        photo.paste(head.resize((side, side), Image.Resampling.LANCZOS), corner)
    return photo


@pytest.mark.parametrize("share", [0.04, 0.06, 0.08])
def test_small_faces_have_the_shape_of_the_large_one(predict, head, share):
    (large,) = predict(head.resize((500, 500), Image.Resampling.LANCZOS))
    (small,) = predict(placed(head, round(2.2 * share * 1200), (430, 710)))
    assert np.linalg.norm(small.xyz - large.xyz, axis=1).mean() < 0.006


def test_no_small_face_is_missed_found_twice_or_turned(predict, head):
    rng = np.random.default_rng(0)
    for side in (110, 160, 220):
        faces = predict(placed(head, side, tuple(map(int, rng.integers(0, 1200 - side, 2)))))
        assert len(faces) == 1 and abs(faces[0].pose.roll) < 20
    corners = [(30 + 230 * (i % 5), 30 + 230 * (i // 5)) for i in range(25)]
    faces = predict(placed(head, 190, *corners))
    assert len(faces) == 25 and all(abs(face.pose.roll) < 20 for face in faces)


def test_mediapipes_own_landmarks_give_what_the_photo_gives(predict, head, tmp_path):
    photo = np.asarray(head.resize((500, 500), Image.Resampling.LANCZOS))
    (face,) = predict(photo)
    points = shared_detector().detect_all(photo)[..., :2].astype(float)
    assert np.ptp(points, axis=1).max() > 1.2 * np.ptp(face.landmarks, axis=0).max(), "of all 468"
    (given,) = FaceLifter().predict_landmarks(points)
    assert np.array_equal(given.xyz, face.xyz) and np.array_equal(given.std, face.std)
    assert np.array_equal(given.landmarks, face.landmarks)
    sd = rms_radius(face.landmarks[None])[:, None] * detector_sd("mediapipe", "ibug51")
    lifter = LandmarkLifter.pretrained("ibug51")
    known = lifter.predict(face.landmarks[None] * (1, -1), landmark_sd=sd, return_std=True)[1]
    np.testing.assert_allclose(face.std, known[0], rtol=1e-4)
    gap = points[0].copy()
    gap[33] = np.nan  # of the right eye: where the face's axes are is not known
    (partly,) = FaceLifter().predict_landmarks(gap)
    raw = convert(gap[None], "mediapipe", "ibug51", missing="nan")[0]
    assert np.array_equal(partly.landmarks, raw, equal_nan=True), "it stays where it is"
    assert partly.std.mean() > 0.9 * face.std.mean(), "the errors are MediaPipe's nevertheless"
    np.save(tmp_path / "points.npy", points)
    words = ("-m", "deepmds_keras", "predict", "points.npy", "--format", "npz")
    assert python(*words, folder=tmp_path).returncode == 0
    saved = read_npz(tmp_path / "deepmds-out/points.npz")
    np.testing.assert_array_equal(saved["shape"][0], face.xyz.astype(np.float32))


def test_the_first_picture_of_an_animation_is_read_and_a_note_says_so(predict, head, tmp_path):
    path = tmp_path / "a.gif"
    rest = [Image.new("RGB", head.size, colour) for colour in ("black", "white")]
    head.save(path, save_all=True, append_images=rest)
    for source in (path, path.read_bytes()):
        (face,) = predict(source)
        assert any("the first of 3 pictures of the file" in note for note in face.notes)


@pytest.mark.parametrize("detector", ["dlib", "mediapipe"])
def test_landmarks_of_a_detector_move_with_the_face(detector):
    views = np.random.default_rng(0).normal(0, 90, (4, 51, 2)) + 300
    moved = to_ibug(views, detector, "ibug51") - views
    turn = np.array([[0.6, 0.8], [-0.8, 0.6]])
    again = to_ibug(3 * views @ turn + 70, detector, "ibug51") - (3 * views @ turn + 70)
    np.testing.assert_allclose(again, 3 * moved @ turn, atol=1e-9)
    assert 0 < np.abs(moved).max() < 0.3 * 90
    np.testing.assert_array_equal(to_ibug(views, detector, "bfm72"), views)


@pytest.mark.parametrize(("detector", "scheme"), [("dlib", "ibug68"), ("mediapipe", "ibug51")])
def test_landmarks_of_an_upright_face_move_as_the_table_says(detector, scheme):
    """To the right and down, in radii of the face without its jaw."""
    view = 1000 * LandmarkLifter.pretrained(scheme).mean_shape_[:, :2] * (1, -1) + 300
    table = read_table(DETECTOR_ERRORS)
    known = [(float(r["dx"]), float(r["dy"])) for r in table if r["detector"] == detector]
    moved = to_ibug(view[None], detector, scheme)[0] - view
    np.testing.assert_allclose(moved, rms_radius(view[None, -51:])[0] * np.array(known), atol=0.1)


def test_the_jaw_as_dlib_finds_it_stays():
    views = np.random.default_rng(0).normal(0, 90, (4, 68, 2)) + 300
    moved = to_ibug(views, "dlib", "ibug68") - views
    assert not moved[:, :17].any() and moved[:, 17:].any(axis=(0, 2)).all()


def test_errors_of_each_detector_are_known_in_its_schemes():
    for detector, scheme, n in (("dlib", "ibug68", 68), ("mediapipe", "ibug51", 51)):
        sd = detector_sd(detector, scheme)
        assert sd.shape == (n,) and (sd > 0.02).all() and (sd < 0.5).all()
    assert detector_sd("mediapipe", "bfm72") is None


FORKED = """
from multiprocessing import get_context
import numpy as np
from deepmds_keras import DeepMDS, FaceLifter, InputError

VIEW = np.random.default_rng(0).normal(size=(51, 2))

def use(_):
    try:
        {use}
    except InputError as error:
        return str(error)

if __name__ == "__main__":
    lifter = FaceLifter("mediapipe")
    use(0)
    with get_context("fork").Pool(1) as pool:
        print(pool.apply_async(use, (0,)).get(timeout=60))
"""


@pytest.mark.skipif(not hasattr(os, "fork"), reason="no fork here")
@pytest.mark.parametrize(
    ("library", "use"),
    [
        ("MediaPipe", "lifter.predict(np.zeros((64, 64, 3), np.uint8))"),
        pytest.param(
            "Keras",
            "DeepMDS.pretrained('deepmds-ibug51').predict(VIEW, check_orientation=False)",
            marks=pytest.mark.slow,
        ),
    ],
)
def test_in_a_fork_it_is_refused_instead_of_waiting_for_ever(library, use):
    if library == "MediaPipe" and not MEDIAPIPE:
        pytest.skip("MediaPipe is not installed")
    done = python("-c", FORKED.replace("{use}", use))
    assert done.stdout.startswith(f"{library} cannot be used in a fork")
    assert "get_context('spawn')" in done.stdout
