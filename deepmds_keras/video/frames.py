"""Reads videos frame by frame: upright, each with its time, whatever of a damaged file there is."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path

import numpy as np

from deepmds_keras.errors import InputError, needs
from deepmds_keras.photos import MIN_SIDE

_TAIL = {True: 1.0, False: 0.1}  # seconds by which sound may outlast the pictures, or these err
_MAX_PIXELS = 64_000_000  # twice those of 8K
_RATE = Fraction(25)  # frames a second where a file does not say
_LOCAL = {"protocol_whitelist": "file"}  # no file, such as a playlist, has others fetched
_STRETCH = 3  # of a pixel's sides at most: of television's it is up to 2.2, more is damage


@dataclass(frozen=True, eq=False)
class Frame:
    """One picture of a video.

    Attributes:
        index: From 0, of all frames that could be decoded.
        time: Seconds since the first of them.
        image: `(H, W, 3)` uint8 RGB, upright, of square pixels.
    """

    index: int
    time: float
    image: np.ndarray


class Video:
    """The frames of a file; each iteration reads it anew, one frame at a time.

    Attributes:
        n_frames: How many an iteration gives, by what the file says; None if it does not.
        damage: What the last complete iteration could not read, as a sentence; None if nothing.

    Args:
        path: Any kind of file that FFmpeg reads.
        every: 1 gives every frame, 2 every other, and so on, from the first.

    Raises:
        InputError: PyAV is missing; the file is missing, damaged from its beginning or no video;
            a frame has a side below 32 pixels or more than 64 million pixels. Iterating raises it
            where no frame can be decoded.
    """

    def __init__(self, path: str | Path, every: int = 1):
        self.path, self.every, self.damage = Path(path), every, None
        with self._opened() as (container, stream):
            if min(stream.width, stream.height) < MIN_SIDE:
                raise self._unreadable(f"frames of {stream.width} x {stream.height} pixels")
            if stream.width * stream.height > _MAX_PIXELS:
                raise InputError(
                    f"{path} must have at most {_MAX_PIXELS:,} pixels a frame. "
                    f"Received {stream.width} x {stream.height}."
                )
            self._step = float(1 / (stream.average_rate or stream.guessed_rate or _RATE))
            self._seconds = _duration(container, stream, self._step)
            self._tail = 4 * self._step + _TAIL[len(container.streams) > 1]
            stretch = float(stream.sample_aspect_ratio or 1)
            self._stretch = stretch if 1 / _STRETCH <= stretch <= _STRETCH else 1
        n = stream.frames or (round(self._seconds / self._step) if self._seconds else 0)
        self.n_frames = -(-n // every) or None

    def __iter__(self) -> Iterator[Frame]:
        self.damage = None
        start, time, index, damaged = None, 0.0, -1, 0
        for frame in self._decoded():
            damaged += frame is None or frame.is_corrupt
            if frame is None:
                continue
            index += 1
            if frame.time is not None:
                start = frame.time if start is None else start
                time = frame.time - start
            elif index:
                time += self._step
            if index % self.every == 0:
                yield Frame(index, time, self._upright(frame))
        if index < 0:
            raise self._unreadable("no frame that can be decoded")
        self.damage = self._damage(time + self._step, damaged)

    def _decoded(self) -> Iterator:
        """PyAV's frames, and None for each part of the file that gives none."""
        with self._opened() as (container, stream):
            packets = container.demux(stream)
            while True:
                try:
                    packet = next(packets, None)  # none comes after an error of its own
                    frames = [] if packet is None else packet.decode()
                except import_av().error.FFmpegError:
                    yield None
                    continue
                if packet is None:
                    return
                yield from frames

    def _upright(self, frame) -> np.ndarray:
        """`(H, W, 3)` uint8 RGB, as a player shows it."""
        image = frame.to_ndarray(width=round(frame.width * self._stretch), format="rgb24")
        return np.ascontiguousarray(np.rot90(image, round(frame.rotation / 90)))

    @contextmanager
    def _opened(self):
        """The container and its video stream, while it is open."""
        av = import_av()
        if not self.path.is_file():
            found = "a folder or device" if self.path.exists() else "a path that does not exist"
            raise self._unreadable(found)
        try:
            with av.open(url(self.path), options=_LOCAL, metadata_errors="replace") as opened:
                stream = opened.streams.best("video")
                if stream is None or stream.codec_context is None:
                    raise self._unreadable("no pictures, or of an unknown kind")
                yield opened, stream
        except av.error.FFmpegError as error:
            raise self._unreadable(error.strerror) from None

    def _unreadable(self, received: str) -> InputError:
        return InputError(f"{self.path} must be a video that can be read. Received: {received}.")

    def _damage(self, read: float, damaged: int) -> str | None:
        if self._seconds and self._seconds - read > self._tail:
            return (f"the video is damaged: of the {self._seconds:.1f} s that it should have, the "
                    f"first {read:.1f} s could be read")  # fmt: skip
        if damaged:
            return (f"the video is damaged: {damaged} of its frames could be read in part, or not "
                    "at all")  # fmt: skip
        return None


def import_av():
    """PyAV, imported where a video is read or written.

    Raises:
        MissingPackageError: It is not there.
    """
    with needs("PyAV, which reads videos,", "video"):
        import av
    return av


def url(path: str | Path) -> str:
    """A path as PyAV opens it whatever its letters are: `a:b` is no address of the network."""
    return f"file:{path}"


def _duration(container, stream, step: float) -> float | None:
    """Seconds, of the pictures where the file says so, else of all that it holds."""
    known = [stream.frames * step]
    if stream.duration is not None:
        known.append(float(stream.duration * stream.time_base))
    elif container.duration is not None:
        known.append(container.duration / 1e6)
    return max(known) or None
