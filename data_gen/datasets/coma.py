"""CoMA: registered meshes of twelve subjects who perform twelve extreme expressions.

Ranjan et al. 2018, "Generating 3D faces using convolutional mesh autoencoders",
doi:10.1007/978-3-030-01219-9_43; for research, by registration, coma.is.tue.mpg.de. The meshes have
FLAME's topology and are in metres.
"""

from collections.abc import Callable
from pathlib import Path

import numpy as np
from joblib import Parallel, delayed

from data_gen.mesh_files import read_ply
from data_gen.models.flame import LandmarkEmbedding
from data_gen.models.openhead import load_openhead
from deepmds_keras.errors import InputError
from deepmds_keras.geometry.alignment import procrustes

_MM = 1e3  # the files are in metres
_MESHES_PER_CHUNK = 128
# Root mean square distance in mm from the landmarks of an aligned mean face: up to 20 in extreme
# expressions, 50 to 90 if the triangles are in another order.
_MAX_DISTANCE = 35.0


def find_meshes(root: str | Path) -> list[Path]:
    """All meshes in the folder of the subjects, sorted by subject, sequence and frame.

    Raises:
        InputError: No mesh where one is expected.
    """
    # macOS leaves ._NAME.ply next to NAME.ply.
    meshes = sorted(p for p in Path(root).glob("*/*/*.ply") if not p.name.startswith("."))
    if not meshes:
        raise InputError(
            f"{root}: must hold the data set CoMA, SUBJECT/SEQUENCE/*.ply, such as "
            "FaceTalk_170725_00137_TA/bareteeth/bareteeth.000001.ply. Received no such file."
        )
    return meshes


def load_coma(
    root: str | Path,
    embedding: LandmarkEmbedding,
    *,
    jobs: int = 1,
    progress: Callable[[int], object] | None = None,
) -> tuple[np.ndarray, list[tuple[Path, str]]]:
    """Landmarks of every mesh; meshes that are damaged or not FLAME's are skipped and listed.

    A mesh is FLAME's if its supposed landmarks are arranged like those of a face, which fails if
    its triangles are in another order.

    Args:
        progress: Called with the number of meshes just read.

    Returns:
        `(n, 51, 3)` float32, millimetres, in the order of `find_meshes`; and path and reason of
        each skipped mesh.

    Raises:
        InputError: As for `find_meshes`, or no mesh can be used.
    """
    meshes = find_meshes(root)
    starts = range(0, len(meshes), _MESHES_PER_CHUNK)
    tasks = (delayed(_read_chunk)(meshes[k : k + _MESHES_PER_CHUNK], embedding) for k in starts)
    frames: list[np.ndarray | str] = []
    for chunk in Parallel(jobs, return_as="generator")(tasks):
        frames += chunk
        if progress is not None:
            progress(len(chunk))
    landmarks = [frame for frame in frames if not isinstance(frame, str)]
    skipped = [(p, why) for p, why in zip(meshes, frames, strict=True) if isinstance(why, str)]
    if not landmarks:
        raise InputError(
            f"{root}: must hold meshes of FLAME. None of {len(meshes)} is; the first, "
            f"{skipped[0][0]}: {skipped[0][1]}"
        )
    return np.stack(landmarks), skipped


def _read_chunk(paths: list[Path], embedding: LandmarkEmbedding) -> list[np.ndarray | str]:
    """The landmarks of each mesh, or what is wrong with it."""
    head = load_openhead()
    mean = head.mean[head.landmarks["ibug51"]]
    frames = []
    for path in paths:
        try:
            vertices, triangles = read_ply(path)
            landmarks = embedding.points(vertices, triangles) * _MM
            turn, _, shift = procrustes(mean, landmarks, scaling=False, reflection=False)
            distance = np.sqrt(((mean @ turn + shift - landmarks) ** 2).sum(1).mean())
            if distance > _MAX_DISTANCE:
                raise InputError(
                    "must be a mesh of FLAME in metres, with FLAME's triangles in FLAME's order. "
                    f"Received one with landmarks {distance:.0f} mm from those of a face."
                )
            frames.append(np.float32(landmarks))
        except InputError as error:
            frames.append(str(error).removeprefix(f"{path}: "))
    return frames
