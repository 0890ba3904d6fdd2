"""Landmark tables: what holds for every scheme, and where each is on the face models."""

import csv

import numpy as np
import pytest
from places import SHARED

from data_gen.landmarks import load_basel_anchors, load_vertices
from data_gen.models.openhead import load_openhead, read_openhead
from deepmds_keras.errors import InputError
from deepmds_keras.landmarks import load_scheme, load_schemes

SIZES = {"bfm72": 72, "ibug68": 68, "ibug51": 51, "mediapipe": 468}


@pytest.fixture(params=[name for name, scheme in load_schemes().items() if scheme.names])
def scheme(request):
    return load_scheme(request.param)


def test_scheme_has_its_number_of_landmarks_each_named_once(scheme):
    n = SIZES[scheme.name]
    assert len(scheme) == len(scheme.names) == len(scheme.groups) == len(scheme.mirror) == n
    assert len(set(scheme.names)) == n
    assert list(scheme.numbers) == sorted(set(scheme.numbers))


def test_no_two_schemes_are_taken_for_each_other_by_their_number_of_landmarks():
    schemes = load_schemes()
    assert {name: len(scheme) for name, scheme in schemes.items()} == SIZES
    sizes = [size for scheme in schemes.values() for size in scheme.sizes]
    assert len({*sizes}) == len(sizes)


def test_mirror_is_an_involution_that_swaps_right_and_left(scheme):
    np.testing.assert_array_equal(scheme.mirror[scheme.mirror], np.arange(len(scheme)))
    swap = {"right": "left", "left": "right"}
    for i, name in enumerate(scheme.names):
        side, _, rest = name.partition("_")
        mirrored = f"{swap[side]}_{rest}" if side in swap else name
        assert scheme.names[scheme.mirror[i]] == mirrored


def test_right_is_the_subjects_right_on_the_open_head(scheme):
    x = load_openhead().mean[load_vertices(scheme.name).vertices["openhead"], 0]
    for name, across in zip(scheme.names, x, strict=True):
        side = name.split("_")[0]
        assert across < -1 if side == "right" else across > 1 if side == "left" else abs(across) < 1


def test_open_head_vertices_are_closed_under_its_mirror(scheme):
    vertices = load_vertices(scheme.name).vertices["openhead"]
    np.testing.assert_array_equal(read_openhead()["mirror"][vertices], vertices[scheme.mirror])


def test_tables_agree_with_the_open_head_file():
    head = load_openhead()
    for name in ("bfm72", "ibug68"):
        expected = load_vertices(name).vertices["openhead"]
        np.testing.assert_array_equal(head.landmarks[name], expected)


def test_vertices_are_distinct_on_every_model(scheme):
    for model, vertices in load_vertices(scheme.name).vertices.items():
        assert len(set(vertices)) == len(vertices) == len(scheme), model
        assert vertices.min() >= 0, model


def test_only_complete_models_have_vertices():
    assert set(load_vertices("bfm72").vertices) == {"openhead", "ict", "bfm2009"}
    assert set(load_vertices("ibug68").vertices) == {"openhead", "ict"}
    assert set(load_vertices("ibug68").anchors) == {"openhead", "ict", "bfm2009", "bfm2017"}


def test_polylines_pass_through_landmarks_and_mirror_in_the_mouth():
    scheme = load_scheme("bfm72")
    assert scheme.polylines[0] == (0, 2, 11, 3, 0)
    assert all(0 <= i < 72 for line in scheme.polylines for i in line)
    edges = {
        frozenset(pair)
        for line in load_scheme("ibug68").polylines
        for pair in zip(line, line[1:], strict=False)
    }
    mirror = load_scheme("ibug68").mirror
    assert {frozenset(int(mirror[i]) for i in edge) for edge in edges} == edges


def test_bfm2009_vertices_are_the_published_ones_less_one():
    published = {1: 2088, 12: 5959, 29: 8320, 57: 14472, 72: 53307}
    vertices = load_vertices("bfm72").vertices["bfm2009"]
    assert {number: vertices[number - 1] + 1 for number in published} == published
    assert (np.diff(vertices) > 0).all()


def test_ibug51_is_ibug68_without_the_jaw():
    full, inner = load_scheme("ibug68"), load_scheme("ibug51")
    assert inner.numbers == full.numbers[17:]
    np.testing.assert_array_equal(inner.mirror, full.mirror[17:] - 17)
    vertices = (load_vertices(name).vertices["ict"] for name in ("ibug51", "ibug68"))
    np.testing.assert_array_equal(next(vertices), next(vertices)[17:])
    anchors = (load_vertices(name).anchors["bfm2009"] for name in ("ibug51", "ibug68"))
    assert next(anchors) == {i - 17: vertex for i, vertex in next(anchors).items() if i >= 17}
    lines = [tuple(i + 17 for i in line) for line in inner.polylines]
    assert lines == list(full.polylines[1:])


def test_schemes_cannot_be_changed_by_their_users(scheme):
    with pytest.raises(ValueError, match="read-only"):
        scheme.mirror[0] = 1
    with pytest.raises(ValueError, match="read-only"):
        load_vertices(scheme.name).vertices["openhead"][0] = 1


def test_basel_names_come_in_mirrored_pairs():
    names = load_basel_anchors().keys()
    swapped = {n.replace("right", "#").replace("left", "right").replace("#", "left") for n in names}
    assert swapped == set(names)


def test_unknown_scheme_is_refused():
    with pytest.raises(InputError, match="bfm72, ibug68, ibug51, mediapipe. Received 'bfm73'"):
        load_scheme("bfm73")
    with pytest.raises(InputError, match="bfm72, ibug68, ibug51. Received 'bfm73'"):
        load_vertices("bfm73")


def test_vertices_agree_with_the_shared_tables(shared):
    with (shared / "landmarks" / "bfm72.csv").open() as file:
        rows = list(csv.DictReader(file))
    vertices = load_vertices("bfm72").vertices
    for column, model in (("bfm_vertex", "bfm2009"), ("ict_vertex", "ict")):
        np.testing.assert_array_equal([int(row[column]) for row in rows], vertices[model])


@pytest.fixture
def shared():
    folder = SHARED
    if not folder.is_dir():
        pytest.skip("../shared is absent")
    return folder
