"""Basel Face Model 2017 and 2019: the HDF5 files in statismo layout.

Gerig et al. 2018, doi:10.1109/FG.2018.00021; licensed by the University of Basel.
"""

from __future__ import annotations

import json
import math
import struct
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
from scipy.spatial import KDTree

from data_gen.landmarks import load_basel_anchors, load_vertices
from data_gen.models.landmark_transfer import MIN_ANCHORS, transfer_landmarks
from data_gen.models.mesh import orient_outwards
from data_gen.models.model_files import as_basis, expect_format, find_path, model_of
from data_gen.models.morphable_model import MorphableModel
from data_gen.models.openhead import load_openhead
from deepmds_keras.errors import InputError, brief
from deepmds_keras.files import sha256_of

CANDIDATES = {
    name: tuple(folder + file for file in files for folder in ("", f"{name}/", "BaselFaceModel/"))
    for name, files in {
        "bfm2017": ("model2017-1_bfm_nomouth.h5", "model2017-1_face12_nomouth.h5"),
        "bfm2019": ("model2019_bfm.h5", "model2019_face12.h5", "model2019_fullHead.h5"),
    }.items()
}
_N_VERTICES_NOMOUTH = 53149  # of model2017-1_bfm_nomouth.h5, whose iBUG vertices eos lists
_LANDMARKS = "metadata/landmarks/json"
_DEFLATED = 1032  # the most numbers' bytes that one byte of a compressed file can stand for


@np.errstate(over="ignore", invalid="ignore")  # what is too large is refused in the end
def load_bfm2017(path: str | Path, name: str = "bfm2017") -> MorphableModel:
    """Reads the Basel Face Model 2017 or 2019.

    `pcaVariance` holds variances. The neutral face is the mean shape; an expression adds the
    expression mean too. Expression weights are in standard deviations.

    No list of the paper's 72 landmarks exists for these meshes. `"bfm72"` is approximate, carried
    over from the open head (`landmark_transfer`). That goes by the landmarks named in the file
    itself or, without those, by the iBUG vertices that eos lists for the 2017 model. Landmarks are
    left out where neither is there.

    Args:
        path: The `.h5` file or the folder that holds it.
        name: `"bfm2017"` or `"bfm2019"`.

    Raises:
        InputError: The file is missing, damaged, of another format, or its sizes disagree.
    """
    if name not in CANDIDATES:
        raise InputError(f"name must be one of {', '.join(CANDIDATES)}. Received {name!r}.")
    file = find_path(path, CANDIDATES[name], what=f"the Basel Face Model {name[-4:]}")
    expect_format(file, b"\x89HDF\r\n\x1a\n", "an HDF5 file")
    try:
        with h5py.File(file, "r") as h5:
            model = _read_model(file, h5, name)
            anchors = _named_anchors(file, h5, model)
    except InputError:
        raise
    except Exception as error:  # h5py raises many kinds for a damaged file
        raise InputError(
            f"{file}: must be a whole HDF5 file. Received {brief(repr(error))}."
        ) from error
    if not anchors and name == "bfm2017" and model.n_vertices == _N_VERTICES_NOMOUTH:
        anchors = _eos_anchors()
    if len(anchors) < MIN_ANCHORS:
        return model
    try:
        landmarks = _transfer_from_openhead(anchors, model)
    except InputError as error:
        raise InputError(f"{file}: the 72 landmarks cannot be placed: {error}") from error
    return replace(model, landmarks={"bfm72": landmarks})


def _read_model(file: Path, h5: h5py.File, name: str) -> MorphableModel:
    mean, basis = _statistics(file, h5, "shape")
    cells = _numbers(file, h5, "shape/representer/cells")
    if cells.ndim != 2 or cells.shape[0] != 3 or cells.min() < 0 or cells.max() >= len(mean):
        raise InputError(
            f"{file}: shape/representer/cells must be (3, T) and count {len(mean)} vertices from 0."
            f" Received shape {cells.shape}."
        )
    expression = colour = (None, None)
    if "expression" in h5:
        expression = _statistics(file, h5, "expression", len(mean))
    if "color" in h5:
        colour = _statistics(file, h5, "color", len(mean))
    return model_of(
        file,
        name=name,
        mean=mean,
        identity_basis_times_sd=basis,
        triangles=orient_outwards(mean, cells.T.astype(int)),
        expression_mean=expression[0],
        expression_basis=expression[1],
        colour_mean=None if colour[0] is None else colour[0].clip(0, 1),
        colour_basis_times_sd=colour[1],
        sha256=sha256_of([file]),
    )


def _statistics(
    file: Path, h5: h5py.File, group: str, n_vertices: int | None = None
) -> tuple[np.ndarray, np.ndarray]:
    mean = _numbers(file, h5, f"{group}/model/mean").ravel().astype(np.float64)
    columns = _numbers(file, h5, f"{group}/model/pcaBasis")
    variance = _numbers(file, h5, f"{group}/model/pcaVariance").ravel().astype(np.float64)
    if mean.size % 3 or columns.shape != (mean.size, variance.size) or not variance.size:
        raise InputError(
            f"{file}: {group}/model mean, pcaBasis, pcaVariance must have shapes (3n,), (3n, k), "
            f"(k,). Received {mean.shape}, {columns.shape}, {variance.shape}."
        )
    if n_vertices is not None and mean.size != 3 * n_vertices:
        raise InputError(
            f"{file}: {group}/model must have the {n_vertices} vertices of shape/model. "
            f"Received {mean.size // 3}."
        )
    if (variance < 0).any():
        raise InputError(f"{file}: {group}/model/pcaVariance must not be negative. Received some.")
    return mean.reshape(-1, 3), as_basis(columns, np.sqrt(variance))


def _numbers(file: Path, h5: h5py.File, key: str) -> np.ndarray:
    dataset = h5.get(key)
    if not isinstance(dataset, h5py.Dataset) or dataset.dtype.kind not in "fiu":
        raise InputError(f"{file}: must hold an array of numbers {key}. Received none.")
    return _content(file, dataset)


def _content(file: Path, dataset: h5py.Dataset):
    """All of a dataset, if the file holds that much: what was never written is read as zeros."""
    held = dataset.id.get_storage_size()
    most = held * (_DEFLATED if dataset.compression else 1)
    chunk = dataset.dtype.itemsize * math.prod(dataset.chunks or (0,))
    is_whole = dataset.shape is not None and max(dataset.nbytes, chunk) <= most
    if not is_whole or held > file.stat().st_size:
        raise InputError(
            f"{file}: {dataset.name} must be whole. Received {held} bytes for an array of "
            f"{dataset.dtype} {dataset.shape}."
        )
    return dataset[()]


def _named_anchors(file: Path, h5: h5py.File, model: MorphableModel) -> dict[int, int]:
    """Open head vertex to this model's vertex, from the landmarks named in the file.

    They are points of the reference mesh (statismo's "representer"), a vertex each.
    """
    dataset = h5.get(_LANDMARKS)
    if not isinstance(dataset, h5py.Dataset):
        return {}
    try:
        content = json.loads(_text(file, dataset))
        points = {row["id"]: row["coordinates"] for row in content}
        points = {k: points[k] for k in load_basel_anchors() if k in points}
        coordinates = np.array(list(points.values()), np.float64).reshape(len(points), 3)
        if not np.isfinite(coordinates).all():
            raise ValueError("coordinates that are not finite")
    except InputError:
        raise
    except (ValueError, KeyError, TypeError, OverflowError, RecursionError, struct.error) as error:
        raise InputError(
            f"{file}: {_LANDMARKS} must list id and coordinates. Received {brief(repr(error))}."
        ) from error
    reference = _numbers(file, h5, "shape/representer/points").T
    if reference.shape != model.mean.shape:
        raise InputError(
            f"{file}: shape/representer/points must be (3, {model.n_vertices}). "
            f"Received {reference.T.shape}."
        )
    _, vertices = KDTree(reference).query(coordinates)
    on_openhead = [load_basel_anchors()[point]["openhead"] for point in points]
    return dict(zip(on_openhead, map(int, vertices), strict=True))


def _text(file: Path, dataset: h5py.Dataset) -> str:
    """A text: one string, the first of an array of strings, or an array of characters."""
    if dataset.dtype.kind in "iu":
        return _content(file, dataset).tobytes().decode("utf-8")
    if dataset.dtype.kind == "S":
        return np.ravel(_content(file, dataset))[0].decode("utf-8")
    if h5py.check_string_dtype(dataset.dtype) is None:
        raise TypeError(f"{dataset.dtype}")
    return _string_of_any_length(file, dataset.id.get_offset()).decode("utf-8")


def _string_of_any_length(file: Path, place: int | None) -> bytes:
    """Object that HDF5 keeps in a "global heap", by a reference from elsewhere in the file.

    Read here, since a damaged heap makes HDF5 go round for ever, or crash.
    """
    if place is None:
        raise ValueError("a string that is not stored in one piece")
    with file.open("rb") as stream:
        stream.seek(place)
        length, address, index = struct.unpack("<IQI", stream.read(16))
        stream.seek(min(address, file.stat().st_size))
        magic, size = struct.unpack("<4s4xQ", stream.read(16))
        heap = stream.read(min(size, file.stat().st_size)) if magic == b"GCOL" else b""
    start = 0
    while start + 16 <= len(heap):
        number, size = struct.unpack_from("<H6xQ", heap, start)
        if number == index:
            return heap[start + 16 : start + 16 + min(length, size)]
        start += 16 + -(-size // 8) * 8
    raise ValueError("a string that is not where it should be")


def _eos_anchors() -> dict[int, int]:
    scheme = load_vertices("ibug68")
    known = scheme.anchors["bfm2017"]
    return {int(scheme.vertices["openhead"][i]): vertex for i, vertex in known.items()}


def _transfer_from_openhead(anchors: dict[int, int], model: MorphableModel) -> np.ndarray:
    head = load_openhead()
    return transfer_landmarks(
        head.mean,
        head.triangles,
        head.landmarks["bfm72"],
        np.array(list(anchors.keys())),
        model.mean,
        model.triangles,
        np.array(list(anchors.values())),
    ).vertices
