"""Photos: what is handled (grey, alpha, 16 bits, rotated, any shape), and what is refused."""

import numpy as np
import pytest
from PIL import Image

from deepmds_keras import InputError, read_photo
from deepmds_keras.photos import check_photo, open_photo

RAMP = np.uint8(np.linspace(0, 255, 64))


@pytest.fixture
def colour():
    """Red grows to the right, green downwards."""
    image = np.zeros((64, 64, 3), np.uint8)
    image[..., 0], image[..., 1] = RAMP, RAMP[:, None]
    return image


def saved(folder, image, name="photo.png", **options):
    path = folder / name
    (image if isinstance(image, Image.Image) else Image.fromarray(image)).save(path, **options)
    return path


def test_a_photo_keeps_its_colours_and_directions(tmp_path, colour):
    face = read_photo(saved(tmp_path, colour))
    assert face.shape == (96, 96, 3)
    assert face.dtype == np.uint8
    assert face[48, 90, 0] > 200 > 60 > face[48, 5, 0]
    assert face[90, 48, 1] > 200 > 60 > face[5, 48, 1]


def test_the_middle_square_is_taken_of_a_wide_photo(tmp_path, colour):
    wide = np.concatenate([np.full((64, 40, 3), 9, np.uint8), colour, np.full_like(colour, 9)], 1)
    wide = wide[:, :144]
    assert np.array_equal(read_photo(saved(tmp_path, wide)), read_photo(saved(tmp_path, colour)))


def test_a_box_is_cut_out_and_white_beyond_the_photo(tmp_path, colour):
    face = read_photo(saved(tmp_path, colour), (32, 0, 64, 64), size=64)
    assert np.array_equal(face[:, :32], colour[:, 32:])
    assert (face[:, 33:] == 255).all()


@pytest.mark.parametrize("grey", [RAMP, np.uint16(RAMP) * 257, RAMP > 100])
def test_grey_photos_become_three_equal_channels(tmp_path, grey):
    face = read_photo(saved(tmp_path, np.tile(grey, (64, 1))), size=64)
    expected = 255 * grey if grey.dtype == bool else RAMP
    assert np.array_equal(face, np.repeat(np.tile(expected, (64, 1))[..., None], 3, axis=2))


def test_transparent_is_white(tmp_path, colour):
    alpha = np.full((64, 64, 1), 255, np.uint8)
    alpha[:, 32:] = 0
    face = read_photo(saved(tmp_path, np.concatenate([colour, alpha], 2)), size=64)
    assert (face[:, 33:] == 255).all()
    assert np.array_equal(face[:, :31], colour[:, :31])
    palette = Image.fromarray(colour).quantize(16)
    assert read_photo(saved(tmp_path, palette, transparency=0)).shape == (96, 96, 3)


def test_the_note_on_which_way_is_up_is_followed(tmp_path, colour):
    exif = Image.Exif()
    exif[0x0112] = 6  # to be turned by 90 degrees clockwise
    face = read_photo(saved(tmp_path, colour, exif=exif), size=64)
    assert np.array_equal(face, np.rot90(colour, -1))


def test_a_whole_photo_is_opened_pixel_by_pixel_upright_and_on_white(tmp_path, colour):
    wide = colour[:40]
    exif = Image.Exif()
    exif[0x0112] = 6
    assert np.array_equal(open_photo(saved(tmp_path, wide)), wide)
    assert np.array_equal(open_photo(saved(tmp_path, wide, exif=exif)), np.rot90(wide, -1))
    clear = np.concatenate([wide, np.zeros((40, 64, 1), np.uint8)], 2)
    photo = open_photo(saved(tmp_path, clear))
    assert (photo == 255).all()
    assert check_photo(photo) is photo
    photo[:] = 0  # it is the caller's


@pytest.mark.parametrize("read", [open_photo, read_photo])
@pytest.mark.parametrize(
    ("size", "message"),
    [
        ((31, 500), r"at least 32 pixels on each side. Received 31 x 500.$"),
        ((10_000, 10_000), r"at most 64,000,000 pixels. Received 10000 x 10000.$"),
        ((14_000, 13_000), r"at most 64,000,000 pixels. Received: Image size \(182000000 pixels"),
    ],
)
def test_tiny_and_huge_photos_are_refused(tmp_path, read, size, message):
    path = saved(tmp_path, Image.new("1", size))
    with pytest.raises(InputError, match=f"photo.png must.*{message}"):
        read(path)


@pytest.mark.parametrize("read", [open_photo, read_photo])
def test_what_is_no_photo_is_refused_in_one_line(tmp_path, colour, read):
    path = tmp_path / "photo.jpg"
    with pytest.raises(InputError, match="photo.jpg does not exist; it must be a photo"):
        read(path)
    saved(tmp_path, colour, "photo.jpg")
    whole = path.read_bytes()
    for content, received in [
        (b"", "0 bytes"),
        (b"text", "no image of a kind that Pillow reads"),
        (whole[: len(whole) // 2], "OSError: .*[Tt]runcated"),
    ]:
        path.write_bytes(content)
        needed = f"photo.jpg must be a photo that can be read. Received {received}"
        with pytest.raises(InputError, match=needed) as refused:
            read(path)
        assert "\n" not in str(refused.value)
    with pytest.raises(InputError, match="must be a photo that can be read. Received a folder"):
        read(tmp_path)


@pytest.mark.parametrize("box", [(0, 0, 0, 5), (0, 0, 5, -1), (0, 0, np.nan, 5)])
def test_a_box_without_area_is_refused(tmp_path, colour, box):
    with pytest.raises(InputError, match="box must be"):
        read_photo(saved(tmp_path, colour), box)
