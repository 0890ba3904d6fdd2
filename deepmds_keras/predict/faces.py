"""Faces that the command found in a source, each with its result."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from deepmds_keras.camera import HeadPose


@dataclass(frozen=True, eq=False)
class Found:
    """Landmarks of the faces of one source.

    Attributes:
        source: The photo or file of landmarks.
        names: Of the faces.
        scheme: Of the landmarks.
        landmarks: `(n, L, 2)`, x right and y down.
        is_photo: Whether the source is a photo.
    """

    source: Path
    names: Sequence[str]
    scheme: str
    landmarks: np.ndarray
    is_photo: bool


@dataclass(frozen=True, eq=False)
class Face:
    """One face of one photo, or of one row of a file of landmarks.

    Attributes:
        name: Unique among the faces of a run; begins the names of its files.
        source: The photo, or the file of landmarks.
        photo: The photo, or None where the landmarks were given.
        scheme: Name of the landmark scheme.
        landmarks: `(L, 2)` pixels of the photo, or whatever the file counts in; x right, y down.
        shape: `(L, 3)` from the front: +x to the subject's left, +y up, +z out of the face.
        unit: Of the shape: `"mm"`, or `"normalised"`, in which the largest extent is about 1.
        pose: How the face is seen, which turns the shape onto the landmarks.
        notes: What a reader must know of this face, such as a pose beyond those of training.
    """

    name: str
    source: Path
    photo: Path | None
    scheme: str
    landmarks: np.ndarray
    shape: np.ndarray
    unit: str
    pose: HeadPose
    notes: tuple[str, ...] = ()

    def reduced(self, step: float) -> Face:
        """The face as it is seen in its photo at a `step`-th of the photo's size."""
        scale, translation = self.pose.scale / step, self.pose.translation / step
        pose = replace(self.pose, scale=scale, translation=translation)
        return replace(self, landmarks=self.landmarks / step, pose=pose)
