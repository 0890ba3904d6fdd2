"""Laws of the public functions, on inputs that Hypothesis invents, and bad landmarks."""

import tempfile
from pathlib import Path

import numpy as np
import pytest
from hypothesis import assume, example, given, settings
from hypothesis import strategies as st
from hypothesis.configuration import set_hypothesis_home_dir
from hypothesis.extra.numpy import arrays
from scipy.spatial import procrustes
from scipy.spatial.distance import pdist, squareform
from scipy.spatial.transform import Rotation

from deepmds_keras import InputError, align, embed, metrics, normalise
from deepmds_keras.baselines.closed_form import Aldrian, AldrianAuthors
from deepmds_keras.geometry.alignment import align_to_mean, is_mirrored
from deepmds_keras.geometry.camera import head_poses
from deepmds_keras.geometry.orientation import resolve_orientation
from deepmds_keras.geometry.units import centre, rms_radius, unit
from deepmds_keras.validation import check_points

pytestmark = pytest.mark.usefixtures("one_thread")

# Nothing is written into the folder that the tests run in.
set_hypothesis_home_dir(Path(tempfile.gettempdir(), "deepmds-hypothesis"))
laws = settings(deadline=None, derandomize=True, database=None, max_examples=60)


def points(n_landmarks=(5, 9)):
    """Landmarks of one face, whole hundredths, that lie in no plane or line."""
    shapes = st.integers(*n_landmarks).map(lambda n: (n, 3))
    drawn = arrays(np.int64, shapes, elements=st.integers(-1000, 1000), fill=st.nothing())
    return drawn.map(lambda face: face / 100).filter(lambda face: spread(face) > 0.05)


def spread(face):
    """Least extent of a face by its largest."""
    extents = np.linalg.svd(face - face.mean(0), compute_uv=False)
    return extents[-1] / max(extents[0], 1e-9)


def several(n):
    """So many faces of six landmarks."""
    return st.tuples(*[points((6, 6))] * n).map(np.array)


angles = st.integers(-314, 314).map(lambda hundredths: hundredths / 100)
turns = st.tuples(angles, angles, angles).map(lambda v: Rotation.from_rotvec(v).as_matrix())
scales = st.sampled_from([0.01, 0.3, 1.0, 2.5, 400.0])
shifts = arrays(np.int64, (3,), elements=st.integers(-50, 50), fill=st.nothing())
similarities = st.tuples(scales, turns, shifts).map(
    lambda drawn: lambda face: drawn[0] * face @ drawn[1] + drawn[2]
)
seeds = st.integers(0, 2**32 - 1).map(np.random.default_rng)


def close(received, expected, rtol=1e-8):
    np.testing.assert_allclose(received, expected, atol=rtol * max(np.abs(expected).max(), 1e-9))


@laws
@given(points(), similarities, st.booleans())
def test_any_similarity_is_undone_a_mirror_image_only_where_that_is_allowed(target, moved, mirror):
    source = moved(target * [1, 1, -1 if mirror else 1])
    assert is_mirrored(source, target) == mirror
    close(align(source, target), target)
    error = metrics.mse(align(source, target, reflection=False), target)
    assert (error > 1e-12 * np.var(target)) == mirror


@laws
@given(several(2), st.booleans(), st.booleans(), seeds)
def test_no_other_motion_comes_nearer(faces, scaling, reflection, rng):
    source, target = faces
    best = align(source, target, scaling=scaling, reflection=reflection)
    least = metrics.mse(best, target)
    for step in (1e-3, 0.1, 3.0):
        turn = Rotation.from_rotvec(step * rng.normal(size=3)).as_matrix()
        if reflection and rng.random() < 0.5:
            turn = -turn
        factor = np.exp(step * rng.normal()) if scaling else 1.0
        middle = best.mean(0)
        other = factor * (best - middle) @ turn + middle + step * rng.normal(size=3)
        assert metrics.mse(other, target) >= least * (1 - 1e-9)


@laws
@given(points(), scales, st.integers(-9, 9), shifts)
def test_scale_and_a_shift_along_all_axes_are_lost_and_come_back(face, factor, shift, moved):
    scaled = normalise(face)
    assert scaled.min() == 0 and scaled.max() == 1
    close(normalise(factor * face + shift), scaled)
    low, size = unit(face)
    close(scaled * size + low, face)
    close(centre(face + moved), centre(face))


@laws
@given(points(), st.sampled_from([2, 3]), st.sampled_from([1e-200, 1e-100, 1.0, 1e100, 1e200]))
def test_good_landmarks_come_back_as_they_are_in_any_unit(face, d, factor):
    face = factor * face[:, :d]
    assume(spread(face / factor) > 1e-3)
    assert np.array_equal(check_points(face, "views", d), face[None])


@laws
@given(several(3), st.sampled_from([np.nan, np.inf, -np.inf]), seeds)
def test_a_number_that_is_not_finite_is_refused_with_its_face(faces, bad, rng):
    which = tuple(rng.integers(faces.shape))
    faces[which] = bad
    with pytest.raises(InputError, match=f"NaN or infinity in face {which[0]}"):
        check_points(faces, "views", 3)
    for function in (align, metrics.mse, lambda *both: normalise(both[0])):
        with pytest.raises(InputError):
            function(faces, faces)


@settings(laws, max_examples=200)
@given(arrays(float, st.tuples(*[st.integers(0, 5)] * 3), elements=st.floats()))
@example(1e200 * np.eye(3)[None])
@example(1e-200 * np.eye(3)[None])
def test_any_numbers_pass_or_are_refused(numbers):
    try:
        passed = check_points(numbers, "shapes", 3)
    except InputError:
        return
    assert np.array_equal(passed, numbers) and np.isfinite(numbers).all()


@settings(laws, max_examples=12)
@given(
    points((8, 8)).filter(lambda face: pdist(face).min() > 0.5), st.permutations(range(8)), seeds
)
def test_the_order_of_landmarks_does_not_change_an_embedding(face, order, rng):
    distances = squareform(pdist(face) * rng.uniform(0.8, 1.2, 28))
    moved = embed(distances[np.ix_(order, order)])
    close(pdist(moved), pdist(embed(distances)[order]), 1e-3)


@laws
@given(several(2), similarities, st.booleans(), st.integers(0, 5))
def test_how_an_embedding_lies_does_not_matter(faces, moved, mirrored, front):
    shape, frontal = faces[0], faces[1, None, :, :2]
    turned = resolve_orientation(shape[None], frontal, front)[0]
    close(pdist(turned), pdist(shape))
    close(turned.mean(0), [*frontal[0].mean(0), 0])
    assert turned[front, 2] >= -1e-9
    assume(abs(turned[front, 2]) > 1e-3)
    again = moved(shape * [1, 1, -1 if mirrored else 1])
    factor = np.linalg.norm(again[0] - again[1]) / max(np.linalg.norm(shape[0] - shape[1]), 1e-9)
    assume(0.009 < factor < 401)
    resolved = resolve_orientation(again[None], frontal, front)[0]
    middle = [*frontal[0].mean(0), 0]
    close(resolved - middle, factor * (turned - middle), 1e-5)


def test_alignment_agrees_with_scipy_and_one_target_serves_all_sources():
    source, target = np.random.default_rng(0).normal(size=(2, 5, 12, 3))
    for face, other, aligned in zip(source, target, align(source, target), strict=True):
        size = ((other - other.mean(0)) ** 2).sum()
        assert np.isclose(((aligned - other) ** 2).sum() / size, procrustes(other, face)[2])
    assert np.allclose(align(source, target[0]), align(source, target[[0] * 5]))
    for wrong in (source[:, 1:], source[1:], source[0]):
        with pytest.raises(InputError, match=r"Received \(.*3\) and \(5, 12, 3\)"):
            align(wrong, target)


def test_shapes_are_turned_onto_the_mean_of_those_of_the_training():
    shapes = centre(np.random.default_rng(0).normal(size=(9, 6, 3)))
    others = np.concatenate([shapes[:6], 3 * shapes[6:, ::-1]])
    for upright in (False, True):
        turned, again = (align_to_mean(s, 6, upright=upright) for s in (shapes, others))
        np.testing.assert_array_equal(turned[:6], again[:6])
        assert np.array_equal(turned[..., 1], shapes[..., 1]) == upright


@pytest.mark.parametrize("power", [-700, 600])
def test_no_unit_is_so_small_or_large_that_squares_are_lost(power):
    views, shapes, others = np.random.default_rng(0).normal(size=(3, 4, 9, 3))
    views, mean, basis = views[..., :2], others[0], 0.1 * others[:3]

    def results(unit):
        return [
            rms_radius(unit * shapes) / unit,
            align(unit * shapes, others),
            align(shapes, unit * others) / unit,
            is_mirrored(unit * shapes, unit * others),
            metrics.depth_corr(unit * shapes, unit * others),
            metrics.depth_corr_across_faces(shapes, unit * others),
            metrics.explained_share(unit * shapes, unit * others),
            head_poses(unit * views, unit * shapes).residual,
            Aldrian(mean, basis).predict(unit * views),
        ]

    for received, expected in zip(results(2.0**power), results(1.0), strict=True):
        np.testing.assert_allclose(received, expected, rtol=1e-10, atol=1e-12)
    # What the authors' regularisation is of depends on the unit.
    assert np.isfinite(AldrianAuthors(mean, basis, np.ones(3)).predict(2.0**power * views)).all()


def test_landmarks_in_metres_of_a_map_are_no_single_point():
    faces = np.random.default_rng(0).random((2, 10, 3)) * 0.1 + [6.9e5, 5.3e6, 100.0]
    assert check_points(faces, "shapes", 3) is not None


@pytest.mark.parametrize("points", [np.ones(3), np.ones((0, 3)), np.ones((2, 0, 3))])
def test_what_has_no_landmarks_is_neither_normalised_nor_aligned(points):
    for function in (normalise, lambda points: align(points, points)):
        with pytest.raises(InputError, match=r"must have shape \(n, L >= 1, d\) or \(L, d\)"):
            function(points)


@pytest.mark.parametrize(
    ("points", "message"),
    [
        (np.zeros((2, 5, 3)), r"shape \(faces >= 1, landmarks >= 3, 2\)"),
        (np.zeros((0, 5, 2)), r"shape \(faces >= 1, landmarks >= 3, 2\)"),
        (np.zeros((2, 2, 2)), r"shape \(faces >= 1, landmarks >= 3, 2\)"),
        (np.array([["a", "b"]] * 3), "must hold numbers"),
        (None, "must hold numbers"),
        (np.full((2, 5, 2), 7e9), "all 5 landmarks coincide in face 0"),
        (np.arange(10.0).reshape(1, 5, 2) * [1, -9], "all landmarks lie on one line in face 0"),
        ([[[1, 2], [3, 4], [5]]], "unequal lengths"),
        (np.ma.masked_greater(np.random.default_rng(0).random((1, 5, 2)), 0.9), "NaN"),
    ],
)
def test_what_is_no_landmarks_is_named(points, message):
    with pytest.raises(InputError, match=message):
        check_points(points, "views", 2)
