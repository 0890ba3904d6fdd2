"""Writes a video of what was found: landmarks drawn over the frames."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from fractions import Fraction
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from deepmds_keras.video.frames import Frame, import_av, url

_SIDE = 1280  # pixels of the larger side at most
_TICK = Fraction(1, 1000)  # seconds; MPEG-4 has no finer than 1/65535
_LINE, _DOT, _EDGE = "#FFFFFF", "#FFD000", "#333333"  # as in the pictures of photos
_MPEG4_BITS = 6_000_000  # a second
_SETTINGS = {"libx264": {"preset": "veryfast", "crf": "23"}, "mpeg4": {}}


def write_preview(
    path: str | Path,
    frames: Iterable[Frame],
    faces: Mapping[int, Mapping[str, np.ndarray]],
    lines: Sequence[Sequence[int]],
) -> None:
    """Write an MP4 of the frames with their faces, at the times of the frames and without sound.

    H.264 where PyAV has an encoder of it, else MPEG-4; at most 1280 pixels wide or high, all of the
    size of the first frame.

    Args:
        path: Of the file, whatever is in it.
        frames: One or more; one at a time is in memory.
        faces: Of a frame's index its faces: label to `(L, 2)` pixels, x right and y down.
        lines: Polylines that join landmarks.

    Raises:
        InputError: PyAV is missing, or what reading the frames raises.
        OSError: The file cannot be written.
    """
    av = import_av()
    codec = next(name for name in _SETTINGS if name in av.codecs_available)
    stream, last = None, -1
    with av.open(url(path), "w", format="mp4", options={"movflags": "faststart"}) as output:
        for frame in frames:
            if stream is None:
                stream = output.add_stream(codec, rate=30, options=_SETTINGS[codec])
                stream.width, stream.height = _even_size(*frame.image.shape[1::-1])
                stream.pix_fmt, stream.codec_context.time_base = "yuv420p", _TICK
                if codec == "mpeg4":
                    stream.bit_rate = _MPEG4_BITS
            image = _drawn(
                frame.image, (stream.width, stream.height), faces.get(frame.index, {}), lines
            )
            shown = av.VideoFrame.from_image(image)
            shown.pts = last = max(round(frame.time / _TICK), last + 1)
            shown.time_base = _TICK
            output.mux(stream.encode(shown))
        if stream is not None:
            output.mux(stream.encode())


def _even_size(width: int, height: int) -> tuple[int, int]:
    """Width and height of the preview: colour is stored for two by two pixels."""
    scale = min(1, _SIDE / max(width, height))
    return tuple(max(2, 2 * round(scale * side / 2)) for side in (width, height))


def _drawn(
    image: np.ndarray,
    size: tuple[int, int],
    faces: Mapping[str, np.ndarray],
    lines: Sequence[Sequence[int]],
) -> Image.Image:
    scale = np.divide(size, image.shape[1::-1])
    image = Image.fromarray(image)
    if image.size != size:
        image = image.resize(size, Image.Resampling.BILINEAR)
    draw = ImageDraw.Draw(image)
    for label, landmarks in faces.items():
        points = scale * landmarks
        side = np.ptp(points, axis=0).max()
        radius, width = max(1.0, side / 100), max(1, round(side / 150))
        for line in lines:
            draw.line([*map(tuple, points[list(line)])], fill=_LINE, width=width)
        for x, y in points:
            draw.ellipse((x - radius, y - radius, x + radius, y + radius), _DOT, _EDGE, width=0)
        font = ImageFont.load_default(max(12, side / 8))
        corner = points[:, 0].min(), points[:, 1].min() - side / 8
        draw.text(corner, label, _DOT, font, "lb", stroke_width=1, stroke_fill=_EDGE)
    return image
