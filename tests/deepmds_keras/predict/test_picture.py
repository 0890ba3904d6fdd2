"""Pictures of faces: one scale in all views, every name and note readable, bounded in size."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure
from PIL import Image

from data_gen.models.openhead import load_openhead
from deepmds_keras.camera import head_pose
from deepmds_keras.normalisation import normalise
from deepmds_keras.predict.faces import Face
from deepmds_keras.predict.picture import draw_face, draw_summary, write_picture


@pytest.fixture(scope="module")
def face():
    model = load_openhead()
    shape = normalise(model.mean[model.landmarks["bfm72"]][None])[0]
    view = 150 * shape[:, :2] + (200, -400)
    photo = Path("photo.jpg")
    pose = head_pose(view, shape)
    return Face("photo", photo, photo, "bfm72", view * (1, -1), shape, "normalised", pose)


@pytest.fixture(scope="module")
def photo():
    return np.random.default_rng(0).integers(0, 255, (480, 640, 3), np.uint8)


def test_an_angle_that_rounds_to_nothing_has_no_minus(face):
    turned = replace(face, pose=replace(face.pose, yaw=-19.6, pitch=-0.4, roll=0.6))
    assert turned.angles == "yaw -20°, pitch +0°, roll +1°"


def panel(figure: Figure, title: str):
    return next(axes for axes in figure.axes if axes.get_title() == title)


def points_of(axes) -> np.ndarray:
    return np.asarray(axes.collections[-1].get_offsets())


def words(figure: Figure) -> str:
    return "\n".join(text.get_text() for text in figure.texts)


def inches_per_unit(figure: Figure, axes) -> np.ndarray:
    """Along x and y."""
    box = axes.get_position()
    size = figure.get_size_inches() * (box.width, box.height)
    return size / [np.ptp(axes.get_xlim()), np.ptp(axes.get_ylim())]


def test_all_views_have_one_scale_and_show_every_landmark(face, photo):
    figure = draw_face(face, photo)
    views = [panel(figure, title) for title in ("Front", "Three quarters", "Side")]
    scales = np.array([inches_per_unit(figure, axes) for axes in views])
    assert np.allclose(scales, scales[0, 0])
    for axes in views:
        points, limits = points_of(axes), np.array([axes.get_xlim(), axes.get_ylim()])
        assert len(points) == 72
        assert (points > limits[:, 0]).all()
        assert (points < limits[:, 1]).all()


def test_the_nose_points_out_of_the_side_view_and_the_left_eye_is_on_the_right(face, photo):
    figure = draw_face(face, photo)
    nose, right_eye, left_eye = 28, 0, 56
    front, half, side = (
        points_of(panel(figure, title)) for title in ("Front", "Three quarters", "Side")
    )
    assert front[right_eye, 0] < front[nose, 0] < front[left_eye, 0]
    assert side[:, 0].argmax() == nose
    assert half[nose, 0] - half[:, 0].mean() > 0.05  # turned to its left, as from the side
    assert np.array_equal(front[:, 1], side[:, 1])


def test_landmarks_are_drawn_on_the_part_of_the_photo_that_is_shown(face, photo):
    dark = np.zeros_like(photo)
    for x, y in face.landmarks.astype(int):
        dark[y, x] = 255
    axes = draw_face(face, dark).axes[0]
    shown = axes.images[0].get_array()
    x, y = points_of(axes).astype(int).T
    assert (shown[y, x] > 200).all()
    assert axes.images[0].get_extent() == [0, shown.shape[1], shown.shape[0], 0]


def test_without_a_photo_the_landmarks_stand_alone_with_y_down(face):
    figure = draw_face(replace(face, photo=None), None)
    axes = panel(figure, "Landmarks given")
    assert np.array_equal(points_of(axes), face.landmarks)
    assert axes.get_ylim()[0] > axes.get_ylim()[1]


def test_pose_unit_axes_and_notes_are_said(face, photo):
    text = words(draw_face(replace(face, notes=("Turned beyond 30°.",)), photo))
    for said in ("yaw", "x to the subject's left", "does not show the true size", "beyond 30°"):
        assert said in text
    millimetres = draw_face(replace(face, unit="mm", shape=150 * face.shape), photo)
    assert "mm (millimetres" in words(millimetres)
    assert panel(millimetres, "Side").get_xlabel() == "z (mm)"


@pytest.mark.parametrize("name", ["a$b$c", "顔\udcff\n<b>", "long" * 60, r"$\frac$ _{"])
def test_any_name_can_be_drawn(tmp_path, face, photo, name):
    named = replace(face, name=name, notes=(f"see {name}",))
    figure = draw_face(named, photo)
    write_picture(tmp_path / "face.png", figure)
    with Image.open(tmp_path / "face.png") as picture:
        assert picture.width == 1200
    title = figure.texts[0].get_text()
    assert len(title) <= 70
    assert title[0] == (name[0] if name[0].isascii() else "?")
    write_picture(tmp_path / "all.png", draw_summary([named], [photo]))


def test_equal_faces_give_equal_files_and_no_others(tmp_path, face, photo):
    for name in ("a.png", "b.png"):
        write_picture(tmp_path / name, draw_face(face, photo))
    assert (tmp_path / "a.png").read_bytes() == (tmp_path / "b.png").read_bytes()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.png", "b.png"]


def test_a_summary_is_bounded_says_so_and_reads_no_more_photos_than_it_draws(face, photo):
    faces = [replace(face, name=f"face {i}") for i in range(40)]
    read = []

    def photos():
        for i in range(40):
            read.append(i)
            yield photo if i % 2 else None

    figure = draw_summary(faces, photos())
    assert "24 of 40 faces" in words(figure)
    assert "face 23" in words(figure)
    assert "face 24" not in words(figure)
    assert len(read) == 24
    assert len(figure.axes) == 48
    boxes = [axes.get_position() for axes in figure.axes]
    assert all(0 <= box.x0 < box.x1 <= 1 and 0 <= box.y0 < box.y1 <= 1 for box in boxes)


def test_a_summary_of_few_faces_is_no_larger_than_they_need(face):
    one, six = draw_summary([face], [None]), draw_summary([face] * 6, [None] * 6)
    assert one.get_size_inches()[0] < 2
    assert six.get_size_inches()[1] > one.get_size_inches()[1]
    assert "1 face" in words(one)
