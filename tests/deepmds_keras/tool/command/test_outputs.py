"""Results read back: the numbers, what they mean, and which points the lines join."""

import csv
import json
import struct
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from deepmds_keras import __version__
from deepmds_keras.geometry.camera import head_pose
from deepmds_keras.landmarks import load_scheme
from deepmds_keras.tool.command.outputs import FORMATS, MESH_FORMATS, output_files, write_output
from deepmds_keras.tool.predict.faces import Face
from deepmds_keras.tool.predict.landmark_files import read_landmarks
from deepmds_keras.tool.predict.mesh import fit_surfaces, surface_triangles

MODEL = {"name": "deepmds-bfm72", "trained_on": "20,000 faces of the open head"}
TEXTS = [kind for kind in FORMATS if kind != "glb"]  # and arrays: without the extra
ODD = 'ä "x",#1%s\n'


def make_face(name="a", scheme="bfm72", seed=0, unit="normalised", notes=(), std=False):
    rng = np.random.default_rng(seed)
    shape = rng.uniform(-1, 1, (len(load_scheme(scheme)), 3)) * (80 if unit == "mm" else 0.5)
    view = 300 * shape[:, :2] + [400, -300] + rng.normal(size=(len(shape), 2))
    photo = Path(f"{name}.jpg")
    pose = head_pose(view, shape)
    sd = rng.random(shape.shape) if std else None
    return Face(name, photo, photo, scheme, view * [1, -1], shape, unit, pose, notes, std=sd)


def written(folder, kinds, *faces):
    files = output_files(folder, "run", faces, kinds)
    for path, held in files.items():
        write_output(path, held, MODEL)
    return [*files]


def assert_close(actual, expected):
    """To the seven digits that are written."""
    np.testing.assert_allclose(actual, expected, atol=1e-6 * np.abs(expected).max(), rtol=0)


@pytest.mark.parametrize(("unit", "std"), [("mm", True), ("normalised", False)])
def test_the_table_gives_the_numbers_back_and_says_what_they_are(tmp_path, unit, std):
    faces = [make_face(ODD, "ibug51", 0, unit, (), std)]
    faces.append(make_face("b", "ibug51", 1, unit, ("?",), std))
    (path,) = written(tmp_path, ["csv"], *faces)
    table = pd.read_csv(path, comment="#")
    axes = [f"{what}{axis}" for what in ("", "std_", "image_") for axis in "xyz"]
    assert table.columns.tolist() == ["face", "number", "name", *axes, "residual"]
    assert table.face.unique().tolist() == [ODD, "b"]
    for face in faces:
        rows = table[table.face == face.name]
        assert tuple(rows.number) == load_scheme("ibug51").numbers
        assert tuple(rows.name) == load_scheme("ibug51").names
        assert_close(rows[["x", "y", "z"]], face.xyz)
        assert_close(rows[["image_x", "image_y", "image_z"]], face.landmarks_3d)
        assert_close(rows["residual"], face.residuals)
        known = rows[["std_x", "std_y", "std_z"]]
        assert known.isna().to_numpy().all() if face.std is None else np.allclose(known, face.std)
    comments = [line for line in path.read_text().splitlines() if line.startswith("#")]
    facts = (unit, "+x to the subject's left", "x to the right, y down", "ibug51", "deepmds-bfm72")
    for fact in (*facts, __version__, "18 to 68", "does not show the true size", '"b": ?'):
        assert any(fact in line for line in comments), fact


def test_json_and_archive_give_everything_back(tmp_path):
    faces = [make_face(ODD, notes=("yaw beyond training",)), make_face("b", seed=1)]
    (path, archive) = written(tmp_path, ["json", "npz"], *faces)
    content = json.loads(path.read_bytes())
    assert content["model"] == MODEL
    assert (content["scheme"], content["unit"]) == ("bfm72", "normalised")
    assert content["landmark_names"] == list(load_scheme("bfm72").names)
    assert content["landmark_numbers"] == list(range(1, 73))
    for record, face in zip(content["faces"], faces, strict=True):
        assert record["name"] == face.name and record["notes"] == list(face.notes)
        assert record["source"] == record["photo"] == str(face.photo)
        for key, value in {
            "shape": face.xyz,
            "landmarks": face.landmarks,
            "image_xyz": face.landmarks_3d,
            "residual": face.residuals,
        }.items():
            assert_close(record[key], value)
        assert record["std"] is None
        for key, value in face.pose.as_dict().items():
            assert_close(record["pose"][key], value)
    with np.load(archive, allow_pickle=False) as file:
        arrays = dict(file)
    assert np.array_equal(arrays["shape"], np.float32([face.xyz for face in faces]))
    assert np.array_equal(arrays["landmarks"], np.float32([face.landmarks for face in faces]))
    assert np.array_equal(arrays["residual"], np.float32([face.residuals for face in faces]))
    assert arrays["face"].tolist() == [ODD, "b"]
    for key in faces[0].pose.as_dict():
        measured = arrays["pose_residual" if key == "residual" else key]
        assert np.array_equal(measured, np.float32([face.pose.as_dict()[key] for face in faces]))
    assert json.loads(str(arrays["description"]))["model"] == MODEL


def by_hand(path):
    """Vertices, triangles if there are any, and header of a PLY file."""
    lines = path.read_text(encoding="ascii").splitlines()
    end = lines.index("end_header")
    assert lines[:2] == ["ply", "format ascii 1.0"]
    counts = [int(line.split()[-1]) for line in lines[:end] if line.startswith("element")]
    body = lines[end + 1 :]
    assert len(body) == sum(counts)
    triangles = np.array([line.split() for line in body[counts[0] :]], int)
    return np.loadtxt(body[: counts[0]]), triangles, lines[:end]


@pytest.mark.parametrize("scheme", ["bfm72", "ibug51", "ibug68"])
def test_the_lines_join_the_points_that_the_scheme_joins(tmp_path, scheme):
    face = make_face("a", scheme, notes=("20° to the left",))
    lines = load_scheme(scheme).polylines
    ply, obj = written(tmp_path, ["ply", "obj"], face)
    vertices, _, header = by_hand(ply)
    assert_close(vertices, face.xyz)
    assert any("unit of x, y, z: normalised" in line for line in header)
    rows = [line.split() for line in obj.read_text(encoding="utf-8").splitlines()]
    assert_close([[float(v) for v in row[1:]] for row in rows if row[0] == "v"], face.xyz)
    actual = [[int(i) - 1 for i in row[1:]] for row in rows if row[0] == "l"]
    assert [tuple(line) for line in actual] == list(lines)


def test_meshes_are_read_back(tmp_path):
    heads = fit_surfaces(make_face("é", "ibug51").xyz[None], "ibug51")[0]
    face = make_face("é", "ibug51", notes=("a note",))
    ply, obj = written(tmp_path, MESH_FORMATS, face)
    vertices, triangles, header = by_hand(ply)
    lines = obj.read_text(encoding="ascii").splitlines()
    for actual, corners in (
        (vertices, triangles[:, 1:]),
        (
            np.array([line.split()[1:] for line in lines if line[0] == "v"], float),
            np.array([line.split()[1:] for line in lines if line[0] == "f"], int) - 1,
        ),
    ):
        assert_close(actual, heads)
        assert np.array_equal(corners, surface_triangles())
    assert any("a note" in line for line in header)


def glb_by_hand(path):
    """JSON of a GLB, and an accessor's numbers by its index, by the specification of glTF 2.0."""
    content = path.read_bytes()
    magic, version, size, json_size, kind = struct.unpack("<4s2II4s", content[:20])
    assert (magic, version, size, kind) == (b"glTF", 2, len(content), b"JSON")
    described = json.loads(content[20 : 20 + json_size])
    binary_size, kind = struct.unpack("<I4s", content[20 + json_size : 28 + json_size])
    binary = content[28 + json_size :]
    assert kind == b"BIN\0" and binary_size == len(binary) and not (json_size % 4 or size % 4)
    assert described["buffers"] == [{"byteLength": binary_size}]
    types = {5121: "u1", 5123: "<u2", 5125: "<u4", 5126: "<f4"}

    def numbers(index):
        accessor = described["accessors"][index]
        view = described["bufferViews"][accessor["bufferView"]]
        start = view["byteOffset"] + accessor.get("byteOffset", 0)
        n = accessor["count"] * {"SCALAR": 1, "VEC3": 3}[accessor["type"]]
        read = np.frombuffer(binary, types[accessor["componentType"]], n, start)
        read = read.reshape(accessor["count"], -1)
        assert np.array_equal(read.min(0), np.float32(accessor["min"]))
        assert np.array_equal(read.max(0), np.float32(accessor["max"]))
        return read

    return described, numbers


@pytest.mark.parametrize(("unit", "metres"), [("mm", 1e-3), ("normalised", 1)])
def test_a_glb_is_the_head_by_the_specification(tmp_path, unit, metres):
    face = make_face("é", "ibug51", unit=unit, notes=("a note",))
    (path,) = written(tmp_path, ["glb"], face)
    described, numbers = glb_by_hand(path)
    (node,) = described["scenes"][described["scene"]]["nodes"]
    while "mesh" not in described["nodes"][node]:
        (node,) = described["nodes"][node]["children"]
    assert not {"matrix", "scale", "rotation", "translation"} & described["nodes"][node].keys()
    (primitive,) = described["meshes"][described["nodes"][node]["mesh"]]["primitives"]
    assert primitive.get("mode", 4) == 4  # triangles
    head = fit_surfaces(face.xyz[None], "ibug51")[0]
    assert_close(numbers(primitive["attributes"]["POSITION"]), head * metres)
    triangles = numbers(primitive["indices"]).reshape(-1, 3)
    assert np.array_equal(triangles, surface_triangles())
    # Normals are of unit length, and point to where triangles are seen counter-clockwise.
    normals = numbers(primitive["attributes"]["NORMAL"])
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1, atol=1e-5)
    a, b, c = (head[triangles[:, i]] for i in range(3))
    towards = (np.cross(b - a, c - a) * normals[triangles[:, 0]]).sum(1)
    assert (towards > 0).mean() > 0.9
    assert "a note" in str(described["scenes"])


def test_tables_hold_all_faces_and_wireframes_one(tmp_path):
    faces = [make_face("run-1"), make_face("run-2", seed=1)]
    paths = written(tmp_path / "new" / "folder", TEXTS, *faces)
    names = ["run.csv", "run.json", "run.npz", "run-1.ply", "run-2.ply", "run-1.obj", "run-2.obj"]
    assert [path.name for path in paths] == names
    assert sorted(path.name for path in paths[0].parent.iterdir()) == sorted(names)
    assert_close(by_hand(paths[4])[0], faces[1].xyz)


@pytest.mark.parametrize("name", ['x\nend_header\n9,9,9\n"', "\udcff"])
def test_no_name_adds_rows_comments_or_elements(tmp_path, name):
    face = make_face("a", notes=("note",))
    face = Face(**vars(face) | {"name": name})
    for kind in TEXTS:
        write_output(tmp_path / f"a.{kind}", [face], {"name": name})
    with open(tmp_path / "a.csv", encoding="utf-8", newline="") as file:
        rows = [row for row in csv.reader(file) if not row[0].startswith("#")]
    assert len(rows) == 73 and len({row[0] for row in rows[1:]}) == 1
    assert len(by_hand(tmp_path / "a.ply")[0]) == 72
    assert {line[0] for line in (tmp_path / "a.obj").read_text().splitlines()} == set("#vl")


def test_names_of_landmarks_come_back_as_they_are(tmp_path):
    names = ["back, top", '50% "seat"', "leg %s", "#arm", "left", "right"]
    with open(tmp_path / "chair.csv", "w", encoding="utf-8", newline="") as file:
        csv.writer(file).writerows([("number", "name"), *enumerate(names, 1)])
    face = make_face(scheme=str(tmp_path / "chair.csv"))
    write_output(tmp_path / "a.csv", [face], MODEL)
    lines = (tmp_path / "a.csv").read_text(encoding="utf-8").splitlines()
    table = [*csv.DictReader(line for line in lines if not line.startswith("#"))]
    assert [row["name"] for row in table] == names
    read = read_landmarks(tmp_path / "a.csv", scheme=face.scheme)
    np.testing.assert_allclose(read[0], face.landmarks, rtol=1e-6)
