"""Landmark schemes: what holds for each, where each is on the face models, and conversion."""

import numpy as np
import pytest
from faces import mean_landmarks

from data_gen.landmarks import load_vertices
from data_gen.models.openhead import read_openhead
from deepmds_keras import landmarks
from deepmds_keras.errors import InputError
from deepmds_keras.files import read_table
from deepmds_keras.landmarks import FOLDER, convert, load_scheme, load_schemes, scheme_of

SIZES = {"bfm72": 72, "ibug68": 68, "ibug51": 51, "mediapipe": 468}
PAIRS = {
    int(row["number"]): (int(row["ibug68"]), row["evidence"])
    for row in read_table(FOLDER / "bfm72_ibug68.csv")
}
FARTHEST = {"vertex": 7.0, "place": 3.5}  # mm between the two landmarks on a head model
FIVE = {
    "five.csv": """number,name,group,mirror
1,right_eye_outer_corner,right_eye,2
2,left_eye_outer_corner,left_eye,1
3,nose_tip,nose,3
4,right_mouth_corner,outer_mouth,5
5,left_mouth_corner,outer_mouth,4
""",
    "five_polylines.csv": "polyline,landmarks\n1,1-3-2\n2,4-5\n",
    "five_ibug68.csv": "number,ibug68\n1,37\n2,46\n3,31\n4,49\n5,55\n",
}


@pytest.fixture(params=[name for name, scheme in load_schemes().items() if scheme.polylines])
def scheme(request):
    return load_scheme(request.param)


@pytest.fixture(params=["head", "ict"])
def model(request):
    return request.getfixturevalue(request.param)


def numbered(scheme, n=None):
    """Landmarks whose coordinates are their position, its double and its negative."""
    position = np.arange(float(n or len(load_scheme(scheme))))
    return np.stack([position, 2 * position, -position], axis=1)


def distances(model):
    """`(72, 68)` millimetres on the mean face."""
    bfm72, ibug68 = (model.mean[model.landmarks[scheme]] for scheme in ("bfm72", "ibug68"))
    return np.linalg.norm(bfm72[:, None] - ibug68, axis=-1)


def test_scheme_has_its_number_of_landmarks_each_named_once(scheme):
    n = SIZES[scheme.name]
    assert len(scheme) == len(scheme.names) == len(scheme.groups) == len(scheme.mirror) == n
    assert len(set(scheme.names)) == n
    assert list(scheme.numbers) == sorted(set(scheme.numbers))
    assert all(0 <= i < n for line in scheme.polylines for i in line)
    with pytest.raises(ValueError, match="read-only"):
        scheme.mirror[0] = 1
    with pytest.raises(ValueError, match="read-only"):
        load_vertices(scheme.name).vertices["openhead"][0] = 1


def test_the_number_of_landmarks_tells_the_scheme():
    assert {name: len(scheme) for name, scheme in load_schemes().items()} == SIZES
    actual = [scheme_of(n) for n in (51, 68, 72, 468, 478)]
    assert actual == ["ibug51", "ibug68", "bfm72", "mediapipe", "mediapipe"]
    with pytest.raises(InputError, match=r"51, 68, 72, 468 or 478 landmarks. Received 70\."):
        scheme_of(70)
    with pytest.raises(InputError, match="bfm72, ibug68, ibug51, mediapipe, or .* 'bfm73'"):
        load_scheme("bfm73")


def test_mirror_is_an_involution_that_swaps_right_and_left_also_on_the_open_head(scheme):
    np.testing.assert_array_equal(scheme.mirror[scheme.mirror], np.arange(len(scheme)))
    vertices = load_vertices(scheme.name).vertices["openhead"]
    np.testing.assert_array_equal(read_openhead()["mirror"][vertices], vertices[scheme.mirror])
    swap = {"right": "left", "left": "right"}
    for i, (name, x) in enumerate(
        zip(scheme.names, mean_landmarks(scheme.name)[:, 0], strict=True)
    ):
        side, _, rest = name.partition("_")
        mirrored = f"{swap[side]}_{rest}" if side in swap else name
        assert scheme.names[scheme.mirror[i]] == mirrored
        assert x < -1 if side == "right" else x > 1 if side == "left" else abs(x) < 1


def test_ibug51_is_ibug68_without_the_jaw():
    full, inner = load_scheme("ibug68"), load_scheme("ibug51")
    assert inner.numbers == full.numbers[17:]
    np.testing.assert_array_equal(inner.mirror, full.mirror[17:] - 17)
    vertices = (load_vertices(name).vertices["ict"] for name in ("ibug51", "ibug68"))
    np.testing.assert_array_equal(next(vertices), next(vertices)[17:])
    lines = [tuple(i + 17 for i in line) for line in inner.polylines]
    assert lines == list(full.polylines[1:])
    points = numbered("ibug68")
    np.testing.assert_array_equal(convert(points, "ibug68", "ibug51"), points[17:])


def test_corners_tip_and_chin_are_those_that_everybody_knows():
    mediapipe = convert(numbered("mediapipe"), "mediapipe", "ibug68", missing="nan")[:, 0]
    bfm72 = convert(numbered("bfm72"), "bfm72", "ibug68", missing="nan")[:, 0] + 1
    known = {  # iBUG number: FaceMesh's point, from 0, and landmark of the 72, from 1
        37: (33, 1),
        40: (133, 12),
        43: (362, 46),
        46: (263, 57),
        49: (61, 7),
        55: (291, 51),
        31: (4, 29),
        9: (np.nan, 71),
    }
    for number, points in known.items():
        np.testing.assert_array_equal((mediapipe[number - 1], bfm72[number - 1]), points)


def test_points_that_two_schemes_share_survive_the_way_there_and_back():
    for source in SIZES:
        for target in SIZES:
            there = convert(numbered(source), source, target, missing="nan")
            back = convert(there, target, source, missing="nan")
            known = ~np.isnan(back[:, 0])
            np.testing.assert_array_equal(back[known], numbered(source)[known])
            assert known.sum() == (~np.isnan(there[:, 0])).sum()
            assert np.isnan(there).any(1).sum() == np.isnan(there).all(1).sum()
    refined = numbered("mediapipe", 478)
    for target in ("mediapipe", "ibug51"):
        left_out = convert(refined[:468], "mediapipe", target)
        np.testing.assert_array_equal(convert(refined, "mediapipe", target), left_out)


@pytest.mark.parametrize(
    ("points", "arguments", "message"),
    [
        (np.zeros((68, 2)), ("ibug", "ibug51"), "must be one of bfm72, .* Received 'ibug'"),
        (np.zeros((68, 2)), ("ibug68", "flame"), "must be one of .* Received 'flame'"),
        (np.zeros((51, 2)), ("ibug68", "ibug51"), r"L = 68, .* Received \(51, 2\) of float64"),
        (np.zeros((470, 3)), ("mediapipe", "ibug51"), r"L = 468 or 478, .* Received \(470, 3\)"),
        (np.zeros((68, 4)), ("ibug68", "ibug51"), "d = 2 or 3"),
        (np.zeros(68), ("ibug68", "ibug51"), "Received"),
        (np.full((68, 2), "a"), ("ibug68", "ibug51"), "must be numbers"),
    ],
)
def test_what_is_not_of_the_source_is_refused(points, arguments, message):
    with pytest.raises(InputError, match=message):
        convert(points, *arguments)
    with pytest.raises(InputError, match=r"in bfm72, or missing .* without 28 of the 51: \[19, "):
        convert(np.zeros((72, 2)), "bfm72", "ibug51")
    with pytest.raises(InputError, match="missing must be"):
        convert(np.zeros((68, 2)), "ibug68", "ibug51", missing="zero")


def test_pairs_of_the_72_and_the_68_are_the_same_point_on_both_head_models(model):
    bfm72, ibug68 = load_scheme("bfm72"), load_scheme("ibug68")
    assert len({number for number, _ in PAIRS.values()}) == len(PAIRS) == 24
    for number, (match, evidence) in PAIRS.items():
        mirrored = int(bfm72.mirror[number - 1]) + 1
        assert PAIRS[mirrored] == (int(ibug68.mirror[match - 1]) + 1, evidence)
        assert distances(model)[number - 1, match - 1] < FARTHEST[evidence], (number, match)
    near = distances(model) < FARTHEST["place"]
    alike = np.array(bfm72.names)[:, None] == np.array(ibug68.names)
    actual = {tuple(map(int, pair)) for pair in np.argwhere(near & alike) + 1}
    by_place = {(number, match) for number, (match, how) in PAIRS.items() if how == "place"}
    assert by_place <= actual <= {(number, match) for number, (match, _) in PAIRS.items()}


def test_a_scheme_that_tables_alone_describe_is_like_the_others(tmp_path, monkeypatch):
    for name, text in FIVE.items():
        (tmp_path / name).write_text(text)
    for table in FOLDER.glob("*.csv"):
        (tmp_path / table.name).write_bytes(table.read_bytes())
    with (tmp_path / "schemes.csv").open("a") as file:
        file.write("five,five,1,5,\n")
    monkeypatch.setattr(landmarks, "FOLDER", tmp_path)
    load_schemes.cache_clear()
    try:
        assert scheme_of(5) == "five" and load_scheme("five").index("nose_tip") == 2
        ibug68 = np.random.default_rng(0).random((3, 68, 2))
        expected = ibug68[:, [36, 45, 30, 48, 54]]
        np.testing.assert_array_equal(convert(ibug68, "ibug68", "five"), expected)
        assert not np.isnan(convert(np.zeros((478, 3)), "mediapipe", "five")).any()
    finally:
        load_schemes.cache_clear()
