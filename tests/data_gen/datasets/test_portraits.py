"""Photos of expressive faces turned any way: made alike by anybody, with the truth in place."""

import numpy as np
import pytest

from data_gen.datasets.portraits import PIXELS, Portraits
from data_gen.models.openhead import load_openhead

SEED = (0, 3)


def take(*numbers):
    return list(Portraits(load_openhead(), SEED).photos(range(*numbers)))


@pytest.fixture(scope="module")
def photos(apart):
    return apart(take, 6)


def test_a_photo_is_the_same_whichever_others_are_made(apart, photos):
    (again,) = apart(take, 4, 5)
    assert np.array_equal(again.image, photos[4].image)
    assert np.array_equal(again.pixels["bfm72"], photos[4].pixels["bfm72"])


def test_all_landmarks_are_in_the_photo_and_differ_from_face_to_face(photos):
    for photo in photos:
        assert photo.image.shape == (PIXELS, PIXELS, 3)
        assert photo.pixels["ibug68"].min() > 0 and photo.pixels["ibug68"].max() < PIXELS
    assert np.ptp([photo.yaw for photo in photos]) > 30
    assert np.ptp([photo.landmarks["ibug68"] for photo in photos], axis=0).max() > 5


def test_pupils_are_darker_than_what_surrounds_the_eyes(photos):
    """Landmarks lie where the image shows them: the eyes are darker than the nose."""
    darker = 0
    for photo in photos:
        grey = photo.image.mean(2)
        at = np.rint(photo.pixels["ibug68"] - 0.5).astype(int)
        eye = at[36:42] if photo.yaw > 0 else at[42:48]
        x, y = np.rint(eye.mean(0)).astype(int)
        nose_x, nose_y = at[29]
        darker += grey[y - 3 : y + 4, x - 3 : x + 4].min() < grey[nose_y, nose_x]
    assert darker == len(photos)
