"""Opens photos, and makes of them the images that MobileFace takes."""

from __future__ import annotations

import io
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from PIL import Image, ImageOps, UnidentifiedImageError

from deepmds_keras.errors import InputError, needs

IMAGE_SIZE = 96  # of a side of what MobileFace sees
MIN_SIDE, MAX_PIXELS = 32, 256_000_000
_FULL_PIXELS = MAX_PIXELS // 4  # more are halved each way: no photo takes more than 200 MB then
_MAX_BYTES = 1 << 29
# Modes of Pillow whose values cannot be averaged: palettes, bits, and 16 bits a pixel.
_NOT_AVERAGED = ("1", "P", "PA", "I;16", "I;16L", "I;16B", "I;16N")


def open_photo(path: str | Path) -> np.ndarray:
    """A photo, in colour and upright; one of more than 64 million pixels at half its size.

    A grey photo becomes one of three equal channels, transparency white, and the camera's note on
    which way is up is followed.

    Args:
        path: Any kind of file that Pillow reads, but PostScript, and HEIC where pillow-heif is
            installed; of several frames the first is taken.

    Returns:
        `(H, W, 3)` uint8, RGB. `photo_step` tells how many pixels of the photo a pixel is.

    Raises:
        InputError: The file is missing or no photo, is cut short, has a side below 32 pixels or
            more than 256 million pixels, or is larger than 512 MiB.
    """
    with _opened(path) as photo:
        return np.array(in_colour(ImageOps.exif_transpose(_reduced(photo))))


def photo_step(path: str | Path) -> int:
    """Pixels of a photo, along a side, for a pixel of `open_photo`: 1, or 2 of a large one.

    Raises:
        InputError: As `open_photo`, but that the photo is cut short.
    """
    with _opened(path) as photo:
        return _step(photo)


def read_photo(
    path: str | Path,
    box: tuple[float, float, float, float] | None = None,
    *,
    size: int = IMAGE_SIZE,
) -> np.ndarray:
    """The face in a photo, as `open_photo` sees it, of the size that the network takes.

    What the box has beyond the photo is white.

    Args:
        path: As for `open_photo`.
        box: `(left, top, width, height)` of the face in pixels, about 1.4 times the box of its
            landmarks; None takes the largest square in the middle.
        size: Pixels of a side of the result; the aspect of the box is not kept.

    Returns:
        `(size, size, 3)` uint8, RGB.

    Raises:
        InputError: As `open_photo`, or the box has no area.
    """
    photo, step = Image.fromarray(open_photo(path)), photo_step(path)
    if box is None:
        side = min(photo.size)
        left, top, width, height = (photo.width - side) / 2, (photo.height - side) / 2, side, side
    else:
        left, top, width, height = np.divide(box, step)
    if not (width > 0 and height > 0 and np.isfinite([left, top, width, height]).all()):
        raise InputError(f"box must be (left, top, width > 0, height > 0). Received {tuple(box)}.")
    corners = np.rint([left, top, left + width, top + height]).astype(int)
    face = Image.new(
        "RGB", (max(corners[2] - corners[0], 1), max(corners[3] - corners[1], 1)), "white"
    )
    face.paste(photo, (-corners[0], -corners[1]))
    return np.asarray(face.resize((size, size), Image.Resampling.BILINEAR))


def check_photo(photo: np.ndarray) -> np.ndarray:
    """A photo as `open_photo` returns it.

    Raises:
        InputError: Not `(H, W, 3)` uint8.
    """
    photo = np.asarray(photo)
    if photo.ndim != 3 or photo.shape[2] != 3 or photo.dtype != np.uint8:
        raise InputError(
            f"image must be RGB, uint8 (H, W, 3). Received {photo.dtype} {photo.shape}."
        )
    return photo


@contextmanager
def _opened(path: str | Path) -> Iterator[Image.Image]:
    """A photo of which only the head is read; whatever goes wrong becomes one line."""
    try:
        with warnings.catch_warnings(), _pillows_limit(MAX_PIXELS):
            warnings.simplefilter("ignore")  # of what is above half its limit
            content = _content(path)
            if _is_heif(content):
                _add_heif(path)
            # From memory, where what is claimed to follow is not allotted before it is read.
            with Image.open(io.BytesIO(content)) as opened:
                if opened.format == "EPS":  # which Pillow would have Ghostscript run
                    raise InputError(f"{path} must be a photo. Received PostScript, a program.")
                _check_size(path, *opened.size)
                yield opened
    except FileNotFoundError:
        raise InputError(f"{path} does not exist; it must be a photo.") from None
    except InputError:
        raise
    except Image.DecompressionBombError as error:
        size = str(error).partition(" exceeds")[0]
        raise InputError(
            f"{path} must have at most {MAX_PIXELS:,} pixels. Received: {size}."
        ) from None
    except Exception as error:  # Pillow raises many kinds for a damaged file
        raise InputError(
            f"{path} must be a photo that can be read. Received {_received(path, error)}."
        ) from None


@contextmanager
def _pillows_limit(pixels: int) -> Iterator[None]:
    """Its own lets no photo of 200 million pixels pass, as some telephones take them."""
    before, Image.MAX_IMAGE_PIXELS = Image.MAX_IMAGE_PIXELS, pixels
    try:
        yield
    finally:
        Image.MAX_IMAGE_PIXELS = before


def _content(path: str | Path) -> bytes:
    path = Path(path)
    if (size := path.stat().st_size) > _MAX_BYTES:
        raise InputError(f"{path} must be a photo of at most 512 MiB. Received {size:,} bytes.")
    return path.read_bytes()


def _is_heif(content: bytes) -> bool:
    """By the content: telephones send HEIC files called `.jpg`."""
    return content[4:8] == b"ftyp" and content[8:12] not in (b"avif", b"avis")


def _add_heif(path: str | Path) -> None:
    with needs(f"{path}: pillow-heif, which opens HEIC photos,", "heic"):
        from pillow_heif import register_heif_opener
    register_heif_opener()


def _check_size(path: str | Path, width: int, height: int) -> None:
    """Before anything is decoded: a small file can claim to be a huge image."""
    if min(width, height) < MIN_SIDE:
        raise InputError(
            f"{path} must be at least {MIN_SIDE} pixels on each side. Received {width} x {height}."
        )
    if width * height > MAX_PIXELS:
        raise InputError(
            f"{path} must have at most {MAX_PIXELS:,} pixels. Received {width} x {height}."
        )


def _step(photo: Image.Image) -> int:
    return 2 if photo.width * photo.height > _FULL_PIXELS else 1


def _reduced(photo: Image.Image) -> Image.Image:
    """At half its size if it is large, without its other half being decoded if it is a JPEG."""
    if _step(photo) == 1:
        return photo
    half = photo.width // 2, photo.height // 2
    if photo.format in ("JPEG", "MPO") and photo.draft(None, half):
        return photo
    if photo.mode in _NOT_AVERAGED:
        return photo.resize(half, Image.Resampling.NEAREST)
    return photo.reduce(2)


def in_colour(photo: Image.Image) -> Image.Image:
    """The photo as RGB; transparency becomes white."""
    if photo.mode.startswith("I"):  # 16 bits a pixel, which Pillow would cut off at 255
        photo = Image.fromarray(np.uint8(np.asarray(photo, float).clip(0, 65535) / 257))
    if photo.has_transparency_data:
        photo = photo.convert("RGBA")
        white = Image.new("RGBA", photo.size, "white")
        photo = Image.alpha_composite(white, photo)
    return photo.convert("RGB")


def _received(path: str | Path, error: Exception) -> str:
    """In the reader's words, on one line."""
    if isinstance(error, IsADirectoryError) or Path(path).is_dir():
        return "a folder"
    if isinstance(error, UnidentifiedImageError):
        return "no image of a kind that Pillow reads" if Path(path).stat().st_size else "0 bytes"
    return f"{type(error).__name__}: {' '.join(str(error).split())[:200]}"
