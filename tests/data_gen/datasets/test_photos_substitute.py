"""Photos of synthetic faces, in CelebA's form and turned any way, with the truth about them."""

import functools

import numpy as np
import pytest

from data_gen.datasets.photos_substitute import PIXELS, PhotosSubstitute, Portraits
from data_gen.models.openhead import load_openhead
from deepmds_keras.geometry.camera import orthographic_cameras

N = 12
RIGHT_EYE, LEFT_EYE = slice(36, 42), slice(42, 48)  # of iBUG's landmarks


@functools.cache  # in the process that draws, since a scene takes seconds
def source(kind):
    if kind == "photos":
        return PhotosSubstitute(load_openhead(), 100, (0, 11))
    return Portraits(load_openhead(), (0, 3))


def take(kind, *numbers):
    return list(source(kind).photos(range(*numbers)))


def take_two_at_once(kind):
    """Two unfinished series side by side, the second of photos that the first has drawn as well."""
    photos = source(kind)
    first, second = photos.photos(range(2, 10)), photos.photos(range(4, 1, -1))
    next(first)
    return [next(second) for _ in range(3)]


@pytest.fixture(scope="module")
def photos(apart):
    return apart(take, "photos", N)


@pytest.fixture(scope="module")
def portraits(apart):
    return apart(take, "portraits", 6)


def of(photos, name, scheme=None):
    values = [getattr(photo, name) for photo in photos]
    return np.array([value[scheme] for value in values] if scheme else values)


@pytest.mark.parametrize("kind", ["photos", "portraits"])
def test_a_photo_is_the_same_whichever_others_are_drawn(request, apart, kind):
    first, again = request.getfixturevalue(kind), apart(take_two_at_once, kind)
    assert [photo.name for photo in again] == ["000005.jpg", "000004.jpg", "000003.jpg"]
    for photo, other in zip(again, first[4:1:-1], strict=True):
        assert np.array_equal(photo.image, other.image)
        assert np.array_equal(photo.pixels["ibug68"], other.pixels["ibug68"])


def test_photos_are_framed_by_the_eyes_as_celeba_has_them(photos):
    images = of(photos, "image")
    assert images.shape == (N, 218, 178, 3)
    # No two photos show the same background, whatever the head in the middle.
    sides = images[:, :100, ::16].reshape(N, -1).astype(float)
    assert (np.abs(sides[:, None] - sides).mean(-1) + 1000 * np.eye(N)).min() > 5
    pixels = of(photos, "pixels", "ibug68")
    right, left = pixels[:, RIGHT_EYE].mean(1), pixels[:, LEFT_EYE].mean(1)
    assert np.allclose((right + left).mean(0) / 2, [89, 111.5], atol=1.5)
    apart = np.linalg.norm(left - right, axis=1)
    assert abs(apart.mean() - 38) < 1 and 0.3 < apart.std() < 2.5
    tilt = np.rad2deg(np.arctan2(left[:, 1] - right[:, 1], left[:, 0] - right[:, 0]))
    assert abs(tilt).max() < 8 and tilt.std() > 1


def test_landmarks_are_those_of_the_neutral_face_and_pixels_those_seen_from_its_angles(photos):
    model, landmarks = load_openhead(), of(photos, "landmarks", "bfm72")
    rngs = (np.random.default_rng([0, 11, number]) for number in range(N))
    identity = np.array([rng.standard_normal(model.n_identity) for rng in rngs])
    assert np.allclose(landmarks, model.shape(identity)[:, model.landmarks["bfm72"]])
    seen = of(photos, "pixels", "bfm72") * (1, -1)
    poses = orthographic_cameras(seen, landmarks)
    yaw, pitch = np.array([(pose.yaw, pose.pitch) for pose in poses]).T
    assert 9 < yaw.std() < 21 and 4 < pitch.std() < 11
    # An orthographic camera explains what is seen, but for perspective.
    assert np.allclose(yaw, of(photos, "yaw"), atol=3)
    for pose, points, places in zip(poses, landmarks, seen, strict=True):
        assert 1.2 < 1 / pose.scale < 2.2  # millimetres of a pixel
        missed = np.linalg.norm(pose.project(points) - places, axis=1).max()
        assert missed < 0.06 * np.ptp(places)


@pytest.mark.parametrize("kind", ["photos", "portraits"])
def test_eyes_are_dark_where_the_landmarks_are(request, kind):
    darker = []
    for photo in request.getfixturevalue(kind):
        grey, at = photo.image.mean(2), np.rint(photo.pixels["ibug68"] - 0.5).astype(int)
        x, y = np.rint(at[RIGHT_EYE if photo.yaw > 0 else LEFT_EYE].mean(0)).astype(int)
        nose_x, nose_y = at[29]
        darker.append(grey[y - 2 : y + 3, x - 2 : x + 3].min() < grey[nose_y, nose_x])
    assert np.mean(darker) > 0.9


def test_portraits_differ_and_hold_all_landmarks(portraits):
    assert of(portraits, "image").shape == (6, PIXELS, PIXELS, 3)
    pixels = of(portraits, "pixels", "ibug68")
    assert pixels.min() > 0 and pixels.max() < PIXELS
    assert np.ptp(of(portraits, "yaw")) > 30
    assert np.ptp(of(portraits, "landmarks", "ibug68"), axis=0).max() > 5
