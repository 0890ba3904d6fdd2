"""Any detector can find the landmarks of photos: it is a row of a table."""

import numpy as np
import pytest
from PIL import Image

from deepmds_keras import InputError, photos
from deepmds_keras.detection.detectors import DETECTORS, Detector
from deepmds_keras.predict.arguments import parse
from deepmds_keras.predict.detection import faces_in_photos


@pytest.fixture
def made_up(monkeypatch):
    """A third detector, of the 68: as many faces as the first pixel says, the right one first."""

    def open_model(landmarker):
        assert landmarker == "its model"
        face = np.full((68, 2), 7.0) + np.arange(68)[:, None]

        def find(photo):
            n = photo[0, 0, 0]
            return face + 9.0 * np.arange(n)[::-1, None, None], n > 0

        return find

    row = Detector("ibug68", open_model, lambda: True, "nobody's")
    monkeypatch.setitem(DETECTORS, "made-up", row)
    return row


def test_a_third_detector_finds_faces_in_the_order_of_the_method(tmp_path, made_up):
    paths = [tmp_path / name for name in ("two.png", "none.png", "text.png", "one.png")]
    for path, n in zip(paths, (2, 0, None, 1), strict=True):
        if n is None:
            path.write_text("hello")
        else:
            Image.new("RGB", (90, 90), (n, 0, 0)).save(path)
    two, none, text, one = faces_in_photos(paths, "made-up", "its model", None)
    assert two.shape == (2, 68, 2) and one.shape == (1, 68, 2)
    np.testing.assert_array_equal(one[0, :, 0], 7 + np.arange(68))
    np.testing.assert_array_equal(two, [one[0], one[0] + 9], "from left to right")
    assert isinstance(none, InputError) and isinstance(text, InputError)
    assert (
        "no face found by made-up, whichever side is up; try --detector mediapipe or dlib, or"
        in str(none)
    )
    assert "text.png must be a photo" in str(text)


@pytest.mark.parametrize("unsure", [0.0, 0.8])
@pytest.mark.parametrize("quarters", [1, 2, 3])
def test_a_photo_that_lies_on_its_side_is_turned_and_its_landmarks_turned_back(
    tmp_path, monkeypatch, quarters, unsure
):
    """A detector of a white spot in the left upper quarter of a photo that is higher than wide."""
    looked_at = []

    def detect(photo):
        looked_at.append(photo.shape)
        y, x = np.argwhere(photo[..., 0]).mean(0) + 0.5
        height, width = photo.shape[:2]
        upright = height > width and x < width / 2 and y < height / 2
        # One that is wrong, and less sure, where the photo is not upright.
        return np.full((1, 68, 2), (x, y) if upright else (3, 3)), 0.95 if upright else unsure

    row = Detector("ibug68", lambda _: detect, lambda: True, "")
    monkeypatch.setitem(DETECTORS, "spots", row)
    upright = np.zeros((120, 90, 3), np.uint8)
    upright[30:32, 20:24] = 255
    turned = np.rot90(upright, -quarters)
    paths = [tmp_path / "upright.png", tmp_path / "turned.png"]
    for path, photo in zip(paths, (upright, turned), strict=True):
        Image.fromarray(photo).save(path)
    first, second = faces_in_photos(paths, "spots", None, None)
    assert len(looked_at) == 2 + 3  # what is found upright is not turned
    for faces, photo in ((first, upright), (second, turned)):
        y, x = np.argwhere(photo[..., 0]).mean(0) + 0.5
        np.testing.assert_array_equal(faces, np.full((1, 68, 2), (x, y)))


def test_landmarks_of_a_large_photo_are_in_its_own_pixels(tmp_path, made_up, monkeypatch):
    monkeypatch.setattr(photos, "_FULL_PIXELS", 8_000)
    Image.new("RGB", (100, 90), (1, 0, 0)).save(tmp_path / "large.png")
    (faces,) = faces_in_photos([tmp_path / "large.png"], "made-up", "its model", None)
    np.testing.assert_array_equal(faces[0, :, 0], 2 * (7 + np.arange(68)))


def test_the_command_offers_a_third_detector_with_its_terms(made_up, capsys):
    assert parse(["predict", "a.jpg", "--detector", "made-up"]).detector == "made-up"
    with pytest.raises(SystemExit):
        parse(["predict", "--help"])
    assert "made-up (nobody's)" in " ".join(capsys.readouterr().out.split())
