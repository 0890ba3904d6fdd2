"""Faces detected in a source, each with its result."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from deepmds_keras.geometry.camera import HeadPose


@dataclass(frozen=True)
class FrameRef:
    """Where in a video a face is seen.

    Attributes:
        frame: Index of the frame, from 0.
        time: Seconds since the first frame.
        track: Number of the face, from 1; it keeps it from frame to frame.
    """

    frame: int
    time: float
    track: int


@dataclass(frozen=True, eq=False)
class Detections:
    """Landmarks of the faces of one source.

    Attributes:
        source: The photo, video or file of landmarks; None for input in memory.
        names: Names of the faces.
        scheme: Scheme of the landmarks.
        landmarks: `(n, L, 2)`, x right and y down. A NaN landmark is missing; a face without any
            landmark is a gap.
        is_photo: Whether the source is a photo.
        faults: Number of each gap that is an unusable face, 0-based, → the reason.
        detector: Name and licence of the detector, or None: the landmarks were given.
        frame_refs: Where in the video each face is; None for other sources.
        scores: The detector's scores `(n,)`, 0 to 1, NaN or None if it has none.
        notes: Number of a face, 0-based, → what a reader must know about it.
        remarks: What a reader must know about the source.
        landmark_sd: `(n, L)` standard deviations of the errors of a coordinate in the unit of the
            landmarks; None if unknown.
        found_by: Name of the detector of landmarks that were given, if their scheme tells it.
    """

    source: Path | None
    names: Sequence[str]
    scheme: str
    landmarks: np.ndarray
    is_photo: bool = False
    faults: Mapping[int, str] = field(default_factory=dict)
    detector: dict[str, str] | None = None
    frame_refs: Sequence[FrameRef] | None = None
    scores: np.ndarray | None = None
    notes: Mapping[int, str] = field(default_factory=dict)
    remarks: Sequence[str] = ()
    landmark_sd: np.ndarray | None = None
    found_by: str | None = None


@dataclass(frozen=True, eq=False, repr=False)
class Face:
    """One face of one photo, of one frame of a video, or of one row of landmarks.

    All numbers of a gap are NaN.

    Attributes:
        name: Unique among the faces of a run; the names of its files begin with it.
        source: The photo, the video, or the file of landmarks; None for input in memory.
        photo: The photo, or None for other sources.
        scheme: Name of the landmark scheme.
        landmarks: `(L, 2)` in pixels of the photo or frame, or in the unit of the file; x right, y
            down; NaN where a landmark is missing.
        xyz: `(L, 3)` from the front: +x to the subject's left, +y up, +z out of the face.
        unit: Unit of `xyz` and `std`: `"mm"`, or `"normalised"`: the range of all coordinates of a
            face together, see `normalise`. By the shipped weights a face measures about 1.
        pose: The camera that projects the shape onto the landmarks.
        notes: What a reader must know about this face, such as a pose beyond those of training.
        detector: Name and licence of the detector, or None: the landmarks were given.
        frame_ref: Where in the video it is seen; None for other sources.
        std: `(L, 3)` standard deviations of the errors of `xyz`, in its unit, or None if the model
            does not estimate them.
        score: The detector's score, 0 to 1, or None if it has none.
    """

    name: str
    source: Path | None
    photo: Path | None
    scheme: str
    landmarks: np.ndarray
    xyz: np.ndarray
    unit: str
    pose: HeadPose
    notes: tuple[str, ...] = ()
    detector: dict[str, str] | None = None
    frame_ref: FrameRef | None = None
    std: np.ndarray | None = None
    score: float | None = None

    def __repr__(self) -> str:
        notes = f", {counted(len(self.notes), 'note')}" if self.notes else ""
        return (
            f"<Face {self.name!r}: {len(self.xyz)} landmarks ({self.scheme}), {self.angles}{notes}>"
        )

    @property
    def landmarks_3d(self) -> np.ndarray:
        """`(L, 3)`: the landmarks in the image, with depth.

        z is in pixels, like x and y, grows towards the viewer and is 0 at the shape's origin. A
        missing landmark lies where the shape projects to.
        """
        depth = self.pose.scale * self.xyz @ self.pose.rotation[2]
        seen = np.where(np.isnan(self.landmarks), self.seen_shape, self.landmarks)
        return np.column_stack([seen, depth])

    @property
    def seen_shape(self) -> np.ndarray:
        """The landmarks of the shape, projected into the image: `(L, 2)`, y down."""
        return self.pose.project(self.xyz) * (1, -1)

    @property
    def residuals(self) -> np.ndarray:
        """`(L,)` distances in pixels of the landmarks from the projected shape; NaN if missing."""
        return np.linalg.norm(self.seen_shape - self.landmarks, axis=1)

    @property
    def bbox(self) -> tuple[float, float, float, float]:
        """Left, top, right and bottom of the landmarks in the image."""
        if self.is_gap:
            return (math.nan,) * 4
        low, high = np.nanmin(self.landmarks, axis=0), np.nanmax(self.landmarks, axis=0)
        return (*low.tolist(), *high.tolist())

    @property
    def angles(self) -> str:
        """The head's pose in whole degrees: `yaw +20°, pitch +12°, roll -8°`; or `gap`."""
        if self.is_gap:
            return "gap"
        degrees = {name: float(getattr(self.pose, name)) for name in ("yaw", "pitch", "roll")}
        return ", ".join(f"{name} {in_degrees(angle)}" for name, angle in degrees.items())

    @property
    def is_gap(self) -> bool:
        """Whether it stands for a row without a face, or for a face that cannot be used."""
        return math.isnan(self.xyz[0, 0])

    def gap(self, name: str, notes: tuple[str, ...]) -> Face:
        """A gap in the same source as this face."""
        pose = replace(self.pose, **_nan(vars(self.pose)))
        return replace(self, **_nan(vars(self)), name=name, pose=pose, notes=notes)


def frame_of(face: Face) -> FrameRef:
    """Where in its video a face is seen; only for faces of videos."""
    if face.frame_ref is None:
        raise ValueError(f"{face.name} is not of a video")
    return face.frame_ref


def in_degrees(angle: float) -> str:
    """An angle in whole degrees: `+20°`, `-8°`, `0°`."""
    return f"{f'{round(angle):+}' if round(angle) else 0}°"


def name_faces(name: str, n: int) -> list[str]:
    """Names of the n faces of one source: the source's, numbered from 1 if there are several."""
    if n == 1:
        return [name]
    return [f"{name}-{i:0{len(str(n))}d}" for i in range(1, n + 1)]


def counted(n: int, thing: str) -> str:
    """A number of things, in words for readers."""
    return f"{n:,} {thing}s" if n > 1 else f"{n} {thing}"


def _nan(values: Mapping) -> dict:
    """The numbers among them, all NaN."""
    kinds = (float, np.ndarray)
    return {key: value * np.nan for key, value in values.items() if isinstance(value, kinds)}
