"""Photos: what is handled (grey, alpha, 16 bits, rotated, any shape), and what is refused."""

import io

import numpy as np
import pytest
from PIL import Image, features

from deepmds_keras import InputError
from deepmds_keras.tool.detection.photos import check_photo, open_photo, read_photo

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


@pytest.mark.parametrize("grey", [RAMP, np.uint16(RAMP) * 257, RAMP > 100])
def test_grey_photos_become_three_equal_channels(tmp_path, grey):
    photo = open_photo(saved(tmp_path, np.tile(grey, (64, 1))))
    expected = 255 * grey if grey.dtype == bool else RAMP
    assert np.array_equal(photo, np.repeat(np.tile(expected, (64, 1))[..., None], 3, axis=2))


@pytest.mark.parametrize(
    ("kind", "white"),
    [(np.uint16, 255), (np.uint16, 1023), (np.uint16, 4095), (np.int32, 65535),
     (np.float32, 1), (np.float32, 255), (np.float32, 65535)],
)  # fmt: skip
def test_the_largest_grey_value_tells_the_range(tmp_path, kind, white):
    grey = np.tile(RAMP / 255 * white, (64, 1)).astype(kind)
    photo = open_photo(saved(tmp_path, grey, "photo.tif"))
    assert np.abs(photo[..., 0].astype(int) - RAMP).max() <= 1 and photo.max() == 255
    assert np.array_equal(open_photo(Image.fromarray(grey)), photo)


@pytest.mark.parametrize(
    ("kind", "low", "high"),
    [(np.float32, 0, np.nan), (np.float32, -1, 1), (np.float32, 0, 1.2), (np.int32, 0, 70000)],
)
def test_grey_values_in_no_known_range_are_refused(tmp_path, kind, low, high):
    grey = np.linspace(low, high, 64 * 64).reshape(64, 64).astype(kind)
    for source, name in (
        (saved(tmp_path, grey, "a.tif"), "a.tif"),
        (Image.fromarray(grey), "^image"),
    ):
        with pytest.raises(InputError, match=f"{name} must have grey values from 0 to 1, to 255"):
            open_photo(source)


@pytest.mark.parametrize("tag", range(1, 9))
def test_what_pillow_opened_is_brought_upright_as_its_file_is(tmp_path, colour, tag):
    exif = Image.Exif()
    exif[0x0112] = tag
    path = saved(tmp_path, colour[:40], exif=exif)
    with Image.open(path) as opened:
        assert np.array_equal(open_photo(opened), open_photo(path))


def test_transparent_is_white(tmp_path, colour):
    alpha = np.full((64, 64, 1), 255, np.uint8)
    alpha[:, 32:] = 0
    photo = open_photo(saved(tmp_path, np.concatenate([colour, alpha], 2)))
    assert (photo[:, 32:] == 255).all()
    assert np.array_equal(photo[:, :32], colour[:, :32])
    palette = Image.fromarray(colour).quantize(16)
    assert open_photo(saved(tmp_path, palette, transparency=0)).shape == (64, 64, 3)


def test_a_photo_is_opened_pixel_by_pixel_and_upright_from_a_file_or_its_content(tmp_path, colour):
    wide = colour[:40]
    exif = Image.Exif()
    exif[0x0112] = 6
    assert np.array_equal(open_photo(saved(tmp_path, wide)), wide)
    assert np.array_equal(open_photo(saved(tmp_path, wide, exif=exif)), np.rot90(wide, -1))
    content = saved(tmp_path, wide).read_bytes()
    for source in (content, io.BytesIO(content)):
        photo = open_photo(source)
        assert np.array_equal(photo, wide)
    assert check_photo(photo) is photo
    photo[:] = 0  # it is the caller's
    for wrong in (photo[..., 0], photo / 255, photo[:0], photo[:, :0]):
        with pytest.raises(InputError, match="image must be RGB, uint8"):
            check_photo(wrong)
    with pytest.raises(InputError, match="^image must be a readable photo"):
        open_photo(content[:60])


@pytest.mark.skipif(not features.check("avif"), reason="Pillow without AVIF")
def test_avif_is_read_whichever_of_its_brands_is_first(tmp_path, colour):
    path = saved(tmp_path, colour, "a.avif", quality=95)
    content = path.read_bytes()
    for brand in (b"avif", b"mif1"):
        opened = open_photo(content[:8] + brand + content[12:]).astype(int)
        assert np.abs(opened - colour).mean() < 6


@pytest.mark.parametrize("suffix", [".gif", ".png", ".webp"])
def test_pictures_of_an_animation_are_counted(tmp_path, colour, suffix):
    images = [Image.fromarray(np.roll(colour, 9 * i, axis=1)) for i in range(3)]
    path = saved(tmp_path, images[0], f"a{suffix}", save_all=True, append_images=images[1:])
    assert read_photo(path)[1] == read_photo(path.read_bytes())[1] == 3
    assert read_photo(saved(tmp_path, images[0], f"b{suffix}"))[1] == 1
    # Cameras add small copies, which are no animation.
    copies = {"format": "MPO", "save_all": True, "append_images": images[1:]}
    assert read_photo(saved(tmp_path, images[0], "c.jpg", **copies))[1] == 1


def test_heic_is_read_whatever_it_is_called_and_upright(tmp_path, colour):
    from pillow_heif import register_heif_opener

    exif = Image.Exif()
    exif[0x0112] = 6
    register_heif_opener()
    for name in ("photo.heic", "photo.jpg"):
        saved(tmp_path, colour[:40], name, format="HEIF", exif=exif.tobytes(), quality=-1)
        opened = open_photo(tmp_path / name).astype(int)
        assert np.abs(opened - np.rot90(colour[:40], -1)).mean() < 6
    whole = (tmp_path / "photo.heic").read_bytes()
    (tmp_path / "photo.heic").write_bytes(whole[: len(whole) // 2])
    with pytest.raises(InputError, match="photo.heic must be a readable photo"):
        open_photo(tmp_path / "photo.heic")


@pytest.mark.parametrize(
    ("size", "message"),
    [
        ((31, 500), r"at least 32 pixels on each side. Received 31 x 500.$"),
        ((16_010, 16_000), r"at most 256,000,000 pixels. Received 16010 x 16000.$"),
        ((23_000, 23_000), r"at most 256,000,000 pixels. Received 23000 x 23000.$"),
    ],
)
def test_tiny_and_huge_photos_are_refused(tmp_path, size, message):
    path = tmp_path / "photo.png"
    path.write_bytes(b"P5 %d %d 255\n" % size)  # the head of a PGM, which claims to be that large
    with pytest.raises(InputError, match=f"photo.png must.*{message}"):
        open_photo(path)


def test_what_pillow_opened_and_arrays_have_the_least_size_of_files():
    with pytest.raises(InputError, match="image must be at least 32 pixels on each side"):
        open_photo(Image.new("RGB", (1, 40)))
    with pytest.raises(InputError, match=r"H and W at least 32. Received uint8 \(1, 40, 3\)"):
        check_photo(np.zeros((1, 40, 3), np.uint8))


@pytest.mark.parametrize("name", ["photo.png", "photo.webp", "photo.jpg"])
def test_a_photo_with_a_damaged_tag_is_read_as_it_is_stored(tmp_path, colour, name):
    path = saved(tmp_path, colour, name, exif=b"Exif\0\0garbage", lossless=True)
    assert np.abs(open_photo(path).astype(int) - colour).max() < 60


def test_what_is_no_photo_is_refused_in_one_line(tmp_path, colour):
    path = tmp_path / "photo.jpg"
    with pytest.raises(InputError, match="photo.jpg does not exist; it must be a photo"):
        open_photo(path)
    saved(tmp_path, colour, "photo.jpg")
    whole = path.read_bytes()
    for content, received in [
        (b"", "0 bytes"),
        (b"text", "no image format that Pillow reads"),
        (whole[: len(whole) // 2], "OSError: .*[Tt]runcated"),
    ]:
        path.write_bytes(content)
        needed = f"photo.jpg must be a readable photo. Received {received}"
        with pytest.raises(InputError, match=needed) as refused:
            open_photo(path)
        assert "\n" not in str(refused.value)
    with pytest.raises(InputError, match="must be a readable photo. Received a folder"):
        open_photo(tmp_path)
