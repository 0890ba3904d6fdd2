"""Basel Face Models: the MATLAB file of 2009, and the HDF5 files of 2017 and 2019 (statismo).

Paysan et al. 2009, doi:10.1109/AVSS.2009.58; Gerig et al. 2018, doi:10.1109/FG.2018.00021;
licensed by the University of Basel.
"""

import json
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np

from data_gen.landmarks import known_landmarks, load_basel_anchors, load_vertices
from data_gen.models.array_files import read_mat
from data_gen.models.morphable_model import MorphableModel, model_of
from data_gen.models.openhead import load_openhead
from deepmds_keras.errors import InputError, brief, naming
from deepmds_keras.files import sha256_of

N_VERTICES_2009 = 53490
_N_VERTICES_NOMOUTH = 53149  # of model2017-1_bfm_nomouth.h5, whose iBUG vertices eos lists
_MM = 1e-3  # the file of 2009 is in micrometres
_KEYS = ("shapeMU", "shapePC", "shapeEV", "texMU", "texPC", "texEV", "tl")
_LANDMARKS = "metadata/landmarks/json"
_DEFLATED = 1032  # the most numbers' bytes that one byte of a compressed file can stand for


@np.errstate(over="ignore", invalid="ignore")  # what is too large is refused in the end
def load_bfm2009(path: str | Path) -> MorphableModel:
    """Reads the Basel Face Model 2009.

    `shapeEV` holds standard deviations, whatever its name says; `tl` counts vertices from 1 and
    winds triangles clockwise. There are landmarks `"bfm72"` on the whole mesh of 53,490 vertices;
    its subsets are numbered otherwise.

    Raises:
        InputError: The file is missing, damaged, of another format, or its sizes disagree.
    """
    file = Path(path)
    arrays = read_mat(file, _KEYS)
    shape, texture = (
        _statistics(f"{file}: {prefix}MU, {prefix}PC, {prefix}EV", *parts, unit)
        for prefix, unit in (("shape", _MM), ("tex", 1 / 255))
        for parts in [[arrays[f"{prefix}{key}"] for key in ("MU", "PC", "EV")]]
    )
    if (first := arrays["tl"].min(initial=1)) < 1:
        raise InputError(f"{file}: tl must count vertices from 1. Received {first:g}.")
    is_whole = len(shape[0]) == N_VERTICES_2009
    return model_of(
        file,
        name="bfm2009",
        mean=shape[0],
        identity_basis_times_sd=shape[1],
        triangles=arrays["tl"].astype(int) - 1,
        landmarks=known_landmarks("bfm2009", np.arange(N_VERTICES_2009)) if is_whole else {},
        colour_mean=texture[0].clip(0, 1),
        colour_basis_times_sd=texture[1],
        sha256=sha256_of([file]),
    )


@np.errstate(over="ignore", invalid="ignore")  # what is too large is refused in the end
def load_bfm2017(path: str | Path, name: str = "bfm2017") -> MorphableModel:
    """Reads the Basel Face Model 2017 or 2019.

    `pcaVariance` holds variances. The neutral face is the mean shape; an expression adds the
    expression mean too. Expression weights are in standard deviations.

    No list of the paper's 72 landmarks exists for these meshes. `"bfm72"` is approximate, carried
    over from the open head (`transfer_landmarks`). That goes by the landmarks named in the file
    itself or, without those, by the iBUG vertices that eos lists for the 2017 model. Landmarks are
    left out where neither is there.

    Raises:
        InputError: The file is missing, damaged, of another format, or its sizes disagree.
    """
    from data_gen.models.landmark_transfer import MIN_ANCHORS, transfer_landmarks  # slow to load

    file = Path(path)
    try:
        with h5py.File(file, "r") as h5:
            fields = _read_fields(h5)
            anchors = _named_anchors(h5, fields["mean"].shape)
    except InputError as error:
        raise InputError(f"{file}: {error}") from None
    except Exception as error:  # h5py raises many kinds for a damaged file
        raise InputError(
            f"{file}: must be a whole HDF5 file. Received {brief(repr(error))}."
        ) from None
    model = model_of(file, name=name, sha256=sha256_of([file]), **fields)
    if not anchors and name == "bfm2017" and model.n_vertices == _N_VERTICES_NOMOUTH:
        ibug = load_vertices("ibug68")
        on_head = ibug.vertices["openhead"]
        anchors = {int(on_head[i]): vertex for i, vertex in ibug.anchors["bfm2017"].items()}
    if len(anchors) < MIN_ANCHORS:
        return model
    on_head, on_model = np.array([*anchors.items()]).T
    with naming(f"{file}: the 72 landmarks cannot be placed"):
        landmarks = transfer_landmarks(load_openhead(), on_head, model, on_model)
    return replace(model, landmarks={"bfm72": landmarks})


def _read_fields(h5: h5py.File) -> dict[str, np.ndarray | None]:
    """Arguments of `MorphableModel`."""
    parts = {"shape": (None, None), "expression": (None, None), "color": (None, None)}
    for group in parts:
        if group == "shape" or group in h5:
            keys = [f"{group}/model/{key}" for key in ("mean", "pcaBasis", "pcaVariance")]
            mean, columns, variance = (_numbers(h5, key) for key in keys)
            sd = np.sqrt(variance, dtype=float)
            parts[group] = _statistics(", ".join(keys), mean, columns, sd)
    colour_mean, colour_basis = parts["color"]
    return {
        "mean": parts["shape"][0],
        "identity_basis_times_sd": parts["shape"][1],
        "triangles": _numbers(h5, "shape/representer/cells").T.astype(int),
        "expression_mean": parts["expression"][0],
        "expression_basis": parts["expression"][1],
        "colour_mean": None if colour_mean is None else colour_mean.clip(0, 1),
        "colour_basis_times_sd": colour_basis,
    }


def _statistics(
    what: str, mean: np.ndarray, columns: np.ndarray, sd: np.ndarray, unit: float = 1.0
) -> tuple[np.ndarray, np.ndarray]:
    """Mean `(V, 3)` float64 and offsets at one s.d. `(K, V, 3)` float32, of columns `(3V, K)`."""
    mean, sd = mean.ravel().astype(float) * unit, sd.ravel().astype(float) * unit
    if mean.size % 3 or columns.shape != (mean.size, sd.size) or not sd.size:
        raise InputError(
            f"{what} must have the sizes 3V, (3V, K) and K. "
            f"Received {mean.size}, {columns.shape} and {sd.size}."
        )
    # One component at a time: the files are large, and a second copy in double would be larger.
    basis = np.empty((sd.size, mean.size // 3, 3), np.float32)
    for k in range(sd.size):
        basis[k] = columns[:, k].reshape(-1, 3) * sd[k]
    return mean.reshape(-1, 3), basis


def _numbers(h5: h5py.File, key: str) -> np.ndarray:
    """All of a dataset, if the file holds that much: what was never written is read as zeros."""
    dataset = h5.get(key)
    if not isinstance(dataset, h5py.Dataset) or dataset.dtype.kind not in "fiu":
        raise InputError(f"must hold an array of numbers {key}. Received none.")
    if dataset.nbytes > _DEFLATED * dataset.id.get_storage_size():
        raise InputError(f"{key} must be whole. Received less than {dataset.nbytes} bytes of it.")
    return dataset[()]


def _named_anchors(h5: h5py.File, shape: tuple[int, int]) -> dict[int, int]:
    """Open head vertex to this model's vertex, from the landmarks named in the file.

    They are points of the reference mesh (statismo's "representer"), a vertex each.
    """
    if _LANDMARKS not in h5:
        return {}
    from scipy.spatial import KDTree  # slow to load, and other models do without

    # One string, the first of an array of strings, or an array of characters.
    text = np.asarray(h5[_LANDMARKS][()])
    text = text.tobytes() if text.dtype.kind in "iu" else text.ravel()[0]
    try:
        rows = {row["id"]: row["coordinates"] for row in json.loads(text)}
        known = load_basel_anchors().items()
        anchors = {vertex["openhead"]: rows[name] for name, vertex in known if name in rows}
        coordinates = np.array([*anchors.values()], float).reshape(-1, 3)
        reference = _numbers(h5, "shape/representer/points").T
        _, vertices = KDTree(reference).query(coordinates)
    except (ValueError, KeyError, TypeError, RecursionError) as error:
        raise InputError(
            f"{_LANDMARKS} must list id and coordinates. Received {brief(repr(error))}."
        ) from error
    if reference.shape != shape:
        raise InputError(
            f"shape/representer/points must be (3, {shape[0]}). Received {reference.T.shape}."
        )
    return dict(zip(anchors, map(int, vertices), strict=True))
