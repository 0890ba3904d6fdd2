"""Scans as text: however the points are written they come back, and bad files are refused."""

import gzip
import os

import numpy as np
import pytest

from data_gen.formats.vrml import MAX_BYTES, read_asc_points, read_vrml_points
from deepmds_keras.errors import InputError

POINTS = np.array([[-12.5, 3.25, -1015.0], [0.0, 1e-3, 998.5], [7.0, -80.0, 1500.0]])


@pytest.fixture
def written(tmp_path):
    """A file of the text or bytes."""

    def write(content, name="001-001.wrl"):
        file = tmp_path / name
        file.write_bytes(content.encode() if isinstance(content, str) else content)
        return file

    return write


@pytest.mark.parametrize(
    "text",
    [
        # First triple on the opening line, last on the closing one.
        "#VRML V2.0 utf8\nShape { geometry IndexedFaceSet {\n coord Coordinate {\n"
        "\tpoint [-12.5 3.25 -1015.0,\n\t 0 0.001 998.5,\n\t 7 -80 1500]\n } } }",
        # Brackets on lines of their own; commas after every triple, or after every number.
        "coord Coordinate { point [\n-12.5 3.25 -1015,\n0 0.001 998.5,\n7 -80 1500,\n] }",
        "coord Coordinate { point [-12.5, 3.25, -1015, 0, 1e-3, 998.5, 7, -80, 1.5e3] }",
        "coord Coordinate { point[-12.5 3.25 -1015 0 1E-3 998.5 7 -80 +1.5E+3] }",
        "COORD COORDINATE { POINT\n[-12.5 3.25 -1015 0 0.001 998.5 7 -80 1500] }",
        "coord DEF c Coordinate{point [ -12.5 3.25 -1015 # a ] in a comment\n"
        "0 0.001 998.5, #another, 1 2 3\n 7 -80 1500 ]}",
        "Coordinate3 { point [ -12.5 3.25 -1015, 0 .001 998.5, 7. -80. 1500. ] }",
        "point [-12.5 3.25 -1015 0 0.001 998.5 7 -80 1500]",
    ],
)
@pytest.mark.parametrize("line_end", ["\n", "\r\n", "\r"])
def test_points_come_back_however_they_are_written(written, text, line_end):
    file = written(text.replace("\n", line_end))
    points = read_vrml_points(file)
    assert points.dtype == np.float64
    np.testing.assert_array_equal(points, POINTS)


def test_normals_colours_triangles_and_texture_are_left_out(written):
    file = written(
        "texCoord TextureCoordinate { point [ 0 0, 0 1, 1 1, 1 0, 0 0, 0.5 0.5 ] }\n"
        "texCoord TextureCoordinate2\n{\n point [ 0 0, 0 1, 1 1, 1 0, 0 0, 0.5 0.5 ] }\n"
        "normal Normal { vector [ 1 0 0, 0 1 0 ] } color Color { color [ 1 1 1, 0 0 0 ] }\n"
        "coord Coordinate { point [ 1 2 3 ] } coordIndex [ 0, 0, 0, -1 ]\n"
        "checkpoint [ 1 2 3 4 5 6 ] Viewpoint { position 0 0 9 }"
    )
    assert read_vrml_points(file).tolist() == [[1, 2, 3]]


def test_the_largest_of_several_blocks_is_taken(written):
    blocks = ["1 2 3", "4 5 6, 7 8 9", "1.000000000 2.000000000       3.000000000"]
    file = written("".join(f"Coordinate {{ point [ {block} ] }}\n" for block in blocks))
    assert read_vrml_points(file).tolist() == [[4, 5, 6], [7, 8, 9]]


def test_what_comments_and_strings_say_is_no_block(written):
    file = written(
        "#VRML V2.0 utf8\n# point [ 9 9 9, 9 9 9 ]\n"
        'WorldInfo { info [ "5 # of", "point [ 8 8 8, 8 8 8 ]" ] } Coordinate { point [ 1 2 3 ] }'
    )
    assert read_vrml_points(file).tolist() == [[1, 2, 3]]


def test_many_points_come_back_to_the_last_digit(written):
    points = np.random.default_rng(0).normal(0, 500, (3000, 3))
    rows = [" ".join(map(repr, row)) for row in points.tolist()]
    file = written("#VRML V2.0 utf8\nCoordinate { point [ " + ",\r\n".join(rows) + " ] }")
    np.testing.assert_array_equal(read_vrml_points(file), points)
    file = written("\n".join(rows), "001-001.asc")
    np.testing.assert_array_equal(read_asc_points(file), points)


@pytest.mark.parametrize(
    "text",
    [
        "-12.5 3.25 -1015.0\n0 1e-3 998.5\n7 -80 1500",
        "# x y z\r\n-12.5\t3.25\t-1015.0\r\n\r\n  0 0.001 998.5  \r\n7 -80 1500\r\n",
        "-12.5, 3.25, -1015,\n0, 0.001, 998.5,\n7, -80, 1500, # the last\n",
    ],
)
def test_bare_lines_come_back(written, text):
    points = read_asc_points(written(text, "001-001.asc"))
    assert points.dtype == np.float64
    np.testing.assert_array_equal(points, POINTS)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("", r"must be a VRML text with a block .* begins with b''"),
        ("#VRML V2.0 utf8\nShape { }", r"must be a VRML text .* begins with b'#VRML V2.0 utf8"),
        ("TextureCoordinate { point [ 0 0, 0 1, 1 1 ] }", "must be a VRML text with a block"),
        (bytes(range(256)) * 40, "must be a VRML text with a block"),
        (gzip.compress(b"Coordinate { point [ 1 2 3 ] }", mtime=0), r"begins with b'\\x1f\\x8b"),
        ("Coordinate { point [ ] }", "must hold three numbers per point. Received 0 in all"),
        ("Coordinate { point [ 1 2 3 4 ] }", "three numbers per point. Received 4 in all"),
        ("Coordinate { point [ 1 2 3, 4 5 6", r"must end its block 'point \[' by '\]'"),
        ("Coordinate { point [ 1 2 3 } Normal { vector [ 1 0 0 ] }", "must end its block"),
        ("Coordinate { point [ 1 2 three ] }", "points must be numbers. Received: .*three"),
        ("Coordinate { point [ 1 2 3\x00 ] }", "points must be numbers"),
        ("Coordinate { point [ 1 2 " + "x" * 9999 + " ] }", "points must be numbers. .{,110}$"),
        ("Coordinate { point [ 1 2 NaN ] }", "must be finite. Received NaN"),
        ("Coordinate { point [ 1 2 -inf ] }", "must be finite"),
        ("Coordinate { point [ 1 2 1e999 ] }", "must be finite"),
        ("Coordinate { point [ 1.#QNAN 2 3, 4 1.#QNAN 6, 7 8 1.#QNAN ] }", "must be numbers"),
    ],
)
def test_a_damaged_vrml_text_is_refused(written, content, message):
    file = written(content)
    with pytest.raises(InputError, match=f"(?s)^{file}: .*{message}"):
        read_vrml_points(file)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("", "three numbers per point. Received 0 in all"),
        ("# nothing\n\n", "three numbers per point. Received 0 in all"),
        ("1 2 3\n4 5\n", "must hold three numbers per line. Received 2"),
        ("1 2 3 4 5 6\n7 8 9 10 11 12\n", "must hold three numbers per line. Received 6"),
        ("1 2 3\n4 5\n6\n", "must hold three numbers per line"),
        ("1 2 3\nx y z\n", "points must be numbers. Received: .*x"),
        ("1 2 3\n4 nan 6\n", "must be finite"),
        (b"\x80\x04 \x95 \x00\n", "points must be numbers"),
    ],
)
def test_damaged_bare_lines_are_refused(written, content, message):
    file = written(content, "001-001.asc")
    with pytest.raises(InputError, match=f"^{file}: .*{message}"):
        read_asc_points(file)


@pytest.mark.parametrize("read", [read_vrml_points, read_asc_points])
def test_a_huge_file_is_refused_before_it_is_read(written, read):
    file = written("Coordinate { point [ 1 2 3 ] }")
    os.truncate(file, 100 * MAX_BYTES)  # sparse: takes no room, and would not fit the memory
    with pytest.raises(InputError, match=f"{file}: .* at most {MAX_BYTES} bytes. Received 134217"):
        read(file)


@pytest.mark.parametrize("read", [read_vrml_points, read_asc_points])
def test_what_cannot_be_opened_is_refused(tmp_path, read):
    for path in (tmp_path / "absent.wrl", tmp_path):
        with pytest.raises(InputError, match=f"{path}: must be a scan that can be read. Received"):
            read(path)
