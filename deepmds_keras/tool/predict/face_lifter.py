"""Photos, videos and landmarks to 3D faces, from Python."""

from __future__ import annotations

import os
from collections.abc import Iterator
from itertools import groupby
from pathlib import Path
from typing import BinaryIO

import numpy as np
from PIL import Image

from deepmds_keras.errors import InputError, check_choice
from deepmds_keras.landmarks import convert, load_scheme, scheme_of
from deepmds_keras.landmarks.arrays import as_faces, seem_fractions
from deepmds_keras.landmarks.y_axis import check_y_axis
from deepmds_keras.lifting.inputs import as_landmark_sd, as_visible
from deepmds_keras.tool.detection import DETECTORS, FOUND_BY, default_detector, to_ibug
from deepmds_keras.tool.detection.photos import check_photo, read_photo
from deepmds_keras.tool.predict.estimation import estimate_faces
from deepmds_keras.tool.predict.faces import Detections, Face, frame_of, name_faces
from deepmds_keras.tool.predict.landmark_files import FRACTIONS, Z_UNUSED, find_unusable
from deepmds_keras.tool.predict.models import given_scheme, target_scheme
from deepmds_keras.tool.predict.photo_faces import find_in_photo
from deepmds_keras.tool.predict.smoothing import check_smooth
from deepmds_keras.tool.predict.video_faces import find_in_video
from deepmds_keras.tool.predict.videos import Frame, Video
from deepmds_keras.validation import check_number, check_whole


class FaceLifter:
    """Photos, videos and landmarks to 3D faces; detector and weights are loaded once.

    Threads may use it, or one each; they take turns at the detector.

    Args:
        detector: `"mediapipe"` or `"dlib"`; None uses the first that is installed.
        landmarker: File of a face landmarker (`.task`) of MediaPipe's; None uses the one in
            the package.
        model: `"lifting"` (the default), `"deepmds"`, the paper's method, or a file that
            `LandmarkLifter.save` or `DeepMDS.save` wrote. A lifter of other objects takes
            landmarks alone.
        interocular: Millimetres between the outer corners of the eyes, which sets the scale.

    Raises:
        InputError: Unknown detector, or `interocular` is not positive and finite.

    Examples:
        >>> lifter = FaceLifter(interocular=90)
        >>> for face in lifter.predict("family.jpg"):  # doctest: +SKIP
        ...     print(face.xyz, face.landmarks_3d, face.pose.yaw, face.std)
    """

    def __init__(
        self,
        detector: str | None = None,
        landmarker: str | Path | None = None,
        model: str | Path | None = None,
        interocular: float | None = None,
    ):
        if detector is not None:
            check_choice(detector, "detector", DETECTORS)
        if interocular is not None:
            check_number(interocular, "interocular")
        self.landmarker = None if landmarker is None else str(landmarker)
        self.model = None if model is None else str(model)
        self.interocular = interocular
        self.detector = detector or default_detector(landmarker)

    def predict(
        self, image: str | Path | bytes | BinaryIO | Image.Image | np.ndarray
    ) -> list[Face]:
        """3D landmarks of the faces in a photo.

        Args:
            image: A file, its content, an open binary file, a Pillow image, or an array
                `(H, W, 3)` uint8 in RGB order (OpenCV's is BGR: `image[..., ::-1]`). Of an
                animation the first picture is read, which a note on each face says.

        Returns:
            The faces from left to right; an empty list if there is none.

        Raises:
            InputError: The photo cannot be read, the detector is not installed, or the model does
                not exist.
        """
        image = image.read() if hasattr(image, "read") else image
        path = Path(image) if isinstance(image, (str, os.PathLike)) else None
        if isinstance(image, (str, os.PathLike, bytes, Image.Image)):
            pixels, n_pictures = read_photo(image)
        else:
            pixels, n_pictures = check_photo(image), 1
        found = find_in_photo(
            pixels,
            path,
            "face" if path is None else path.stem,
            detector=self.detector,
            landmarker=self.landmarker,
            model=self.model,
            n_pictures=n_pictures,
        )
        return self._estimate(found)

    def predict_landmarks(
        self,
        points: np.ndarray,
        scheme: str | Path | None = None,
        visible: np.ndarray | None = None,
        landmark_sd: float | np.ndarray | None = None,
    ) -> list[Face]:
        """3D landmarks of faces whose 2D landmarks are known.

        Args:
            points: `(n, L, 2)` or `(L, 2)`, x to the right and y down, as in an image; 51 or 68 of
                iBUG, the paper's 72, or 468 or 478 of MediaPipe, in pixels; or those of the objects
                that the model lifts. See `as_faces` for what else is taken; of three coordinates, z
                is not used. A landmark that is NaN, None or masked is missing; a face without any
                landmark gives a gap.
            scheme: Name of the landmark scheme, or a table of your own, as for `load_scheme`; None
                infers it from L, or from the model. MediaPipe's landmarks are moved to where iBUG
                300-W has them, as those of a photo are.
            visible: `(n, L)` or `(L,)` bool, False where a landmark is missing.
            landmark_sd: Standard deviation of the errors of a coordinate, in the unit of the
                points: one number, `(n,)`, `(n, L)`, or `(L,)` of one face; None is what was
                measured of MediaPipe for its landmarks, and for others 2.5 % of their r.m.s.
                radius, about 1 % of the distance between the outer corners of the eyes.

        Returns:
            A face for each row. One that seems upside down or mirrored, unlike most others, gets
            a note.

        Raises:
            InputError: Landmarks of another shape, or fractions of an image; most faces are upside
                down or mirrored; a face has fewer than six landmarks, or all on one line; or an
                unknown model.
        """
        faces = as_faces(points, "landmarks")
        points = faces[..., :2]
        n, size = points.shape[:2]
        missing = np.isnan(points).any(-1)  # half a landmark is none
        if visible is not None:
            missing |= ~as_visible(visible, (n, size))
        points = np.where(missing[..., None], np.nan, points)
        if np.isinf(points).any():
            raise InputError("landmarks must be finite, or NaN if missing.")
        scheme = given_scheme(scheme, self.model) or scheme_of(size)
        target = target_scheme(scheme, self.model)
        if load_scheme(scheme).is_face and seem_fractions(points):
            raise InputError(f"landmarks must be in pixels. {FRACTIONS}.")
        if landmark_sd is not None:
            sd = as_landmark_sd(landmark_sd, ~missing)
            # Where none is given for what is missing, the mean of the others stands for it.
            known = np.where(missing, 0, sd).sum(1) / np.maximum((~missing).sum(1), 1)
            sd = np.where(missing, known[:, None], sd)
            landmark_sd = convert(np.stack([sd, sd], -1), scheme, target)[..., 0]
        needed = "y must point down; negate it if it points up."
        odd = check_y_axis(points, scheme, "landmarks", needed=needed)
        notes = dict.fromkeys(range(n), Z_UNUSED) if faces.shape[2] > 2 else {}
        for i, fault in odd.items():
            more = f"seems to stand otherwise than the other faces: {fault}"
            notes[i] = f"{notes[i]}; {more}" if i in notes else more
        landmarks = convert(points, scheme, target)
        if n and np.isnan(landmarks).all():
            raise InputError("landmarks must not all be missing. Received only NaN.")
        for i, fault in find_unusable(landmarks).items():
            raise InputError(f"landmarks {fault} in face {i}.")
        found_by = FOUND_BY.get(scheme)
        landmarks = to_ibug(landmarks, found_by, target)
        return self._estimate(
            Detections(
                source=None,
                names=name_faces("face", n),
                scheme=target,
                landmarks=landmarks,
                notes=notes,
                landmark_sd=landmark_sd,
                found_by=found_by,
            )
        )

    def predict_video(
        self, path: str | Path, every: int = 1, smooth: float | str = 0
    ) -> Iterator[tuple[Frame, list[Face]]]:
        """3D landmarks of the faces in a video; the whole video is analysed first.

        Args:
            path: Any file that FFmpeg reads.
            every: 1 uses every frame, 2 every other, and so on.
            smooth: Smoothing over time: standard deviation in used frames of a Gaussian about each,
                or `"causal"`, from the frames before only, as for live use; 0 is none.

        Yields:
            Each frame, with its index, time and image `(H, W, 3)` uint8 RGB; and its faces, each
            with `frame_ref.track`, the same number for a person in all frames.

        Raises:
            InputError: PyAV is missing, the video cannot be read, no frame has a face, or
                `every` or `smooth` is out of range.
        """
        check_whole(every, "every")
        check_smooth(smooth)
        detections = find_in_video(
            path,
            Path(path).stem,
            detector=self.detector,
            landmarker=self.landmarker,
            model=self.model,
            every=every,
            smooth=smooth,
        )
        by_frame = groupby(self._estimate(detections), key=lambda face: frame_of(face).frame)
        faces = {frame: [*some] for frame, some in by_frame}
        for frame in Video(path, every):
            yield frame, faces.get(frame.index, [])

    def _estimate(self, detections: Detections) -> list[Face]:
        if not detections.names:
            return []
        return estimate_faces(detections, model=self.model, interocular=self.interocular)


def predict_photo(
    photo: str | Path | bytes | BinaryIO | Image.Image | np.ndarray,
    *,
    detector: str | None = None,
    model: str | Path | None = None,
    interocular: float | None = None,
) -> list[Face]:
    """3D landmarks of the faces in a photo: `FaceLifter.predict`, whose options are the same.

    Args:
        photo: A file by name or open, its content, a Pillow image, or an array `(H, W, 3)` uint8,
            RGB.
        detector, model, interocular: As for `FaceLifter`.

    Returns:
        The faces from left to right; an empty list if there is none.

    Raises:
        InputError: As for `FaceLifter` and its `predict`.
    """
    return FaceLifter(detector, model=model, interocular=interocular).predict(photo)


def predict_landmarks(
    landmarks: np.ndarray,
    *,
    scheme: str | Path | None = None,
    visible: np.ndarray | None = None,
    landmark_sd: float | np.ndarray | None = None,
    model: str | Path | None = None,
    interocular: float | None = None,
) -> list[Face]:
    """3D landmarks of faces whose 2D landmarks are known: `FaceLifter.predict_landmarks`.

    Args:
        landmarks: `(n, L, 2)` or `(L, 2)`, x right and y down.
        scheme, visible, landmark_sd: As in the method.
        model, interocular: As for `FaceLifter`.

    Returns:
        A face for each row.

    Raises:
        InputError: As for `FaceLifter` and its `predict_landmarks`.
    """
    lifter = FaceLifter(model=model, interocular=interocular)
    return lifter.predict_landmarks(landmarks, scheme, visible, landmark_sd)
