"""Renders: the image is the same view as the landmarks, the right way round, every time alike."""

from functools import cache

import numpy as np
import pytest
from faces import cameras

from data_gen import renderer
from data_gen.appearance import Albedo, Lights
from data_gen.models.mesh import vertex_normals
from data_gen.models.morphable_model import MorphableModel
from data_gen.models.openhead import load_openhead
from data_gen.renderer import Renderer, part_of, seen_vertices, square_frames, stretched_frames
from deepmds_keras.errors import InputError
from deepmds_keras.geometry.views import in_camera_frame, pose_and_project, project

SIZE = 96
NOSE_TIP, RIGHT_CORNER, LEFT_CORNER, CHIN = 28, 6, 50, 33
GREY = np.full((1, 3), 0.4)


# What draws does so in a separate process (`apart`), where it is kept for the next call.
load_head = cache(load_openhead)
part_of_head = cache(lambda: part_of(load_head(), seen_vertices(load_head(), "bfm72")))
renderer_of = cache(lambda whole: Renderer(load_head() if whole else part_of_head(), SIZE))


def n_triangles_seen():
    return len(part_of_head().triangles)


def drawn(colours, pose, whole=True, background=None, stretched=False):
    """One image of the mean face in colours, all of it or what can be seen; and its vertices."""
    head, part = load_head(), load_head() if whole else part_of_head()
    landmarks = head.mean[None, head.landmarks["bfm72"]]
    posed, seen = pose_and_project(part.mean[None], landmarks, pose)
    frames = square_frames(project(landmarks, pose), SIZE)
    if stretched:
        frames = stretched_frames(seen[..., :2], SIZE)
    colours = np.broadcast_to(colours, (1, part.n_vertices, 3))
    light = Lights(np.array([[0, 0, 1.0]]), np.ones(1), np.ones((1, 3)))
    image = renderer_of(whole).draw(seen, posed, colours, frames, light, background)[0]
    return image, frames.pixels(seen[..., :2])[0]


POSES = [
    cameras(),
    cameras(yaw=45.0),
    cameras(yaw=-45.0),
    cameras(yaw=-30.0, pitch=-20.0, field_of_view=5.0),
    cameras(roll=40.0, pitch=-15.0),
]


def redness(apart, marked, pose):
    """`(size, size)` how much redder than grey the image is where vertices are painted red."""
    colours = np.where(marked[:, None], (1.0, 0, 0), (0.5, 0.5, 0.5))
    image, _ = apart(drawn, colours, pose)
    return image[..., 0].astype(float) - image[..., 1]


@pytest.mark.parametrize("landmark", [NOSE_TIP, RIGHT_CORNER, LEFT_CORNER, CHIN])
def test_a_landmark_lies_on_what_is_painted_there(apart, head, landmark):
    vertex = head.landmarks["bfm72"][landmark]
    near = np.linalg.norm(head.mean - head.mean[vertex], axis=1) < 6
    facing = [
        pose
        for pose in POSES
        if vertex_normals(in_camera_frame(head.mean[None], pose)[0], head.triangles)[vertex, 2]
        > 0.3
    ]
    assert len(facing) >= 4
    for pose in facing:
        red = redness(apart, near, pose).clip(0)
        assert red.max() > 200
        rows, columns = np.indices(red.shape) + 0.5  # middles of the pixels
        middle = np.array([(red * axis).sum() for axis in (columns, rows)]) / red.sum()
        view = project(head.mean[None, head.landmarks["bfm72"]], pose)
        place = square_frames(view, SIZE).pixels(view)[0, landmark]
        assert np.linalg.norm(middle - place) < 2


def test_what_lies_behind_is_hidden(apart, head):
    back = (head.mean[:, 2] < 0) & (np.abs(head.mean[:, 0]) < 40)
    assert redness(apart, back, cameras()).max() < 30
    # Turned to its left, the face shows its right cheek and hides its left ear.
    ear = head.landmarks["ibug68"][[0, 16]]
    for yaw, vertex, seen in ((45.0, ear[0], True), (45.0, ear[1], False), (-45.0, ear[1], True)):
        near = np.linalg.norm(head.mean - head.mean[vertex], axis=1) < 10
        assert (redness(apart, near, cameras(yaw)).max() > 100) == seen


@pytest.mark.parametrize("pose", POSES)
def test_the_silhouette_is_that_of_the_vertices_in_either_frame(apart, pose):
    for stretched in (False, True):
        image, places = apart(drawn, GREY, pose, True, None, stretched)
        rows, columns = np.nonzero((image < 250).any(-1))
        low, high = np.clip([places.min(0), places.max(0)], 0, SIZE)
        assert np.abs(low - [columns.min(), rows.min()]).max() < 1.5
        assert np.abs(high - [columns.max() + 1, rows.max() + 1]).max() < 1.5
        if stretched:  # the head touches every side
            assert np.allclose([low, high], [[0, 0], [SIZE, SIZE]])


def test_a_background_is_seen_where_the_head_is_not(apart):
    background = np.random.default_rng(0).integers(0, 256, (1, SIZE, SIZE, 3)).astype(np.uint8)
    white, other = (apart(drawn, GREY, cameras(), True, b)[0] for b in (None, background))
    outside, inside = (white == 255).all(-1), (white == 102).all(-1)
    assert 0.02 < outside.mean() < 0.6 and inside.mean() > 0.3
    assert np.array_equal(other[outside], background[0][outside])
    assert np.array_equal(other[inside], white[inside])
    # On the outline a pixel is part head, part background.
    edge = ~(inside | outside)
    share = (white[edge] - 102.0) / (255 - 102)
    mixed = 102 + share * (background[0][edge] - 102.0)
    assert edge.sum() > SIZE and np.allclose(other[edge], mixed, atol=1.5)


def test_what_cannot_be_seen_need_not_be_drawn(apart, head):
    assert apart(n_triangles_seen) < len(head.triangles)
    for pose in POSES[:4]:
        whole, fewer = (apart(drawn, GREY, pose, whole)[0] for whole in (True, False))
        assert (np.abs(whole.astype(int) - fewer) > 8).mean() < 1e-3


def test_painted_faces_have_features_and_differ(head):
    colours = Albedo(head).sample(200, np.random.default_rng(0))
    assert colours.shape == (200, head.n_vertices, 3)
    assert 0 <= colours.min() <= colours.max() <= 1
    ibug = head.landmarks["ibug68"]
    brightness = colours.mean(-1)
    skin, lips = colours[:, ibug[29]], colours[:, ibug[[50, 57]]].mean(1)
    assert np.ptp(skin.mean(1)) > 0.4  # light and dark skin
    assert (lips[:, 0] / lips[:, 1] > skin[:, 0] / skin[:, 1]).mean() > 0.95  # redder
    assert (brightness[:, ibug[19]] < skin.mean(1)).mean() > 0.9  # brows
    # On the front of each eyeball, a dark middle within the white.
    eye = head.mean[ibug[36:42]].mean(0)
    near = np.flatnonzero(np.linalg.norm(head.mean[:, :2] - eye[:2], axis=1) < 12)
    assert (brightness[:, near].min(1) < 0.15).all()
    assert (brightness[:, near].max(1) > brightness[:, near].min(1) + 0.3).all()


def test_what_cannot_be_coloured_or_drawn_is_refused(head, monkeypatch):
    bare = MorphableModel("bare", np.zeros((3, 3)), np.zeros((1, 3, 3)), np.array([[0, 1, 2]]))
    with pytest.raises(InputError, match="bare must have colours, or the landmarks ibug68"):
        Albedo(bare)
    monkeypatch.setattr(renderer.sys, "platform", "linux")
    monkeypatch.setitem(renderer.sys.modules, "tensorflow", None)
    with pytest.raises(InputError, match="in a process that has not loaded TensorFlow"):
        Renderer(head, SIZE)
    monkeypatch.delitem(renderer.sys.modules, "tensorflow")
    monkeypatch.setattr(renderer.ctypes.util, "find_library", lambda name: None)
    with pytest.raises(InputError, match="libEGL or libOSMesa"):
        Renderer(head, SIZE)
