"""Renders: the image is the same view as the landmarks, the right way round, every time alike."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from data_gen.datasets.dataset import make_dataset
from data_gen.datasets.images import frames_of, make_scene, render
from data_gen.models.mesh import vertex_normals
from data_gen.models.morphable_model import MorphableModel
from data_gen.models.openhead import load_openhead
from data_gen.rendering import rasteriser
from data_gen.rendering.albedo import Albedo
from data_gen.rendering.renderer import Lights, Renderer, sample_lights, square_frames
from data_gen.rendering.visibility import part_of, seen_vertices
from data_gen.views.projections import Cameras, in_camera_frame, project, project_with_depth
from deepmds_keras.errors import InputError

SIZE = 96
NOSE_TIP, RIGHT_CORNER, LEFT_CORNER, CHIN = 28, 6, 50, 33


# What draws does so in a process of its own (`apart`), where it is kept for the next call.
open_head = cache(load_openhead)
open_head_part = cache(lambda: part_of(open_head(), seen_vertices(open_head(), "bfm72")))
scene_of = cache(lambda protocol: make_scene(open_head(), "bfm72", SIZE, protocol))
renderer_of = cache(lambda whole: Renderer(open_head() if whole else open_head_part(), SIZE))


def rendered(faces, chosen, seed, protocol="paper"):
    return render(scene_of(protocol), faces, chosen, np.random.default_rng(seed))


def projected_vertices(faces, protocol="paper"):
    """Where the vertices that are drawn lie in the images: `(n, V, 2)` pixels."""
    scene = scene_of(protocol)
    posed, landmarks = (
        in_camera_frame(points, faces.cameras)
        for points in (scene.model.shape(faces.identity), faces.landmarks.astype(float))
    )
    seen = project_with_depth(posed, landmarks, faces.cameras)
    return frames_of(scene, faces.views.astype(float), seen).pixels(seen[..., :2])


def open_head_part_as_it_is():
    return open_head_part()


def highest(protocol):
    return scene_of(protocol).model.mean[:, 1].max()


@pytest.fixture(scope="module")
def model():
    return load_openhead()


@pytest.fixture(scope="module")
def faces(model):
    return make_dataset(model, 12, np.random.default_rng(3))


def camera(**angles):
    values = {name: np.array([angles.get(name, 0.0)]) for name in Cameras.__dataclass_fields__}
    return Cameras(**values | {"projection": np.array([int("field_of_view" in angles)])})


def painted(colours, pose, light=None, whole=True):
    """One image of the mean face in the colours given, all of it or what can be seen."""
    model, part = open_head(), open_head() if whole else open_head_part()
    landmarks = model.mean[None, model.landmarks["bfm72"]]
    posed = in_camera_frame(part.mean[None], pose)
    seen = project_with_depth(posed, in_camera_frame(landmarks, pose), pose)
    light = light or Lights(np.array([[0, 0, 1.0]]), np.ones(1), np.ones((1, 3)))
    frames = square_frames(project(landmarks, pose), SIZE)
    return renderer_of(whole).draw(seen, posed, colours[None], frames, light)[0]


def before(model_faces, background):
    """The first face of a data set, whole, before a background."""
    scene = scene_of("released")
    posed, landmarks = (
        in_camera_frame(points, model_faces.cameras[:1])
        for points in (scene.model.shape(model_faces.identity[:1]), model_faces.landmarks[:1])
    )
    seen = project_with_depth(posed, landmarks, model_faces.cameras[:1])
    grey = np.full((1, scene.model.n_vertices, 3), 0.4)
    light = Lights(np.array([[0, 0, 1.0]]), np.ones(1), np.ones((1, 3)))
    frames = square_frames(model_faces.views[:1], SIZE)
    renderer = Renderer(scene.model, SIZE)
    image = renderer.draw(seen, posed, grey, frames, light, background)
    renderer.close()
    return image[0]


def redness(image):
    """`(size, size)` how much redder than grey."""
    return image[..., 0].astype(float) - image[..., 1]


POSES = [
    camera(),
    camera(yaw=45.0),
    camera(yaw=-45.0),
    camera(yaw=-30.0, pitch=-20.0, field_of_view=5.0),
    camera(roll=40.0, pitch=-15.0),
]


@pytest.mark.parametrize("landmark", [NOSE_TIP, RIGHT_CORNER, LEFT_CORNER, CHIN])
def test_a_landmark_lies_on_what_is_painted_there(apart, model, landmark):
    vertex = model.landmarks["bfm72"][landmark]
    near = np.linalg.norm(model.mean - model.mean[vertex], axis=1) < 6
    colours = np.where(near[:, None], (1.0, 0, 0), (0.5, 0.5, 0.5))
    facing = [
        pose
        for pose in POSES
        if vertex_normals(in_camera_frame(model.mean[None], pose)[0], model.triangles)[vertex, 2]
        > 0.3
    ]
    assert len(facing) >= 4
    for pose in facing:
        red = redness(apart(painted, colours, pose)).clip(0)
        assert red.max() > 200
        rows, columns = np.indices(red.shape) + 0.5  # middles of the pixels
        middle = np.array([(red * axis).sum() for axis in (columns, rows)]) / red.sum()
        view = project(model.mean[None, model.landmarks["bfm72"]], pose)
        place = square_frames(view, SIZE).pixels(view)[0, landmark]
        assert np.linalg.norm(middle - place) < 2


def test_left_is_left_and_up_is_up(apart, model):
    left = np.where(model.mean[:, :1] > 0, (1.0, 0, 0), (0.5, 0.5, 0.5))
    red = redness(apart(painted, left, camera())) > 100
    # The subject's left is on the right of the image.
    assert red[:, SIZE // 2 + 2 :].mean() > 0.5
    assert not red[:, : SIZE // 2 - 2].any()
    high = np.where(model.mean[:, 1:2] > 0, (1.0, 0, 0), (0.5, 0.5, 0.5))
    red = redness(apart(painted, high, camera())) > 100
    assert np.flatnonzero(red.any(1)).mean() < np.flatnonzero(~red.any(1)).mean()


def test_what_lies_behind_is_hidden(apart, model):
    back = (model.mean[:, 2] < 0) & (np.abs(model.mean[:, 0]) < 40)
    colours = np.where(back[:, None], (1.0, 0, 0), (0.5, 0.5, 0.5))
    assert redness(apart(painted, colours, camera())).max() < 30
    # Turned to its own left, the face shows its right cheek and hides its left ear.
    ear = model.landmarks["ibug68"][[0, 16]]
    for yaw, vertex, seen in ((45.0, ear[0], True), (45.0, ear[1], False), (-45.0, ear[1], True)):
        near = np.linalg.norm(model.mean - model.mean[vertex], axis=1) < 10
        colours = np.where(near[:, None], (1.0, 0, 0), (0.5, 0.5, 0.5))
        red = redness(apart(painted, colours, camera(yaw=yaw)))
        assert (red.max() > 100) == seen


def test_the_silhouette_is_that_of_the_vertices(apart, model, faces):
    # Cut to the head's bounding box, the head touches every side of the image ...
    assert apart(highest, "released") == model.mean[:, 1].max()  # from the crown on
    images, _ = apart(rendered, faces, range(4), 0, "released")
    drawn = (images < 250).any(-1)
    for side in (drawn[:, 0], drawn[:, -1], drawn[:, :, 0], drawn[:, :, -1]):
        assert side.any(1).all()
    # ... and square frames show it where its vertices are.
    images, landmarks = apart(rendered, faces, range(12), 0)
    for image, places in zip(images, apart(projected_vertices, faces), strict=True):
        columns = np.flatnonzero((image < 250).any((0, 2)))
        assert abs(columns[0] - max(places[:, 0].min(), 0)) < 1.5
        assert abs(columns[-1] + 1 - min(places[:, 0].max(), SIZE)) < 1.5
    inside = np.floor(landmarks).astype(int)
    on_face = (images < 250).any(-1)[np.arange(12)[:, None], inside[..., 1], inside[..., 0]]
    assert on_face.mean() > 0.98  # all but some on the very outline


def test_a_background_is_seen_where_the_head_is_not(apart, faces):
    background = np.random.default_rng(0).integers(0, 256, (1, SIZE, SIZE, 3)).astype(np.uint8)
    white, other = apart(before, faces, None), apart(before, faces, background)
    assert np.array_equal(white, apart(before, faces, np.full_like(background, 255)))
    outside = (white == 255).all(-1)
    assert 0.02 < outside.mean() < 0.6
    assert np.array_equal(other[outside], background[0][outside])
    inside = (white == 102).all(-1)
    assert inside.mean() > 0.3
    assert np.array_equal(other[inside], white[inside])
    # On the outline a pixel is part head, part background.
    edge = ~(inside | outside)
    share = (white[edge] - 102.0) / (255 - 102)
    mixed = 102 + share * (background[0][edge] - 102.0)
    assert edge.sum() > SIZE and np.allclose(other[edge], mixed, atol=1.5)


def test_landmark_pixels_are_those_of_the_views(apart, faces):
    _, landmarks = apart(rendered, faces, range(12), 0)
    low, high = landmarks.min(1), landmarks.max(1)
    assert np.allclose((low + high) / 2, SIZE / 2, atol=1e-3)
    assert np.allclose((high - low).max(1), SIZE / 1.4, atol=1e-3)
    upright = landmarks * (1, -1)  # the views have y up
    scale = np.ptp(upright, axis=1) / np.ptp(faces.views, axis=1)
    assert np.allclose(scale[:, 0], scale[:, 1], rtol=1e-4)


def test_same_random_numbers_same_bytes(apart, faces):
    first, again, other = (apart(rendered, faces, range(5), seed) for seed in (1, 1, 2))
    assert all(np.array_equal(a, b) for a, b in zip(first, again, strict=True))
    assert not np.array_equal(first[0], other[0])
    assert np.array_equal(first[1], other[1])  # only colours and light are drawn anew


def test_light_falls_from_where_the_lamp_is(apart, model):
    grey = np.full((model.n_vertices, 3), 0.6)
    lamp = Lights(np.array([[0.9, 0, 0.44]]), np.array([0.3]), np.ones((1, 3)))
    image = apart(painted, grey, camera(), lamp)
    face = image[30:60].astype(float).mean((0, 2))
    assert face[60:75].mean() > face[21:36].mean() + 20
    lights = sample_lights(500, np.random.default_rng(0))
    assert np.allclose(np.linalg.norm(lights.direction, axis=1), 1)
    assert (lights.direction[:, 2] > 0).all()


def test_what_cannot_be_seen_need_not_be_drawn(apart, model):
    part = apart(open_head_part_as_it_is)
    assert len(part.triangles) < len(model.triangles)
    for pose in POSES[:4]:
        whole, fewer = (
            apart(painted, np.full((n, 3), 0.6), pose, None, all_of_it)
            for n, all_of_it in ((model.n_vertices, True), (part.n_vertices, False))
        )
        assert (np.abs(whole.astype(int) - fewer) > 8).mean() < 1e-3


def test_painted_faces_have_features_and_differ(model):
    colours = Albedo(model).sample(200, np.random.default_rng(0))
    assert colours.shape == (200, model.n_vertices, 3)
    assert 0 <= colours.min() <= colours.max() <= 1
    ibug = model.landmarks["ibug68"]
    brightness = colours.mean(-1)
    skin, lips = colours[:, ibug[29]], colours[:, ibug[[50, 57]]].mean(1)
    assert np.ptp(skin.mean(1)) > 0.4  # light and dark skin
    assert (lips[:, 0] / lips[:, 1] > skin[:, 0] / skin[:, 1]).mean() > 0.95  # redder
    assert (brightness[:, ibug[19]] < skin.mean(1)).mean() > 0.9  # brows
    # On the front of each eyeball, a dark middle within the white.
    eye = model.mean[ibug[36:42]].mean(0)
    near = np.flatnonzero(np.linalg.norm(model.mean[:, :2] - eye[:2], axis=1) < 12)
    assert (brightness[:, near].min(1) < 0.15).all()
    assert (brightness[:, near].max(1) > brightness[:, near].min(1) + 0.3).all()


def test_a_model_with_colours_is_coloured_by_them(model):
    rng = np.random.default_rng(0)
    mean = rng.uniform(0.4, 0.6, (model.n_vertices, 3))
    basis = rng.normal(0, 0.02, (5, model.n_vertices, 3))
    coloured = replace(model, colour_mean=mean, colour_basis_times_sd=basis)
    vertices = np.arange(0, model.n_vertices, 7)
    colours = Albedo(coloured, vertices).sample(4000, rng)
    assert np.allclose(colours.mean(0), mean[vertices], atol=0.01)
    assert np.allclose(colours.std(0), np.sqrt((basis[:, vertices] ** 2).sum(0)), rtol=0.15)


def test_a_model_that_cannot_be_coloured_is_refused():
    bare = MorphableModel("bare", np.zeros((3, 3)), np.zeros((1, 3, 3)), np.array([[0, 1, 2]]))
    with pytest.raises(InputError, match="bare must have colours, or the landmarks ibug68"):
        Albedo(bare)


def test_a_process_that_cannot_draw_is_told_why(model, monkeypatch):
    monkeypatch.setattr(rasteriser.sys, "platform", "linux")
    monkeypatch.setitem(rasteriser.sys.modules, "tensorflow", None)
    with pytest.raises(InputError, match="in a process that has not loaded TensorFlow"):
        Renderer(model, SIZE)
    monkeypatch.delitem(rasteriser.sys.modules, "tensorflow")
    monkeypatch.setattr(rasteriser.ctypes.util, "find_library", lambda name: None)
    with pytest.raises(InputError, match="libEGL or libOSMesa"):
        Renderer(model, SIZE)
