"""Photos of synthetic faces: in CelebA's form, with the truth about what they show."""

from dataclasses import replace

import numpy as np
import pytest

from data_gen.datasets.photos_standin import PhotosStandin
from data_gen.models.openhead import load_openhead
from data_gen.views.projections import Cameras, rotations
from deepmds_keras.errors import InputError

N, SEED = 36, (0, 11)
RIGHT_EYE, LEFT_EYE = slice(36, 42), slice(42, 48)  # of iBUG's landmarks
LIPS, BRIDGE = [50, 52, 56, 58], [27, 28, 29]


def take(*numbers):
    return list(PhotosStandin(load_openhead(), 100, SEED).photos(range(*numbers)))


def take_two_at_once():
    """Two unfinished series side by side, the second of photos that the first has made as well."""
    source = PhotosStandin(load_openhead(), 100, SEED)
    first, second = source.photos(range(2, 10)), source.photos(range(4, 1, -1))
    next(first)
    return len(source), [next(second) for _ in range(3)]


@pytest.fixture(scope="module")
def model():
    return load_openhead()


@pytest.fixture(scope="module")
def photos(apart):
    return apart(take, N)


def of(photos, name, scheme=None):
    values = [getattr(photo, name) for photo in photos]
    return np.array([value[scheme] for value in values] if scheme else values)


def test_a_photo_is_the_same_whichever_others_are_made(apart, photos):
    n, again = apart(take_two_at_once)
    assert n == 100
    assert [photo.name for photo in again] == ["000005.jpg", "000004.jpg", "000003.jpg"]
    for photo, other in zip(again, photos[4:1:-1], strict=True):
        assert photo.name == other.name
        assert np.array_equal(photo.image, other.image)
        assert np.array_equal(photo.pixels["ibug68"], other.pixels["ibug68"])


def test_photos_are_framed_by_the_eyes_as_celeba_has_them(photos):
    assert of(photos, "image").shape == (N, 218, 178, 3)
    pixels = of(photos, "pixels", "ibug68")
    right, left = pixels[:, RIGHT_EYE].mean(1), pixels[:, LEFT_EYE].mean(1)
    assert np.allclose((right + left).mean(0) / 2, [89, 111.5], atol=1.5)
    apart = np.linalg.norm(left - right, axis=1)
    assert abs(apart.mean() - 38) < 1 and 0.3 < apart.std() < 2.5
    tilt = np.rad2deg(np.arctan2(left[:, 1] - right[:, 1], left[:, 0] - right[:, 0]))
    assert abs(tilt).max() < 8 and tilt.std() > 1
    inside = (pixels > 0).all(-1) & (pixels < (178, 218)).all(-1)
    assert inside.mean() > 0.98


def test_landmarks_are_those_of_the_neutral_face(model, photos):
    shapes = model.shape(of(photos, "identity"))
    for scheme in ("bfm72", "ibug68"):
        assert np.allclose(of(photos, "landmarks", scheme), shapes[:, model.landmarks[scheme]])
    identity = of(photos, "identity")
    assert abs(identity.mean()) < 0.05 and abs(identity.std() - 1) < 0.05


def test_pixels_are_the_landmarks_seen_from_the_angles_told(photos):
    angles = np.array([of(photos, name) for name in ("yaw", "pitch", "roll")])
    assert 9 < angles[0].std() < 21 and 4 < angles[1].std() < 11
    turns = rotations(Cameras(np.ones(N, int), *angles, np.zeros(N)))
    for photo, turn in zip(photos, turns, strict=True):
        posed = photo.landmarks["bfm72"] @ turn.T
        seen = photo.pixels["bfm72"] * (1, -1)
        # A scale and a shift explain what is seen, but for perspective.
        posed, seen = posed[:, :2] - posed[:, :2].mean(0), seen - seen.mean(0)
        scale = (posed * seen).sum() / (posed**2).sum()
        assert 1.2 < 1 / scale < 2.2  # millimetres of a pixel
        assert np.linalg.norm(scale * posed - seen, axis=1).max() < 0.06 * np.ptp(seen)


def redness(image, places):
    """Mean of red over green about some places."""
    columns, rows = np.int64(places).T
    values = [image[rows + i, columns + j].astype(float) for i in (-1, 0, 1) for j in (-1, 0, 1)]
    red, green, _ = np.mean(values, axis=(0, 1))
    return red / green


def test_lips_are_red_where_the_landmarks_are_and_not_where_their_mirror_image_is(photos):
    turned = [photo for photo in photos if abs(photo.yaw) > 10]
    assert len(turned) > 8
    above_skin, above_mirrored = [], []
    for photo in turned:
        places = photo.pixels["ibug68"]
        lips = redness(photo.image, places[LIPS])
        above_skin.append(lips / redness(photo.image, places[BRIDGE]))
        mirrored = redness(photo.image[:, ::-1], places[LIPS])
        above_mirrored.append(lips / mirrored)
    assert np.median(above_skin) > 1.1
    assert np.median(above_mirrored) > 1.02


def test_backgrounds_differ_and_faces_stand_out(photos):
    images = of(photos, "image").astype(float)
    corners = images[:, :20, :20].mean((1, 2, 3))
    assert corners.std() > 30
    assert ((images[:, :20, :20] > 250).all(-1).mean((1, 2)) > 0.9).mean() < 0.2
    # No two photos show the same background, whatever the head in the middle.
    sides = images[:, :100, ::16].reshape(N, -1)
    apart = np.abs(sides[:, None] - sides).mean(-1) + 1000 * np.eye(N)
    assert apart.min() > 5


def test_a_model_without_the_landmarks_is_refused(model):
    bare = replace(model, name="bare", landmarks={"ibug68": model.landmarks["ibug68"]})
    with pytest.raises(InputError, match="bare must have the landmarks bfm72 .* Received ibug68"):
        PhotosStandin(bare, 1, [0])
