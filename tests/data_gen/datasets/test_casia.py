"""CASIA-3D FaceV1: every layout is found, the index decides, scans come in our frame."""

import os
import struct
from functools import cache

import numpy as np
import pytest
from PIL import Image
from writers.scans import asc, vrml

from data_gen.datasets.casia import (
    CasiaScan,
    find_scans,
    load_scan,
    read_index,
    to_world,
    write_index,
)
from data_gen.models.openhead import load_openhead
from data_gen.views.projections import Cameras, rotations
from deepmds_keras.errors import InputError

DISTANCE = 1000.0  # mm from the scanner
# What a camera that looks along +z with y down has, from our frame.
HALF_TURN = np.array([1.0, -1.0, -1.0])
IMAGE = np.random.default_rng(0).integers(0, 255, (12, 16, 3), np.uint8)


@cache
def head_surface():
    """Points spread evenly over a head."""
    head, rng = load_openhead(), np.random.default_rng(0)
    corners = head.mean[head.triangles]
    areas = np.linalg.norm(np.cross(*np.diff(corners, axis=1).swapaxes(0, 1)), axis=1)
    triangles = rng.choice(len(areas), 60_000, p=areas / areas.sum())
    weights = rng.dirichlet([1, 1, 1], len(triangles))
    return np.einsum("nk,nkd->nd", weights, corners[triangles])


@cache
def seen_head(yaw=0.0, pitch=0.0, roll=0.0):
    """Points of a head that a scanner at the origin sees, the nearest of each cell; our frame."""
    angles = (np.array([float(angle)]) for angle in (yaw, pitch, roll))
    turn = rotations(Cameras(np.zeros(1, int), *angles, np.zeros(1)))[0]
    points = head_surface() @ turn.T
    points = points[np.argsort(-points[:, 2])]
    _, nearest = np.unique((points[:, :2] // 4) @ [1000, 1], return_index=True)
    return points[nearest] - [0, 0, DISTANCE]


def shoulders():
    """The front of an ellipsoid under the head, as densely covered as the head."""
    x, y = np.random.default_rng(0).uniform(-1, 1, (2, 8000))
    depth = np.sqrt(np.maximum(1 - x**2 - y**2, 0))
    front = np.stack([x, y, depth], axis=1)[depth > 0.1]
    return front * [220, 90, 95] + [0, -290, -20 - DISTANCE]


def touch(*files):
    for file in files:
        file.parent.mkdir(parents=True, exist_ok=True)
        file.touch()


def touch_scans(root, *stems):
    for stem in stems:
        touch(root / "WRL" / stem[:3] / f"{stem}.wrl", root / "BMP" / stem[:3] / f"{stem}.bmp")


def names(scans):
    return [f"{scan.subject}-{scan.scan:03d}" for scan in scans]


@pytest.fixture
def said():
    """Sentences that were reported."""
    return []


class TestFinding:
    @pytest.mark.parametrize(
        ("clouds", "images"),
        [
            ("3D-Face-WRL/{0}/{1}.wrl", "3D-Face-BMP/{0}/{1}.bmp"),
            ("3D-Face-WRL1-30/WRL1-30/{0}/{1}.wrl", "3D-Face-BMP1-30/BMP1-30/{0}/{1}.bmp"),
            ("CASIA-3D-FaceV1/CASIA-3D-FaceV1/3D-Face-WRL/{0}/{1}.wrl", "a/b/c/{0}/{1}.bmp"),
            ("3D-Face-WRL/{0}/{1}.WRL", "3D-Face-BMP/{0}/{1}.BMP"),
            ("3D-Face-ASC/{0}/{1}.asc", "3D-Face-BMP/{0}/{1}.jpg"),
            ("{0}/{1}.Asc", "{0}/{1}.PNG"),
            ("{1}.wrl", "{1}.jpeg"),
        ],
    )
    def test_every_layout_is_found(self, tmp_path, said, clouds, images):
        stems = ["001-001", "001-002", "031-001", "123-037"]
        expected = []
        for stem in stems:
            cloud, image = (tmp_path / path.format(stem[:3], stem) for path in (clouds, images))
            touch(cloud, image)
            expected.append(CasiaScan(stem[:3], int(stem[4:]), image=image, points=cloud))
        assert find_scans(tmp_path, said.append) == expected
        assert said == []

    def test_archives_of_thirty_subjects_may_lie_side_by_side(self, tmp_path, said):
        for part, subject in (("91-123", "100"), ("1-30", "002"), ("31-60", "031")):
            for kind in ("WRL", "BMP"):
                folder = tmp_path / f"3D-Face-{kind}{part}" / f"{kind}{part}" / subject
                touch(*(folder / f"{subject}-00{k}.{kind.lower()}" for k in (2, 1)))
        expected = ["002-001", "002-002", "031-001", "031-002", "100-001", "100-002"]
        assert names(find_scans(tmp_path, said.append)) == expected

    def test_other_files_are_passed_over(self, tmp_path, said):
        touch_scans(tmp_path, "001-001")
        for name in ("Thumbs.db", "._001-001.bmp", "1-1.bmp", "001-0012.wrl", "001-001.txt"):
            touch(tmp_path / "BMP" / "001" / name)
        (tmp_path / "WRL" / "001-002.wrl").mkdir()
        assert names(find_scans(tmp_path, said.append)) == ["001-001"]
        assert said == []

    def test_of_two_copies_the_first_path_is_taken_and_the_other_reported(self, tmp_path, said):
        touch_scans(tmp_path / "b", "001-001", "001-002")
        touch_scans(tmp_path / "a", "001-001")
        touch_scans(tmp_path / "c", "001-001")
        scans = find_scans(tmp_path, said.append)
        assert [scan.image.relative_to(tmp_path).parts[0] for scan in scans] == ["a", "b"]
        assert [scan.points.relative_to(tmp_path).parts[0] for scan in scans] == ["a", "b"]
        assert len(said) == 1
        assert f"{tmp_path}: 4 further copies are not used, such as {tmp_path}/b" in said[0]

    def test_vrml_goes_before_asc_and_bmp_before_jpg(self, tmp_path, said):
        touch(*(tmp_path / end / f"001-001.{end}" for end in ("asc", "jpg", "bmp", "wrl")))
        (scan,) = find_scans(tmp_path, said.append)
        assert (scan.points.suffix, scan.image.suffix) == (".wrl", ".bmp")

    def test_halves_of_scans_are_counted_and_reported(self, tmp_path, said):
        touch_scans(tmp_path, "001-001", "001-002", "001-003", "001-004")
        (tmp_path / "WRL" / "001" / "001-001.wrl").unlink()
        (tmp_path / "BMP" / "001" / "001-002.bmp").unlink()
        (tmp_path / "BMP" / "001" / "001-004.bmp").unlink()
        assert names(find_scans(tmp_path, said.append)) == ["001-003"]
        without_image, without_points = said
        assert f"2 scans have no image, such as {tmp_path}/WRL/001/001-002.wrl." in without_image
        assert f"1 images have no scan, such as {tmp_path}/BMP/001/001-001.bmp." in without_points

    def test_reports_are_printed_unless_one_listens(self, tmp_path, capsys):
        touch_scans(tmp_path, "001-001")
        touch(tmp_path / "002-001.bmp")
        find_scans(tmp_path)
        assert "1 images have no scan" in capsys.readouterr().out

    def test_nothing_found_tells_the_layout(self, tmp_path, said):
        with pytest.raises(InputError, match=f"{tmp_path}: .*3D-Face-WRL/001/001-001.wrl and .*"):
            find_scans(tmp_path, said.append)
        touch(*(tmp_path / f"001-00{k}.bmp" for k in range(1, 4)))
        with pytest.raises(InputError, match="Received 0 scans and 3 images, no two of one name"):
            find_scans(tmp_path, said.append)

    def test_a_missing_folder_is_refused(self, tmp_path):
        touch(tmp_path / "file")
        for path in (tmp_path / "absent", tmp_path / "file"):
            with pytest.raises(InputError, match=f"{path}: must be the folder of CASIA-3D"):
                find_scans(path)


class TestIndex:
    @pytest.fixture
    def scans(self, tmp_path):
        touch_scans(tmp_path, "001-001", "001-002", "002-001", "123-037")
        return find_scans(tmp_path)

    @pytest.fixture
    def index(self, tmp_path):
        def write(*rows, columns="subject,scan,use,condition"):
            (tmp_path / "index.csv").write_text("\n".join(["# a comment", columns, *rows]))
            return tmp_path / "index.csv"

        return write

    def test_the_default_uses_every_scan(self, tmp_path, scans):
        path = tmp_path / "made" / "index.csv"
        write_index(path, scans)
        assert read_index(path, scans) == scans
        lines = path.read_text().splitlines()
        table = [line for line in lines if not line.startswith("#")]
        assert table[:2] == ["subject,scan,use,condition", "001,1,yes,"]
        comments = "".join(line for line in lines if line.startswith("#"))
        assert "3937 of 4624" in comments and "None of this is verified" in comments
        # A spreadsheet would wrap such lines in quotes, and they would no longer be comments.
        assert "," not in comments and '"' not in comments

    def test_an_index_that_exists_is_never_overwritten(self, index, scans):
        path = index("001,1,yes,smile")
        with pytest.raises(InputError, match=f"{path}: must not exist yet; delete it"):
            write_index(path, scans)
        assert [scan.condition for scan in read_index(path, scans)] == ["smile"]

    def test_the_table_chooses_and_names(self, index, scans):
        path = index("123,37,YES, smile ", "001,2,no,anger", "002,001,1,", "001,1,0,")
        chosen = read_index(path, scans)
        assert names(chosen) == ["002-001", "123-037"]
        assert [scan.condition for scan in chosen] == ["", "smile"]
        assert [scan.points for scan in chosen] == [scan.points for scan in scans[2:]]

    def test_numbers_may_lose_their_zeros_and_lines_gain_commas(self, index, scans):
        path = index("1,1,yes,", "2,1,yes,a")
        path.write_text(path.read_text().replace("# a comment", "# a comment,,,"))
        assert names(read_index(path, scans)) == ["001-001", "002-001"]

    def test_conditions_that_were_written_come_back(self, index, tmp_path, scans):
        chosen = read_index(index('001,1,yes,"smile, side light"'), scans)
        write_index(tmp_path / "again.csv", chosen)
        assert read_index(tmp_path / "again.csv", scans) == chosen
        assert chosen[0].condition == "smile, side light"

    @pytest.mark.parametrize(
        ("row", "columns", "message"),
        [
            ("001,1,yes,", "subject,scan,used,condition", "must have columns subject,scan,use,con"),
            ("001,1,yes", "subject,scan,use", "must have columns subject,scan,use,condition"),
            ("001,1,yes,,x", "subject,scan,use,condition,note", "must have columns"),
            ("001;1;yes;", "subject;scan;use;condition", "must have columns"),
            ("001,1,yes", None, "must have columns .* Received the row"),
            ("001,1,yes,a,b", None, "must have columns .* Received the row"),
            ("004,1,yes,", None, "must list scans that exist. Received 004-001"),
            ("001,3,no,", None, "must list scans that exist. Received 001-003"),
            ("one,1,yes,", None, "subject and scan must be numbers. Received .*'one'"),
            ("001,,yes,", None, "subject and scan must be numbers"),
            ("001,1,maybe,", None, "use must be yes, no, 1 or 0. Received 'maybe'"),
            ("001,1,,", None, "use must be yes, no, 1 or 0. Received ''"),
            ("001,1,no,", None, "must use at least one scan. Received 1 rows, none"),
            ("", None, "must use at least one scan. Received 0 rows, none"),
        ],
    )
    def test_a_malformed_table_is_refused(self, index, scans, row, columns, message):
        path = index(row, **({"columns": columns} if columns else {}))
        with pytest.raises(InputError, match=f"{path}: {message}"):
            read_index(path, scans)

    def test_a_scan_that_is_listed_twice_is_refused(self, index, scans):
        path = index("001,2,yes,", "1,2,no,")
        with pytest.raises(InputError, match=f"{path}: must list a scan once. Received 001-002"):
            read_index(path, scans)

    def test_what_is_no_text_is_refused(self, tmp_path, scans):
        (tmp_path / "binary.csv").write_bytes(b"\xff\xfe\x00")
        for path in (tmp_path / "binary.csv", tmp_path / "absent.csv", tmp_path):
            with pytest.raises(InputError, match=f"{path} must be a table"):
                read_index(path, scans)


class TestLoading:
    @pytest.fixture
    def scan(self, tmp_path):
        """One of a head with y down and z away, as a camera has it."""
        (tmp_path / "001-001.wrl").write_text(vrml(seen_head() * HALF_TURN))
        Image.fromarray(IMAGE).save(tmp_path / "001-001.bmp")
        return CasiaScan("001", 1, tmp_path / "001-001.bmp", tmp_path / "001-001.wrl")

    def test_image_and_points_come_back_in_our_frame(self, scan):
        image, points = load_scan(scan)
        assert image.dtype == np.uint8 and points.dtype == np.float64
        np.testing.assert_array_equal(image, IMAGE)
        np.testing.assert_array_equal(points, seen_head())

    def test_bare_lines_and_other_images_are_read_too(self, scan, tmp_path):
        other = tmp_path / "001-001.ASC"
        other.write_text(asc(seen_head()))
        png = tmp_path / "001-001.PNG"
        Image.fromarray(IMAGE).save(png)
        image, points = load_scan(CasiaScan("001", 1, png, other))
        np.testing.assert_array_equal(image, IMAGE)
        np.testing.assert_array_equal(points, seen_head())

    @pytest.mark.parametrize("mode", ["L", "P", "1"])
    def test_an_image_of_any_colours_becomes_rgb(self, scan, mode):
        converted = Image.fromarray(IMAGE).convert(mode)
        converted.save(scan.image)
        np.testing.assert_array_equal(load_scan(scan)[0], np.array(converted.convert("RGB")))

    def test_a_truncated_image_is_refused(self, scan):
        whole = scan.image.read_bytes()
        for size in (0, 1, 20, 54, 300, len(whole) - 1):
            scan.image.write_bytes(whole[:size])
            with pytest.raises(InputError, match=f"{scan.image}: must be a whole BMP, PNG or JPEG"):
                load_scan(scan)

    def test_a_file_that_is_no_image_is_refused(self, scan):
        for content in (b"text", os.urandom(500), b"BM" + os.urandom(500), b"\x89PNG\r\n\x1a\n"):
            scan.image.write_bytes(content)
            with pytest.raises(InputError, match=f"{scan.image}: must be a whole BMP"):
                load_scan(scan)
        Image.fromarray(IMAGE).save(scan.image, format="GIF")
        with pytest.raises(InputError, match=f"{scan.image}: must be a whole BMP"):
            load_scan(scan)
        scan.image.unlink()
        with pytest.raises(InputError, match=f"{scan.image}: must be a whole BMP"):
            load_scan(scan)

    @pytest.mark.parametrize("side", [10_000, 60_000])
    def test_an_image_that_would_fill_the_memory_is_refused(self, scan, side):
        content = bytearray(scan.image.read_bytes())
        struct.pack_into("<ii", content, 18, side, side)  # width and height of a BMP
        scan.image.write_bytes(content)
        with pytest.raises(InputError, match=f"{scan.image}: .* bomb"):
            load_scan(scan)

    @pytest.mark.parametrize(
        ("text", "message"),
        [
            ("", "must be a VRML text"),
            ("point [ 1 2 3, 4 5", "must end its block"),
            (vrml(seen_head()).replace("-", "nan ", 1), "must"),
            (vrml(seen_head()[:499]), "points must be at least 500. Received 499"),
            (vrml(seen_head() / 1000), "extend over 50 to 1000 mm. Received 0."),
        ],
    )
    def test_damaged_points_are_refused_by_name(self, scan, text, message):
        scan.points.write_text(text)
        with pytest.raises(InputError, match=f"{scan.points}: .*{message}"):
            load_scan(scan)


POSES = [
    {},
    {"yaw": 30},
    {"yaw": -60},
    {"yaw": 90},
    {"yaw": -90, "roll": 15},
    {"pitch": 35},
    {"pitch": -35},
    {"yaw": 45, "pitch": -25},
    {"roll": 40},
]


class TestFrame:
    @pytest.mark.parametrize("pose", POSES, ids=str)
    def test_points_of_either_frame_come_to_ours_in_every_pose(self, pose):
        points = seen_head(**pose)
        np.testing.assert_array_equal(to_world(points), points)
        np.testing.assert_array_equal(to_world(points * HALF_TURN), points)

    @pytest.mark.parametrize("pose", POSES, ids=str)
    def test_shoulders_do_not_mislead(self, pose):
        points = np.concatenate([seen_head(**pose), shoulders()])
        np.testing.assert_array_equal(to_world(points * HALF_TURN), points)
        np.testing.assert_array_equal(to_world(points), points)

    def test_depth_alone_would_be_misled_by_shoulders(self):
        points = np.concatenate([seen_head(), shoulders()])
        distance = np.linalg.norm((points - np.median(points, axis=0))[:, :2], axis=1)
        assert np.corrcoef(points[:, 2], distance)[0, 1] > 0.1  # the rim is nearer than the middle

    def test_the_origin_may_be_anywhere(self):
        points = seen_head()
        for offset in ([0, 0, DISTANCE], [30, -50, 2 * DISTANCE], [0, 0, -DISTANCE]):
            moved = points + offset
            np.testing.assert_array_equal(to_world(moved), moved)
            np.testing.assert_array_equal(to_world(moved * HALF_TURN), moved)

    def test_noise_holes_and_stray_points_do_not_mislead(self):
        rng = np.random.default_rng(0)
        points = seen_head(yaw=20) + rng.normal(0, 2, seen_head(yaw=20).shape)
        points = points[np.linalg.norm(points[:, :2] - [20, 40], axis=1) > 15]
        points[::100, 2] += rng.normal(0, 60, len(points[::100]))
        np.testing.assert_array_equal(to_world(points * HALF_TURN), points)

    def test_a_mirrored_scan_stays_mirrored(self):
        points = seen_head(yaw=30)
        for mirror in ([-1, 1, 1], [1, -1, 1], [1, 1, -1]):
            given = points * mirror
            found = to_world(given)
            volumes = [
                np.linalg.det(cloud[[0, 500, 1000]] - cloud[1500]) for cloud in (given, found)
            ]
            np.testing.assert_allclose(*volumes)

    def test_the_given_points_are_not_changed(self):
        points = seen_head() * HALF_TURN
        before = points.copy()
        to_world(points)
        np.testing.assert_array_equal(points, before)

    def test_a_plane_is_refused(self):
        flat = np.random.default_rng(0).uniform(-100, 100, (3000, 3)) * [1, 1, 0]
        tilted = flat + flat[:, :1] * [0, 0, 0.5]
        for plane in (flat, tilted, flat + [0, 0, DISTANCE]):
            with pytest.raises(
                InputError, match="bulges towards the scanner. .* 0 patches .* 0 ag"
            ):
                to_world(plane)

    def test_as_many_bulges_each_way_are_refused(self):
        rng = np.random.default_rng(0)
        wave = rng.uniform(-200, 200, (5000, 3))
        wave[:, 2] = 30 * np.cos(wave[:, 0] * np.pi / 100)
        with pytest.raises(
            InputError, match="must be of a surface that bulges towards the scanner"
        ):
            to_world(wave)

    def test_too_few_points_or_another_unit_are_refused(self):
        points = seen_head()
        with pytest.raises(InputError, match="points must be at least 500. Received 499"):
            to_world(points[:499])
        for factor in (0.001, 0.1, 10, 1000):
            with pytest.raises(InputError, match="points must extend over 50 to 1000 mm"):
                to_world(points * factor)
        strays = np.concatenate([points, [[0, 0, 1e6], [1e300, -1e300, 0]]])
        assert len(to_world(strays)) == len(strays)
