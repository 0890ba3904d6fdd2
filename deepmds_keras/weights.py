"""Trained networks: their files and checkpoints."""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from deepmds_keras.errors import InputError, brief, check_choice
from deepmds_keras.files import reading, write_arrays

if TYPE_CHECKING:
    import keras

PRETRAINED = Path(__file__).with_name("pretrained")
_HASHED_ROWS = 1024  # at a time: images are read from files


def fingerprint(*arrays: np.ndarray) -> str:
    """Hash of arrays, or of what is indexed like one, by which a checkpoint knows its data."""
    digest = hashlib.sha256()
    for array in arrays:
        for start in range(0, len(array), _HASHED_ROWS):
            rows = np.ascontiguousarray(array[start : start + _HASHED_ROWS])
            digest.update(f"{rows.dtype} {rows.shape}".encode())
            digest.update(rows.tobytes())
    return digest.hexdigest()


def network_arrays(network: keras.Model) -> dict[str, np.ndarray]:
    """The weights of a network by layer and name, such as `encode_1/kernel`."""
    return {key: weight.numpy() for key, weight in _variables(network).items()}


def set_network_arrays(network: keras.Model, arrays: dict[str, np.ndarray], source: str) -> None:
    """Set the weights of a network from arrays of `network_arrays`.

    Raises:
        InputError: A weight is missing, not numeric, NaN, infinite or of another shape; the
            message names `source`.
    """
    for key, weight in _variables(network).items():
        _assign(weight, arrays.get(key), f"{source}: {key} of {network.name}")


def write_checkpoint(path: str | Path, network: keras.Model, description: dict) -> None:
    """Write what training needs to resume: weights, optimiser state, and a description."""
    state = {f"optimizer/{i}": v.numpy() for i, v in enumerate(network.optimizer.variables)}
    # Floats hardly compress, and compressing a large network takes longer than an epoch.
    write_arrays(path, network_arrays(network) | state, description, compressed=False)


def set_checkpoint(network: keras.Model, arrays: dict[str, np.ndarray], source: str) -> None:
    """Set a compiled network and its optimiser from arrays of `write_checkpoint`.

    Raises:
        InputError: As for `set_network_arrays`, of the optimiser's state too.
    """
    set_network_arrays(network, arrays, source)
    network.optimizer.build(network.trainable_variables)
    for i, variable in enumerate(network.optimizer.variables):
        _assign(variable, arrays.get(f"optimizer/{i}"), f"{source}: state {i} of the optimiser")


def checkpoint_files(folder: str | Path, variant: str, schedule: str) -> dict[str, Path]:
    """Checkpoint file of each network of `DeepMDS` in a folder.

    All variants of the dissimilarity net share the autoencoder.
    """
    return {
        "autoencoder": Path(folder, f"autoencoder-{schedule}.npz"),
        "dissimilarity_net": Path(folder, f"dissimilarity-{variant}-{schedule}.npz"),
    }


def pretrained_names(prefix: str = "") -> list[str]:
    """Names of the weights that ship with the package, those that begin with the prefix."""
    return sorted(path.stem for path in PRETRAINED.glob(f"{prefix}*.npz"))


def pretrained_path(name: str) -> Path:
    """Path of the weights that ship with the package.

    Raises:
        InputError: No weights have that name; the message lists those that exist.
    """
    check_choice(name, "name", pretrained_names())
    return PRETRAINED / f"{name}.npz"


def read_keras2_weights(network: keras.Model, path: str | Path) -> None:
    """Load a Keras 2 weight file (HDF5, weights only), such as the authors', into a network.

    Layers are matched by order, since their names differ. The file is parsed, never executed.

    Raises:
        InputError: Missing or truncated file, or one whose layers have other shapes or hold NaN
            or infinity.
    """
    import h5py  # of the extra `keras`, which lifters do without

    weights = [weight for layer in network.layers for weight in layer.weights]
    needed, arrays = [tuple(weight.shape) for weight in weights], []
    with reading(path, "a Keras 2 weight file (HDF5)"), h5py.File(path, "r") as file:
        groups = [file[name] for name in _read_names(file, "layer_names")]
        data = [group[name] for group in groups for name in _read_names(group, "weight_names")]
        shapes = [dataset.shape for dataset in data]
        if shapes == needed:  # otherwise the file may claim more than memory holds
            arrays = [dataset[()] for dataset in data]
    if shapes != needed:
        raise InputError(
            f"{path} must have the {len(needed)} weights of {network.name}, of shapes "
            f"{brief(needed, 40)}. Received {len(shapes)}, {brief(shapes, 40)}."
        )
    for weight, array in zip(weights, arrays, strict=True):
        _assign(weight, array, f"{path}: {weight.path} of {network.name}")


def _read_names(group, key: str) -> list:
    """An attribute that lists names; reading other kinds crashes HDF5 if they are damaged."""
    import h5py

    attribute = group.attrs.get_id(key)
    if 0 in attribute.shape:  # of a layer without weights, which Keras writes as no numbers
        return []
    if attribute.dtype.kind != "S" and h5py.check_string_dtype(attribute.dtype) is None:
        raise ValueError(f"{key} are no text but {attribute.dtype}")
    return [*group.attrs[key]]


def _variables(network: keras.Model) -> dict:
    """Weights by layer and name; Keras assigns the state of random generators to no layer."""
    layers = network.layers
    return {f"{layer.name}/{weight.name}": weight for layer in layers for weight in layer.weights}


def _assign(variable, array: np.ndarray | None, name: str) -> None:
    """Set a variable; an array that does not fit raises InputError, which names it."""
    if array is None or array.dtype.kind not in "fiu" or array.shape != tuple(variable.shape):
        received = "nothing" if array is None else f"{array.dtype} {array.shape}"
        raise InputError(
            f"{name} must be numbers of shape {tuple(variable.shape)}. Received {received}."
        )
    if not np.isfinite(array).all():
        raise InputError(f"{name} must be finite. Received NaN or infinity.")
    variable.assign(array)
