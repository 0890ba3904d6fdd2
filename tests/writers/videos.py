"""Videos from arrays of frames."""

from __future__ import annotations

from fractions import Fraction

import pytest

CODECS = {".avi": "mpeg4", ".mov": "mpeg4", ".webm": "libvpx"}  # others: libx264


def write_video(path, images, times=None, rotation=0, pixel=None):
    """The images, 25 a second or at the times given in ms, in the container of the suffix.

    Args:
        path: Where; its suffix is one that `deepmds predict` takes.
        images: Of one size, each `(H, W, 3)` uint8.
        times: Of each image.
        rotation: Degrees counterclockwise, which is noted for the player only.
        pixel: Width by height of a pixel.
    """
    av = pytest.importorskip("av")
    codec = CODECS.get(path.suffix, "libx264")
    options = {"movflags": "faststart"} if path.suffix in (".mp4", ".mov") else {}
    with av.open(str(path), "w", options=options) as output:
        stream = output.add_stream(codec, rate=25, options={"g": "10"})
        stream.height, stream.width = images[0].shape[:2]
        stream.pix_fmt, stream.bit_rate = "yuv420p", 2_000_000
        if times is not None:
            stream.codec_context.time_base = Fraction(1, 1000)
        if pixel is not None:
            stream.codec_context.sample_aspect_ratio = Fraction(pixel)
        if rotation:
            if not hasattr(stream, "set_display_rotation"):
                pytest.skip("this PyAV cannot note a rotation")
            stream.set_display_rotation(rotation)
        for i, image in enumerate(images):
            frame = av.VideoFrame.from_ndarray(image)
            if times is not None:
                frame.pts, frame.time_base = times[i], Fraction(1, 1000)
            output.mux(stream.encode(frame))
        output.mux(stream.encode())
    return path
