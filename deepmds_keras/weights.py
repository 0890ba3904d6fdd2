"""Files of trained networks, checkpoints and the authors' weights."""

from __future__ import annotations

import math
import os
from pathlib import Path
from typing import TYPE_CHECKING

import h5py
import numpy as np

from deepmds_keras.io.archives import read_arrays, write_arrays
from deepmds_keras.io.errors import InputError, brief

if TYPE_CHECKING:
    import keras

_DEFLATED = 1032  # the most bytes that one of a compressed data set can stand for
PRETRAINED = Path(__file__).with_name("pretrained")


def network_arrays(network: keras.Model) -> dict[str, np.ndarray]:
    """The weights of a network by layer and name, such as `encode_1/kernel`."""
    return {
        f"{layer.name}/{weight.name}": weight.numpy()
        for layer in network.layers
        for weight in layer.weights
        if "seed_generator" not in weight.path
    }


def set_network_arrays(network: keras.Model, arrays: dict[str, np.ndarray], source: str) -> None:
    """Put arrays of `network_arrays` back.

    Raises:
        InputError: A weight is missing, no number, NaN, infinite or of another shape; the message
            names `source`.
    """
    for layer in network.layers:
        for weight in layer.weights:
            key = f"{layer.name}/{weight.name}"
            array = arrays.get(key, np.empty(0, object))
            if array.dtype.kind not in "fiu" or array.shape != tuple(weight.shape):
                found = f"{array.dtype} {array.shape}" if key in arrays else "nothing"
                raise InputError(
                    f"{source}: {key} of {network.name} must have shape {tuple(weight.shape)}. "
                    f"Received {found}."
                )
            _check_finite(array, f"{source}: {key} of {network.name}")
            weight.assign(array)


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
            _check_finite(array, f"{path}: layer {layer.name} of {network.name}")
        layer.set_weights(group)


def write_checkpoint(path: str | Path, network: keras.Model, description: dict) -> None:
    """Everything that training needs to go on: weights, optimiser state, and a description."""
    state = {f"optimizer/{i}": v.numpy() for i, v in enumerate(network.optimizer.variables)}
    # Floats hardly get smaller, and to press those of a large network takes longer than an epoch.
    write_arrays(path, network_arrays(network) | state, description, compressed=False)


def read_checkpoint(path: str | Path, network: keras.Model) -> dict:
    """Put a checkpoint back into a compiled network and return its description.

    Raises:
        InputError: The file is damaged or belongs to another network.
    """
    arrays, description = read_arrays(path)
    set_network_arrays(network, arrays, str(path))
    network.optimizer.build(network.trainable_variables)
    for i, variable in enumerate(network.optimizer.variables):
        array = arrays.get(f"optimizer/{i}", np.empty(0, object))
        if array.dtype.kind not in "fiu" or array.shape != tuple(variable.shape):
            raise InputError(f"{path} holds no optimiser state; delete it to train anew.")
        variable.assign(array)
    return description


def checkpoint_files(folder: str | Path, variant: str, schedule: str) -> dict[str, Path]:
    """File of each network of `DeepMDS` in a folder of checkpoints, named by what it depends on.

    The autoencoder is the same for every variant of the dissimilarity net.
    """
    names = {
        "autoencoder": f"autoencoder-{schedule}",
        "dissimilarity_net": f"dissimilarity-{variant}-{schedule}",
    }
    return {network: Path(folder, f"{name}.npz") for network, name in names.items()}


def pretrained_path(name: str) -> Path:
    """Path of the weights that ship with the package.

    Raises:
        InputError: No weights of that name; the message lists what there is.
    """
    path = PRETRAINED / f"{name}.npz"
    if not path.is_file():
        names = sorted(p.stem for p in PRETRAINED.glob("*.npz"))
        raise InputError(f"name must be one of {', '.join(names) or 'none'}. Received {name!r}.")
    return path


def _check_finite(array: np.ndarray, name: str) -> None:
    if not np.isfinite(array).all():
        raise InputError(f"{name} must be finite. Received NaN or infinity.")


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
