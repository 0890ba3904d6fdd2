"""Results read back: the numbers, what they mean, and which points the lines join."""

import csv
import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from deepmds_keras import InputError, __version__
from deepmds_keras.camera import head_pose
from deepmds_keras.landmarks import load_scheme
from deepmds_keras.predict.faces import Face
from deepmds_keras.predict.landmark_files import read_landmarks
from deepmds_keras.predict.outputs import FORMATS, output_files, wireframe_edges, write_output

MODEL = {"name": "deepmds-bfm72", "trained_on": "20,000 faces of the open head"}
ODD = 'ä "x",#1%s\n'


def make_face(name="a", scheme="bfm72", seed=0, unit="normalised", notes=(), std=False):
    rng = np.random.default_rng(seed)
    shape = rng.uniform(-1, 1, (len(load_scheme(scheme)), 3)) * (80 if unit == "mm" else 0.5)
    view = 300 * shape[:, :2] + [400, -300] + rng.normal(size=(len(shape), 2))
    photo = Path(f"{name}.jpg")
    pose = head_pose(view, shape)
    own = rng.random(shape.shape) if std else None
    return Face(name, photo, photo, scheme, view * [1, -1], shape, unit, pose, notes, std=own)


def written(folder, kind, *faces, name="run"):
    return written_all(folder, name, faces, [kind])


def written_all(folder, name, faces, kinds):
    files = output_files(folder, name, faces, kinds)
    for path, held in files.items():
        write_output(path, held, MODEL)
    return [*files]


def assert_close(found, expected):
    """To the seven digits that are written."""
    np.testing.assert_allclose(found, expected, atol=1e-6 * np.abs(expected).max(), rtol=0)


@pytest.mark.parametrize("scheme", ["bfm72", "ibug51"])
@pytest.mark.parametrize(("unit", "std"), [("mm", True), ("normalised", False)])
def test_the_table_gives_the_numbers_back(tmp_path, scheme, unit, std):
    faces = [make_face(ODD, scheme, 0, unit, (), std), make_face("b", scheme, 1, unit, ("?",), std)]
    (path,) = written(tmp_path, "csv", *faces)
    table = pd.read_csv(path, comment="#")
    axes = [f"{what}{axis}" for what in ("", "std_", "image_") for axis in "xyz"]
    assert table.columns.tolist() == ["face", "number", "name", *axes, "residual"]
    assert table.face.unique().tolist() == [ODD, "b"]
    for face in faces:
        rows = table[table.face == face.name]
        assert tuple(rows.number) == load_scheme(scheme).numbers
        assert tuple(rows.name) == load_scheme(scheme).names
        assert_close(rows[["x", "y", "z"]], face.shape)
        assert_close(rows[["image_x", "image_y", "image_z"]], face.image_xyz)
        assert_close(rows["residual"], face.residual)
        known = rows[["std_x", "std_y", "std_z"]]
        assert known.isna().to_numpy().all() if face.std is None else np.allclose(known, face.std)


def test_the_table_states_unit_axes_scheme_and_notes(tmp_path):
    (path,) = written(tmp_path, "csv", make_face(unit="mm", notes=("yaw beyond training",)))
    comments = [line for line in path.read_text().splitlines() if line.startswith("#")]
    for said in (
        *("mm", "+x to the subject's left", "x to the right, y down", "bfm72", "deepmds-bfm72"),
        *(__version__, "1 to 72", "does not show the true size", '"a": yaw beyond training'),
    ):
        assert any(said in line for line in comments), said


def test_json_gives_everything_back(tmp_path):
    faces = [make_face(ODD, notes=("yaw beyond training",)), make_face("b", seed=1)]
    (path,) = written(tmp_path, "json", *faces)
    content = json.loads(path.read_bytes())
    assert content["model"] == MODEL
    assert content["generator"] == f"deepmds-keras {__version__}"
    assert (content["scheme"], content["unit"]) == ("bfm72", "normalised")
    assert "does not show the true size" in content["scale"]
    assert content["landmark_names"] == list(load_scheme("bfm72").names)
    assert content["landmark_numbers"] == list(range(1, 73))
    for record, face in zip(content["faces"], faces, strict=True):
        assert record["name"] == face.name
        assert record["source"] == record["photo"] == str(face.photo)
        assert record["notes"] == list(face.notes)
        assert_close(record["shape"], face.shape)
        assert_close(record["landmarks"], face.landmarks)
        assert_close(record["image_xyz"], face.image_xyz)
        assert_close(record["residual"], face.residual)
        assert record["std"] is None
        for key, value in vars(face.pose).items():
            assert_close(record["pose"][key], value)


def test_the_pose_that_is_written_sees_the_shape_where_the_landmarks_are(tmp_path):
    (path,) = written(tmp_path, "json", make_face())
    (record,) = json.loads(path.read_bytes())["faces"]
    pose, seen = record["pose"], np.array(record["landmarks"]) * [1, -1]
    turned = np.array(record["shape"]) @ np.array(pose["rotation"]).T
    off = pose["scale"] * turned[:, :2] + pose["translation"] - seen
    residual = np.sqrt((off**2).sum(1).mean()) / np.ptp(seen, axis=0).max()
    assert residual == pytest.approx(pose["residual"], rel=1e-3)


def test_the_archive_gives_arrays_with_the_digits_of_float32(tmp_path):
    faces = [make_face(f"a-{i}", "ibug51", i) for i in range(3)]
    (path,) = written(tmp_path, "npz", *faces)
    with np.load(path, allow_pickle=False) as file:
        arrays = dict(file)
    assert np.array_equal(arrays["shape"], np.float32([face.shape for face in faces]))
    assert np.array_equal(arrays["landmarks"], np.float32([face.landmarks for face in faces]))
    assert arrays["face"].tolist() == ["a-0", "a-1", "a-2"]
    assert arrays["landmark_numbers"].tolist() == list(range(18, 69))
    assert np.array_equal(arrays["residual"], np.float32([face.residual for face in faces]))
    for key in vars(faces[0].pose):
        measured = arrays["pose_residual" if key == "residual" else key]
        assert np.array_equal(measured, np.float32([getattr(face.pose, key) for face in faces]))
    description = json.loads(str(arrays["description"]))
    assert description["unit"] == "normalised"
    assert description["model"] == MODEL


@pytest.mark.parametrize("kind", ["csv", "json"])
def test_results_can_be_read_as_landmarks(tmp_path, kind):
    faces = [make_face("a-1"), make_face("a-2", seed=1)]
    (path,) = written(tmp_path, kind, *faces)
    assert_close(read_landmarks(path), [face.landmarks for face in faces])


def by_hand(path):
    """Vertices and edges of a PLY file, by its header."""
    lines = path.read_text(encoding="ascii").splitlines()
    end = lines.index("end_header")
    assert lines[:2] == ["ply", "format ascii 1.0"]
    counts = [int(line.split()[-1]) for line in lines[:end] if line.startswith("element")]
    body = lines[end + 1 :]
    assert len(body) == sum(counts)
    return np.loadtxt(body[: counts[0]]), np.loadtxt(body[counts[0] :], dtype=int), lines[:end]


@pytest.mark.parametrize("scheme", ["bfm72", "ibug51", "ibug68"])
def test_the_lines_join_the_points_that_the_scheme_joins(tmp_path, scheme):
    face = make_face(ODD, scheme, notes=("20° to the left",))
    lines = load_scheme(scheme).polylines
    joined = {frozenset(pair) for line in lines for pair in zip(line, line[1:], strict=False)}

    (path,) = written(tmp_path, "ply", Face(**vars(face) | {"name": "a"}))
    vertices, edges, header = by_hand(path)
    assert_close(vertices, face.shape)
    assert len(edges) == len(joined)
    assert {frozenset(edge) for edge in edges.tolist()} == joined
    assert any("unit of x, y, z: normalised" in line for line in header)
    assert any("+y up" in line for line in header)

    (path,) = written(tmp_path, "obj", Face(**vars(face) | {"name": "a"}))
    rows = [line.split() for line in path.read_text(encoding="utf-8").splitlines()]
    assert_close([[float(v) for v in row[1:]] for row in rows if row[0] == "v"], face.shape)
    found = [[int(i) - 1 for i in row[1:]] for row in rows if row[0] == "l"]
    assert [tuple(line) for line in found] == list(lines)


def test_vtk_reads_the_wireframes(tmp_path):
    vtk = pytest.importorskip("vtk", reason="vtk, of the extra experiments, is not installed")
    from vtk.util.numpy_support import vtk_to_numpy

    face = make_face()
    for kind, reader in (("ply", vtk.vtkPLYReader()), ("obj", vtk.vtkOBJReader())):
        (path,) = written(tmp_path, kind, face)
        reader.SetFileName(str(path))
        reader.Update()
        assert_close(vtk_to_numpy(reader.GetOutput().GetPoints().GetData()), face.shape)
    lines = reader.GetOutput().GetLines()
    ends = vtk_to_numpy(lines.GetOffsetsArray())
    points = np.split(vtk_to_numpy(lines.GetConnectivityArray()), ends[1:-1])
    assert [tuple(line) for line in points] == list(load_scheme("bfm72").polylines)


def test_edges_are_unique_and_within_the_scheme():
    for name in ("bfm72", "ibug51", "ibug68"):
        edges = wireframe_edges(load_scheme(name))
        assert len({frozenset(edge) for edge in edges.tolist()}) == len(edges)
        assert (edges[:, 0] < edges[:, 1]).all()
        assert 0 <= edges.min() < edges.max() < len(load_scheme(name))


def test_tables_hold_all_faces_and_wireframes_one(tmp_path):
    faces = [make_face("a-1"), make_face("a-2", seed=1)]
    paths = written_all(tmp_path / "new" / "folder", "a", faces, FORMATS)
    names = ["a.csv", "a.json", "a.npz", "a-1.ply", "a-2.ply", "a-1.obj", "a-2.obj"]
    assert [path.name for path in paths] == names
    assert sorted(path.name for path in paths[0].parent.iterdir()) == sorted(names)
    assert_close(by_hand(paths[4])[0], faces[1].shape)


def test_a_name_cannot_add_rows_comments_or_elements(tmp_path):
    name = 'x\nend_header\n9,9,9\n"'
    face = make_face(name, notes=("note",))
    for kind in ("csv", "ply", "obj"):
        path = tmp_path / f"a.{kind}"
        write_output(path, [face], {"name": name})
    with open(tmp_path / "a.csv", encoding="utf-8", newline="") as file:
        rows = [row for row in csv.reader(file) if not row[0].startswith("#")]
    assert len(rows) == 73
    assert {row[0] for row in rows[1:]} == {name}
    assert len(by_hand(tmp_path / "a.ply")[0]) == 72
    assert {line[0] for line in (tmp_path / "a.obj").read_text().splitlines()} == set("#vl")


def test_a_name_of_bytes_that_are_no_text_is_written(tmp_path):
    for kind in FORMATS:
        (path,) = written(tmp_path, kind, Face(**vars(make_face("\udcff")) | {"name": "\udcff"}))
        assert path.stat().st_size


def test_a_file_that_cannot_be_written_leaves_what_there_was(tmp_path):
    (tmp_path / "run.csv" / "kept").mkdir(parents=True)
    with pytest.raises(InputError, match="run.csv must be a file to write"):
        written(tmp_path, "csv", make_face())
    assert [path.name for path in tmp_path.iterdir()] == ["run.csv"]
    (tmp_path / "file").touch()
    with pytest.raises(InputError, match="must be a file that can be written"):
        written(tmp_path / "file", "csv", make_face())


def test_an_unknown_format_is_refused_before_anything_is_written(tmp_path):
    with pytest.raises(InputError, match="one of csv, json, npz, ply, obj. Received 'stl'"):
        output_files(tmp_path, "a", [make_face()], ["csv", "stl"])
    assert not any(tmp_path.iterdir())
