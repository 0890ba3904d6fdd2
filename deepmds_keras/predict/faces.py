"""Faces that the command found in a source, each with its result."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from deepmds_keras.camera import HeadPose


@dataclass(frozen=True)
class Moment:
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
class Found:
    """Landmarks of the faces of one source.

    Attributes:
        source: The photo, video or file of landmarks; None of what is in memory.
        names: Of the faces.
        scheme: Of the landmarks.
        landmarks: `(n, L, 2)`, x right and y down; NaN are gaps.
        is_photo: Whether the source is a photo.
        faults: Of gaps that are faces which cannot be used, 0-based, why.
        detector: Name and licence of what found them, or None: they were given.
        moments: Of the faces of a video; None of other sources.
        notes: What a reader must know of the source.
    """

    source: Path | None
    names: Sequence[str]
    scheme: str
    landmarks: np.ndarray
    is_photo: bool
    faults: Mapping[int, str] = field(default_factory=dict)
    detector: dict[str, str] | None = None
    moments: Sequence[Moment] | None = None
    notes: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class Face:
    """One face of one photo, of one frame of a video, or of one row of a file of landmarks.

    All is NaN of a gap.

    Attributes:
        name: Unique among the faces of a run; begins the names of its files.
        source: The photo, the video, or the file of landmarks; None of what is in memory.
        photo: The photo, or None of other sources.
        scheme: Name of the landmark scheme.
        landmarks: `(L, 2)` pixels of the photo or frame, or whatever the file counts in; x right,
            y down.
        shape: `(L, 3)` from the front: +x to the subject's left, +y up, +z out of the face.
        unit: Of the shape: `"mm"`, or `"normalised"`, in which the largest extent is about 1.
        pose: How the face is seen, which turns the shape onto the landmarks.
        notes: What a reader must know of this face, such as a pose beyond those of training.
        detector: Name and licence of what found the landmarks, or None: they were given.
        moment: Where in the video it is seen; None of other sources.
        std: `(L, 3)` standard deviations of the errors of the shape, in its unit, or None: the
            model does not know them.
    """

    name: str
    source: Path | None
    photo: Path | None
    scheme: str
    landmarks: np.ndarray
    shape: np.ndarray
    unit: str
    pose: HeadPose
    notes: tuple[str, ...] = ()
    detector: dict[str, str] | None = None
    moment: Moment | None = None
    std: np.ndarray | None = None

    @property
    def image_xyz(self) -> np.ndarray:
        """`(L, 3)`: the landmarks as they lie in the image, and how far they are in front.

        z is in pixels, as x and y, grows towards the viewer and is 0 at the shape's origin.
        """
        depth = self.pose.scale * self.shape @ self.pose.rotation[2]
        return np.column_stack([self.landmarks, depth])

    @property
    def seen_shape(self) -> np.ndarray:
        """Where the landmarks of the shape are seen, turned as the head is: `(L, 2)`, y down."""
        return self.pose.project(self.shape) * (1, -1)

    @property
    def residual(self) -> np.ndarray:
        """`(L,)` pixels between each landmark and where the shape has it."""
        return np.linalg.norm(self.seen_shape - self.landmarks, axis=1)

    @property
    def angles(self) -> str:
        """The head's pose in whole degrees: `yaw +20°, pitch +12°, roll -8°`."""
        degrees = {name: round(getattr(self.pose, name)) for name in ("yaw", "pitch", "roll")}
        return ", ".join(f"{name} {angle:+}°" for name, angle in degrees.items())

    @property
    def is_gap(self) -> bool:
        """Whether it stands for a row without a face, or with one that cannot be used."""
        return math.isnan(self.shape[0, 0])

    def gap(self, name: str, notes: tuple[str, ...]) -> Face:
        """A gap among faces of which this is one."""
        pose = replace(self.pose, **_nan(vars(self.pose)))
        return replace(self, **_nan(vars(self)), name=name, pose=pose, notes=notes)

    def reduced(self, step: float) -> Face:
        """The face as it is seen in its photo at a `step`-th of the photo's size."""
        scale, translation = self.pose.scale / step, self.pose.translation / step
        pose = replace(self.pose, scale=scale, translation=translation)
        return replace(self, landmarks=self.landmarks / step, pose=pose)


def _nan(values: Mapping) -> dict:
    """The numbers among them, all NaN."""
    kinds = (float, np.ndarray)
    return {key: value * np.nan for key, value in values.items() if isinstance(value, kinds)}
