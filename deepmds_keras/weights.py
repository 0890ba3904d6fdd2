"""Files of trained networks and checkpoints."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from deepmds_keras.errors import InputError
from deepmds_keras.files import read_arrays, write_arrays

if TYPE_CHECKING:
    import keras

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
            check_finite(array, f"{source}: {key} of {network.name}")
            weight.assign(array)


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


def check_finite(array: np.ndarray, name: str) -> None:
    """Raise InputError, which names the array, where it holds NaN or infinity."""
    if not np.isfinite(array).all():
        raise InputError(f"{name} must be finite. Received NaN or infinity.")
