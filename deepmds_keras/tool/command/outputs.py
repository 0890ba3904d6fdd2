"""Writes 3D faces as tables, JSON, NumPy archives, wireframes and meshes, with unit and axes."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from types import ModuleType
from typing import BinaryIO

import numpy as np

from deepmds_keras import __version__
from deepmds_keras.errors import needs
from deepmds_keras.files import atomic_write
from deepmds_keras.landmarks import load_scheme
from deepmds_keras.tool.predict.faces import Face
from deepmds_keras.tool.predict.mesh import fit_surfaces, surface_triangles

AXES = {
    "shape": "+x to the subject's left, +y up, +z out of the face; seen from the front. Of another "
    "object those of the training",
    "landmarks": "x to the right, y down; pixels of the photo or of the frame, or the unit of the "
    "landmarks given",
    "std": "standard deviations of the errors of x, y, z, in the same unit",
    "image_xyz": "x to the right, y down, z towards the viewer, all in pixels of the photo, or the "
    "unit of the landmarks given; z is 0 at the middle of the face",
    "residual": "distance of each landmark from where the shape has it in the image",
    "pose": "yaw > 0 turns the face to the subject's own left, pitch > 0 up, roll > 0 leans its "
    "top to the subject's own right; degrees, applied in this order. (x, -y) of the landmarks is "
    "about scale * p / (1 - perspective * p_z) + translation, where p is rotation @ shape, without "
    "the third coordinate. residual: how far it is off (root mean square), in larger sides of the "
    "landmarks' box",
}
TIME = (
    "of the frames of a video, from 0; time: seconds since the first; track: one number for each "
    "face, the same from frame to frame. Where no face is found, there is no row"
)
SCALE = {
    "mm": "millimetres, set by a distance that was given: one view does not show the true size",
    "normalised": "no unit of length: one view does not show the true size; by the shipped "
    "weights the largest extent of a face is about 1",
}
_COLUMNS = "number,name,x,y,z,std_x,std_y,std_z,image_x,image_y,image_z,residual"
# Lines of the comments above a table.
_DESCRIBED = {
    "std": "std_x, std_y, std_z",
    "image_xyz": "image_x, image_y, image_z",
    "residual": "residual",
}
_DIGITS = 7  # significant digits
_MESH = "mesh: head of the open head model (CC0) through the landmarks; far from them it is a guess"


def output_files(
    folder: Path, name: str, faces: Sequence[Face], formats: Iterable[str]
) -> dict[Path, Sequence[Face]]:
    """Files of the faces of one source, each with the faces in it.

    `csv`, `json` and `npz` hold all faces in one file, `NAME.csv`, with gaps as NaN or null; in the
    other formats every face has its own file, under the face's name. All faces are in one scheme
    and unit. The files follow the order of the formats, some of `FORMATS` and `MESH_FORMATS`.
    """
    one_each = {face.name: [face] for face in faces if not face.is_gap}
    return {
        folder / f"{stem}.{kind}": held
        for kind in formats
        for stem, held in ({name: faces} if kind in _TABLES else one_each).items()
    }


def write_output(path: Path, faces: Sequence[Face], model: Mapping) -> None:
    """Write a file of `output_files`, whole or not at all; its suffix is the format.

    `model` is what `describe_model` says of it. The folder is created if needed.

    Raises:
        InputError, OSError: As for `atomic_write`.
    """
    kinds = FORMATS | MESH_FORMATS
    kind = next(kind for kind in reversed(kinds) if path.name.endswith(f".{kind}"))
    with atomic_write(path) as file:
        kinds[kind](file, faces, model)


def csv_text(faces: Sequence[Face], model: Mapping) -> Iterator[str]:
    """One landmark per row, with its number in the scheme and its position in the image."""
    scheme = load_scheme(faces[0].scheme)
    number = f"%.{_DIGITS}g"
    # What the model does not estimate stays empty.
    std = [number if faces[0].std is not None else ""] * 3
    cells = ",".join([*[number] * 3, *std, *[number] * 4])
    names = map(_csv_cell, scheme.names)
    rows = [f"{n},{name},{cells}\n" for n, name in zip(scheme.numbers, names, strict=True)]
    yield from (f"# {line}\n" for line in _description(faces, model))
    yield from (f"# {columns}: {AXES[key]}\n" for key, columns in _DESCRIBED.items())
    if faces[0].frame_ref is not None:
        yield f"# frame: {TIME}\n"
    yield ",".join(["face", *_frame(faces[0]), _COLUMNS]) + "\n"
    for face in faces:
        # Quoted, so that no character of a file name is taken for part of the table.
        name = '"' + face.name.replace("%", "%%").replace('"', '""') + '",'
        name += "".join(f"{value}," for value in _frame(face).values())
        estimated = () if face.std is None else (face.std,)
        numbers = np.hstack([face.xyz, *estimated, face.landmarks_3d, face.residuals[:, None]])
        yield "".join(name + row for row in rows) % tuple(numbers.ravel().tolist())


def _csv_cell(text: str) -> str:
    """A text as a cell, quoted if it has to be, in a format of `%`."""
    quoted = '"' + text.replace('"', '""') + '"'
    return (quoted if {*text} & {*',"\r\n#'} else text).replace("%", "%%")


def json_text(faces: Sequence[Face], model: Mapping) -> Iterator[str]:
    """Everything known about the faces, one face per line."""
    scheme = load_scheme(faces[0].scheme)
    described = _common(faces, model) | {"landmark_numbers": scheme.numbers}
    described["landmark_names"] = scheme.names
    yield "{\n"
    yield from (f" {json.dumps(key)}: {json.dumps(value)},\n" for key, value in described.items())
    yield ' "faces": ['
    for i, face in enumerate(faces):
        pose = face.pose.as_dict()
        record = {
            "name": face.name,
            "source": str(face.source),
            "photo": None if face.photo is None else str(face.photo),
            **_frame(face),
            "notes": face.notes,
            "pose": None if face.is_gap else {k: _rounded(v) for k, v in pose.items()},
            "landmarks": _rounded(face.landmarks),
            "image_xyz": _rounded(face.landmarks_3d),
            "shape": _rounded(face.xyz),
            "std": None if face.std is None else _rounded(face.std),
            "residual": _rounded(face.residuals),
        }
        yield ",\n  " if i else "\n  "
        yield json.dumps(record, allow_nan=False)
    yield "\n ]\n}\n"


def write_npz(file: BinaryIO, faces: Sequence[Face], model: Mapping) -> None:
    """Float32 arrays over all faces for `numpy.load`, for sources of thousands of faces.

    `shape`, `image_xyz` and, if the model estimates it, `std` `(n, L, 3)`, `landmarks` `(n, L, 2)`,
    `residual` `(n, L)`, `face` `(n,)` names; for the pose `yaw`, `pitch`, `roll`, `scale`,
    `pose_residual`, `perspective` `(n,)`, `rotation` `(n, 3, 3)` and `translation` `(n, 2)`; for
    videos `frame`, `time` and `track` `(n,)`; `landmark_numbers` and `landmark_names` `(L,)`;
    `description`, the rest as JSON.
    """
    scheme = load_scheme(faces[0].scheme)

    def over_faces(values: Iterable) -> np.ndarray:
        return np.array([*values], np.float32)

    columns = {"shape": "xyz", "landmarks": "landmarks", "image_xyz": "landmarks_3d"}
    measured = {
        key: over_faces(getattr(face, field) for face in faces)
        for key, field in (columns | {"residual": "residuals", "std": "std"}).items()
        if getattr(faces[0], field) is not None
    }
    poses = [face.pose.as_dict() for face in faces]
    for key in poses[0]:
        name = f"pose_{key}" if key in measured else key
        measured[name] = over_faces(pose[key] for pose in poses)
    save: Callable[..., None] = np.savez  # compressing measurements takes long and gains little
    save(
        file,
        face=np.array([face.name for face in faces]),
        **{key: np.array([_frame(face)[key] for face in faces]) for key in _frame(faces[0])},
        **measured,
        landmark_numbers=np.array(scheme.numbers),
        landmark_names=np.array(scheme.names),
        description=np.array(json.dumps(_common(faces, model))),
    )


def ply_text(faces: Sequence[Face], model: Mapping, *, mesh: bool = False) -> Iterator[str]:
    """One face: its landmarks as vertices, or the triangles of the head."""
    vertices, comments = _vertices(faces, model, mesh)
    cells = surface_triangles() if mesh else np.empty((0, 3), int)
    triangles = [f"element face {len(cells)}", "property list uchar int vertex_indices"]
    header = [
        "ply",
        "format ascii 1.0",
        *(f"comment {line}" for line in comments),
        f"element vertex {len(vertices)}",
        *(f"property float {axis}" for axis in "xyz"),
        *(triangles if mesh else ()),
        "end_header\n",
    ]
    text = "\n".join(header) + _rows("%.7g %.7g %.7g", vertices)
    text += _rows("3 %d %d %d", cells)
    yield text.encode("ascii", "replace").decode()  # some readers accept ASCII only


def obj_text(faces: Sequence[Face], model: Mapping, *, mesh: bool = False) -> Iterator[str]:
    """One face: vertices, and the lines of its scheme, or triangles of the head."""
    vertices, comments = _vertices(faces, model, mesh)
    text = "".join(f"# {line}\n" for line in comments) + _rows("v %.7g %.7g %.7g", vertices)
    if mesh:
        text += _rows("f %d %d %d", surface_triangles() + 1)
        yield text.encode("ascii", "replace").decode()
        return
    lines = load_scheme(faces[0].scheme).polylines
    yield text + "".join(f"l {' '.join(str(i + 1) for i in line)}\n" for line in lines)


def write_glb(file: BinaryIO, faces: Sequence[Face], model: Mapping) -> None:
    """One face: the head as binary glTF 2.0, whose axes are ours, and its unit the metre.

    A head of no known size keeps its numbers.
    """
    trimesh = import_trimesh()
    vertices, comments = _vertices(faces, model, True)
    metres = vertices / 1000 if faces[0].unit == "mm" else vertices
    head = trimesh.Trimesh(metres, surface_triangles(), process=False)
    scene = trimesh.Scene(head, metadata={"description": comments})
    file.write(scene.export(file_type="glb", include_normals=True))


def import_trimesh() -> ModuleType:
    """trimesh, imported only when a GLB is written.

    Raises:
        MissingPackageError: It is not installed.
    """
    with needs("trimesh, which writes GLB,", "mesh"):
        import trimesh
    return trimesh


def common(scheme: str, unit: str, detector: Mapping | None, model: Mapping) -> dict:
    """What the JSON of faces says of all of them."""
    return {
        "generator": f"deepmds-keras {__version__}",
        "model": model,
        "detector": detector,
        "scheme": scheme,
        "unit": unit,
        "scale": SCALE[unit],
        "axes": AXES,
    }


def description(known: Mapping) -> list[str]:
    """`common` as lines; names are quoted as in JSON, so that they cannot begin another line."""
    scheme, model, detector = load_scheme(known["scheme"]), known["model"], known["detector"]
    terms = [f"licence of the weights: {model['licence']}"] if "licence" in model else []
    if detector is not None:
        terms.append(f"landmarks found by {detector['name']}, licence: {detector['licence']}")
    return [
        f"3D landmarks by {known['generator']}, model {json.dumps(model['name'])}",
        f"scheme: {scheme.name}, numbers {scheme.numbers[0]} to {scheme.numbers[-1]} in this "
        "order; right and left are the subject's",
        f"unit of x, y, z: {known['unit']} ({known['scale']})",
        *terms,
        f"axes: {AXES['shape']}",
    ]


def _common(faces: Sequence[Face], model: Mapping) -> dict:
    face = faces[0]
    frame = {} if face.frame_ref is None else {"frame": TIME}
    return common(face.scheme, face.unit, face.detector, model) | frame


def _description(faces: Sequence[Face], model: Mapping) -> list[str]:
    notes = (f"note on {json.dumps(face.name)}: {note}" for face in faces for note in face.notes)
    return [*description(_common(faces, model)), *notes]


def _frame(face: Face) -> dict[str, float]:
    """Additional columns for a face of a video."""
    if face.frame_ref is None:
        return {}
    columns = vars(face.frame_ref)
    return columns | {"time": round(columns["time"], 6)}


def _vertices(faces: Sequence[Face], model: Mapping, mesh: bool) -> tuple[np.ndarray, list[str]]:
    """Landmarks, or the head through them in their frame and unit, with describing lines."""
    face, described = faces[0], _description(faces, model)
    if not mesh:
        return face.xyz, described
    return fit_surfaces(face.xyz[None], face.scheme)[0], [_MESH, *described]


def _rows(row: str, numbers: np.ndarray) -> str:
    return (f"{row}\n" * len(numbers)) % tuple(numbers.ravel().tolist())


def _rounded(values) -> list | float | None:
    """Values rounded to the decimals that give the largest one its significant digits."""
    if np.isnan(values).all():
        return None
    largest = max(np.nanmax(np.abs(values)), 1e-9)
    return or_null(np.round(values, _DIGITS - 1 - int(np.floor(np.log10(largest)))))


def or_null(values: np.ndarray) -> list | float | None:
    """Numbers for JSON, which has no NaN."""
    return np.where(np.isnan(values), np.array(None), values).tolist()


def _as_text(parts: Callable[[Sequence[Face], Mapping], Iterator[str]]) -> Callable:
    """The writer of a text format, with one face in memory at a time."""

    def write(file: BinaryIO, faces: Sequence[Face], model: Mapping) -> None:
        for part in parts(faces, model):
            file.write(part.encode("utf-8", "backslashreplace"))  # of a file name that is no text

    return write


_TABLES = ("csv", "json", "npz")
FORMATS = {
    "csv": _as_text(csv_text),
    "json": _as_text(json_text),
    "npz": write_npz,
    "ply": _as_text(ply_text),
    "obj": _as_text(obj_text),
    "glb": write_glb,
}
MESH_FORMATS = {
    "mesh.ply": _as_text(partial(ply_text, mesh=True)),
    "mesh.obj": _as_text(partial(obj_text, mesh=True)),
}
