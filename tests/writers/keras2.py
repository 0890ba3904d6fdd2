"""Weights as Keras 2 wrote them, the layout of the authors' files."""

from __future__ import annotations

from pathlib import Path

import h5py
import numpy as np


def write_keras2(path: Path, network) -> Path:
    """HDF5 by layer, in order."""
    with h5py.File(path, "w") as file:
        layers = [layer for layer in network.layers if layer.weights]
        file.attrs["layer_names"] = np.array([layer.name for layer in layers], "S")
        for layer in layers:
            group = file.create_group(layer.name)
            names = [f"{layer.name}/{weight.name}:0" for weight in layer.weights]
            group.attrs["weight_names"] = np.array(names, "S")
            for name, weight in zip(names, layer.weights, strict=True):
                group[name] = weight.numpy()
    return path
