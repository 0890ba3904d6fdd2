"""Lifting: 3D landmarks of 2D ones by a small network that solves for the camera."""
