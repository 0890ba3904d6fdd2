"""CoMA: registered meshes of twelve subjects who perform twelve extreme expressions.

Ranjan et al. 2018, "Generating 3D faces using convolutional mesh autoencoders",
doi:10.1007/978-3-030-01219-9_43; for research, by registration, coma.is.tue.mpg.de. The meshes have
FLAME's topology and are in metres.
"""

from __future__ import annotations

import hashlib
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
from joblib import Parallel, delayed

from data_gen.formats.ply import read_ply
from data_gen.models.flame_embedding import LandmarkEmbedding
from deepmds_keras.errors import InputError

_MM = 1e3  # the files are in metres
_LARGEST_HEAD = 5.0  # metres; larger numbers are another unit
_MESHES_PER_CHUNK = 128


class CoMAMesh(NamedTuple):
    """One frame: `ROOT/subject/sequence/NAME.ply`."""

    subject: str
    sequence: str
    path: Path


@dataclass(frozen=True, eq=False)
class Coma:
    """The landmarks of all frames that could be read, in order of subject, sequence and frame.

    Attributes:
        landmarks: `(n, 51, 3)` float32, millimetres.
        subjects: `(n,)` str, such as `FaceTalk_170725_00137_TA`.
        sequences: `(n,)` str, such as `bareteeth`.
        names: `(n,)` str, file names without `.ply`, such as `bareteeth.000001`.
        skipped: Path and reason of each mesh that was left out.
    """

    landmarks: np.ndarray
    subjects: np.ndarray
    sequences: np.ndarray
    names: np.ndarray
    skipped: list[tuple[Path, str]]

    def __len__(self) -> int:
        return len(self.landmarks)


def find_meshes(root: str | Path) -> list[CoMAMesh]:
    """All meshes of the data set, sorted.

    Args:
        root: The folder of the subjects, or one that holds that folder, such as `COMA_data/`.

    Raises:
        InputError: No mesh where one is expected, or several data sets.
    """
    root = Path(root)
    meshes = _meshes_in(root)
    if not meshes:
        inner = [found for folder in sorted(root.glob("*")) if (found := _meshes_in(folder))]
        if len(inner) > 1:
            raise InputError(
                f"{root}: must hold one data set CoMA. Received {len(inner)} folders of meshes."
            )
        meshes = inner[0] if inner else []
    if not meshes:
        raise InputError(
            f"{root}: must hold the data set CoMA, SUBJECT/SEQUENCE/*.ply, such as "
            "FaceTalk_170725_00137_TA/bareteeth/bareteeth.000001.ply. Received no such file."
        )
    return meshes


def load_coma(
    root: str | Path,
    embedding: LandmarkEmbedding,
    triangles: np.ndarray | None = None,
    *,
    jobs: int = 1,
    progress: Callable[[int], object] | None = None,
) -> Coma:
    """Landmarks of every mesh; those that are damaged or not of FLAME are left out, and listed.

    Args:
        root: As for `find_meshes`.
        embedding: Where FLAME's landmarks lie.
        triangles: `(T, 3)` int, those that each mesh must have, in this order; by default those
            that the most of them have.
        jobs: Processes.
        progress: Called with the number of meshes just read.

    Raises:
        InputError: As for `find_meshes`, or no mesh can be used.
    """
    meshes = find_meshes(root)
    landmarks = np.empty((len(meshes), len(embedding.triangles), 3), np.float32)
    topologies: list[_Topology | str] = []
    starts = range(0, len(meshes), _MESHES_PER_CHUNK)
    chunks = ([mesh.path for mesh in meshes[start:][:_MESHES_PER_CHUNK]] for start in starts)
    tasks = (delayed(_read_chunk)(chunk, embedding) for chunk in chunks)
    for start, (points, found) in zip(
        starts, Parallel(jobs, return_as="generator")(tasks), strict=True
    ):
        landmarks[start : start + len(found)] = points
        topologies += found
        if progress is not None:
            progress(len(found))
    wanted = _wanted_topology(topologies, triangles)
    reasons = [_reason(topology, wanted) for topology in topologies]
    skipped = [(mesh.path, why) for mesh, why in zip(meshes, reasons, strict=True) if why]
    if len(skipped) == len(meshes):
        raise InputError(
            f"{root}: must hold meshes of FLAME. None of {len(meshes)} is; the first, "
            f"{skipped[0][0]}: {skipped[0][1]}"
        )
    kept = [mesh for mesh, why in zip(meshes, reasons, strict=True) if not why]
    return Coma(
        landmarks=landmarks[[not why for why in reasons]],
        subjects=np.array([mesh.subject for mesh in kept]),
        sequences=np.array([mesh.sequence for mesh in kept]),
        names=np.array([mesh.path.stem for mesh in kept]),
        skipped=skipped,
    )


class _Topology(NamedTuple):
    n_vertices: int
    n_triangles: int
    digest: bytes


def _meshes_in(root: Path) -> list[CoMAMesh]:
    meshes = (
        CoMAMesh(path.parent.parent.name, path.parent.name, path) for path in root.glob("*/*/*.ply")
    )
    # macOS leaves ._NAME.ply beside NAME.ply on foreign disks.
    return sorted(mesh for mesh in meshes if not mesh.path.name.startswith("."))


def _read_chunk(
    paths: list[Path], embedding: LandmarkEmbedding
) -> tuple[np.ndarray, list[_Topology | str]]:
    """Landmarks `(n, 51, 3)` in millimetres, and of each mesh the topology or what is wrong."""
    landmarks = np.zeros((len(paths), len(embedding.triangles), 3), np.float32)
    topologies: list[_Topology | str] = []
    for points, path in zip(landmarks, paths, strict=True):
        try:
            vertices, triangles = read_ply(path)
            if np.ptp(vertices, axis=0).max() > _LARGEST_HEAD:
                raise InputError(
                    f"must be a head in metres. Received one of {np.ptp(vertices, axis=0)}."
                )
            points[:] = embedding.points(vertices, triangles) * _MM
            topologies.append(_Topology(len(vertices), len(triangles), _digest(triangles)))
        except InputError as error:
            topologies.append(str(error).removeprefix(f"{path}: "))
    return landmarks, topologies


def _digest(triangles: np.ndarray) -> bytes:
    return hashlib.blake2b(np.ascontiguousarray(triangles, np.int64).tobytes()).digest()


def _wanted_topology(
    topologies: list[_Topology | str], triangles: np.ndarray | None
) -> _Topology | None:
    """The most common, of those with the triangles if given; None if there is none."""
    digest = None if triangles is None else _digest(triangles)
    counts = Counter(
        topology
        for topology in topologies
        if isinstance(topology, _Topology) and digest in (None, topology.digest)
    )
    return counts.most_common(1)[0][0] if counts else None


def _reason(topology: _Topology | str, wanted: _Topology | None) -> str:
    """Why a mesh is left out; empty for one that is not."""
    if topology == wanted:
        return ""
    if isinstance(topology, str):
        return topology
    return (
        "must have the same vertices and triangles as the other meshes, FLAME's. Received "
        f"{topology.n_vertices} vertices and {topology.n_triangles} triangles"
        f"{', numbered otherwise' if wanted and topology[:2] == wanted[:2] else ''}."
    )
