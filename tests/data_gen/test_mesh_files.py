"""Meshes and scans: however they are written they come back, and bad files are refused."""

import numpy as np
import pytest
from writers.scans import write_ply

from data_gen.mesh_files import read_asc_points, read_ply, read_vrml_points
from deepmds_keras.errors import InputError


@pytest.mark.parametrize(
    ("read", "text"),
    [
        (read_vrml_points, "coord Coordinate {\n\tpoint [-12.5 3.25 -15.0,\n\t0 1e-3 998.5\n] }"),
        (read_vrml_points, "COORD { POINT\n[-12.5, 3.25, -15, 0, 1E-3, +9.985E+2,] }"),
        (read_vrml_points, "point[ -12.5 3.25 -15 # a ] in a comment\n0 .001 998.5 #1 2 3\n]"),
        (
            read_vrml_points,
            "TextureCoordinate { point [ 0 0, 0 1, 1 1, 1 0, 0 0, 0.5 0.5 ] }\n# point [ 9 9 9 ]\n"
            'info [ "point [ 8 8 8 ]" ] Coordinate { point [ 1 2 3 ] } normal { vector [ 1 0 0 ] }'
            "Coordinate { point [ -12.5 3.25 -15 0 .001 998.5 ] } checkpoint [ 1 2 3 4 5 6 7 8 9 ]",
        ),
        (read_asc_points, "# x y z\n-12.5\t3.25\t-15.0,\n\n  0, 0.001 998.5 # a\n"),
    ],
)
@pytest.mark.parametrize("line_end", ["\n", "\r\n", "\r"])
def test_points_come_back_however_they_are_written(tmp_path, read, text, line_end):
    (tmp_path / "a").write_bytes(text.replace("\n", line_end).encode())
    expected = [[-12.5, 3.25, -15.0], [0.0, 1e-3, 998.5]]
    np.testing.assert_array_equal(read(tmp_path / "a"), expected)


@pytest.mark.parametrize(
    ("read", "content", "message"),
    [
        (read_vrml_points, b"point [ 1 2 3 4 ]", "Received 4 in all"),
        (read_vrml_points, b"point [ 1 2 1e999 ]", "must be finite"),
        (read_asc_points, b"1 2 3\n4 5\n6\n", "three numbers per line"),
        (read_asc_points, b"1 2 3\n4 nan 6\n", "must be finite"),
    ],
)
def test_what_is_not_three_finite_numbers_a_point_is_refused(tmp_path, read, content, message):
    (tmp_path / "a").write_bytes(content)
    with pytest.raises(InputError, match=f"^{tmp_path}/a: .*{message}.{{,200}}$"):
        read(tmp_path / "a")


MESH = np.random.default_rng(0).normal(size=(9, 3)), np.arange(9, dtype=np.int32).reshape(3, 3)


@pytest.mark.parametrize("kind", [np.float32, np.float64])
@pytest.mark.parametrize("faces", ["vertex_indices", "vertex_index"])
def test_meshes_come_back(tmp_path, kind, faces):
    vertices, triangles = read_ply(
        write_ply(tmp_path / "a.ply", MESH[0].astype(kind), MESH[1], faces=faces)
    )
    np.testing.assert_array_equal(vertices, MESH[0].astype(kind))
    np.testing.assert_array_equal(triangles, MESH[1])


@pytest.mark.parametrize(
    "change",
    [
        lambda content: content.replace(b"double z", b"double w"),
        lambda content: content.replace(b"\x03\0\0\0\0", b"\x04\0\0\0\0"),
        lambda content: content.replace(b"\x08\0\0\0", b"\x09\0\0\0"),
        lambda content: content.replace(MESH[0][0, :1].tobytes(), np.float64([np.nan]).tobytes()),
    ],
)
def test_quads_wild_corners_and_nan_are_refused(tmp_path, change):
    file = write_ply(tmp_path / "a.ply", *MESH)
    content = file.read_bytes()
    assert change(content) != content
    file.write_bytes(change(content))
    with pytest.raises(InputError, match="a.ply: .*must"):
        read_ply(file)
