"""Any detector can find the landmarks of photos: it is a row of a table."""

import numpy as np
import pytest
from PIL import Image

from deepmds_keras import InputError
from deepmds_keras.detection.detectors import DETECTORS, Detector
from deepmds_keras.predict.arguments import parse
from deepmds_keras.predict.detection import faces_in_photos


@pytest.fixture
def made_up(monkeypatch):
    """A third detector, of the 68: as many faces as the first pixel of the photo says."""

    def detect(photos, found):
        assert found == "what find returned"
        for photo in photos:
            yield np.full((photo[0, 0, 0], 68, 2), 7.0) + np.arange(68)[:, None]

    row = Detector("ibug68", lambda python: "what find returned", detect, "nobody's")
    monkeypatch.setitem(DETECTORS, "made-up", row)
    return row


def test_a_third_detector_finds_faces_in_the_order_of_the_method(tmp_path, made_up):
    paths = [tmp_path / name for name in ("two.png", "none.png", "text.png", "one.png")]
    for path, n in zip(paths, (2, 0, None, 1), strict=True):
        if n is None:
            path.write_text("hello")
        else:
            Image.new("RGB", (90, 90), (n, 0, 0)).save(path)
    found = made_up.find(None)
    two, none, text, one = faces_in_photos(paths, "made-up", found)
    assert two.shape == (2, 51, 2) and one.shape == (1, 51, 2)
    np.testing.assert_array_equal(one[0, :, 0], 7 + np.arange(17, 68))
    assert isinstance(none, InputError) and isinstance(text, InputError)
    assert "no face found by made-up; try --detector dlib or mediapipe, or" in str(none)
    assert "text.png must be a photo" in str(text)


def test_the_command_offers_a_third_detector_with_its_terms(made_up, capsys):
    assert parse(["predict", "a.jpg", "--detector", "made-up"]).detector == "made-up"
    with pytest.raises(SystemExit):
        parse(["predict", "--help"])
    assert "made-up (nobody's)" in " ".join(capsys.readouterr().out.split())
