"""Weight files of Keras 2, as the authors released theirs: parsed, never executed."""

from __future__ import annotations

import math
import os
from pathlib import Path
from typing import TYPE_CHECKING

import h5py
import numpy as np

from deepmds_keras.errors import InputError, brief
from deepmds_keras.weights import check_finite

if TYPE_CHECKING:
    import keras

_DEFLATED = 1032  # the most bytes that one of a compressed data set can stand for


def read_keras2_weights(network: keras.Model, path: str | Path) -> None:
    """Load a Keras 2 weight file (HDF5, weights only), as the authors released, into a network.

    Layers correspond by order, since their names differ.

    Raises:
        InputError: Missing or truncated file, or one whose layers have other shapes or hold NaN
            or infinity.
    """
    try:
        with h5py.File(path, "r") as file:
            groups = [file[name] for name in _read_names(file, "layer_names")]
            groups = [[_read_dataset(g[w]) for w in _read_names(g, "weight_names")] for g in groups]
    except FileNotFoundError:
        raise InputError(f"{path} does not exist; it must be a Keras 2 weight file.") from None
    except Exception as error:  # h5py raises many kinds for a damaged file
        received = f"{type(error).__name__}: {brief(error)}"
        raise InputError(
            f"{path} must be a Keras 2 weight file (HDF5). Received {received}."
        ) from None
    groups = [group for group in groups if group]
    layers = [layer for layer in network.layers if layer.weights]
    found = [[np.shape(w) for w in group] for group in groups]
    needed = [[tuple(w.shape) for w in layer.weights] for layer in layers]
    if found != needed:
        differing = next(
            (f"layer {i + 1} has {a}, not {b}"
             for i, (a, b) in enumerate(zip(found, needed, strict=False)) if a != b),
            f"it has {len(found)} layers with weights, not {len(needed)}",
        )  # fmt: skip
        raise InputError(f"{path} does not fit the network {network.name}: {differing}.")
    for layer, group in zip(layers, groups, strict=True):
        for array in group:
            check_finite(array, f"{path}: layer {layer.name} of {network.name}")
        layer.set_weights(group)


def _read_names(group: h5py.Group, key: str) -> np.ndarray:
    """An attribute that lists names; other kinds crash HDF5 when they are damaged."""
    attribute = group.attrs.get_id(key)
    if 0 in attribute.shape:  # of a layer without weights, which Keras writes as no numbers
        return np.empty(0, str)
    dtype = attribute.dtype
    if dtype.kind != "S" and h5py.check_string_dtype(dtype) is None:
        raise ValueError(f"{key} are no text but {dtype}")
    return group.attrs[key]


def _read_dataset(dataset: h5py.Dataset) -> np.ndarray:
    """All of a dataset, if the file holds that much: what was never written is read as zeros."""
    if dataset.dtype.kind not in "fiu" or dataset.shape is None:
        raise ValueError(f"{dataset.name} holds no numbers")
    held = dataset.id.get_storage_size()
    chunk = dataset.dtype.itemsize * math.prod(dataset.chunks or (0,))
    most = held * (_DEFLATED if dataset.compression else 1)
    if max(dataset.nbytes, chunk) > most or held > os.path.getsize(dataset.file.filename):
        raise ValueError(f"{dataset.name} claims {dataset.nbytes} bytes, more than the file holds")
    return dataset[()]
