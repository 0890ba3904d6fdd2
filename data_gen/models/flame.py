"""FLAME: identity, expression and an articulated jaw, from its pickle or the same as npz.

Li et al. 2017, "Learning a model of facial shape and expression from 4D scans",
doi:10.1145/3130800.3130813; licensed by the Max Planck Society, flame.is.tue.mpg.de.
"""

from __future__ import annotations

import zipfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.sparse import issparse
from scipy.spatial.transform import Rotation

from data_gen.formats.plain_pickle import load_plain_pickle
from data_gen.models.flame_embedding import find_embedding, load_embedding
from data_gen.models.mesh import orient_outwards
from data_gen.models.model_files import find_path, model_of
from data_gen.models.morphable_model import MorphableModel
from deepmds_keras.errors import InputError
from deepmds_keras.files import read_npz, sha256_of

CANDIDATES = (
    "generic_model.pkl",
    "flame2023.pkl",
    "flame2023_no_jaw.pkl",
    "FLAME2020/generic_model.pkl",
    "FLAME2023/flame2023.pkl",
    "FLAME2023/flame2023_no_jaw.pkl",
    "FLAME/generic_model.pkl",
    "flame/generic_model.pkl",
    "models/generic_model.pkl",
    "generic_model.npz",
    "flame.npz",
    "FLAME/flame.npz",
)
N_IDENTITY, N_EXPRESSION, N_JOINTS = 300, 100, 5
JAW = 2  # number of its joint
# Turn of the jaw, radians, that weight one of an expression stands for: about one s.d., our choice.
JAW_STEP = 0.1
_MM = 1e3  # the files are in metres
_OLDER_KEYS = {
    "default_v": "v_template",
    "template_v": "v_template",
    "joint_regressor": "J_regressor",
    "blendshapes": "posedirs",
}
_ROOT = (-1, 2**32 - 1)  # what stands for no parent


@dataclass(frozen=True, eq=False)
class Flame:
    """The articulated model as in its file, but in millimetres.

    Attributes:
        template: `(V, 3)`, the mean face at rest.
        shape_basis: `(B, V, 3)`, offsets at one s.d.: 300 of identity, then 100 of expression.
        pose_basis: `(9 (J - 1), V, 3)`, offsets for the entries of each joint's rotation matrix,
            less the identity, row by row; not for the root.
        joint_regressor: `(J, V)`, joints of a face at rest.
        skinning_weights: `(V, J)`, how far each vertex follows each joint; rows sum to 1.
        parents: `(J,)` int, the joint that each hangs on, -1 for the root: root, neck, jaw, eyes.
        triangles: `(T, 3)` int, 0-based, in the order and winding of the file.
    """

    template: np.ndarray
    shape_basis: np.ndarray
    pose_basis: np.ndarray
    joint_regressor: np.ndarray
    skinning_weights: np.ndarray
    parents: np.ndarray
    triangles: np.ndarray


@np.errstate(over="ignore", invalid="ignore")  # what is too large is refused in the end
def load_flame(path: str | Path) -> MorphableModel:
    """Reads FLAME as a linear model.

    Its 51 landmarks, which are points within triangles, are appended as vertices of no triangle.
    The expressions are the 100 of FLAME, then `jaw_x` (positive opens), `jaw_y` and `jaw_z`: one
    unit of them moves each vertex along its tangent as the mean face's jaw turns by 0.1 rad. True
    vertices go in an arc and are missed by half the angle times their way: 5 % at 0.1 rad, 10 % at
    0.2 rad, which is 2 mm for one 100 mm from the joint.

    Args:
        path: `generic_model.pkl`, `flame2023.pkl`, an npz with the same arrays (a dense
            `J_regressor`), or a folder that holds one. `flame_static_embedding.pkl` must lie beside
            it or up to two folders above.

    Returns:
        The model in millimetres; landmarks `"ibug51"`.

    Raises:
        InputError: A file is missing, damaged, of another content, or its sizes disagree.
    """
    file = find_path(path, CANDIDATES, what="FLAME")
    flame = read_flame(file)
    embedding_file = find_embedding(*file.absolute().parents[:3])
    embedding = load_embedding(embedding_file)

    def with_landmarks(vertices: np.ndarray) -> np.ndarray:
        try:
            points = embedding.points(vertices, flame.triangles)
        except InputError as error:
            raise InputError(f"{file}: {error} (of {embedding_file})") from None
        return np.concatenate([vertices, points.astype(vertices.dtype)], axis=-2)

    n_vertices = len(flame.template)
    basis = with_landmarks(flame.shape_basis)
    return model_of(
        file,
        name="flame",
        mean=with_landmarks(flame.template),
        identity_basis_times_sd=basis[:N_IDENTITY],
        triangles=orient_outwards(flame.template, flame.triangles),
        landmarks={"ibug51": np.arange(n_vertices, basis.shape[1])},
        expression_basis=np.concatenate([basis[N_IDENTITY:], with_landmarks(_jaw(flame))]),
        expression_names=(
            *(f"expression_{k + 1:03}" for k in range(N_EXPRESSION)),
            *("jaw_x", "jaw_y", "jaw_z"),
        ),
        sha256=sha256_of([file, embedding_file]),
    )


def read_flame(path: str | Path) -> Flame:
    """Reads FLAME with its joints.

    Args:
        path: As for `load_flame`; no embedding is needed.

    Raises:
        InputError: As for `load_flame`.
    """
    file = find_path(path, CANDIDATES, what="FLAME")
    arrays = _read(file)
    if not 0.05 < np.ptp(arrays["v_template"], axis=0).max() < 5:
        raise InputError(
            f"{file}: v_template must be a head in metres. Received one of "
            f"{np.ptp(arrays['v_template'], axis=0)}."
        )
    weights = arrays["weights"].astype(float)
    if (weights < -1e-6).any() or (np.abs(weights.sum(axis=1) - 1) > 1e-3).any():
        raise InputError(
            f"{file}: weights must not be negative, and sum to 1 for each vertex. Received "
            f"{weights.min():g} and sums from {weights.sum(axis=1).min():g}."
        )
    return Flame(
        template=arrays["v_template"].astype(float) * _MM,
        shape_basis=_basis(arrays["shapedirs"]),
        pose_basis=_basis(arrays["posedirs"]),
        joint_regressor=arrays["J_regressor"].astype(float),
        skinning_weights=weights,
        parents=_parents(file, arrays["kintree_table"]),
        triangles=_triangles(file, arrays["f"], len(arrays["v_template"])),
    )


def skin(
    flame: Flame, shape: np.ndarray, pose: np.ndarray, translation: np.ndarray | None = None
) -> np.ndarray:
    """Faces in any pose, in FLAME's order of evaluation.

    The shape's offsets are added to the template, and the joints of the result are found. Then come
    offsets for the pose (but not the root's). Each joint turns what follows it (linear blend
    skinning), and the translation moves it all.

    Args:
        flame: The model.
        shape: `(n, b)`, `b <= B` standard-normal coefficients, identity before expression.
        pose: `(n, J, 3)` radians, axis times angle, of each joint relative to its parent.
        translation: `(n, 3)` millimetres; none by default.

    Returns:
        `(n, V, 3)` millimetres.

    Raises:
        InputError: More coefficients or other joints than the model has.
    """
    if shape.shape[1] > len(flame.shape_basis):
        raise InputError(
            f"shape must have at most {len(flame.shape_basis)} coefficients a face. Received "
            f"{shape.shape[1]}."
        )
    if pose.shape != (len(shape), len(flame.parents), 3):
        raise InputError(
            f"pose must be {(len(shape), len(flame.parents), 3)}. Received {pose.shape}."
        )
    at_rest = flame.template + np.tensordot(shape, flame.shape_basis[: shape.shape[1]], axes=1)
    joints = flame.joint_regressor @ at_rest
    local = Rotation.from_rotvec(pose.reshape(-1, 3)).as_matrix().reshape(*pose.shape, 3)
    features = (local[:, 1:] - np.eye(3)).reshape(len(pose), -1)
    posed = at_rest + np.tensordot(features, flame.pose_basis, axes=1)
    turns, places = local.copy(), joints.copy()
    for joint, parent in enumerate(flame.parents[1:], start=1):
        turns[:, joint] = turns[:, parent] @ local[:, joint]
        bone = (joints[:, joint] - joints[:, parent])[:, :, None]
        places[:, joint] = places[:, parent] + (turns[:, parent] @ bone)[:, :, 0]
    shifts = places - (turns @ joints[..., None])[..., 0]
    blended = np.einsum("vj,njde->nvde", flame.skinning_weights, turns)
    faces = (blended @ posed[..., None])[..., 0] + flame.skinning_weights @ shifts
    return faces if translation is None else faces + translation[:, None]


def _jaw(flame: Flame) -> np.ndarray:
    """`(3, V, 3)` float32, the tangents of turning the mean face's jaw about x, y and z."""
    pose = np.zeros((2, 3, len(flame.parents), 3))
    pose[0, :, JAW] = JAW_STEP * np.eye(3)
    pose[1] = -pose[0]
    faces = skin(flame, np.zeros((6, 0)), pose.reshape(6, -1, 3))
    return ((faces[:3] - faces[3:]) / 2).astype(np.float32)


def _read(file: Path) -> dict[str, np.ndarray]:
    """The arrays of the model by their present names, of the right shapes and finite."""
    arrays = read_npz(file) if zipfile.is_zipfile(file) else load_plain_pickle(file)
    arrays = arrays if isinstance(arrays, dict) else {}
    arrays = {new: arrays[old] for old, new in _OLDER_KEYS.items() if old in arrays} | arrays
    n_vertices, n_triangles = (len(_or_empty(arrays.get(key))) or 1 for key in ("v_template", "f"))
    shapes = {
        "v_template": (n_vertices, 3),
        "f": (n_triangles, 3),
        "shapedirs": (n_vertices, 3, N_IDENTITY + N_EXPRESSION),
        "posedirs": (n_vertices, 3, 9 * (N_JOINTS - 1)),
        "J_regressor": (N_JOINTS, n_vertices),
        "kintree_table": (2, N_JOINTS),
        "weights": (n_vertices, N_JOINTS),
    }
    for key, shape in shapes.items():
        if key not in arrays:
            raise InputError(f"{file}: must be FLAME, {', '.join(shapes)}. Received no {key}.")
        array = arrays[key]
        is_array = isinstance(array, np.ndarray) or issparse(array)
        if not is_array or array.shape != shape or array.dtype.kind not in "fiu":
            found = f"{array.dtype} {array.shape}" if is_array else type(array).__name__
            raise InputError(f"{file}: {key} must be numbers {shape}. Received {found}.")
        arrays[key] = array.toarray() if issparse(array) else array
        if not np.isfinite(arrays[key]).all():
            raise InputError(f"{file}: {key} must be finite. Received NaN or infinity.")
    return arrays


def _or_empty(array) -> np.ndarray:
    return array if isinstance(array, np.ndarray) and array.ndim else np.empty(0)


def _basis(directions: np.ndarray) -> np.ndarray:
    """`(V, 3, K)` metres to `(K, V, 3)` float32 millimetres."""
    return np.ascontiguousarray(np.moveaxis(directions * _MM, -1, 0), dtype=np.float32)


def _parents(file: Path, table: np.ndarray) -> np.ndarray:
    parents, joints = table.astype(np.int64)
    is_tree = parents[0] in _ROOT and all(0 <= p < j for j, p in enumerate(parents[1:], start=1))
    if not is_tree or not np.array_equal(joints, np.arange(N_JOINTS)):
        raise InputError(
            f"{file}: kintree_table must give each joint's parent, an earlier joint, and its own "
            f"number; the root's parent must be {_ROOT[1]}. Received {table.tolist()}."
        )
    return np.array([-1, *parents[1:]])


def _triangles(file: Path, f: np.ndarray, n_vertices: int) -> np.ndarray:
    if f.dtype.kind not in "iu" or not len(f) or not 0 <= f.min() <= f.max() < n_vertices:
        raise InputError(
            f"{file}: f must number {n_vertices} vertices from 0. Received {f.dtype}"
            f"{f', from {f.min()} to {f.max()}' if f.size else ', none'}."
        )
    return f.astype(int)
