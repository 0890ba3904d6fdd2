"""Fits to landmarks and edges: the outline helps, and known faces and cameras come back."""

from dataclasses import replace

import numpy as np
import pytest
from PIL import Image
from scipy.spatial import ConvexHull, KDTree

from data_gen.fitting.edge_fitting import EdgeFitter
from data_gen.fitting.edges import EdgeMatcher, ImageEdges, edges_about, find_edges
from data_gen.fitting.landmark_fitting import LandmarkFitter
from data_gen.fitting.occluding_edges import Surface
from data_gen.models.morphable_model import MorphableModel
from data_gen.models.openhead import load_openhead
from data_gen.rendering.albedo import Albedo
from data_gen.rendering.renderer import Frames, Renderer, sample_lights
from data_gen.views.projections import Cameras, in_camera_frame, rotations
from deepmds_keras.alignment import align
from deepmds_keras.errors import InputError
from deepmds_keras.normalisation import normalise

pytestmark = pytest.mark.usefixtures("one_thread")
N, SIZE, SCALE = 60, 218, 0.6  # faces, pixels, pixels per mm
LEFT_OUT = 20  # columns on either side: images are 178 wide
NOISE = 1.5  # mm
BLANK = np.full((SIZE, SIZE - 2 * LEFT_OUT, 3), 128, np.uint8)


def portraits():
    """Random faces before dark walls, in CelebA's size; their identities, poses and landmarks."""
    model, rng = load_openhead(), np.random.default_rng(0)
    identity, shapes = model.sample(N, rng)
    yaw, pitch, roll = rng.normal(0, [[20], [7], [3]], (3, N)).clip(-40, 40)
    cameras = Cameras(np.zeros(N, int), yaw, pitch, roll, np.zeros(N))
    posed = in_camera_frame(shapes, cameras)
    landmarks = posed[:, model.landmarks["ibug68"]]
    extent = np.full((N, 2), SIZE / SCALE)
    frames = Frames(landmarks[..., :2].mean(1) - extent / 2, extent, SIZE)
    renderer = Renderer(model, SIZE)
    albedo = Albedo(model).sample(N, rng)
    ground = np.linspace(40, 90, SIZE)[:, None, None] + rng.normal(0, 2, (N, SIZE, SIZE, 3))
    lights, grounds = sample_lights(N, rng), np.uint8(ground)
    images = renderer.draw(posed, posed, albedo, frames, lights, grounds)[:, :, LEFT_OUT:-LEFT_OUT]
    renderer.close()
    return identity, rotations(cameras), images, frames.pixels(landmarks[..., :2]) - (LEFT_OUT, 0)


@pytest.fixture(scope="module")
def model():
    return load_openhead()


@pytest.fixture(scope="module")
def fitter(model):
    return EdgeFitter(model)


@pytest.fixture(scope="module")
def faces(apart):
    return apart(portraits)


@pytest.fixture(scope="module")
def detected(faces):
    """The landmarks as a detector might find them, pixels."""
    pixels = faces[3]
    return pixels + np.random.default_rng(1).normal(0, NOISE * SCALE, pixels.shape)


@pytest.fixture(scope="module")
def fits(fitter, faces, detected):
    """Of every face: with the edges of its image, and without any."""
    _, _, images, _ = faces
    with_edges = [fitter.fit(*face) for face in zip(detected, images, strict=True)]
    return with_edges, [fitter.fit(face, BLANK) for face in detected]


def angle(a, b):
    return np.rad2deg(np.arccos(np.clip((np.trace(a.T @ b) - 1) / 2, -1, 1)))


def errors(model, fits, identity):
    """Mean squared error of the paper's landmarks after alignment, of each face."""
    part = model.restrict(model.landmarks["bfm72"])
    truth = normalise(part.shape(identity))
    fitted = part.shape(np.array([fit.identity for fit in fits]))
    return ((align(fitted, truth) - truth) ** 2).mean((1, 2))


def jaw(model, identity, rotation):
    """Points of the outline below the eyes, `(m, 3)`, frame of the model."""
    surface = Surface(model, model.mean[:, 2] > 30, len(identity))
    points = surface.occluding_edges(identity, rotation).points
    return points[(points[:, 1] < 20) & (points[:, 1] > -75)]


def ball(radius=50.0, n=3000, grown=0.0, centre=(0, 0, 0)):
    """A sphere, whose only component makes it larger, as a model's mean, basis and triangles."""
    k = np.arange(n) + 0.5
    height, turn = 1 - 2 * k / n, k * np.pi * (1 + 5**0.5)
    flat = np.sqrt(1 - height**2)
    points = np.stack([flat * np.cos(turn), flat * np.sin(turn), height], axis=1)
    hull = ConvexHull(points)
    a, b, c = points[hull.simplices].swapaxes(0, 1)
    inwards = (np.cross(b - a, c - a) * hull.equations[:, :3]).sum(1) < 0
    triangles = np.where(inwards[:, None], hull.simplices[:, ::-1], hull.simplices)
    return radius * points + np.array(centre), grown * points[None], triangles


def surface_of(*balls):
    n = np.cumsum([0, *(len(mean) for mean, _, _ in balls)])
    model = MorphableModel(
        "balls",
        np.concatenate([mean for mean, _, _ in balls]),
        np.concatenate([basis for _, basis, _ in balls], axis=1),
        np.concatenate([triangles + i for (_, _, triangles), i in zip(balls, n, strict=False)]),
    )
    return Surface(model, np.ones(model.n_vertices, bool), 1)


def disc(middle=(40.3, 30.8), radius=20.0, size=80, brightness=200.0):
    """An image of a bright disc, its rim as a camera blurs it."""
    y, x = np.indices((size, size)) + 0.5
    distance = np.hypot(x - middle[0], y - middle[1])
    return (brightness * (radius - distance + 0.5).clip(0, 1))[..., None].repeat(3, 2)


def test_the_rim_of_a_disc_is_found_to_a_fraction_of_a_pixel():
    edges = find_edges(disc())
    offsets = edges.points - (40.3, 30.8)
    radii = np.linalg.norm(offsets, axis=1)
    assert np.abs(radii - 20).max() < 0.3
    assert np.abs(radii - 20).mean() < 0.1
    # All around, and from dark to bright.
    assert len(edges.points) > 100
    turns = np.sort(np.arctan2(*offsets.T))
    assert np.diff(turns).max() < 0.15
    inwards = -offsets / radii[:, None]
    assert ((inwards * edges.normals).sum(1) > 0.98).all()


def test_what_has_no_contrast_has_no_edges():
    noise = np.random.default_rng(0).normal(0, 1, (60, 80, 3))
    for image in (BLANK, 128 + noise, disc(brightness=2.0), np.zeros((1, 1, 3))):
        edges = find_edges(image)
        assert edges.points.shape == edges.normals.shape == (0, 2)


def test_a_faint_edge_counts_only_if_it_goes_on_from_a_clear_one():
    image = np.zeros((60, 60, 3))
    image[:, 30:] = np.linspace(20, 200, 60)[:, None, None]  # one edge, fading
    image[20:40, 10:15] = 22.0  # as faint as its faint end
    columns, rows = find_edges(image).points.T
    assert np.abs(columns - 30).max() < 2
    assert rows.min() < 2 and rows.max() > 58 and np.diff(np.sort(rows)).max() < 1.5


def test_edges_are_looked_for_about_the_points_alone_and_at_the_size_asked_for():
    image = disc()
    left = np.array([[16, 15], [16, 45], [30, 30]])
    near = edges_about(left, image, 5.0, 1).points
    assert 10 < len(near) < 60
    assert near[:, 0].max() < 30 + 5
    all_around = np.array([[15, 5], [15, 55], [65, 55], [65, 5]])
    coarse = edges_about(5 * all_around, image.repeat(5, 0).repeat(5, 1), 5.0, 5)
    fine = edges_about(all_around, image, 1.0, 1)
    np.testing.assert_allclose(coarse.points, 5 * fine.points, atol=1e-6)


def test_the_edge_matched_is_the_nearest_that_runs_the_same_way():
    across, along = (1.0, 0.0), (0.0, 1.0)
    edges = ImageEdges(
        np.array([[1.0, 0.0], [3.0, 0.0], [0.0, 50.0]]), np.array([along, across, across])
    )
    points, normals = np.array([[0.0, 0.0], [0.0, 20.0]]), np.array([across, across])
    for flipped in (1, -1):  # it does not matter which side is bright
        rows, places = EdgeMatcher(edges, reach=10.0, turn=4.0).match(points, flipped * normals)
        assert rows.tolist() == [0]
        assert places.tolist() == [[3.0, 0.0]]
    rows, places = EdgeMatcher(edges, reach=10.0, turn=0.1).match(points, normals)
    assert places.tolist() == [[1.0, 0.0]]
    nothing = ImageEdges(np.empty((0, 2)), np.empty((0, 2)))
    rows, places = EdgeMatcher(nothing, reach=10.0, turn=4.0).match(points, normals)
    assert rows.shape == (0,) and places.shape == (0, 2)


def test_the_occluding_edges_of_a_ball_are_its_rim_from_wherever_it_is_seen():
    surface = surface_of(ball(grown=10.0))
    for yaw, growth in ((0.0, 0.0), (70.0, 1.0), (160.0, -1.0)):
        turn = rotations(Cameras(0, *np.array([[yaw], [20.0], [0.0]]), 0))[0]
        rim = surface.occluding_edges(np.array([growth]), turn)
        x, y, z = turn @ rim.points.T
        radius = 50 + 10 * growth
        assert np.abs(np.hypot(x, y) - radius).max() < 0.02 * radius
        assert np.abs(z).max() < 0.1 * radius
        outwards = np.stack([x, y], axis=1) / np.hypot(x, y)[:, None]
        assert ((outwards * rim.normals).sum(1) > 0.5).all()
        assert rim.shares.sum() == pytest.approx(1)
        assert np.diff(np.sort(np.arctan2(x, y))).max() < 0.2
        np.testing.assert_allclose(rim.points / (5 + growth), rim.basis[0], rtol=1e-4, atol=1e-3)


def test_edges_that_are_hidden_or_against_something_near_are_left_out():
    front = np.eye(3)
    behind = ball(30.0, 800, centre=(10, 0, -200))  # nothing of it is seen
    bump = ball(20.0, 800, centre=(0, 0, 33))  # 3 mm higher than the ball around it, and narrower
    high = ball(20.0, 800, centre=(0, 0, 90))
    for other, n_rims in ((behind, 1), (bump, 1), (high, 2)):
        rims = surface_of(ball(), other).occluding_edges(np.zeros(1), front)
        radii = np.linalg.norm(rims.points[:, :2], axis=1)
        assert (np.abs(radii - 50) < 1.5).sum() > 60
        assert (radii < 48).any() == (n_rims == 2)
    alone = surface_of(behind).occluding_edges(np.zeros(1), front)
    assert len(alone.points) > 40  # it is seen where nothing hides it


@pytest.mark.slow
def test_edges_bring_the_outline_and_the_pose_nearer_to_the_truth(model, faces, detected, fits):
    identity, poses, _, _ = faces
    distances = []
    for some in fits:
        apart_by = []
        for coefficients, pose, fit, at in zip(identity, poses, some, faces[3], strict=True):
            points = model.shape(coefficients)[model.landmarks["ibug68"]]
            shift = (at - SCALE * points @ (pose[:2].T * (1, -1))).mean(0)
            true = SCALE * jaw(model, coefficients, pose) @ (pose[:2].T * (1, -1)) + shift
            found = fit.project(jaw(model, fit.identity, fit.camera.rotation))
            apart_by.append(np.median(KDTree(found).query(true)[0]) / SCALE)
        distances.append(np.mean(apart_by))
    with_edges, without = distances
    assert with_edges < 0.8 * without
    turned = [
        np.mean([angle(fit.camera.rotation, pose) for fit, pose in zip(some, poses, strict=True)])
        for some in fits
    ]
    assert turned[0] < 0.85 * turned[1]
    assert turned[0] < 3


def test_edges_bring_the_landmarks_nearer_to_the_truth(model, faces, fits):
    identity = faces[0]
    with_edges, without = (errors(model, some, identity).mean() for some in fits)
    mean_face = errors(model, [replace(fits[0][0], identity=np.zeros(1))] * N, identity).mean()
    assert with_edges < 0.97 * without < 0.8 * mean_face


def test_a_fit_says_of_itself_what_is_so(model, detected, fits):
    vertices = model.landmarks["ibug68"][[8, *range(17, 68)]]
    for fit, points in zip(fits[0], detected, strict=True):
        assert fit.identity.shape == (40,)
        assert np.abs(fit.identity).max() <= 3
        np.testing.assert_allclose(
            np.linalg.inv(fit.camera.rotation), fit.camera.rotation.T, atol=1e-9
        )
        assert np.linalg.det(fit.camera.rotation) == pytest.approx(1)
        shape = model.shape(fit.identity)
        missed = fit.project(shape[vertices]) - points[[8, *range(17, 68)]]
        assert fit.rms == pytest.approx(np.sqrt((missed**2).sum(1).mean()))
        assert fit.rms < 2 * NOISE * SCALE * np.sqrt(2)
    assert np.mean([fit.edge_share for fit in fits[0]]) > 0.6
    scales = np.array([fit.camera.scale for fit in fits[0]]) / SCALE
    assert abs(scales.mean() - 1) < 0.02 and scales.std() < 0.05
    assert np.mean([fit.converged for fit in fits[0]]) > 0.7
    assert max(fit.n_rounds for fit in fits[0]) <= 20


def test_without_edges_the_fit_is_that_of_landmarks_alone(model, detected, fits):
    vertices = model.landmarks["ibug68"][[8, *range(17, 68)]]
    alone = LandmarkFitter(
        replace(model, landmarks={"same": vertices}),
        "same",
        n_identity=40,
        n_expression=0,
        landmark_sd=np.sqrt(0.40 / 40 / (0.15 / 52)) / 0.6,
        tolerance=1e-12,
    )
    for fit, points in zip(fits[1], detected, strict=True):
        assert fit.edge_share == 0 and fit.converged
        expected = alone.fit(points[[8, *range(17, 68)]] * (1, -1))
        np.testing.assert_allclose(fit.identity, expected.identity, atol=0.1)
        assert angle(fit.camera.rotation, expected.camera.rotation) < 0.2
        assert fit.camera.scale == pytest.approx(expected.camera.scale, rel=2e-3)


def test_a_shifted_image_shifts_the_fit_and_nothing_else(fitter, faces, detected, fits):
    image = np.pad(faces[2][0], ((11, 0), (7, 0), (0, 0)), mode="edge")
    fit = fitter.fit(detected[0] + (7, 11), image)
    np.testing.assert_allclose(fit.identity, fits[0][0].identity, atol=1e-6)
    shift = fit.camera.translation - fits[0][0].camera.translation
    np.testing.assert_allclose(shift, (7, -11), atol=1e-6)


def test_a_larger_image_gives_much_the_same_face(fitter, faces, detected, fits):
    turned, changes, effects = [], [], []
    for image, points, small, alone in zip(faces[2][:10], detected, *fits, strict=False):
        large = np.array(
            Image.fromarray(image).resize((4 * 178, 4 * 218), Image.Resampling.BICUBIC)
        )
        fit = fitter.fit(4 * points, large)
        assert fit.camera.scale == pytest.approx(4 * small.camera.scale, rel=0.05)
        turned.append(angle(fit.camera.rotation, small.camera.rotation))
        changes.append(np.linalg.norm(fit.identity - small.identity))
        effects.append(np.linalg.norm(alone.identity - small.identity))
    assert np.mean(changes) < 0.7 * np.mean(effects)
    assert np.mean(turned) < 1.5


def test_a_face_that_the_image_cuts_off_is_fitted_by_what_there_is(fitter, faces, detected):
    middle = int(detected[0][:, 0].mean())
    fit = fitter.fit(detected[0], faces[2][0][:, : middle + 10])
    assert 0 < fit.edge_share < fitter.fit(detected[0], faces[2][0]).edge_share
    assert angle(fit.camera.rotation, faces[1][0]) < 6


def test_coefficients_stay_within_three_standard_deviations(model, fitter):
    part = model.restrict(model.landmarks["ibug68"])
    views = SCALE * part.shape(15 * np.eye(10))[..., :2] * (1, -1) + (89, 111)
    largest = [np.abs(fitter.fit(view, BLANK).identity).max() for view in views]
    assert max(largest) == 3


@pytest.mark.parametrize("schemes", [("bfm72",), ("ibug51",), ("bfm72", "ibug51")])
def test_models_with_fewer_landmarks_are_fitted_too(model, faces, detected, schemes):
    partly = replace(model, landmarks={name: model.landmarks[name] for name in schemes})
    fitter = EdgeFitter(partly)
    some = [fitter.fit(*face) for face in zip(detected, faces[2], strict=True)]
    turned = [angle(fit.camera.rotation, pose) for fit, pose in zip(some, faces[1], strict=True)]
    assert np.mean(turned) < 4.5
    mean_face = errors(model, [replace(some[0], identity=np.zeros(1))] * N, faces[0]).mean()
    assert errors(model, some, faces[0]).mean() < 0.85 * mean_face


def test_basel_face_models_are_fitted_by_what_the_tables_know(model, faces, detected):
    """The full mesh has landmarks of its own; any other of that name might number anew."""
    n_vertices, tip = 53149, 47846  # of the 2017 model, and its chin
    full = replace(model, name="bfm2017", landmarks={"bfm72": model.landmarks["bfm72"]})
    spare = n_vertices - model.n_vertices
    far = np.full((spare, 3), [0.0, 0.0, -500.0])
    full = replace(
        full,
        mean=np.concatenate([full.mean, far]),
        identity_basis_times_sd=np.pad(
            full.identity_basis_times_sd[:3], ((0, 0), (0, spare), (0, 0))
        ),
        expression_basis=None,
        expression_names=(),
    )
    # The chin of the table lies among the vertices far behind, which no fit can explain.
    assert tip >= model.n_vertices
    other = replace(full, name="bfm2019")
    rms = [EdgeFitter(a_model).fit(detected[0], faces[2][0]).rms for a_model in (full, other)]
    assert rms[0] > 5 * rms[1]


def test_what_cannot_be_fitted_is_refused(model, fitter, faces, detected):
    points, image = detected[0], faces[2][0]
    missing = points.copy()
    missing[3, 1] = np.nan  # of the jaw line, which is not fitted
    height = image.shape[0]
    for landmarks, message in (
        (missing, "landmarks must be finite"),
        (points[17:], r"landmarks must be \(68, 2\). Received \(51, 2\)"),
        ((0, height) + points * (1, -1), "y turned up: .* seen from behind or mirrored"),
        ((178, 0) + points * (-1, 1), "seen from behind or mirrored"),
        (points[:, :1] * (1, 1), "spread in two directions"),
        (points * 10, "must be pixels of the image, which is 178 x 218. Received 0 of 68"),
    ):
        with pytest.raises(InputError, match=message):
            fitter.fit(landmarks, image)
    for other in (image[..., 0], image / 255.0, image[..., :1]):
        with pytest.raises(InputError, match=r"image must be RGB, uint8 \(H, W, 3\)"):
            fitter.fit(points, other)
    with pytest.raises(InputError, match="n_identity must be at least 1. Received 0"):
        EdgeFitter(model, n_identity=0)
    with pytest.raises(InputError, match="openhead must be a mesh .* Received one that has none"):
        EdgeFitter(replace(model, landmarks={}))


def test_as_many_components_are_fitted_as_asked_for_or_there_are(model, faces, detected):
    fewer = replace(model, identity_basis_times_sd=model.identity_basis_times_sd[:12])
    assert EdgeFitter(model, n_identity=7).fit(detected[0], faces[2][0]).identity.shape == (7,)
    assert EdgeFitter(fewer).fit(detected[0], faces[2][0]).identity.shape == (12,)
