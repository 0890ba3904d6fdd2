"""Laws of the public functions, on inputs that Hypothesis makes up: the same ones in every run."""

import json
import tempfile
from pathlib import Path

import numpy as np
import pytest
from hypothesis import assume, example, given, settings
from hypothesis import strategies as st
from hypothesis.configuration import set_hypothesis_home_dir
from hypothesis.extra.numpy import array_shapes, arrays, scalar_dtypes
from scipy.spatial.distance import pdist, squareform
from scipy.spatial.transform import Rotation

from data_gen.views.projections import Cameras, in_camera_frame, project, rotations
from deepmds_keras import InputError, align, embed, pair_features
from deepmds_keras.alignment import is_mirrored
from deepmds_keras.camera import camera_angles, head_pose
from deepmds_keras.checks import check_points
from deepmds_keras.files import read_arrays, write_arrays
from deepmds_keras.landmarks.conversion import face_sizes
from deepmds_keras.metrics import depth_corr, mse, wilcoxon_table
from deepmds_keras.normalisation import centre, normalise, unit
from deepmds_keras.orientation import resolve_orientation
from deepmds_keras.predict.faces import Face
from deepmds_keras.predict.landmark_files import read_landmarks
from deepmds_keras.predict.outputs import write_output

pytestmark = pytest.mark.usefixtures("one_thread")

# Nothing is written into the folder that the tests run in.
set_hypothesis_home_dir(Path(tempfile.gettempdir(), "deepmds-hypothesis"))
COMMON = {"deadline": None, "derandomize": True, "database": None}
laws = settings(**COMMON, max_examples=60)
few = settings(**COMMON, max_examples=12)  # of what takes tenths of a second


def points(n_landmarks=(5, 9), d=3):
    """Landmarks of one face, whole hundredths, that lie in no plane or line."""
    shapes = st.integers(*n_landmarks).map(lambda n: (n, d))
    drawn = arrays(np.int64, shapes, elements=st.integers(-1000, 1000), fill=st.nothing())
    return drawn.map(lambda face: face / 100).filter(lambda face: spread(face) > 0.05)


def spread(face):
    """Least extent of a face by its largest."""
    extents = np.linalg.svd(face - face.mean(0), compute_uv=False)
    return extents[-1] / max(extents[0], 1e-9)


def several(n, n_landmarks=6, d=3):
    """So many faces of as many landmarks."""
    return st.tuples(*[points((n_landmarks, n_landmarks), d)] * n)


angles = st.integers(-314, 314).map(lambda hundredths: hundredths / 100)
turns = st.tuples(angles, angles, angles).map(lambda v: Rotation.from_rotvec(v).as_matrix())
scales = st.sampled_from([0.01, 0.3, 1.0, 2.5, 400.0])
shifts = arrays(np.int64, (3,), elements=st.integers(-50, 50), fill=st.nothing())
similarities = st.tuples(scales, turns, shifts).map(
    lambda drawn: lambda face: drawn[0] * face @ drawn[1] + drawn[2]
)
seeds = st.integers(0, 2**32 - 1).map(np.random.default_rng)


def close(found, expected, rtol=1e-8):
    np.testing.assert_allclose(found, expected, atol=rtol * max(np.abs(expected).max(), 1e-9))


class TestAlign:
    @laws
    @given(points(), similarities, st.booleans())
    def test_any_similarity_is_undone(self, target, moved, reflection):
        close(align(moved(target), target, reflection=reflection), target)
        assert not is_mirrored(moved(target), target)

    @laws
    @given(points(), similarities)
    def test_a_mirror_image_is_undone_only_where_that_is_allowed(self, target, moved):
        source = moved(target * [1, 1, -1])
        assert is_mirrored(source, target)
        close(align(source, target), target)
        assert mse(align(source, target, reflection=False), target) > 1e-12 * np.var(target)

    @laws
    @given(several(2), st.booleans(), st.booleans(), seeds)
    def test_no_other_motion_comes_nearer(self, faces, scaling, reflection, rng):
        source, target = faces
        best = align(source, target, scaling=scaling, reflection=reflection)
        least = mse(best, target)
        for step in (1e-3, 0.1, 3.0):
            turn = Rotation.from_rotvec(step * rng.normal(size=3)).as_matrix()
            if reflection and rng.random() < 0.5:
                turn = -turn
            factor = np.exp(step * rng.normal()) if scaling else 1.0
            middle = best.mean(0)
            other = factor * (best - middle) @ turn + middle + step * rng.normal(size=3)
            assert mse(other, target) >= least * (1 - 1e-9)

    @laws
    @given(several(2), similarities, similarities)
    def test_how_the_source_lies_does_not_matter_and_the_target_takes_it_along(
        self, faces, moved, turned
    ):
        source, target = faces
        centred = [face - face.mean(0) for face in faces]
        singular = np.linalg.svd(centred[0].T @ centred[1], compute_uv=False)
        assume(singular[2] > 1e-3 * singular[0])  # else several turns are the best
        for reflection in (False, True):
            options = {"reflection": reflection}
            assume(reflection or np.diff(singular).max() < -1e-3 * singular[0])
            aligned = align(source, target, **options)
            close(align(moved(source), target, **options), aligned, 1e-6)
            close(align(source, turned(target), **options), turned(aligned), 1e-6)

    @laws
    @given(several(3))
    def test_many_faces_are_aligned_as_each_alone(self, faces):
        source, target = np.array(faces), faces[0]
        for face, aligned in zip(source, align(source, target), strict=True):
            close(aligned, align(face, target))


class TestNormalisation:
    @laws
    @given(points())
    def test_smallest_and_largest_coordinate_become_0_and_1(self, face):
        scaled = normalise(face)
        assert scaled.min() == 0 and scaled.max() == 1
        assert np.array_equal(normalise(scaled), scaled)
        low, size = unit(face)
        close(scaled * size + low, face)

    @laws
    @given(points(), scales, st.integers(-9, 9))
    def test_scale_and_a_shift_along_all_axes_are_lost(self, face, factor, shift):
        close(normalise(factor * face + shift), normalise(face))

    @laws
    @given(points(), shifts)
    def test_centred_faces_forget_where_they_were(self, face, shift):
        moved = centre(face + shift)
        close(moved, centre(face))
        close(centre(moved), moved)
        assert np.abs(moved.mean(0)).max() < 1e-12

    @laws
    @given(arrays(float, array_shapes(min_dims=2, max_dims=3), elements=st.floats()))
    def test_any_numbers_are_scaled_or_refused(self, numbers):
        try:
            scaled = normalise(numbers)
        except InputError:
            faces = numbers.reshape(-1, *numbers.shape[-2:])
            with np.errstate(over="ignore", invalid="ignore"):
                size = np.ptp(faces, (1, 2))
                assert (~np.isfinite(size) | (size == 0)).any()
        else:
            assert np.isfinite(scaled).all() and scaled.min() == 0 and scaled.max() == 1


class TestChecks:
    @laws
    @given(points(d=3), st.sampled_from([2, 3]), scales)
    def test_good_landmarks_come_back_as_they_are(self, face, d, factor):
        face = factor * face[:, :d]
        assume(spread(face) > 1e-3)
        assert np.array_equal(check_points(face, "views", d), face[None])

    @laws
    @given(several(3), st.sampled_from([np.nan, np.inf, -np.inf]), seeds)
    def test_a_number_that_is_not_finite_is_refused_with_its_face(self, faces, bad, rng):
        faces = np.array(faces)
        which = tuple(rng.integers(faces.shape))
        faces[which] = bad
        with pytest.raises(InputError, match=f"NaN or infinity in face {which[0]}"):
            check_points(faces, "views", 3)
        with pytest.raises(InputError):
            normalise(faces)
        with pytest.raises(InputError):
            align(faces, faces)
        with pytest.raises(InputError):
            mse(faces, faces)

    @laws
    @given(points(), scales, seeds)
    def test_a_point_and_a_line_are_refused(self, face, factor, rng):
        along = rng.normal(size=(len(face), 1))
        with pytest.raises(InputError, match="must spread out"):
            check_points(factor * np.broadcast_to(face[0] + 1, face.shape), "views", 3)
        with pytest.raises(InputError, match="must not be collinear"):
            check_points(factor * along * np.array([1.0, 2.0, -0.5]), "views", 3)

    @settings(laws, max_examples=200)
    @given(arrays(float, st.tuples(*[st.integers(0, 5)] * 3), elements=st.floats()))
    @example(1e200 * np.eye(3)[None])
    @example(1e-200 * np.eye(3)[None])
    def test_any_numbers_pass_or_are_refused(self, numbers):
        try:
            passed = check_points(numbers, "shapes", 3)
        except InputError:
            return
        assert np.array_equal(passed, numbers) and np.isfinite(numbers).all()

    @laws
    @given(points(), st.sampled_from([1e-200, 1e-100, 1e100, 1e200]))
    def test_the_unit_of_length_decides_nothing(self, face, factor):
        assert np.array_equal(check_points(factor * face, "shapes", 3)[0], factor * face)


# Landmarks that do not coincide: a distance of 0 stands for one that is missing.
apart = points((8, 8)).filter(lambda face: pdist(face).min() > 0.5)


class TestEmbedding:
    @few
    @given(apart, st.permutations(range(8)), seeds)
    def test_the_order_of_landmarks_does_not_matter(self, face, order, rng):
        noise = squareform(rng.uniform(0.8, 1.2, 28))
        distances = squareform(pdist(face)) * noise
        found = embed(distances[np.ix_(order, order)])
        close(pdist(found), pdist(embed(distances)[order]), 1e-3)


class TestPairFeatures:
    @laws
    @given(points(d=2), st.sampled_from(["paper", "released"]), seeds)
    def test_the_order_of_landmarks_moves_pairs_and_changes_none(self, view, variant, rng):
        order = rng.permutation(len(view))
        features, other = pair_features(view, variant), pair_features(view[order], variant)
        assert features.shape == (len(view) * (len(view) - 1) // 2, {"paper": 6}.get(variant, 5))
        for one, another in zip(features.T, other.T, strict=True):
            assert np.array_equal(squareform(one)[np.ix_(order, order)], squareform(another))

    @laws
    @given(points(d=2))
    def test_pairs_come_in_the_order_of_pdist(self, view):
        paper, released = pair_features(view), pair_features(view, "released")
        for axis in range(2):
            close(paper[:, axis], pdist(view[:, axis : axis + 1]), 1e-5)
        close(released[:, -1], pdist(view), 1e-5)
        close(paper[:, 2:4], released[:, :2])
        close(paper[:, 4:], released[:, 2:4])

    @laws
    @given(several(3, 6, 2), st.sampled_from(["paper", "released"]))
    def test_faces_are_described_one_by_one(self, views, variant):
        together = pair_features(np.array(views), variant)
        for view, features in zip(views, together, strict=True):
            assert np.array_equal(pair_features(view, variant), features)


class TestMetrics:
    @laws
    @given(several(2), scales)
    def test_mse_is_a_squared_distance(self, faces, factor):
        a, b = faces
        assert mse(a, b) == mse(b, a) >= 0
        assert (mse(a, b) == 0) == np.array_equal(a, b)
        assert mse(factor * a, factor * b) == pytest.approx(factor**2 * mse(a, b))
        middle = (a + b) / 2
        assert mse(a, middle) == pytest.approx(mse(a, b) / 4, abs=1e-12)

    @laws
    @given(several(2), scales, st.integers(-5, 5))
    def test_depth_corr_is_symmetric_bounded_and_blind_to_scale(self, faces, factor, shift):
        a, b = faces
        assert depth_corr(a, b) == pytest.approx(depth_corr(b, a))
        assert abs(depth_corr(a, b)) <= len(a) * (1 + 1e-12)
        assert depth_corr(factor * a + shift, b) == pytest.approx(depth_corr(a, b), abs=1e-6)
        # A landmark of three equal coordinates has no correlation.
        assert depth_corr(a, a) == pytest.approx(np.count_nonzero(np.ptp(a, axis=1)))
        assert depth_corr(a, -a) == pytest.approx(-depth_corr(a, a))

    @settings(laws, max_examples=25)
    @given(arrays(np.int64, (2, 20), elements=st.integers(-9, 9)), st.integers(-5, 5))
    def test_wilcoxon_of_two_methods_is_antisymmetric(self, scores, shift):
        a, b = scores
        (forth,), (back,) = (
            wilcoxon_table(dict(pairs)).to_dict("records")
            for pairs in ([("a", a), ("b", b)], [("b", b), ("a", a)])
        )
        assert (forth["method_a"], forth["method_b"]) == (back["method_b"], back["method_a"])
        assert forth["median_difference"] == -back["median_difference"]
        for key in ("n", "statistic", "p_value", "p_value_normal"):
            assert forth[key] == pytest.approx(back[key])
        assert 0 <= forth["p_value"] <= 1 and 0 <= forth["p_value_normal"] <= 1
        (moved,) = wilcoxon_table({"a": a + shift, "b": b + shift}).to_dict("records")
        assert moved == forth


def cameras_of(yaw, pitch, roll, field_of_view=0.0):
    n = np.zeros(1)
    return Cameras(n.astype(int), n + yaw, n + pitch, n + roll, n + field_of_view)


yaws = rolls = st.integers(-1790, 1790).map(lambda tenths: tenths / 10)
pitches = st.integers(-890, 890).map(lambda tenths: tenths / 10)


class TestCameras:
    @laws
    @given(yaws, pitches, rolls)
    def test_angles_of_a_rotation_are_those_it_was_made_of(self, yaw, pitch, roll):
        rotation = rotations(cameras_of(yaw, pitch, roll))
        close(rotation[0] @ rotation[0].T, np.eye(3))
        assert np.linalg.det(rotation[0]) == pytest.approx(1)
        np.testing.assert_allclose(camera_angles(rotation)[:, 0], [yaw, pitch, roll], atol=1e-6)

    @laws
    @given(turns)
    @example(Rotation.from_euler("x", 90, degrees=True).as_matrix())
    @example(Rotation.from_euler("yx", [30, -90], degrees=True).as_matrix())
    def test_any_rotation_is_made_again_of_its_angles(self, rotation):
        ((yaw,), (pitch,), (roll,)) = camera_angles(rotation[None])
        close(rotations(cameras_of(yaw, pitch, roll))[0], rotation, 1e-6)

    @laws
    @given(points(), yaws, pitches, rolls, scales, shifts)
    def test_orthographic_views_follow_the_face(self, face, yaw, pitch, roll, factor, shift):
        cameras = cameras_of(yaw, pitch, roll)
        view = project(face[None], cameras)
        close(view, in_camera_frame(face[None], cameras)[..., :2])
        moved = project(factor * face[None] + shift, cameras)
        close(moved, factor * view + (rotations(cameras) @ shift)[:, None, :2])

    @laws
    @given(points(), yaws, pitches, st.integers(1, 600))
    def test_perspective_is_scaled_with_the_face_and_vanishes_with_its_field(
        self, face, yaw, pitch, tenths
    ):
        wide, flat = cameras_of(yaw, pitch, 0.0, tenths / 10), cameras_of(yaw, pitch, 0.0)
        close(project(7 * face[None], wide), 7 * project(face[None], wide))
        near, far = (
            np.abs(
                project(face[None], cameras_of(yaw, pitch, 0.0, field)) - project(face[None], flat)
            )
            for field in (tenths / 10, tenths / 1000)
        )
        assert far.max() <= 0.02 * near.max() + 1e-9

    @laws
    @given(points(), st.integers(-70, 70), st.integers(-60, 60), rolls, scales, shifts)
    def test_the_pose_of_a_head_is_that_it_was_seen_in(self, face, yaw, pitch, roll, factor, shift):
        rotation = rotations(cameras_of(yaw, pitch, roll))[0]
        view = factor * (face @ rotation.T)[:, :2] + shift[:2]
        assume(spread(view) > 1e-3)
        pose = head_pose(view, face)
        np.testing.assert_allclose([pose.yaw, pose.pitch], [yaw, pitch], atol=1e-5)
        assert np.cos(np.deg2rad(pose.roll - roll)) == pytest.approx(1)
        assert pose.scale == pytest.approx(factor)
        assert pose.residual < 1e-8
        close(pose.project(face), view, 1e-6)


class TestFaceFront:
    @laws
    @given(several(2), similarities, st.booleans(), st.integers(0, 5))
    def test_how_an_embedding_lies_does_not_matter(self, faces, moved, mirrored, front):
        shape, other = np.array(faces)
        frontal = other[None, :, :2]
        turned = resolve_orientation(shape[None], frontal, front)[0]
        assume(abs(turned[front, 2]) > 1e-3)
        again = moved(shape * [1, 1, -1 if mirrored else 1])
        factor = np.linalg.norm(again[0] - again[1]) / max(
            np.linalg.norm(shape[0] - shape[1]), 1e-9
        )
        assume(0.009 < factor < 401)
        found = resolve_orientation(again[None], frontal, front)[0]
        middle = [*frontal[0].mean(0), 0]
        close(found - middle, factor * (turned - middle), 1e-5)

    @laws
    @given(several(2), st.integers(0, 5))
    def test_the_shape_stays_the_same_in_front_of_its_view(self, faces, front):
        shape, other = np.array(faces)
        turned = resolve_orientation(shape[None], other[None, :, :2], front)[0]
        close(pdist(turned), pdist(shape))
        close(turned.mean(0), [*other[:, :2].mean(0), 0])
        assert turned[front, 2] >= -1e-9


def views(n_landmarks):
    """A few views of so many landmarks: any floats that a picture may have."""
    numbers = st.floats(-1e6, 1e6, allow_subnormal=False)
    return arrays(float, st.tuples(st.integers(1, 3), st.just(n_landmarks), st.just(2)),
                  elements=numbers, fill=numbers)  # fmt: skip


@st.composite
def some_views(draw):
    """Views that are accepted, of any number of landmarks that is."""
    n = draw(st.sampled_from(face_sizes()))
    faces = draw(views(n)) + np.random.default_rng(n).normal(size=(n, 2))
    try:
        return check_points(faces, "views", 2)
    except InputError:
        assume(False)


class TestFiles:
    @laws
    @given(some_views(), st.sampled_from(["npy", "csv", "rows.csv", "json", "pts"]), st.booleans())
    def test_landmarks_come_back_to_the_last_bit(self, faces, kind, y_up):
        faces = faces[:1] if kind == "pts" else faces
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder, f"a.{kind}")
            if kind == "npy":
                np.save(path, faces)
            elif kind == "json":
                path.write_text(json.dumps({"landmarks": faces.tolist()}))
            elif kind == "pts":
                rows = "\n".join(f"{x!r} {y!r}" for x, y in (faces[0] + 0.5).tolist())
                path.write_text(f"version: 1\nn_points: {len(faces[0])}\n{{\n{rows}\n}}\n")
            elif kind == "rows.csv":
                path.write_text("\n".join(",".join(map(repr, f.ravel().tolist())) for f in faces))
            else:
                rows = [f"{i},{x!r},{y!r}" for i, f in enumerate(faces) for x, y in f.tolist()]
                path.write_text("\n".join(["face,x,y", *rows]))
            found = read_landmarks(path, y_up=y_up)
        expected = faces * [1, -1] if y_up else faces
        if kind == "pts":  # half a pixel was added and taken away
            np.testing.assert_allclose(found, expected, rtol=0, atol=1e-9 + 2e-16 * 1e6)
        else:
            np.testing.assert_allclose(found, expected, rtol=5e-16)

    @few
    @given(seeds, st.sampled_from(["csv", "json"]), st.text(min_size=1), scales)
    def test_what_the_command_writes_is_read_again(self, rng, kind, name, size):
        shape = rng.normal(size=(72, 3))
        view = size * shape[:, :2]
        pose = head_pose(view, shape)
        source = Path("a.jpg")
        face = Face(
            name, source, None, "bfm72", view * [1, -1], shape, "normalised", pose, ("a note",)
        )
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / f"run.{kind}"
            write_output(path, [face], {"name": "a model"})
            np.testing.assert_allclose(
                read_landmarks(path)[0], face.landmarks, rtol=0, atol=1e-6 * np.abs(view).max()
            )

    @laws
    @given(
        st.dictionaries(
            st.text("abc_/0", min_size=1, max_size=12).map(lambda key: f"a{key}"),
            arrays(
                st.one_of(
                    scalar_dtypes().filter(lambda dtype: dtype.kind in "biufc"),
                    st.just(np.dtype("<U5")),
                ),
                array_shapes(min_dims=0, min_side=0),
            ),
            max_size=4,
        ),
        st.dictionaries(
            st.text(),
            st.recursive(
                st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False) | st.text(),
                lambda inner: st.lists(inner) | st.dictionaries(st.text(), inner),
                max_leaves=5,
            ),
            max_size=3,
        ),
        st.booleans(),
    )
    def test_arrays_and_their_description_come_back(self, held, described, compressed):
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder, "inner", "a.npz")
            write_arrays(path, held, described, compressed=compressed)
            assert [found.name for found in path.parent.iterdir()] == ["a.npz"]
            found, description = read_arrays(path)
        assert description == described
        assert found.keys() == held.keys()
        for key, array in held.items():
            assert found[key].dtype == array.dtype and found[key].shape == array.shape
            assert found[key].tobytes() == array.tobytes()
