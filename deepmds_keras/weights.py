"""Files of trained networks, checkpoints and the authors' weights."""

from __future__ import annotations

import json
import os
import zipfile
import zlib
from pathlib import Path
from typing import TYPE_CHECKING

import h5py
import numpy as np

from deepmds_keras.errors import InputError

if TYPE_CHECKING:
    import keras

# What numpy, zipfile and json raise for a file that is cut short, damaged or of another kind.
_UNREADABLE = (
    AttributeError,
    EOFError,
    KeyError,
    MemoryError,
    NotImplementedError,
    OSError,
    RuntimeError,
    TypeError,
    ValueError,
    zipfile.BadZipFile,
    zlib.error,
)
PRETRAINED = Path(__file__).with_name("pretrained")


def write_arrays(
    path: str | Path,
    arrays: dict[str, np.ndarray],
    description: dict,
    *,
    compressed: bool = True,
) -> None:
    """Write arrays and a JSON description into one npz, under a temporary name until complete."""
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    partial = path.with_name(f".{path.name}.{os.getpid()}.partial")
    with open(partial, "wb") as file:
        save = np.savez_compressed if compressed else np.savez
        save(file, description=np.array(json.dumps(description)), **arrays)
    os.replace(partial, path)


def read_arrays(path: str | Path) -> tuple[dict[str, np.ndarray], dict]:
    """Read what `write_arrays` wrote; nothing in the file is executed.

    Raises:
        InputError: The file is missing, truncated or not of this kind.
    """
    try:
        with open(path, "rb") as opened, np.load(opened, allow_pickle=False) as file:
            arrays = {key: file[key] for key in file.files}
        return arrays, json.loads(str(arrays.pop("description")))
    except FileNotFoundError:
        raise InputError(f"{path} does not exist; it must be a file written by save().") from None
    except _UNREADABLE as error:
        raise InputError(f"{path} must be an npz written by save(). {_line(error)}") from None


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
        InputError: A weight is missing or of another shape; the message names `source`.
    """
    for layer in network.layers:
        for weight in layer.weights:
            key = f"{layer.name}/{weight.name}"
            if key not in arrays or arrays[key].shape != tuple(weight.shape):
                found = f"shape {arrays[key].shape}" if key in arrays else "nothing"
                raise InputError(
                    f"{source}: {key} of {network.name} must have shape {tuple(weight.shape)}. "
                    f"Received {found}."
                )
            weight.assign(arrays[key])


def read_keras2_weights(network: keras.Model, path: str | Path) -> None:
    """Load a Keras 2 weight file (HDF5, weights only), as the authors released, into a network.

    Layers correspond by order, since their names differ.

    Raises:
        InputError: Missing or truncated file, or one whose layers have other shapes.
    """
    try:
        with h5py.File(path, "r") as file:
            groups = [file[name] for name in file.attrs["layer_names"]]
            groups = [[g[w][()] for w in g.attrs["weight_names"]] for g in groups]
    except (OSError, KeyError, ValueError, RuntimeError) as error:
        raise InputError(f"{path} must be a Keras 2 weight file (HDF5). {_line(error)}") from None
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
        if f"optimizer/{i}" not in arrays:
            raise InputError(f"{path} holds no optimiser state; delete it to train anew.")
        variable.assign(arrays[f"optimizer/{i}"])
    return description


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


def _line(error: Exception) -> str:
    if "allow_pickle" in str(error):  # numpy's advice for whatever it does not know
        return "Received a file of another kind."
    return f"Received {type(error).__name__}: {' '.join(str(error).split())[:200]}"
