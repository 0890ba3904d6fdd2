"""ICT-FaceKit Light: the official folder of OBJ files, or the same compiled to one npz file.

Li et al. 2020, "Learning formation of physically-based face attributes" (CVPR); MIT licence,
github.com/ICT-VGL/ICT-FaceKit.
"""

from pathlib import Path

import numpy as np

from data_gen.landmarks import known_landmarks
from data_gen.models.mesh import check_triangles
from data_gen.models.morphable_model import BLENDSHAPE_SD, MorphableModel, model_of
from deepmds_keras.errors import InputError, brief
from deepmds_keras.files import read_npz, sha256_of

NEUTRAL = "generic_neutral_mesh.obj"
N_IDENTITY = 100
N_VERTICES = 26_719  # of the official meshes
# Face, head, neck, mouth and eye sockets; teeth and eyeballs. Left out are the gums and the tongue
# between them, and the tear film, the shells around the eyes and the lashes after them, which
# would be painted as teeth and as the white of the eyes.
KEPT = np.r_[0:14_062, 17_039:24_591]
_MM = 10.0  # the files are in centimetres


@np.errstate(over="ignore", invalid="ignore")  # what is too large is refused in the end
def load_ict(path: str | Path) -> MorphableModel:
    """Reads ICT-FaceKit Light's vertices `KEPT`; the origin stays where the files have it.

    Args:
        path: `FaceXModel` (`generic_neutral_mesh.obj`, `identityNNN.obj`, one OBJ an expression),
            or the compiled npz. That has `mean` (V, 3), `identity` (K, V, 3), `expression`
            (E, V, 3), `expression_names`, `triangles` and `vertex_index` (V,), the vertices'
            numbers in the OBJ files; centimetres.

    Returns:
        The model; landmarks `"bfm72"` and `"ibug68"` where the mesh has all their vertices.

    Raises:
        InputError: A file is missing, malformed or of another mesh.
    """
    path = Path(path)
    files = _files(path) if path.is_dir() else [path]
    arrays = _read_folder(files) if path.is_dir() else read_npz(path)
    try:
        numbers = arrays["vertex_index"].astype(int)
        fields = {
            "mean": arrays["mean"].astype(float) * _MM,
            "identity_basis_times_sd": arrays["identity"].astype(np.float32) * np.float32(_MM),
            "triangles": arrays["triangles"].astype(int),
            "expression_basis": arrays["expression"].astype(np.float32) * np.float32(_MM),
            "expression_names": tuple(map(str, arrays["expression_names"].ravel())),
        }
    except (KeyError, ValueError) as error:
        raise InputError(
            f"{path}: must be ICT-FaceKit Light. Received one without {brief(error)}."
        ) from None
    if numbers.shape != fields["mean"].shape[:1] or (np.diff(numbers) <= 0).any():
        raise InputError(
            f"{path}: vertex_index must be {fields['mean'].shape[:1]} ascending numbers. "
            f"Received {numbers.shape}."
        )
    return model_of(
        path,
        name="ict",
        landmarks=known_landmarks("ict", numbers),
        expression_sd=BLENDSHAPE_SD,
        sha256=sha256_of(files),
        **fields,
    )


def _files(folder: Path) -> list[Path]:
    """The neutral mesh, the identities, and the expressions by name."""
    files = [folder / NEUTRAL, *(folder / f"identity{k:03}.obj" for k in range(N_IDENTITY))]
    for file in files:
        if not file.is_file():
            raise InputError(
                f"{folder}: must hold {NEUTRAL} and identity000.obj to {files[-1].name}. "
                f"Received none of the name {file.name}."
            )
    others = {files[0], *folder.glob("identity[0-9]*.obj")}
    return [*files, *sorted({*folder.glob("*.obj")} - others)]


def _read_folder(files: list[Path]) -> dict[str, np.ndarray]:
    """What the npz holds."""
    mean, faces = _read_obj(files[0], with_faces=True)
    # Bit for bit as in the npz: single precision, before the mean is subtracted.
    offsets = np.stack([_read_obj(file)[0] - mean for file in files[1:]])
    try:
        fans = [(f[0], f[k], f[k + 1]) for f in faces for k in range(1, len(f) - 1)]
        triangles = np.array(fans, int).reshape(-1, 3)
        check_triangles(triangles, N_VERTICES)
    except (ValueError, OverflowError) as error:
        raise InputError(f"{files[0]}: faces must be vertex numbers. {brief(error)}") from None
    number = np.full(N_VERTICES, -1)
    number[KEPT] = np.arange(len(KEPT))
    triangles = number[triangles]
    return {
        "mean": mean,
        "identity": offsets[:N_IDENTITY],
        "expression": offsets[N_IDENTITY:],
        "expression_names": np.array([file.stem for file in files[1 + N_IDENTITY :]]),
        "triangles": triangles[(triangles >= 0).all(axis=1)],
        "vertex_index": KEPT,
    }


def _read_obj(file: Path, *, with_faces: bool = False) -> tuple[np.ndarray, list[list[int]]]:
    """Vertices `(len(KEPT), 3)` float32, as written, and the corners of each polygon, 0-based."""
    try:
        lines = file.read_bytes().splitlines()
        # Not via an array of the words: a long one would make all of them as long.
        words = b" ".join(line[2:] for line in lines if line.startswith(b"v ")).split()
        vertices = np.fromiter(map(float, words), float).reshape(N_VERTICES, 3)
        faces = [line.split()[1:] for line in lines if with_faces and line.startswith(b"f ")]
        faces = [[int(corner.partition(b"/")[0]) - 1 for corner in face] for face in faces]
    except (OSError, ValueError) as error:
        raise InputError(
            f"{file}: must be an OBJ file of the {N_VERTICES} vertices of ICT-FaceKit Light. "
            f"Received {brief(error)}."
        ) from None
    return np.float32(vertices[KEPT]), faces
