"""Lifting: 3D landmarks of 2D ones by a small network that solves for the camera.

Only `layer` and `training` import Keras: to predict, NumPy is enough.
"""

from deepmds_keras.lifting.lifter import LandmarkLifter, Pose

__all__ = ["LandmarkLifter", "Pose"]
