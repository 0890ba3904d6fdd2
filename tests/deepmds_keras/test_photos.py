"""Photos: what is handled (grey, alpha, 16 bits, rotated, any shape), and what is refused."""

import sys

import numpy as np
import pytest
from PIL import Image

from deepmds_keras import InputError, photos, read_photo
from deepmds_keras.photos import check_photo, open_photo, photo_step

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


@pytest.mark.parametrize("kind", ["jpg", "png"])
def test_a_large_photo_is_halved_and_its_pixels_stay_in_place(tmp_path, monkeypatch, kind):
    """A square of 16 pixels at (32, 16) of a photo of an odd number of them."""
    photo = np.zeros((81, 121, 3), np.uint8)
    photo[16:32, 32:48] = 255
    path = saved(tmp_path, photo, f"photo.{kind}", **({"quality": 100} if kind == "jpg" else {}))
    assert photo_step(path) == 1
    assert open_photo(path).shape == photo.shape
    box = read_photo(path, (30, 14, 20, 20), size=64)
    monkeypatch.setattr(photos, "_FULL_PIXELS", 81 * 121 - 1)
    assert photo_step(path) == 2
    half = open_photo(path)
    assert half.shape == (41, 61, 3)
    inside = np.zeros((41, 61), bool)
    inside[8:16, 16:24] = True
    np.testing.assert_array_equal((half > 127).all(2), inside)
    assert np.abs(read_photo(path, (30, 14, 20, 20), size=64) - box.astype(float)).mean() < 12


@pytest.mark.parametrize("mode", ["1", "L", "LA", "P", "RGBA", "CMYK", "I;16", "I", "F"])
def test_large_photos_of_every_mode_are_halved(tmp_path, monkeypatch, mode):
    monkeypatch.setattr(photos, "_FULL_PIXELS", 8_000)
    path = saved(tmp_path, Image.new(mode, (100, 90)), "photo.tif")
    assert open_photo(path).shape == (45, 50, 3)


def test_heic_is_read_whatever_it_is_called_and_upright(tmp_path, colour):
    pytest.importorskip("pillow_heif", reason="pillow-heif is absent: pip install .[heic]")
    exif = Image.Exif()
    exif[0x0112] = 6
    from pillow_heif import register_heif_opener

    register_heif_opener()
    for name in ("photo.heic", "photo.jpg"):
        saved(tmp_path, colour[:40], name, format="HEIF", exif=exif.tobytes(), quality=-1)
        found = open_photo(tmp_path / name).astype(int)
        assert np.abs(found - np.rot90(colour[:40], -1)).mean() < 6
    whole = (tmp_path / "photo.heic").read_bytes()
    (tmp_path / "photo.heic").write_bytes(whole[: len(whole) // 2])
    with pytest.raises(InputError, match="photo.heic must be a photo that can be read"):
        open_photo(tmp_path / "photo.heic")


def test_without_what_reads_heic_its_extra_is_named(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "pillow_heif", None)
    path = tmp_path / "photo.heic"
    path.write_bytes(b"\0\0\0\x18ftypheic\0\0\0\0mif1heic")
    with pytest.raises(InputError, match=r"photo.heic: .* 'deepmds-keras\[heic\]'"):
        open_photo(path)


@pytest.mark.parametrize("read", [open_photo, read_photo])
@pytest.mark.parametrize(
    ("size", "message"),
    [
        ((31, 500), r"at least 32 pixels on each side. Received 31 x 500.$"),
        ((16_010, 16_000), r"at most 256,000,000 pixels. Received 16010 x 16000.$"),
        ((23_000, 23_000), r"at most 256,000,000 pixels. Received: Image size \(529000000 pixels"),
    ],
)
def test_tiny_and_huge_photos_are_refused(tmp_path, read, size, message):
    path = tmp_path / "photo.png"
    path.write_bytes(b"P5 %d %d 255\n" % size)  # the head of a PGM, which claims to be that large
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
