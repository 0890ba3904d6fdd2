"""Landmark schemes: which points of two are the same, and what the document shows of it."""

import re

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from places import ROOT, SHARED

from data_gen.landmarks import load_vertices
from data_gen.models.ict import load_ict
from data_gen.models.openhead import load_openhead
from deepmds_keras.errors import InputError
from deepmds_keras.files import read_table
from deepmds_keras.landmarks import FOLDER, load_scheme, load_schemes
from deepmds_keras.landmarks.conversion import convert, scheme_of
from docs.make_pictures import numbered, place_numbers

SCHEMES = tuple(load_schemes())
DOCUMENT = (ROOT / "docs" / "landmarks.md").read_text(encoding="utf-8")
PAIRS = {
    int(row["number"]): (int(row["ibug68"]), row["evidence"])
    for row in read_table(FOLDER / "bfm72_ibug68.csv")
}
FARTHEST = {"vertex": 7.0, "place": 3.5}  # mm between the two landmarks on a head model
LACKED = {  # by source and target
    ("ibug68", "ibug51"): 0,
    ("ibug51", "ibug68"): 17,
    ("ibug68", "bfm72"): 48,
    ("ibug51", "bfm72"): 49,
    ("bfm72", "ibug68"): 44,
    ("bfm72", "ibug51"): 28,
    ("mediapipe", "ibug51"): 0,
    ("mediapipe", "ibug68"): 17,
    ("mediapipe", "bfm72"): 49,
    ("ibug51", "mediapipe"): 417,
    ("ibug68", "mediapipe"): 417,
    ("bfm72", "mediapipe"): 445,
}


def numbered_points(scheme, n=None):
    """Landmarks whose coordinates are their own position, its double and its negative."""
    position = np.arange(float(n or len(load_scheme(scheme))))
    return np.stack([position, 2 * position, -position], axis=1)


@pytest.fixture(params=["openhead", "ict"])
def model(request):
    if request.param == "openhead":
        return load_openhead()
    path = SHARED / "ict-facekit" / "ict_light.npz"
    if not path.is_file():
        pytest.skip("../shared/ict-facekit is absent")
    return load_ict(path)


def test_ibug51_is_ibug68_without_the_first_17():
    np.testing.assert_array_equal(
        convert(numbered_points("ibug68"), "ibug68", "ibug51"), numbered_points("ibug68")[17:]
    )


def test_corners_tip_and_chin_are_those_that_everybody_knows():
    mediapipe = convert(numbered_points("mediapipe"), "mediapipe", "ibug68", missing="nan")[:, 0]
    bfm72 = convert(numbered_points("bfm72"), "bfm72", "ibug68", missing="nan")[:, 0] + 1
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
    for source in SCHEMES:
        for target in SCHEMES:
            there = convert(numbered_points(source), source, target, missing="nan")
            back = convert(there, target, source, missing="nan")
            known = ~np.isnan(back[:, 0])
            np.testing.assert_array_equal(back[known], numbered_points(source)[known])
            assert known.sum() == (~np.isnan(there[:, 0])).sum()


@pytest.mark.parametrize(("source", "target"), LACKED)
def test_as_many_landmarks_are_lacking_as_the_document_says(source, target):
    converted = convert(numbered_points(source), source, target, missing="nan")
    assert len(converted) == len(load_scheme(target))
    assert np.isnan(converted).any(1).sum() == np.isnan(converted).all(1).sum()
    assert np.isnan(converted[:, 0]).sum() == LACKED[source, target]


def test_a_scheme_without_all_landmarks_of_the_target_is_refused_with_their_numbers():
    for source, target, message in (
        ("ibug51", "ibug68", r"without 17 of the 68: 1-17\."),
        ("bfm72", "ibug51", r"without 28 of the 51: 19, 21, 24, 26, 28-30, 32-33, …\."),
        ("ibug51", "mediapipe", "without 417 of the 468: 1, 3, 6-12, 15-16,"),
    ):
        with pytest.raises(InputError, match=f'in {source}, or missing must be "nan".*{message}'):
            convert(numbered_points(source), source, target)


def test_irises_of_mediapipe_are_left_out():
    refined = numbered_points("mediapipe", 478)
    for target in ("mediapipe", "ibug51"):
        np.testing.assert_array_equal(
            convert(refined, "mediapipe", target),
            convert(refined[:468], "mediapipe", target),
        )


def test_many_faces_are_converted_as_each_by_itself(rng):
    faces = rng.normal(size=(4, 68, 2)).astype(np.float32)
    converted = convert(faces, "ibug68", "bfm72", missing="nan")
    assert converted.dtype == np.float32
    for face, expected in zip(faces, converted, strict=True):
        np.testing.assert_array_equal(convert(face, "ibug68", "bfm72", missing="nan"), expected)


def test_whole_numbers_become_floats_and_the_input_stays_as_it_is():
    pixels = np.arange(136).reshape(68, 2)
    converted = convert(pixels, "ibug68", "ibug68")
    converted[:] = 0
    assert converted.dtype == float
    assert pixels[3, 1] == 7


@pytest.mark.parametrize(
    ("landmarks", "arguments", "message"),
    [
        (np.zeros((68, 2)), ("ibug", "ibug51"), "source must be one of bfm72, .* Received 'ibug'"),
        (np.zeros((68, 2)), ("ibug68", "flame"), "target must be one of .* Received 'flame'"),
        (np.zeros((51, 2)), ("ibug68", "ibug51"), r"L = 68, .* Received \(51, 2\) of float64"),
        (np.zeros((470, 3)), ("mediapipe", "ibug51"), r"L = 468 or 478, .* Received \(470, 3\)"),
        (np.zeros((68, 4)), ("ibug68", "ibug51"), "d = 2 or 3"),
        (np.zeros(68), ("ibug68", "ibug51"), "Received"),
        (np.full((68, 2), "a"), ("ibug68", "ibug51"), "must be numbers"),
    ],
)
def test_what_is_not_of_the_source_is_refused(landmarks, arguments, message):
    with pytest.raises(InputError, match=message):
        convert(landmarks, *arguments)


def test_an_unknown_way_to_treat_missing_landmarks_is_refused():
    with pytest.raises(InputError, match="missing must be one of raise, nan. Received 'zero'"):
        convert(np.zeros((68, 2)), "ibug68", "ibug51", missing="zero")


def test_the_number_of_landmarks_tells_the_scheme():
    numbers = (51, 68, 72, 468, 478)
    found = [scheme_of(n) for n in numbers]
    assert found == ["ibug51", "ibug68", "bfm72", "mediapipe", "mediapipe"]
    with pytest.raises(InputError, match=r"72 \(bfm72\), 68 \(ibug68\), .* Received 70\."):
        scheme_of(70)


def test_pairs_of_the_72_and_the_68_are_one_to_one_and_mirrored():
    bfm72, ibug68 = load_scheme("bfm72"), load_scheme("ibug68")
    assert len({number for number, _ in PAIRS.values()}) == len(PAIRS) == 24
    for ours, (theirs, evidence) in PAIRS.items():
        mirrored = int(bfm72.mirror[ours - 1]) + 1
        assert PAIRS[mirrored] == (int(ibug68.mirror[theirs - 1]) + 1, evidence)


def test_paired_landmarks_are_the_same_point_on_both_head_models(model):
    for ours, (theirs, evidence) in PAIRS.items():
        apart = distances(model)[ours - 1, theirs - 1]
        assert apart < FARTHEST[evidence], (ours, theirs, apart)


def test_pairs_by_place_are_all_that_are_named_alike_and_near(model):
    near = distances(model) < FARTHEST["place"]
    bfm72, ibug68 = load_scheme("bfm72").names, load_scheme("ibug68").names
    alike = np.array(bfm72)[:, None] == np.array(ibug68)
    found = {tuple(map(int, pair)) for pair in np.argwhere(near & alike) + 1}
    by_place = {(ours, theirs) for ours, (theirs, how) in PAIRS.items() if how == "place"}
    assert by_place <= found
    assert found <= {(ours, theirs) for ours, (theirs, _) in PAIRS.items()}


def test_pairs_by_vertex_are_those_with_the_same_number_on_the_basel_model():
    """The nose tip apart, whose number is another landmark's if the base is mistaken."""
    ours = load_vertices("bfm72").anchors["bfm2009"]  # from 0; the authors count from 1
    theirs = load_vertices("ibug68").anchors["bfm2009"]
    same = {
        i + 1: j + 1 for i, vertex in ours.items() for j, v in theirs.items() if v == vertex + 1
    }
    by_vertex = {i: number for i, (number, how) in PAIRS.items() if how == "vertex"}
    assert same.pop(28) == by_vertex.pop(29) == 31
    assert ours[28] == theirs[30]
    assert same == by_vertex


def test_the_document_has_every_pair_and_how_far_it_is_apart(model):
    column = {"openhead": 4, "ict": 5}[model.name]
    shown = {}
    for row in rows_under("| point | of the 72 | of the 68 |"):
        ours, theirs = (list(map(int, cell.split(" / "))) for cell in row[1:3])
        apart = max(distances(model)[i - 1, j - 1] for i, j in zip(ours, theirs, strict=True))
        assert row[column] == f"{apart:.1f}", row
        shown |= {i: (j, row[3]) for i, j in zip(ours, theirs, strict=True)}
    assert shown == PAIRS


def test_the_document_says_how_many_landmarks_each_conversion_gives():
    rows = rows_under("| from \\ to |")
    for row in rows:
        source = row[0].strip("`")
        for target, cell in zip(SCHEMES, row[1:], strict=True):
            converted = convert(numbered_points(source), source, target, missing="nan")
            assert int(cell) == (~np.isnan(converted[:, 0])).sum(), (source, target)
    assert len(rows) == len(SCHEMES)


def test_the_document_lists_the_points_of_mediapipe():
    listed = [int(n) for n in DOCUMENT.split("```\n 70")[1].split("```")[0].split()]
    points = convert(numbered_points("mediapipe"), "mediapipe", "ibug51")[:, 0]
    assert [70, *listed] == points.tolist()


def test_examples_of_the_document_run():
    examples = re.findall(r"```python\n(.*?)```", DOCUMENT, re.S)
    names = {}
    for example in examples:
        exec(example, names)
    assert names["faces"].shape == (10, 51, 2)
    assert names["known"].sum() == 24
    assert (names["scheme"].numbers[13], names["scheme"].names[13]) == (31, "nose_tip")


def test_links_and_pictures_of_the_document_are_there_and_small():
    links = re.findall(r"\]\((?!https?:|#)([^)]+)\)", DOCUMENT)
    pictures = [ROOT / "docs" / link for link in links if link.endswith(".png")]
    assert all((ROOT / "docs" / link).exists() for link in links)
    assert len(pictures) == 3
    assert all(picture.stat().st_size < 300_000 for picture in pictures)


def test_numbers_in_a_picture_hide_neither_each_other_nor_a_landmark():
    head = load_openhead()
    points = head.mean[head.landmarks["ibug51"], :2] * (8, -8)
    labels = [str(number) for number in load_scheme("ibug51").numbers]
    spots = place_numbers(points, labels)
    text = np.array((30, 16))  # pixels of two digits, without the room about them
    over = (np.abs(spots[:, None] - spots) < text).all(-1)
    assert over.sum() == len(points)
    assert not (np.abs(spots[:, None] - points) < text / 2).all(-1).any()
    nearest = np.linalg.norm(spots[:, None] - points, axis=-1).argmin(1)
    assert (nearest == np.arange(len(points))).mean() > 0.8


def test_a_picture_is_as_large_as_the_image_and_shows_each_landmark_where_it_is():
    image = np.full((200, 300, 3), 200, np.uint8)
    points = np.array([(40.0, 50.0), (250.0, 160.0)])
    figure = numbered(image, points, ["1", "23"], ["nose", "right_eye"], [(0, 1)])
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    shown = np.asarray(canvas.buffer_rgba())[..., :3]
    assert shown.shape == image.shape
    for (x, y), colour in zip(points.astype(int), ((0, 103, 74), (0, 91, 150)), strict=True):
        assert np.abs(shown[y, x].astype(int) - colour).max() < 10
    assert {text.get_text() for text in figure.axes[0].texts} >= {"1", "23"}


def rows_under(head):
    """Cells of the document's table whose first line begins like that."""
    lines = DOCUMENT[DOCUMENT.index(f"\n{head}") + 1 :].split("\n\n")[0].splitlines()[2:]
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in lines]


def distances(model):
    """`(72, 68)` millimetres on the mean face."""
    bfm72, ibug68 = (model.mean[model.landmarks[scheme]] for scheme in ("bfm72", "ibug68"))
    return np.linalg.norm(bfm72[:, None] - ibug68, axis=-1)


@pytest.fixture
def rng():
    return np.random.default_rng(0)
