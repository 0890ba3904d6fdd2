"""Fits to landmarks and edges: the outline helps, and known faces and cameras come back."""

from dataclasses import replace

import numpy as np
import pytest
from faces import cameras, degrees_between, rotation_of
from writers.scans import hull

from data_gen.appearance import Albedo, sample_lights
from data_gen.edge_fitting import EdgeFitter
from data_gen.edges import EdgeMatcher, ImageEdges, Surface, find_edges
from data_gen.models.morphable_model import MorphableModel
from data_gen.models.openhead import load_openhead
from data_gen.renderer import Frames, Renderer
from deepmds_keras.errors import InputError
from deepmds_keras.geometry.alignment import align
from deepmds_keras.geometry.units import normalise
from deepmds_keras.geometry.views import in_camera_frame, rotations

pytestmark = pytest.mark.usefixtures("one_thread")
N, SIZE, SCALE, NOISE = 60, 218, 0.6, 1.5  # faces, pixels, pixels per mm, mm
BLANK = np.full((SIZE, SIZE, 3), 128, np.uint8)


def portraits():
    """Random faces before dark walls, in CelebA's size; their identities, poses and landmarks."""
    head, rng = load_openhead(), np.random.default_rng(0)
    identity, shapes = head.sample(N, rng)
    yaw, pitch, roll = rng.normal(0, [[20], [7], [3]], (3, N)).clip(-40, 40)
    poses = cameras(yaw, pitch, roll)
    posed = in_camera_frame(shapes, poses)
    landmarks = posed[:, head.landmarks["ibug68"], :2]
    extent = np.full((N, 2), SIZE / SCALE)
    frames = Frames(landmarks.mean(1) - extent / 2, extent, SIZE)
    renderer = Renderer(head, SIZE)
    albedo = Albedo(head).sample(N, rng)
    walls = np.linspace(40, 90, SIZE)[:, None, None] + rng.normal(0, 2, (N, SIZE, SIZE, 3))
    images = renderer.draw(posed, posed, albedo, frames, sample_lights(N, rng), np.uint8(walls))
    renderer.close()
    return identity, rotations(poses), images, frames.pixels(landmarks)


@pytest.fixture(scope="module")
def faces(apart):
    """Identities, poses, images and landmarks as a detector might find them, pixels."""
    *known, pixels = apart(portraits)
    return *known, pixels + np.random.default_rng(1).normal(0, NOISE * SCALE, pixels.shape)


@pytest.fixture(scope="module")
def fits(head, faces):
    """Of every face: with the edges of its image, and without any."""
    _, _, images, detected = faces
    fitter = EdgeFitter(head)
    with_edges = [fitter.fit(*face) for face in zip(detected, images, strict=True)]
    return with_edges, [fitter.fit(face, BLANK) for face in detected]


def angles(fits, poses):
    return degrees_between(np.array([fit.camera.rotation for fit in fits]), poses)


def error(head, fits, identity):
    """Mean squared error of the paper's landmarks after alignment."""
    part = head.at_landmarks("bfm72")
    truth = normalise(part.shape(identity))
    return (
        (align(part.shape(np.array([fit.identity for fit in fits])), truth) - truth) ** 2
    ).mean()


def ball(radius=50.0, n=3000, grown=0.0, centre=(0, 0, 0)):
    """A sphere, whose only component makes it larger, as a model's mean, basis and triangles."""
    k = np.arange(n) + 0.5
    height, turn = 1 - 2 * k / n, k * np.pi * (1 + 5**0.5)
    flat = np.sqrt(1 - height**2)
    points = np.stack([flat * np.cos(turn), flat * np.sin(turn), height], axis=1)
    return radius * points + np.array(centre), grown * points[None], hull(points)


def surface_of(*balls):
    means, bases, triangles = zip(*balls, strict=True)
    first = np.cumsum([0, *map(len, means)])
    numbered = [t + i for t, i in zip(triangles, first, strict=False)]
    arrays = np.concatenate(means), np.concatenate(bases, axis=1), np.concatenate(numbered)
    return Surface(MorphableModel("balls", *arrays), np.ones(first[-1], bool), 1)


def test_the_rim_of_a_disc_is_located_to_a_fraction_of_a_pixel():
    y, x = np.indices((80, 80)) + 0.5
    inside = (20.5 - np.hypot(x - 40.3, y - 30.8)).clip(0, 1)  # its rim as a camera blurs it
    edges = find_edges(200 * inside[..., None].repeat(3, 2))
    offsets = edges.points - (40.3, 30.8)
    radii = np.linalg.norm(offsets, axis=1)
    assert np.abs(radii - 20).max() < 0.3
    # All around, and from dark to bright.
    assert np.diff(np.sort(np.arctan2(*offsets.T))).max() < 0.15
    assert ((-offsets * edges.normals).sum(1) > 0.98 * radii).all()
    assert not len(find_edges(2 * inside[..., None].repeat(3, 2)).points)  # no contrast


def test_the_edge_matched_is_the_nearest_that_runs_the_same_way():
    across, along = (1.0, 0.0), (0.0, 1.0)
    places = np.array([[1.0, 0.0], [3.0, 0.0], [0.0, 50.0]])
    edges = ImageEdges(places, np.array([along, across, across]))
    points, normals = np.array([[0.0, 0.0], [0.0, 20.0]]), np.array([across, across])
    for flipped in (1, -1):  # it does not matter which side is bright
        rows, matched = EdgeMatcher(edges, reach=10.0, turn=4.0).match(points, flipped * normals)
        assert rows.tolist() == [0] and matched.tolist() == [[3.0, 0.0]]
    _, matched = EdgeMatcher(edges, reach=10.0, turn=0.1).match(points, normals)
    assert matched.tolist() == [[1.0, 0.0]]


def test_the_occluding_edges_of_a_ball_are_its_rim_from_wherever_it_is_seen():
    surface = surface_of(ball(grown=10.0))
    for yaw, growth in ((0.0, 0.0), (70.0, 1.0), (160.0, -1.0)):
        turn = rotation_of(yaw, 20)
        rim = surface.occluding_edges(np.array([growth]), turn)
        x, y, z = turn @ rim.points.T
        radius = 50 + 10 * growth
        assert np.abs(np.hypot(x, y) - radius).max() < 0.02 * radius
        assert np.abs(z).max() < 0.1 * radius
        outwards = np.stack([x, y], axis=1) / np.hypot(x, y)[:, None]
        assert ((outwards * rim.normals).sum(1) > 0.5).all()
        assert rim.shares.sum() == pytest.approx(1)
        np.testing.assert_allclose(rim.points / (5 + growth), rim.basis[0], rtol=1e-4, atol=1e-3)


@pytest.mark.parametrize(
    ("radius", "centre", "is_seen"),
    [
        (30.0, (10, 0, -200), False),  # behind
        (20.0, (0, 0, 33), False),  # a bump, 3 mm higher than the ball around it
        (20.0, (0, 0, 90), True),
    ],
)
def test_edges_that_are_hidden_or_against_something_near_are_left_out(radius, centre, is_seen):
    other = ball(radius, 800, centre=centre)
    rims = surface_of(ball(), other).occluding_edges(np.zeros(1), np.eye(3))
    radii = np.linalg.norm(rims.points[:, :2], axis=1)
    assert (np.abs(radii - 50) < 1.5).sum() > 60
    assert (radii < 48).any() == is_seen


def test_edges_bring_pose_and_landmarks_nearer_to_the_truth(head, faces, fits):
    identity, poses, _, _ = faces
    turned, errors = zip(
        *((angles(some, poses).mean(), error(head, some, identity)) for some in fits), strict=True
    )
    assert turned[0] < 0.85 * turned[1] and turned[0] < 3
    mean_face = error(head, [replace(fits[0][0], identity=np.zeros(1))] * N, identity)
    assert errors[0] < 0.97 * errors[1] < 0.8 * mean_face


def test_a_fit_says_of_itself_what_is_so(head, faces, fits):
    used = [8, *range(17, 68)]
    for fit, points in zip(fits[0], faces[3], strict=True):
        assert fit.identity.shape == (40,) and np.abs(fit.identity).max() <= 3
        missed = fit.project(head.shape(fit.identity))[head.landmarks["ibug68"]] - points
        assert np.sqrt((missed[used] ** 2).sum(1).mean()) < 2 * NOISE * SCALE * np.sqrt(2)
    scales = np.array([fit.camera.scale for fit in fits[0]]) / SCALE
    assert abs(scales.mean() - 1) < 0.02 and scales.std() < 0.05


@pytest.mark.parametrize("schemes", [("bfm72",), ("ibug51",)])
def test_models_with_fewer_landmarks_are_fitted_too(head, faces, schemes):
    fitter = EdgeFitter(replace(head, landmarks={name: head.landmarks[name] for name in schemes}))
    some = [fitter.fit(*face) for face in zip(faces[3], faces[2], strict=True)]
    assert angles(some, faces[1]).mean() < 4.5
    mean_face = error(head, [replace(some[0], identity=np.zeros(1))] * N, faces[0])
    assert error(head, some, faces[0]) < 0.85 * mean_face


def test_what_cannot_be_fitted_is_refused(head, faces):
    fitter, image, points = EdgeFitter(head), faces[2][0], faces[3][0]
    for landmarks, message in (
        ((0, SIZE) + points * (1, -1), "y turned up: .* seen from behind or mirrored"),
        (points * 10, "must be pixels of the image, of 218 x 218. Received 0 of 68"),
    ):
        with pytest.raises(InputError, match=message):
            fitter.fit(landmarks, image)
    with pytest.raises(InputError, match="openhead must be a mesh .* Received one that has none"):
        EdgeFitter(replace(head, landmarks={}))
