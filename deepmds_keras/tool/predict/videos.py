"""Videos: reads them frame by frame, and writes them with the landmarks drawn in."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from fractions import Fraction
from itertools import islice
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw, ImageFont
from tqdm import tqdm

from deepmds_keras.errors import InputError, needs
from deepmds_keras.files import atomic_write, instead_of_file
from deepmds_keras.landmarks import load_scheme
from deepmds_keras.tool.detection.photos import MIN_SIDE
from deepmds_keras.tool.predict.faces import Face, counted, frame_of, in_degrees

_MAX_PIXELS = 64_000_000  # twice those of 8K
_RATE = Fraction(25)  # frames per second if a file does not say
_LOCAL = {"protocol_whitelist": "file"}  # no file, such as a playlist, may fetch others
_STRETCH = 3  # largest aspect ratio of a pixel: television has up to 2.2, more is damage
_SIDE = 1280  # largest side of a written video, pixels
_TICK = Fraction(1, 1000)  # seconds
_LINE, _DOT, _EDGE = "#FFFFFF", "#FFD000", "#333333"  # as in the pictures of photos
_H264 = {"preset": "veryfast", "crf": "23"}


@dataclass(frozen=True, eq=False)
class Frame:
    """One picture of a video.

    Attributes:
        index: Index among all frames that could be decoded, from 0.
        time: Seconds since the first of them.
        image: `(H, W, 3)` uint8 RGB, upright, of square pixels.
    """

    index: int
    time: float
    image: np.ndarray


class Video:
    """The frames of a file that can be decoded; each iteration reads it again.

    Attributes:
        n_frames: Number of frames of an iteration according to the file; None if it does not say.
        frame_bytes: Memory that a frame takes.
        n_counted: That number, unless it only follows from the file's duration.

    Args:
        path: Any file that FFmpeg reads.
        every: 1 gives every frame, 2 every other, and so on, from the first.

    Raises:
        InputError: PyAV is missing; the file is missing, damaged from its beginning or not a video;
            a frame has a side below 32 pixels or more than 64 million pixels. Iterating raises it
            if no frame can be decoded.
    """

    def __init__(self, path: str | Path, every: int = 1):
        self.path, self.every = Path(path), every
        with self._opened() as (container, stream):
            size = f"{stream.width} x {stream.height}"
            self.frame_bytes = 3 * stream.width * stream.height
            if min(stream.width, stream.height) < MIN_SIDE:
                raise self._unreadable(f"frames of {size} pixels")
            if stream.width * stream.height > _MAX_PIXELS:
                raise self._unreadable(f"{size} pixels a frame, more than {_MAX_PIXELS:,}")
            rate = stream.average_rate or stream.guessed_rate or _RATE
            self._step = float(1 / rate)
            stretch = float(stream.sample_aspect_ratio or 1)
            self._stretch = stretch if 1 / _STRETCH <= stretch <= _STRETCH else 1
            # AVI stores no times to show frames at. FFmpeg guesses them, wrongly for B-frames of
            # H.264; times to decode frames at are as far apart.
            self._stamp = "dts" if container.format.name == "avi" else "pts"
            counted = stream.frames
            n = counted or round((container.duration or 0) / 1e6 * rate)
        self.n_frames, self.n_counted = (-(-frames // every) or None for frames in (n, counted))

    def __iter__(self) -> Iterator[Frame]:
        start, time, index, matrix = None, 0.0, -1, None
        for index, frame in enumerate(self._decoded()):
            if not index:
                # Of the first alone: a frame whose side data were read is in a cycle, and stays in
                # memory until the garbage is collected, hundreds of frames later.
                matrix = _display_matrix(frame)
            stamp = getattr(frame, self._stamp)
            if stamp is not None:
                start = stamp if start is None else start
                time = float((stamp - start) * frame.time_base)
            elif index:
                time += self._step
            if index % self.every == 0:
                width = round(frame.width * self._stretch)
                image = frame.to_ndarray(width=width, format="rgb24")
                yield Frame(index, time, np.ascontiguousarray(_shown(image, matrix)))
        if index < 0:
            raise self._unreadable("no frame that can be decoded")

    def _decoded(self) -> Iterator:
        """PyAV's frames, without damaged ones."""
        with self._opened() as (container, stream):
            packets = container.demux(stream)
            while True:
                try:
                    packet = next(packets, None)  # none comes after its error
                    frames = [] if packet is None else packet.decode()
                except _import_av().error.FFmpegError:
                    continue
                if packet is None:
                    return
                yield from frames

    @contextmanager
    def _opened(self):
        """The container and its video stream, while it is open."""
        av = _import_av()
        if not self.path.is_file():
            raise self._unreadable(instead_of_file(self.path))
        try:
            # From 19 on PyAV reads metadata that are no UTF-8 anyway, and refuses the argument.
            is_19 = int(av.__version__.split(".")[0]) >= 19
            lenient = {} if is_19 else {"metadata_errors": "replace"}
            with av.open(_url(self.path), options=_LOCAL, **lenient) as opened:
                stream = opened.streams.best("video")
                if stream is None or stream.codec_context is None:
                    raise self._unreadable("no pictures, or of an unknown kind")
                yield opened, stream
        except av.error.FFmpegError as error:
            raise self._unreadable(error.strerror) from None

    def _unreadable(self, received: str) -> InputError:
        return InputError(f"{self.path} must be a readable video. Received: {received}.")


def _display_matrix(frame) -> np.ndarray | None:
    """How a player turns and mirrors the frames of the file, `(3, 3)`; None is not at all."""
    data = frame.side_data.get(_import_av().sidedata.sidedata.Type.DISPLAYMATRIX)
    return None if data is None else np.frombuffer(bytes(data), np.int32).reshape(3, 3)


def _shown(image: np.ndarray, matrix: np.ndarray | None) -> np.ndarray:
    """A frame's image as a player shows it, by `_display_matrix`."""
    if matrix is None:
        return image
    (x_of_x, y_of_x, _), (x_of_y, y_of_y, _), _ = matrix
    if abs(y_of_x) > abs(x_of_x):  # x becomes y
        image, x_of_x, y_of_y = image.swapaxes(0, 1), x_of_y, y_of_x
    return image[:: -1 if y_of_y < 0 else 1, :: -1 if x_of_x < 0 else 1]


def portraits(faces: Sequence[Face], most: int) -> list[Face]:
    """The most frontal face of each track; of many tracks, the longest."""
    longest = sorted(_by_track(faces), key=len, reverse=True)[:most]

    def turn(face: Face) -> float:
        return float(np.hypot(face.pose.yaw, face.pose.pitch))

    frontal = [min(seen, key=turn) for seen in longest]
    return sorted(frontal, key=lambda face: frame_of(face).track)


def read_stills(source: Path, faces: Sequence[Face], every: int) -> list[np.ndarray]:
    """The whole frame of each face of the source, a video: `(H, W, 3)` uint8 RGB.

    Raises:
        InputError: The video cannot be read any more.
    """
    wanted = {frame_of(face).frame for face in faces}
    frames = islice(Video(source, every), max(wanted) // every + 1)
    images = {frame.index: frame.image for frame in frames if frame.index in wanted}
    return [images[frame_of(face).frame] for face in faces]


def tell_tracks(faces: Sequence[Face], most: int) -> Iterator[str]:
    """Lines about the first tracks of a video: when each is seen, and how the head turns."""
    tracks = _by_track(faces)
    for seen in tracks[:most]:
        first, last = frame_of(seen[0]), frame_of(seen[-1])
        yaws = [float(face.pose.yaw) for face in seen]
        n_noted = sum(bool(face.notes) for face in seen)
        noted = f", {n_noted} with notes" if n_noted else ""
        yield (
            f"  track {first.track}: {first.time:.1f} to {last.time:.1f} s, found in "
            f"{counted(len(seen), 'frame')}{noted}; yaw {in_degrees(min(yaws))} to "
            f"{in_degrees(max(yaws))}"
        )
    if len(tracks) > most:
        yield f"  and {len(tracks) - most} more tracks; pictures are of the {most} longest"


def write_landmark_video(path: Path, source: Path, faces: Sequence[Face], every: int) -> None:
    """Write the used frames of the source with the landmarks of all tracks, whole or not at all.

    The file is an MP4 (H.264) without sound, with the frames' times, at most 1280 pixels wide or
    high; all frames have the size of the first.

    Raises:
        InputError: The video cannot be read any more.
        OSError: The file cannot be written.
    """
    video = Video(source, every)
    shown: dict[int, list[Face]] = {}
    for face in faces:
        shown.setdefault(frame_of(face).frame, []).append(face)
    av = _import_av()
    bar = tqdm(video, total=video.n_frames, unit="frame", leave=False, disable=None)
    options = {"movflags": "faststart"}
    stream, last = None, -1
    with (
        atomic_write(path) as file,
        av.open(_url(file.name), "w", format="mp4", options=options) as output,
    ):
        for frame in bar:
            if stream is None:
                height, width = frame.image.shape[:2]
                half = min(1, _SIDE / max(width, height)) / 2
                stream = output.add_stream("libx264", rate=30, options=_H264)
                # Colour is stored per two by two pixels.
                stream.width = max(2, 2 * round(half * width))
                stream.height = max(2, 2 * round(half * height))
                stream.pix_fmt, stream.codec_context.time_base = "yuv420p", _TICK
            size = stream.width, stream.height
            drawn = av.VideoFrame.from_image(_drawn(frame.image, size, shown.get(frame.index, [])))
            drawn.pts = last = max(round(frame.time / _TICK), last + 1)
            drawn.time_base = _TICK
            output.mux(stream.encode(drawn))
        if stream is not None:
            output.mux(stream.encode())


def _drawn(image: np.ndarray, size: tuple[int, int], faces: Sequence[Face]) -> Image.Image:
    scale = np.divide(size, image.shape[1::-1])
    drawn = Image.fromarray(image)
    if drawn.size != size:
        drawn = drawn.resize(size, Image.Resampling.BILINEAR)
    draw = ImageDraw.Draw(drawn)
    for face in faces:
        points = scale * face.landmarks
        side = np.ptp(points, axis=0).max()
        radius, width = max(1.0, side / 100), max(1, round(side / 150))
        for line in load_scheme(face.scheme).polylines:
            draw.line([*map(tuple, points[list(line)])], fill=_LINE, width=width)
        for x, y in points:
            draw.ellipse((x - radius, y - radius, x + radius, y + radius), _DOT, _EDGE, width=0)
        font = ImageFont.load_default(max(12, side / 8))
        corner, label = (points[:, 0].min(), points[:, 1].min() - side / 8), frame_of(face).track
        draw.text(corner, str(label), _DOT, font, "lb", stroke_width=1, stroke_fill=_EDGE)
    return drawn


def _by_track(faces: Sequence[Face]) -> list[list[Face]]:
    """Faces of each track, in the order of its number."""
    tracks: dict[int, list[Face]] = {}
    for face in faces:
        tracks.setdefault(frame_of(face).track, []).append(face)
    return [tracks[track] for track in sorted(tracks)]


def _import_av():
    """PyAV, imported only when a video is read or written."""
    with needs("PyAV, which reads videos,", "video"):
        import av
    return av


def _url(path: str | Path) -> str:
    """A path that PyAV takes for a file whatever its name: `a:b` is not a network address."""
    return f"file:{path}"
