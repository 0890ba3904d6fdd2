"""Results read back: the numbers, what they mean, and which points the lines join."""

import csv
import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import trimesh

from deepmds_keras import __version__
from deepmds_keras.files import read_npz
from deepmds_keras.geometry.camera import head_pose
from deepmds_keras.landmarks import load_scheme
from deepmds_keras.tool.command.outputs import FORMATS, output_files, write_output
from deepmds_keras.tool.predict.faces import Face
from deepmds_keras.tool.predict.landmark_files import read_landmarks
from deepmds_keras.tool.predict.mesh import fit_surfaces, surface_triangles

MODEL = {"name": "deepmds-bfm72", "trained_on": "20,000 faces of the open head"}
TEXTS = [kind for kind in FORMATS if kind != "glb"]  # and arrays: without the extra
ODD = 'ä "x",#1%s\n'
# As they are called in JSON and NPZ, and in `Face`.
FIELDS = {"shape": "xyz", "landmarks": "landmarks", "image_xyz": "landmarks_3d",
          "residual": "residuals"}  # fmt: skip


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
        for key, field in FIELDS.items():
            assert_close(record[key], getattr(face, field))
        assert record["std"] is None
        for key, value in face.pose.as_dict().items():
            assert_close(record["pose"][key], value)
    arrays = read_npz(archive)
    for key, field in FIELDS.items():
        assert np.array_equal(arrays[key], np.float32([getattr(face, field) for face in faces]))
    assert arrays["face"].tolist() == [ODD, "b"]
    for key in faces[0].pose.as_dict():
        measured = arrays["pose_residual" if key == "residual" else key]
        assert np.array_equal(measured, np.float32([face.pose.as_dict()[key] for face in faces]))
    assert json.loads(str(arrays["description"]))["model"] == MODEL


@pytest.mark.parametrize("scheme", ["bfm72", "ibug51", "ibug68"])
def test_the_lines_join_the_points_that_the_scheme_joins(tmp_path, scheme):
    face = make_face("a", scheme, notes=("20° to the left",))
    lines = load_scheme(scheme).polylines
    ply, obj = written(tmp_path, ["ply", "obj"], face)
    for path in (ply, obj):
        assert_close(trimesh.load(path).vertices, face.xyz)
    assert "comment unit of x, y, z: normalised" in ply.read_text(encoding="ascii")
    rows = [line.split() for line in obj.read_text(encoding="utf-8").splitlines()]
    actual = [[int(i) - 1 for i in row[1:]] for row in rows if row[0] == "l"]
    assert [tuple(line) for line in actual] == list(lines)


@pytest.mark.parametrize(
    ("kind", "unit", "metres"),
    [("mesh.ply", "mm", 1), ("mesh.obj", "mm", 1), ("glb", "mm", 1e-3), ("glb", "normalised", 1)],
)
def test_heads_are_read_back(tmp_path, kind, unit, metres):
    """Those of a known size in metres where the format has a unit."""
    face = make_face("é", "ibug51", unit=unit, notes=("a note",))
    (path,) = written(tmp_path, [kind], face)
    head = trimesh.load(path, process=False, force="mesh")
    assert_close(head.vertices, metres * fit_surfaces(face.xyz[None], "ibug51")[0])
    assert np.array_equal(head.faces, surface_triangles())
    content = path.read_bytes()
    assert b"a note" in content and (kind == "glb") == (b'"NORMAL"' in content)
    assert kind == "glb" or content.isascii()


def test_tables_hold_all_faces_and_wireframes_one(tmp_path):
    faces = [make_face("run-1"), make_face("run-2", seed=1)]
    paths = written(tmp_path / "new" / "folder", TEXTS, *faces)
    names = ["run.csv", "run.json", "run.npz", "run-1.ply", "run-2.ply", "run-1.obj", "run-2.obj"]
    assert [path.name for path in paths] == names
    assert sorted(path.name for path in paths[0].parent.iterdir()) == sorted(names)
    assert_close(trimesh.load(paths[4]).vertices, faces[1].xyz)


@pytest.mark.parametrize("name", ['x\nend_header\n9,9,9\n"', "\udcff"])
def test_no_name_adds_rows_comments_or_elements(tmp_path, name):
    face = make_face("a", notes=("note",))
    face = Face(**vars(face) | {"name": name})
    for kind in TEXTS:
        write_output(tmp_path / f"a.{kind}", [face], {"name": name})
    with open(tmp_path / "a.csv", encoding="utf-8", newline="") as file:
        rows = [row for row in csv.reader(file) if not row[0].startswith("#")]
    assert len(rows) == 73 and len({row[0] for row in rows[1:]}) == 1
    assert len(trimesh.load(tmp_path / "a.ply").vertices) == 72
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
