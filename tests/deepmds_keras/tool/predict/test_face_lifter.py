"""Photos and landmarks to faces from Python: in the right order, whatever is missing."""

import io
import re
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pandas as pd
import pytest
from PIL import Image

from data_gen.views import sample_photo_views
from deepmds_keras import InputError, predict_landmarks, predict_photo
from deepmds_keras.landmarks import convert
from deepmds_keras.tool.detection import DETECTORS, to_ibug
from deepmds_keras.tool.predict.face_lifter import FaceLifter

N = 12


@pytest.fixture(scope="module")
def landmarks(head):
    """`(12, 68, 2)` pixels of faces that no weights have seen."""
    rng = np.random.default_rng(79)
    views, _, _ = sample_photo_views(head, "ibug68", N, rng, detector_sd=0.5)
    return 3 * views * (1, -1) + (700, 500)


@pytest.fixture(scope="module")
def two_faces(heads):
    """A photo of two open heads."""
    return np.hstack(heads[0][[2, 4]])


def shapes(faces):
    return np.stack([face.xyz for face in faces])


def test_depth_in_the_image_is_that_of_the_face_as_it_is_turned(landmarks):
    for face in predict_landmarks(landmarks):
        assert np.allclose(face.landmarks_3d[:, :2], face.landmarks)
        depth = face.pose.scale * face.xyz @ face.pose.rotation[2]
        assert np.allclose(face.landmarks_3d[:, 2], depth)
        off = np.linalg.norm(face.pose.project(face.xyz) * (1, -1) - face.landmarks, axis=1)
        assert np.allclose(face.residuals, off)
        assert depth[30] > depth[[0, 16]].mean(), "z grows towards the viewer"
        low, high = face.landmarks.min(0), face.landmarks.max(0)
        assert face.bbox == (*low, *high) and face.score is None
        assert len(repr(face)) < 100 and "68 landmarks (ibug68)" in repr(face)


def test_other_landmarks_are_taken_by_their_number_or_by_name(landmarks):
    inner = convert(landmarks[:3], "ibug68", "ibug51")
    assert predict_landmarks(inner)[0].scheme == "ibug51"
    assert predict_landmarks(inner[0], scheme="ibug51")[0].name == "face"
    (by_paper,) = predict_landmarks(landmarks[0], model="deepmds")
    assert by_paper.scheme == "ibug51" and by_paper.std is None
    assert predict_landmarks(landmarks[:0]) == []


def test_a_photo_may_be_a_file_its_content_an_image_or_an_array(two_faces, tmp_path):
    path = tmp_path / "two.png"
    Image.fromarray(two_faces).save(path)
    lifter = FaceLifter("dlib")
    faces = lifter.predict(path)
    assert [face.name for face in faces] == ["two-1", "two-2"] and faces[0].photo == path
    assert faces[0].landmarks[:, 0].mean() < faces[1].landmarks[:, 0].mean(), "left to right"
    content = path.read_bytes()
    for other in (Image.fromarray(two_faces), two_faces, content, io.BytesIO(content)):
        again = lifter.predict(other)
        assert np.array_equal(shapes(again), shapes(faces)) and again[0].photo is None
    assert np.array_equal(shapes(predict_photo(str(path), detector="dlib")), shapes(faces))


def test_an_image_without_pixels_is_refused_and_the_next_is_not(two_faces):
    for name in [name for name, row in DETECTORS.items() if row.is_installed()]:
        lifter = FaceLifter(name)
        for wrong in (np.zeros((0, 5, 3), np.uint8), np.zeros((5, 5, 3)), None, b"text"):
            with pytest.raises(InputError, match="^image must be"):
                lifter.predict(wrong)
        assert len(lifter.predict(two_faces)) == 2
        assert lifter.predict(Image.new("RGB", (200, 200))) == []


def test_threads_take_turns_at_a_detector(two_faces, add_detector):
    """dlib's crashes if two enter it, and all lifters of a process share it."""
    inside, together = [], []

    def find(photo):
        inside.append(1)
        together.append(len(inside))
        faces = DETECTORS["dlib"].open(None)(photo)
        inside.pop()
        return faces[0], np.full(len(faces[0]), 0.75)

    add_detector("slow", find)
    alone = shapes(predict_photo(two_faces, detector="slow"))
    with ThreadPoolExecutor(4) as threads:
        lifters = (FaceLifter("slow").predict for _ in range(8))
        results = [*threads.map(lambda predict: predict(two_faces), lifters)]
    assert all(np.array_equal(shapes(faces), alone) for faces in results)
    assert {*together} == {1}
    assert [face.score for face in results[0]] == [0.75, 0.75]


def test_missing_landmarks_are_predicted_and_do_not_touch_other_faces(landmarks):
    whole, some = predict_landmarks(landmarks), landmarks.copy()
    some[0, :17] = some[1, 30] = some[3] = np.nan
    visible = ~np.isnan(some).any(2)
    ways = (
        predict_landmarks(some),
        predict_landmarks(landmarks, visible=visible),
        predict_landmarks(np.ma.masked_array(landmarks, np.isnan(some))),
    )
    for faces in ways:
        assert np.array_equal(shapes(faces), shapes(ways[0]), equal_nan=True)
        assert [face.angles == "gap" for face in faces] == [i == 3 for i in range(N)]
        assert np.isnan([faces[3].pose.yaw, faces[3].pose.roll, faces[3].pose.scale]).all()
    # On some processors the rounding of a matrix product depends on how many rows it has.
    np.testing.assert_allclose(shapes(ways[0])[4:], shapes(whole)[4:], atol=1e-6)
    jaw = ways[0][0]
    assert np.isfinite(jaw.xyz).all() and np.isfinite(jaw.landmarks_3d).all()
    assert np.isnan(jaw.residuals[:17]).all() and np.isfinite(jaw.bbox).all()
    assert 0 < np.abs(jaw.xyz - whole[0].xyz).max() < 0.1
    assert (jaw.std[:17] > whole[0].std[:17]).all()
    with pytest.raises(InputError, match="the model deepmds needs all landmarks"):
        predict_landmarks(convert(some[1:2], "ibug68", "ibug51"), model="deepmds")


@pytest.mark.parametrize("n", [51, 68, 478])
def test_fractions_of_an_image_are_not_taken_for_pixels(n):
    fractions = np.random.default_rng(n).uniform(0.2, 0.7, (2, n, 2))
    with pytest.raises(InputError, match="fractions of an image: multiply x by its width"):
        predict_landmarks(fractions)


def test_coordinates_may_come_first_and_z_is_named_as_unused(landmarks):
    expected = predict_landmarks(landmarks[:3])
    for given in (landmarks[:3].swapaxes(1, 2), np.dstack([landmarks[:3], landmarks[:3, :, :1]])):
        for face, same in zip(predict_landmarks(given), expected, strict=True):
            assert np.array_equal(face.xyz, same.xyz)
            noted = "z of the landmarks is not used" in " ".join(face.notes)
            assert noted == (given.shape[2] == 3)


def test_what_pandas_and_lists_leave_empty_is_missing(landmarks):
    some = landmarks[:2].copy()
    some[0, 3] = np.nan
    expected = shapes(predict_landmarks(some))
    lists = [[None if np.isnan(x) else [x, y] for x, y in face] for face in some.tolist()]
    pairs = [[[None, None] if np.isnan(x) else [x, y] for x, y in face] for face in some.tolist()]
    for given in (lists, pairs, [some[0], *some[1:]]):
        assert np.array_equal(shapes(predict_landmarks(given)), expected)
    table = pd.DataFrame(some[0], columns=["x", "y"]).convert_dtypes()
    assert np.array_equal(predict_landmarks(table)[0].xyz, predict_landmarks(some[0])[0].xyz)
    gap = predict_landmarks([some[1], None])
    assert [face.is_gap for face in gap] == [False, True]


def test_known_errors_of_landmarks_reach_the_model(landmarks):
    size = np.ptp(landmarks, axis=1).max(1)
    sure, unsure = (predict_landmarks(landmarks, landmark_sd=part * size) for part in (0, 0.1))
    assert np.mean([b.std for b in unsure]) > 1.2 * np.mean([a.std for a in sure])
    each = np.repeat(0.1 * size[:, None], 68, 1)
    assert np.array_equal(shapes(predict_landmarks(landmarks, landmark_sd=each)), shapes(unsure))
    mesh = convert(landmarks, "ibug68", "mediapipe", missing="nan")
    alone = predict_landmarks(mesh[0], landmark_sd=np.full((1, 468), 0.1 * size[0]))
    inner = to_ibug(convert(landmarks[:1], "ibug68", "ibug51"), "mediapipe", "ibug51")
    assert np.array_equal(
        shapes(alone), shapes(predict_landmarks(inner, landmark_sd=0.1 * size[0]))
    )
    one = predict_landmarks(landmarks[0], landmark_sd=each[0])
    assert np.array_equal(one[0].xyz, predict_landmarks(landmarks[:1], landmark_sd=each[:1])[0].xyz)


def test_of_what_is_missing_nothing_need_be_known(landmarks):
    size = np.ptp(landmarks, axis=1).max()
    some, sd = landmarks.copy(), np.full(landmarks.shape[:2], 0.1 * size)
    some[:, 40] = sd[:, 40] = np.nan
    expected = predict_landmarks(some, landmark_sd=0.1 * size)
    assert np.array_equal(shapes(predict_landmarks(some, landmark_sd=sd)), shapes(expected))
    some[:, 40, 0] = 7  # half a landmark is none
    half = predict_landmarks(some, landmark_sd=sd)
    assert np.array_equal(half[0].landmarks_3d, expected[0].landmarks_3d)
    some[:, 40] = np.inf
    hidden = predict_landmarks(some, visible=np.arange(68) != 40, landmark_sd=sd)
    assert np.array_equal(shapes(hidden), shapes(expected))
    with pytest.raises(InputError, match="^landmarks must be finite"):
        predict_landmarks(some)


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        (None, "hold numbers. Received dtype object"),
        ([None, [None, None]], "only null"),
        ({}, "hold numbers. Received dtype object"),
        ([1.0, 2.0], r"have shape .* Received \(2,\)"),
        ([[1.0], [2.0, 3.0]], "one array. Received rows of unequal lengths"),
        ([[[1.0], [2.0, 3.0]], [[1.0, 2.0]]], "one array. Received rows of unequal lengths"),
        (np.zeros((68, 4)), r"\(L, 2\).*. Received \(68, 4\)"),
        (np.full((68, 2), 7), "all 68 landmarks coincide"),
        (np.full((68, 2), np.nan), "not all be missing"),
        (np.full((68, 2), np.inf), "finite, or NaN"),
        (np.array([[(i, i) if i < 20 else (np.nan, 0) for i in range(68)]]), "on one line"),
        (np.array([[(i, i * i) if i < 5 else (np.nan, 0) for i in range(68)]]), "at least 6"),
    ],
)
def test_what_are_no_landmarks_is_refused(wrong, message):
    with pytest.raises(InputError, match=f"^landmarks must.*{message}"):
        predict_landmarks(wrong)


@pytest.mark.parametrize(
    "options",
    [
        *({"interocular": mm} for mm in (-90, 0, np.nan, np.inf, "90")),
        *({"visible": each} for each in (np.ones(67, bool), np.ones(68), "yes", [[True], []])),
        *({"landmark_sd": sd} for sd in (-1, np.nan, [1, 2], "a")),
        {"scheme": "ibug"},
        {"model": "nix"},
    ],
)
def test_wrong_options_are_refused_by_name(landmarks, options):
    with pytest.raises(InputError, match=f"^{[*options][0]} must (be|hold)"):
        predict_landmarks(landmarks, **options)


def test_a_batch_is_judged_by_its_majority_and_a_row_has_a_note(landmarks):
    with pytest.raises(InputError, match="^landmarks, face 1 of 12: y must point d") as refused:
        predict_landmarks(landmarks * (1, -1))
    assert "--" not in str(refused.value)
    one = landmarks.copy()
    one[2] *= (1, -1)
    faces = predict_landmarks(one)
    assert "seems to stand otherwise" in " ".join(faces[2].notes)
    (*_, noted) = predict_landmarks(np.dstack([one, one[..., :1]]))[2].notes
    assert {"is not used", "seems to stand"} == {*re.findall("is not used|seems to stand", noted)}
    others = np.arange(N) != 2
    whole = predict_landmarks(landmarks)
    assert np.allclose(shapes(faces)[others], shapes(whole)[others])
    assert not any("otherwise" in " ".join(faces[i].notes) for i in np.flatnonzero(others))
