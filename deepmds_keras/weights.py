"""Files of trained networks, checkpoints and the authors' weights."""

from __future__ import annotations

import contextlib
import errno
import json
import math
import os
import secrets
import warnings
import zipfile
from pathlib import Path
from typing import TYPE_CHECKING, BinaryIO

import h5py
import numpy as np

from deepmds_keras.io.errors import InputError

if TYPE_CHECKING:
    import keras

_HEADERS = {
    (1, 0): np.lib.format.read_array_header_1_0,
    (2, 0): np.lib.format.read_array_header_2_0,
}
# The most that a byte of a file can stand for. What savez does not write is refused.
_DEFLATED = 1032
_ZIP_END, _ZIP_END_SIZE = b"PK\5\6", 22
_EXPANSION = {zipfile.ZIP_STORED: 1, zipfile.ZIP_DEFLATED: _DEFLATED}
PRETRAINED = Path(__file__).with_name("pretrained")


def write_arrays(
    path: str | Path,
    arrays: dict[str, np.ndarray],
    description: dict,
    *,
    compressed: bool = True,
) -> None:
    """Write arrays and a JSON description into one npz, under a temporary name until complete.

    Raises:
        InputError: The path is that of a folder.
        OSError: It cannot be written; `filename` is the path.
    """
    path = Path(path)
    if path.is_dir():
        raise InputError(f"{path} must be a file to write. Received a folder.")
    path.parent.mkdir(parents=True, exist_ok=True)
    partial = path.with_name(f".{path.name}.{secrets.token_hex(4)}.partial")
    try:
        with open(partial, "wb") as file:
            save = np.savez_compressed if compressed else np.savez
            save(file, description=np.array(json.dumps(description)), **arrays)
            file.flush()
            os.fsync(file.fileno())  # some file systems only tell here that they are full
        os.replace(partial, path)
    except OSError as error:
        number = error.errno or errno.ENOSPC  # NumPy has none for what it could not write
        raise OSError(number, os.strerror(number), str(path)) from error
    finally:
        with contextlib.suppress(OSError):  # there is none when all went well
            partial.unlink()


def read_arrays(path: str | Path) -> tuple[dict[str, np.ndarray], dict]:
    """Read what `write_arrays` wrote; nothing in the file is executed, no header is believed.

    Raises:
        InputError: The file is missing, truncated or not of this kind.
    """
    try:
        with open(path, "rb") as opened, warnings.catch_warnings():
            warnings.simplefilter("ignore")  # Python's of odd headers, NumPy's of those of Python 2
            with zipfile.ZipFile(opened) as archive:
                size = opened.seek(0, 2)
                arrays = {
                    member.filename.removesuffix(".npy"): _read_member(archive, member, size)
                    for member in archive.infolist()
                }
                _check_number(opened, len(arrays))
        description = json.loads(str(arrays.pop("description")))
        if not isinstance(description, dict):
            raise ValueError("a description that is no dict")
        return arrays, description
    except FileNotFoundError:
        raise InputError(f"{path} does not exist; it must be a file written by save().") from None
    except Exception as error:  # zipfile, zlib and NumPy's parser of headers raise many kinds
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


def _check_number(file: BinaryIO, n: int) -> None:
    """Python reads a damaged list of contents up to the damage, and does not count what it read."""
    file.seek(-_ZIP_END_SIZE, os.SEEK_END)
    end = file.read()
    if end.startswith(_ZIP_END) and n != int.from_bytes(end[10:12], "little"):
        raise ValueError(f"{n} arrays of {int.from_bytes(end[10:12], 'little')}")


def _read_member(archive: zipfile.ZipFile, member: zipfile.ZipInfo, size: int) -> np.ndarray:
    """An array of an npz file of `size` bytes. NumPy allots what the header claims, true or not."""
    if member.compress_type not in _EXPANSION or member.compress_size > size:
        raise ValueError(f"{member.filename} is packed in another way than NumPy packs")
    with archive.open(member) as stream:
        shape, _, dtype = _HEADERS[np.lib.format.read_magic(stream)](stream)
    n_bytes = math.prod(shape) * dtype.itemsize
    if n_bytes > member.compress_size * _EXPANSION[member.compress_type] and not dtype.hasobject:
        raise ValueError(f"{member.filename} claims {n_bytes} bytes, more than the file can hold")
    with archive.open(member) as stream:
        return np.lib.format.read_array(stream, allow_pickle=False)


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


def _line(error: Exception) -> str:
    if "allow_pickle" in str(error):  # numpy's advice for whatever it does not know
        return "Received a file of another kind."
    return f"Received {type(error).__name__}: {' '.join(str(error).split())[:200]}"
