"""What type checkers and editors know of the package; `make lint` checks it, nothing runs it."""

from collections.abc import Iterator
from typing import assert_type

import numpy as np

from deepmds_keras import (
    DeepMDS,
    Face,
    FaceLifter,
    HeadPose,
    LandmarkLifter,
    convert,
    normalise,
    pair_features,
    predict_landmarks,
    predict_photo,
    read_landmarks,
)
from deepmds_keras.tool.predict.videos import Frame

views = np.zeros((2, 51, 2))
faces = predict_photo("photo.jpg", interocular=90.0)
assert_type(faces, list[Face])
assert_type(predict_landmarks(views, scheme="ibug51", landmark_sd=1.0), list[Face])
assert_type(faces[0].pose, HeadPose)
assert_type(faces[0].bbox, tuple[float, float, float, float])
face_lifter = FaceLifter(detector="dlib")
assert_type(face_lifter.predict(b""), list[Face])
assert_type(face_lifter.predict_video("clip.mp4", every=2), Iterator[tuple[Frame, list[Face]]])

lifter = LandmarkLifter.pretrained("ibug51")
assert_type(lifter, LandmarkLifter)
assert_type(lifter.predict(views, visible=None), np.ndarray)
assert_type(lifter.predict(views, return_std=True), tuple[np.ndarray, np.ndarray])
assert_type(DeepMDS.pretrained("deepmds-ibug51").predict(views), np.ndarray)

assert_type(read_landmarks("points.csv", y_up=True), np.ndarray)
assert_type(convert(views, "ibug51", "bfm72"), np.ndarray)
assert_type(normalise(views), np.ndarray)
assert_type(pair_features(views), np.ndarray)

lifter.predict(views, std=True)  # type: ignore[call-overload]
FaceLifter(detector=3)  # type: ignore[arg-type]
