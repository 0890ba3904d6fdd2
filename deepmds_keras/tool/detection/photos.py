"""Opens photos of any common kind, in colour and upright."""

from __future__ import annotations

import io
import os
import struct
from contextlib import suppress
from pathlib import Path
from typing import BinaryIO

import numpy as np
from PIL import Image, ImageOps, UnidentifiedImageError

from deepmds_keras.errors import InputError, MissingPackageError, brief, needs

MIN_SIDE, MAX_PIXELS = 32, 256_000_000
_MAX_BYTES = 1 << 29
_ANIMATED = ("AVIF", "GIF", "PNG", "WEBP")


def open_photo(source: str | Path | bytes | BinaryIO | Image.Image) -> np.ndarray:
    """The photo of `read_photo` alone."""
    return read_photo(source)[0]


def read_photo(source: str | Path | bytes | BinaryIO | Image.Image) -> tuple[np.ndarray, int]:
    """A photo, in colour and upright, and the number of pictures in its file.

    A grey photo gets three equal channels, transparency becomes white, and the camera's
    orientation tag is applied. If grey values have more than 8 bits, the largest tells how many.

    Args:
        source: File, its content, an open binary file, or what Pillow opened. Any format that
            Pillow reads except PostScript, and HEIC if pillow-heif is installed; the first of
            several frames.

    Returns:
        `(H, W, 3)` uint8, RGB; and how many pictures an animation has, 1 for all else: small
        copies in a camera's file do not count.

    Raises:
        InputError: The file is missing, damaged or not a photo, has a side below 32 pixels or more
            than 256 million pixels, is larger than 512 MiB, or has values in no known range.
    """
    name = source if isinstance(source, (str, os.PathLike)) else "image"
    try:
        if isinstance(source, Image.Image):
            _check_head(source)
            return _pixels(source), 1
        content = _content(source)
        # By the content: telephones send HEIC files called `.jpg`. AVIF may be the second brand.
        brands = content[8 : int.from_bytes(content[:4])]
        is_heic = content[4:8] == b"ftyp" and not (b"avif" in brands or b"avis" in brands)
        with _opened_heic(content, name) if is_heic else _opened(content) as photo:
            _check_head(photo)
            n_pictures = getattr(photo, "n_frames", 1) if photo.format in _ANIMATED else 1
            return _pixels(photo), n_pictures
    except MissingPackageError:
        raise
    except FileNotFoundError:
        raise InputError(f"{name} does not exist; it must be a photo.") from None
    except InputError as error:
        raise InputError(f"{name} {error}") from None
    except Exception as error:  # Pillow raises many kinds for a damaged file
        received = f"{type(error).__name__}: {brief(error)}"
        if isinstance(error, UnidentifiedImageError):
            received = "no image format that Pillow reads" if content else "0 bytes"
        elif isinstance(error, (IsADirectoryError, PermissionError)) and os.path.isdir(name):
            received = "a folder"
        raise InputError(f"{name} must be a readable photo. Received {received}.") from None


def check_photo(photo: np.ndarray) -> np.ndarray:
    """Check that a photo is as `open_photo` returns it.

    Raises:
        InputError: Not `(H, W, 3)` uint8, or smaller.
    """
    photo = np.asarray(photo)
    is_rgb = photo.ndim == 3 and photo.shape[2] == 3 and photo.dtype == np.uint8
    if not is_rgb or min(photo.shape[:2]) < MIN_SIDE:
        raise InputError(
            f"image must be RGB, uint8 (H, W, 3), with H and W at least {MIN_SIDE}. "
            f"Received {photo.dtype} {photo.shape}."
        )
    return photo


def _pixels(photo: Image.Image) -> np.ndarray:
    with suppress(Exception):  # Pillow raises many kinds for a damaged tag, which is no bad photo
        photo = ImageOps.exif_transpose(photo)
    if photo.mode.startswith(("I", "F")):  # more than 8 bits per pixel, which Pillow would clip
        photo = Image.fromarray(_in_8_bits(np.asarray(photo, float)))
    if photo.has_transparency_data:
        photo = photo.convert("RGBA")
        photo = Image.alpha_composite(Image.new("RGBA", photo.size, "white"), photo)
    return np.array(photo.convert("RGB"))


def _in_8_bits(grey: np.ndarray) -> np.ndarray:
    """Grey values from 0 to 255; white is 1, or the largest number of as few bits as hold them."""
    largest, whites = grey.max(), [2**bits - 1 for bits in (1, 8, 10, 12, 14, 16)]
    # A little more than 1 may be of either range; NaN is of none.
    if not (grey.min() >= 0 and largest <= whites[-1]) or 1 < largest < 2:
        raise InputError(
            "must have grey values from 0 to 1, to 255 or to 65535; bring them to 0 to 255. "
            f"Received {grey.min():.6g} to {largest:.6g}."
        )
    white = next(white for white in whites if largest <= white)
    return np.rint(grey * (255 / white)).astype(np.uint8)


def _opened_heic(content: bytes, name: object) -> Image.Image:
    with needs(f"{name}: pillow-heif, which opens HEIC photos,", "heic"):
        from pillow_heif import HeifImageFile
    return HeifImageFile(io.BytesIO(content))


def _opened(content: bytes) -> Image.Image:
    """`Image.open`, without its limit of pixels: that is below ours, and the whole process's.

    It is opened in memory, where what is claimed to follow is not allotted before it is read.
    """
    for register in (Image.preinit, Image.init):  # Pillow's common kinds, then all
        register()
        for kind in Image.ID:
            factory, accepts = Image.OPEN[kind]
            with suppress(SyntaxError, IndexError, TypeError, struct.error):  # of another kind
                accepted = accepts is None or accepts(content[:16])
                if accepted and not isinstance(accepted, str):  # a text says what is missing
                    return factory(io.BytesIO(content), "")
    raise UnidentifiedImageError


def _content(source: str | Path | bytes | BinaryIO) -> bytes:
    if isinstance(source, (str, os.PathLike)):
        with open(source, "rb") as file:
            return _content(file)
    content = source if isinstance(source, bytes) else source.read(_MAX_BYTES + 1)
    if len(content) > _MAX_BYTES:
        raise InputError("must be a photo of at most 512 MiB. Received more.")
    return content


def _check_head(photo: Image.Image) -> None:
    """Before anything is decoded: a small file can claim to be a huge image."""
    width, height = photo.size
    if photo.format == "EPS":  # which Pillow would have Ghostscript run
        raise InputError("is PostScript, which is not supported; convert it to PNG.")
    if min(width, height) < MIN_SIDE:
        raise InputError(
            f"must be at least {MIN_SIDE} pixels on each side. Received {width} x {height}."
        )
    if width * height > MAX_PIXELS:
        raise InputError(f"must have at most {MAX_PIXELS:,} pixels. Received {width} x {height}.")
