"""Lifting: 3D landmarks of 2D ones by a small network that solves for the camera.

Only `layer` and `training` import Keras, and `lifter` scikit-learn: to predict, NumPy is enough.
"""
