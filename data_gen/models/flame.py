"""FLAME: identity, expression and an articulated jaw, and where its landmarks are.

Li et al. 2017, "Learning a model of facial shape and expression from 4D scans",
doi:10.1145/3130800.3130813; licensed by the Max Planck Society, flame.is.tue.mpg.de.
"""

import zipfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.sparse import issparse
from scipy.spatial.transform import Rotation

from data_gen.models.array_files import load_plain_pickle
from data_gen.models.mesh import check_triangles
from data_gen.models.morphable_model import MorphableModel, model_of
from deepmds_keras.errors import InputError, naming
from deepmds_keras.files import read_npz, sha256_of

# The last landmarks of ibug68 are those of ibug51.
EMBEDDINGS = ("flame_static_embedding.pkl", "flame_static_embedding_68.pkl")
_EMBEDDINGS_FROM = "the public repository github.com/TimoBolkart/TF_FLAME"
_FOLDERS = ("", "data/", "models/", "FLAME/", "flame/", "FLAME2020/", "FLAME2023/", "tf_flame/")
N_IDENTITY, N_EXPRESSION, N_JOINTS, N_LANDMARKS = 300, 100, 5, 51
JAW = 2  # number of its joint
# Turn of the jaw, radians, that weight one of an expression stands for: about one s.d., our choice.
JAW_STEP = 0.1
_MM = 1e3  # the files are in metres
_OLDER_KEYS = {
    **{"default_v": "v_template", "template_v": "v_template"},
    **{"joint_regressor": "J_regressor", "blendshapes": "posedirs"},
}
# V vertices, T triangles; 9 numbers of a rotation matrix for each joint but the root.
_SHAPES = {
    "v_template": ("V", 3),
    "f": ("T", 3),
    "shapedirs": ("V", 3, N_IDENTITY + N_EXPRESSION),
    "posedirs": ("V", 3, 9 * (N_JOINTS - 1)),
    "J_regressor": (N_JOINTS, "V"),
    "kintree_table": (2, N_JOINTS),
    "weights": ("V", N_JOINTS),
}
_FLOATS = ("v_template", "J_regressor", "weights")
_NO_PARENT = (-1, 2**32 - 1)


@dataclass(frozen=True, eq=False)
class LandmarkEmbedding:
    """The 51 landmarks iBUG 18 to 68 as points within triangles of FLAME's mesh.

    Attributes:
        triangles: `(51,)` int, 0-based triangle numbers.
        weights: `(51, 3)`, barycentric, of the triangles' corners in the order of the mesh's file;
            rows sum to 1.
    """

    triangles: np.ndarray
    weights: np.ndarray

    def points(self, vertices: np.ndarray, triangles: np.ndarray) -> np.ndarray:
        """The landmarks of meshes.

        Args:
            vertices: `(..., V, 3)`, or offsets of a linear model: the map is linear.
            triangles: `(T, 3)` int, 0-based, in the order of the mesh's file.

        Returns:
            `(..., 51, 3)` in the unit of the vertices.

        Raises:
            InputError: The mesh has fewer triangles than the landmarks lie on.
        """
        if self.triangles.max() >= len(triangles):
            raise InputError(
                f"triangles must be those of FLAME, at least {self.triangles.max() + 1}. "
                f"Received {len(triangles)}."
            )
        corners = vertices[..., triangles[self.triangles], :]
        return np.einsum("lc,...lcd->...ld", self.weights, corners)


@np.errstate(over="ignore", invalid="ignore")  # what is too large is refused in the end
def load_flame(path: str | Path) -> MorphableModel:
    """Reads FLAME as a linear model.

    Its 51 landmarks, which are points within triangles, are appended as vertices of no triangle.
    The expressions are the 100 of FLAME, then `jaw_x` (positive opens), `jaw_y` and `jaw_z`: one
    unit of them moves each vertex along its tangent as the mean face's jaw turns by 0.1 rad. True
    vertices go in an arc and are missed by half the angle times their way: 5 % at 0.1 rad, 10 % at
    0.2 rad, which is 2 mm for one 100 mm from the joint.

    Args:
        path: `generic_model.pkl`, `flame2023.pkl`, or an npz with the same arrays (a dense
            `J_regressor`). `flame_static_embedding.pkl` must lie near, see `find_embedding`.

    Returns:
        The model in millimetres; landmarks `"ibug51"`.

    Raises:
        InputError: A file is missing, damaged, of another content, or its sizes disagree.
    """
    file = Path(path)
    arrays, embedding_file = read_flame(file), find_embedding(file)
    embedding = load_embedding(embedding_file)

    def with_landmarks(vertices: np.ndarray) -> np.ndarray:
        points = embedding.points(vertices, arrays["f"])
        return np.concatenate([vertices, points.astype(vertices.dtype)], axis=-2)

    try:
        mean = with_landmarks(arrays["v_template"] * _MM)
    except InputError as error:
        raise InputError(f"{file}: {error} (of {embedding_file})") from None
    basis, jaw = with_landmarks(_basis(arrays["shapedirs"])), with_landmarks(_jaw(arrays))
    numbered = (f"expression_{k + 1:03}" for k in range(N_EXPRESSION))
    return model_of(
        file,
        name="flame",
        mean=mean,
        identity_basis_times_sd=basis[:N_IDENTITY],
        triangles=arrays["f"],
        landmarks={"ibug51": np.arange(len(arrays["v_template"]), len(mean))},
        expression_basis=np.concatenate([basis[N_IDENTITY:], jaw]),
        expression_names=(*numbered, "jaw_x", "jaw_y", "jaw_z"),
        sha256=sha256_of([file, embedding_file]),
    )


@np.errstate(over="ignore", invalid="ignore")  # what is too large is refused in the end
def read_flame(path: str | Path) -> dict[str, np.ndarray]:
    """Reads the arrays of FLAME's file, in metres, by their present names.

    Returns:
        `v_template` `(V, 3)`, the mean face at rest; `f` `(T, 3)`, triangles in the order and
        winding of the file; `shapedirs` `(V, 3, 400)`, offsets at one s.d. of identity and then
        expression; `posedirs` `(V, 3, 36)`, offsets for the entries of each joint's rotation matrix
        less the identity, row by row, but for the root; `J_regressor` `(5, V)`, joints of a face at
        rest; `weights` `(V, 5)`, how far each vertex follows each joint; `kintree_table` `(2, 5)`,
        each joint's parent (-1 for the root) and number: root, neck, jaw, eyes.

    Raises:
        InputError: As for `load_flame`.
    """
    file = Path(path)
    arrays = read_npz(file) if zipfile.is_zipfile(file) else load_plain_pickle(file)
    arrays = arrays if isinstance(arrays, dict) else {}
    renamed = {new: arrays[old] for old, new in _OLDER_KEYS.items() if old in arrays}
    with naming(file):
        return _checked(renamed | arrays)


def _checked(arrays: dict) -> dict[str, np.ndarray]:
    sizes: dict[str, int] = {}
    for key, shape in _SHAPES.items():
        array = arrays.get(key)
        if not (isinstance(array, np.ndarray) or issparse(array)) or 0 in array.shape:
            array = np.empty(0, object)
        for size, n in zip(shape, array.shape, strict=False):
            if isinstance(size, str):
                sizes.setdefault(size, n)
        wanted = tuple(sizes.get(size, size) for size in shape)
        if array.shape != wanted or array.dtype.kind not in "fiu":
            raise InputError(
                f"must be FLAME, whose {key} are numbers {wanted}. "
                f"Received {array.dtype} {array.shape}{'' if key in arrays else ', no such key'}."
            )
        array = array.toarray() if issparse(array) else array
        if not np.isfinite(array).all():
            raise InputError(f"{key} must be finite. Received NaN or infinity.")
        arrays[key] = array.astype(float) if key in _FLOATS else array
    weights, extent = arrays["weights"], np.ptp(arrays["v_template"], axis=0).max()
    if (weights < -1e-6).any() or (np.abs(weights.sum(axis=1) - 1) > 1e-3).any():
        raise InputError("weights must not be negative, and sum to 1 for each vertex.")
    if not 0.05 < extent < 5:
        raise InputError(f"v_template must be a head in metres. Received one of {extent:g}.")
    parents, joints = arrays["kintree_table"].astype(np.int64)
    is_tree = parents[0] in _NO_PARENT and all(0 <= p < j for j, p in enumerate(parents) if j)
    if not is_tree or joints.tolist() != [*range(N_JOINTS)]:
        raise InputError(
            f"kintree_table must give each joint's parent, an earlier joint ({_NO_PARENT[1]} for "
            f"the root), and its number. Received {arrays['kintree_table'].tolist()}."
        )
    check_triangles(arrays["f"], sizes["V"])
    tree = np.array([[-1, *parents[1:]], joints])
    return {key: arrays[key] for key in _SHAPES} | {
        "f": arrays["f"].astype(int),
        "kintree_table": tree,
    }


def _basis(directions: np.ndarray) -> np.ndarray:
    """`(V, 3, K)` metres to `(K, V, 3)` float32 millimetres."""
    return np.ascontiguousarray(np.moveaxis(directions * _MM, -1, 0), dtype=np.float32)


def skin(arrays: dict[str, np.ndarray], pose: np.ndarray) -> np.ndarray:
    """The mean face in any pose, in FLAME's order of evaluation.

    Offsets for the pose (but not the root's) are added to the template. Then each joint turns what
    follows it (linear blend skinning).

    Args:
        arrays: As from `read_flame`.
        pose: `(n, 5, 3)` radians, axis times angle, of each joint relative to its parent.

    Returns:
        `(n, V, 3)` millimetres.
    """
    template, parents = arrays["v_template"] * _MM, arrays["kintree_table"][0]
    joints = arrays["J_regressor"] @ template
    local = Rotation.from_rotvec(pose.reshape(-1, 3)).as_matrix().reshape(*pose.shape, 3)
    features = (local[:, 1:] - np.eye(3)).reshape(len(pose), -1)
    posed = template + np.tensordot(features, _basis(arrays["posedirs"]), axes=1)
    turns, places = local.copy(), np.tile(joints, (len(pose), 1, 1))
    for joint, parent in enumerate(parents[1:], start=1):
        turns[:, joint] = turns[:, parent] @ local[:, joint]
        bone = joints[joint] - joints[parent]
        places[:, joint] = places[:, parent] + turns[:, parent] @ bone
    shifts = places - (turns @ joints[..., None])[..., 0]
    blended = np.einsum("vj,njde->nvde", arrays["weights"], turns)
    return (blended @ posed[..., None])[..., 0] + arrays["weights"] @ shifts


def _jaw(arrays: dict[str, np.ndarray]) -> np.ndarray:
    """`(3, V, 3)` float32, the tangents of turning the mean face's jaw about x, y and z."""
    pose = np.zeros((2, 3, N_JOINTS, 3))
    pose[0, :, JAW] = JAW_STEP * np.eye(3)
    pose[1] = -pose[0]
    faces = skin(arrays, pose.reshape(6, -1, 3))
    return ((faces[:3] - faces[3:]) / 2).astype(np.float32)


def find_embedding(path: str | Path) -> Path:
    """The landmarks' file: itself, within a folder, next to a file, or up to two folders above.

    Raises:
        InputError: There is none.
    """
    path = Path(path).absolute()
    if path.is_file() and path.name in EMBEDDINGS:
        return path
    folders = (path, *path.parents[:2]) if path.is_dir() else path.parents[:3]
    for folder in folders:
        for name in EMBEDDINGS:
            for inner in _FOLDERS:
                if (folder / inner / name).is_file():
                    return folder / inner / name
    raise InputError(
        f"{path}: must have near it {EMBEDDINGS[0]}, FLAME's landmarks, from {_EMBEDDINGS_FROM}. "
        "Received none."
    )


def load_embedding(path: str | Path) -> LandmarkEmbedding:
    """Reads the file of `find_embedding`, or the last 51 landmarks of that of all 68.

    Raises:
        InputError: The file is missing, damaged or of another content.
    """
    file = find_embedding(path)
    arrays = load_plain_pickle(file)
    try:
        triangles, weights = (np.asarray(arrays[k]) for k in ("lmk_face_idx", "lmk_b_coords"))
        is_known = len(triangles) in (N_LANDMARKS, 68) and triangles.dtype.kind in "iu"
        is_known &= triangles.ndim == 1 and triangles.min() >= 0
        # The official file has weights of -1e-13.
        is_known &= weights.shape == (len(triangles), 3) and weights.min() >= -1e-6
        is_known &= np.allclose(weights.sum(axis=1), 1, rtol=0, atol=1e-6)
    except (TypeError, KeyError, ValueError):
        is_known = False
    if not is_known:
        raise InputError(
            f"{file}: lmk_face_idx must be {N_LANDMARKS} or 68 triangle numbers, and lmk_b_coords "
            "3 weights for each, not negative and 1 in sum. Received others."
        )
    triangles, weights = triangles[-N_LANDMARKS:], weights[-N_LANDMARKS:]
    return LandmarkEmbedding(triangles.astype(int), weights.astype(float))
