"""CoMA: its meshes are found and read, and what cannot be used is listed, not hidden."""

import struct
import sys
import tracemalloc

import numpy as np
import pytest
from writers.scans import write_ply

from data_gen.datasets.coma import find_meshes, load_coma
from data_gen.formats.ply import read_ply
from data_gen.models.flame_embedding import LandmarkEmbedding
from deepmds_keras.errors import InputError

SUBJECTS = ("FaceTalk_170725_00137_TA", "FaceTalk_170728_03272_TA")
SEQUENCES = ("bareteeth", "mouth_open")
V, T = 40, 60


@pytest.fixture(scope="module")
def mesh():
    rng = np.random.default_rng(0)
    triangles = np.array([rng.permutation(V)[:3] for _ in range(T)], np.int32)
    return rng.normal(size=(V, 3)).astype(np.float32) * 0.05, triangles


@pytest.fixture(scope="module")
def embedding():
    rng = np.random.default_rng(1)
    return LandmarkEmbedding(rng.integers(0, T, 51), rng.dirichlet(np.ones(3), 51))


@pytest.fixture
def root(tmp_path, mesh):
    """Two subjects, two sequences, three frames each, numbered from 5 with a gap."""
    vertices, triangles = mesh
    for s, subject in enumerate(SUBJECTS):
        for q, sequence in enumerate(SEQUENCES):
            for frame in (5, 7, 20):
                file = tmp_path / "coma" / subject / sequence / f"{sequence}.{frame:06}.ply"
                write_ply(file, vertices + np.float32(s + q / 10 + frame / 1000), triangles)
    return tmp_path / "coma"


class TestComa:
    def test_landmarks_of_all_meshes_come_sorted_and_in_millimetres(self, root, mesh, embedding):
        coma = load_coma(root, embedding)
        assert len(coma) == 12 and coma.skipped == []
        assert coma.landmarks.dtype == np.float32 and coma.landmarks.shape == (12, 51, 3)
        assert coma.subjects.tolist() == [SUBJECTS[0]] * 6 + [SUBJECTS[1]] * 6
        assert coma.sequences.tolist() == ([SEQUENCES[0]] * 3 + [SEQUENCES[1]] * 3) * 2
        assert coma.names[:4].tolist() == [
            *("bareteeth.000005", "bareteeth.000007", "bareteeth.000020", "mouth_open.000005")
        ]
        corners = mesh[0][mesh[1][embedding.triangles]].astype(float)
        expected = np.einsum("lc,lcd->ld", embedding.weights, corners) * 1000
        shifts = [s * 1000 + q * 100 + f for s in (0, 1) for q in (0, 1) for f in (5, 7, 20)]
        np.testing.assert_allclose(
            coma.landmarks, expected + np.reshape(shifts, (12, 1, 1)), atol=1e-3
        )

    def test_a_folder_between_is_passed(self, root):
        found = find_meshes(root.parent)
        assert [mesh.path for mesh in found] == [mesh.path for mesh in find_meshes(root)]
        assert {mesh.subject for mesh in found} == set(SUBJECTS)

    def test_hidden_copies_of_macos_are_no_meshes(self, root):
        folder = root / SUBJECTS[0] / SEQUENCES[0]
        (folder / "._bareteeth.000005.ply").write_bytes(b"\x00\x05\x16\x07")
        assert len(find_meshes(root)) == 12

    def test_what_cannot_be_used_is_listed_with_its_reason(self, root, mesh, embedding):
        vertices, triangles = mesh
        folder = root / SUBJECTS[0] / SEQUENCES[0]
        write_ply(folder / "a_text.ply", vertices, triangles, text=True)
        write_ply(folder / "b_foreign.ply", vertices, triangles[::-1])
        write_ply(folder / "c_larger.ply", np.vstack([vertices, vertices]), triangles)
        write_ply(folder / "d_millimetres.ply", vertices * 1000, triangles)
        write_ply(folder / "e_few.ply", vertices, triangles[:5])
        whole = (folder / "bareteeth.000005.ply").read_bytes()
        (folder / "f_truncated.ply").write_bytes(whole[:-100])
        (folder / "g_empty.ply").touch()
        coma = load_coma(root, embedding)
        assert len(coma) == 13 and coma.names[0] == "a_text"
        reasons = {path.stem: reason for path, reason in coma.skipped}
        patterns = {
            "b_foreign": f"Received {V} vertices and {T} triangles, numbered otherwise",
            "c_larger": f"Received {2 * V} vertices and {T} triangles.",
            "d_millimetres": "must be a head in metres",
            "e_few": "triangles must be those of FLAME",
            "f_truncated": "Received less than",
            "g_empty": "must be a PLY file",
        }
        assert reasons.keys() == patterns.keys()
        for name, pattern in patterns.items():
            assert pattern in reasons[name] and "coma" not in reasons[name]

    def test_one_foreign_mesh_in_front_does_not_make_the_others_foreign(
        self, root, mesh, embedding
    ):
        without = load_coma(root, embedding)
        first = root / SUBJECTS[0] / SEQUENCES[0] / "aaa.ply"
        write_ply(first, mesh[0], mesh[1][::-1])
        coma = load_coma(root, embedding)
        np.testing.assert_array_equal(coma.landmarks, without.landmarks)
        assert [path for path, _ in coma.skipped] == [first]

    def test_given_triangles_decide_what_is_foreign(self, root, mesh, embedding):
        other = root / SUBJECTS[0] / SEQUENCES[0] / "other.ply"
        write_ply(other, mesh[0], mesh[1][::-1])
        coma = load_coma(root, embedding, mesh[1][::-1])
        assert coma.names.tolist() == ["other"] and len(coma.skipped) == 12

    def test_processes_and_chunks_change_nothing(self, root, embedding, monkeypatch):
        (root / SUBJECTS[1] / SEQUENCES[0] / "bareteeth.000006.ply").touch()
        at_once = load_coma(root, embedding)
        monkeypatch.setattr("data_gen.datasets.coma._MESHES_PER_CHUNK", 5)
        done = []
        in_parts = load_coma(root, embedding, jobs=2, progress=done.append)
        assert done == [5, 5, 3]
        np.testing.assert_array_equal(in_parts.landmarks, at_once.landmarks)
        assert in_parts.names.tolist() == at_once.names.tolist()
        assert in_parts.skipped == at_once.skipped and len(at_once.skipped) == 1

    def test_a_folder_without_meshes_is_refused(self, tmp_path, root):
        empty = tmp_path / "empty"
        empty.mkdir()
        for path in (empty, tmp_path / "absent", root / SUBJECTS[0] / SEQUENCES[0]):
            with pytest.raises(InputError, match=f"{path}: must hold .*SUBJECT/SEQUENCE/"):
                find_meshes(path)

    def test_two_data_sets_are_refused(self, tmp_path, root, mesh):
        write_ply(tmp_path / "other" / "subject" / "smile" / "smile.000001.ply", *mesh)
        with pytest.raises(InputError, match="must hold one data set CoMA. Received 2"):
            find_meshes(tmp_path)

    def test_meshes_of_which_none_can_be_used_are_refused(self, tmp_path, embedding):
        folder = tmp_path / "subject" / "smile"
        folder.mkdir(parents=True)
        (folder / "smile.000001.ply").write_text("hello")
        with pytest.raises(
            InputError, match="None of 1 is; the first, .*000001.ply: must be a PLY"
        ):
            load_coma(tmp_path, embedding)


class TestPly:
    @pytest.mark.parametrize("faces", ["vertex_indices", "vertex_index"])
    @pytest.mark.parametrize("dtype", ["f4", "f8"])
    @pytest.mark.parametrize(("text", "order"), [(False, "<"), (False, ">"), (True, "=")])
    def test_meshes_come_back(self, tmp_path, mesh, faces, dtype, text, order):
        vertices = mesh[0].astype(dtype)
        file = write_ply(tmp_path / "a.ply", vertices, mesh[1], text, order, faces)
        found = read_ply(file)
        assert found[0].dtype == np.float64 and found[1].dtype == np.int64
        assert type(found[0]) is type(found[1]) is np.ndarray  # not mapped to the file
        np.testing.assert_array_equal(found[0], vertices)
        np.testing.assert_array_equal(found[1], mesh[1])

    def test_other_properties_and_crlf_in_the_header_do_not_matter(self, tmp_path):
        header = (
            "ply\nformat binary_big_endian 1.0\ncomment a face\nelement vertex 3\n"
            "property uchar red\nproperty float z\nproperty float x\nproperty float y\n"
            "element face 1\nproperty list uchar int vertex_indices\nproperty uchar flags\n"
            "end_header\n"
        )
        body = b"".join(struct.pack(">Bfff", 255, 3, i, 2) for i in range(3))
        body += struct.pack(">BiiiB", 3, 2, 0, 1, 7)
        for line_end in ("\n", "\r\n"):
            file = tmp_path / "a.ply"
            file.write_bytes(header.replace("\n", line_end).encode() + body)
            vertices, triangles = read_ply(file)
            np.testing.assert_array_equal(vertices, [[0, 2, 3], [1, 2, 3], [2, 2, 3]])
            np.testing.assert_array_equal(triangles, [[2, 0, 1]])

    @pytest.mark.parametrize("text", [False, True])
    def test_every_truncated_file_is_refused(self, tmp_path, mesh, text):
        file = write_ply(tmp_path / "a.ply", *mesh, text=text)
        data = file.read_bytes().rstrip()
        for n in range(0, len(data) - 2, 31):
            file.write_bytes(data[:n])
            with pytest.raises(InputError, match="a.ply: must (be|hold|have) "):
                read_ply(file)

    @pytest.mark.parametrize(
        ("old", "new", "message"),
        [
            (b"element vertex 40", b"element vertex 4000000000", "holds what it announces"),
            (b"element face 60", b"element face 99999999999999", "holds what it announces"),
            (b"element face 60", b"element face -60", "must have a PLY header"),
            (b"element face 60", b"element face sixty", "must have a PLY header"),
            (b"element face 60", b"element face 59", None),
            (b"element face 60", b"element face 61", "holds what it announces"),
            (b"property float z\n", b"property float w\n", "vertices x, y, z"),
            (b"element vertex", b"element corner", "Received one without .vertex"),
            (b"element face", b"element edge", "Received one without .face"),
            (b"vertex_indices", b"corner_indices", "faces vertex_indices"),
            (b"1.0\n", b"2.0\n", "must have a PLY header"),
            (b"ply\n", b"plx\n", "must be a PLY file. Received 1.* bytes that begin b'plx"),
            (b"end_header", b"end_heater", "must be a PLY file"),
        ],
    )
    def test_a_header_that_lies_is_refused(self, tmp_path, mesh, old, new, message):
        file = write_ply(tmp_path / "a.ply", *mesh)
        file.write_bytes(file.read_bytes().replace(old, new, 1))
        if message is None:
            assert len(read_ply(file)[1]) == 59
            return
        tracemalloc.start()
        try:
            with pytest.raises(InputError, match=f"a.ply: .*({message})"):
                read_ply(file)
            assert tracemalloc.get_traced_memory()[1] < 1e6
        finally:
            tracemalloc.stop()

    def test_a_false_end_of_the_header_hides_no_counts(self, tmp_path):
        file = tmp_path / "a.ply"
        for comment in ("comment end_header\n", "comment \rend_header\n"):
            file.write_text(
                f"ply\nformat ascii 1.0\n{comment}element face 50000000\n"
                "property list uchar int vertex_indices\nend_header\n",
                newline="",
            )
            with pytest.raises(InputError, match="holds what it announces"):
                read_ply(file)

    def test_bad_numbers_are_refused(self, tmp_path, mesh):
        vertices, triangles = mesh
        file = tmp_path / "a.ply"
        for bad in (np.nan, np.inf):
            write_ply(
                file, np.where(np.arange(V)[:, None] == 7, np.float32(bad), vertices), triangles
            )
            with pytest.raises(InputError, match="a.ply: vertices must be finite"):
                read_ply(file)
        for shift in (-1, V):
            write_ply(file, vertices, triangles + shift)
            with pytest.raises(InputError, match=f"a.ply: faces must number {V} vertices from 0"):
                read_ply(file)

    @pytest.mark.parametrize("text", [False, True])
    def test_faces_that_are_no_triangles_are_refused(self, tmp_path, mesh, text):
        quads = np.hstack([mesh[1], mesh[1][:, :1]])
        file = write_ply(tmp_path / "a.ply", mesh[0], quads, text=text)
        with pytest.raises(InputError, match="a.ply: .*(unexpected list length|be triangles)"):
            read_ply(file)

    @pytest.mark.parametrize("text", [False, True])
    def test_a_mesh_without_faces_is_refused(self, tmp_path, mesh, text):
        file = write_ply(tmp_path / "a.ply", *mesh, text=text)
        file.write_bytes(file.read_bytes().replace(b"element face 60", b"element face 0"))
        with pytest.raises(InputError, match="a.ply: .*must be"):
            read_ply(file)

    def test_a_missing_file_is_refused(self, tmp_path):
        for path in (tmp_path / "absent.ply", tmp_path):
            with pytest.raises(InputError, match=f"{path}: must be"):
                read_ply(path)

    def test_a_mesh_is_not_read_face_by_face(self, tmp_path, mesh):
        vertices, triangles = mesh
        file = write_ply(tmp_path / "a.ply", vertices, np.tile(triangles, (100, 1)))
        calls = 0

        def count(frame, event, value):
            nonlocal calls
            calls += event.endswith("call")

        sys.setprofile(count)
        try:
            read_ply(file)
        finally:
            sys.setprofile(None)
        assert calls < 10 * T
