"""Drawn heads for detectors, and how far a detector's landmarks lie off."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from faces import cameras

from data_gen.datasets.dataset import make_dataset
from data_gen.datasets.images import make_scene, render
from data_gen.models.openhead import load_openhead
from deepmds_keras.geometry.views import project

CANTHI = [19, 28]  # of the 51 inner landmarks
NOSE_TIP = 13


def drawn_heads(size=256):
    """Five open heads, yaw -20 to 20 degrees, and their 51 inner landmarks in pixels."""
    model = load_openhead()
    faces = make_dataset(model, 5, np.random.default_rng(4), scheme="ibug51")
    turned = cameras(np.linspace(-20, 20, 5))
    views = np.float32(project(faces.landmarks.astype(float), turned))
    scene = make_scene(model, "ibug51", size, margin=2.0)
    faces = replace(faces, cameras=turned, views=views)
    return render(scene, faces, range(5), np.random.default_rng(0))


def nme(landmarks, truth):
    """Mean distance of each face's landmarks, in distances of its outer canthi: `(n,)`."""
    canthi = truth[:, CANTHI[0]] - truth[:, CANTHI[1]]
    return np.linalg.norm(landmarks - truth, axis=2).mean(1) / np.linalg.norm(canthi, axis=1)
