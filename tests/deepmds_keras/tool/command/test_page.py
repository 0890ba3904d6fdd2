"""The page of 3D faces in a real browser: it is drawn, turns, and loads and runs nothing else."""

import base64
import io
import json
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from urllib.parse import unquote

import numpy as np
import pandas as pd
import pytest
from faces import mean_landmarks, rotation_of
from PIL import Image

from deepmds_keras.geometry.camera import head_pose
from deepmds_keras.geometry.units import normalise
from deepmds_keras.tool.command.overlay import cut_out
from deepmds_keras.tool.command.page import write_page
from deepmds_keras.tool.html_parts import json_in_html
from deepmds_keras.tool.predict.faces import Face

PHONE = {
    "viewport": {"width": 390, "height": 844},
    "device_scale_factor": 2,
    "is_mobile": True,
    "has_touch": True,
}
STILL = {"reduced_motion": "reduce", "viewport": {"width": 1280, "height": 900}}
HOSTILE = "<img src=x onerror=window.ran=1>\"'&amp;{{faces}}</script><script>window.ran=1</script>"
POSE = (20, 12, -8)


@pytest.fixture(scope="module")
def face():
    """A head that is turned, looks up and leans, in a photo of 640 x 480."""
    shape = normalise(mean_landmarks("bfm72"))
    view = 180 * shape @ rotation_of(*POSE)[:2].T + (330, -420)
    pose = head_pose(view, shape)
    photo = Path("/somewhere/private/photo.jpg")
    return Face("photo", photo, photo, "bfm72", view * (1, -1), shape, "normalised", pose)


@pytest.fixture(scope="module")
def photo():
    return np.random.default_rng(0).integers(0, 255, (480, 640, 3), np.uint8)


@pytest.fixture
def page_of(tmp_path, visit):
    def page_of(faces, photos, mesh=False, **options):
        path = tmp_path / "page.html"
        write_page(path, faces, photos, mesh=mesh)
        return visit(path, **(STILL | options))

    return page_of


def drawn(page, which=0):
    """What a canvas shows, `(H, W, 4)`, once what was asked of it is drawn."""
    canvas = page.locator("canvas").nth(which)
    canvas.scroll_into_view_if_needed()
    encoded = canvas.evaluate(
        """async (canvas) => {
          for (let k = 0; k < 4; k += 1) await new Promise(requestAnimationFrame);
          return canvas.toDataURL();
        }"""
    )
    png = io.BytesIO(base64.b64decode(encoded.partition(",")[2]))
    return np.asarray(Image.open(png).convert("RGBA"))


def is_line(image):
    """Which pixels have about the colour of lines, faint ones left out."""
    near = (np.abs(image[..., :3].astype(int) - (201, 79, 0)) < 40).all(-1)
    return near & (image[..., 3] > 100)


def middle(page):
    box = page.locator("canvas").first.bounding_box()
    return box["x"] + box["width"] / 2, box["y"] + box["height"] / 2


def test_the_photo_is_loaded_and_the_shape_drawn(page_of, face, photo):
    page = page_of([face], [photo])
    assert page.title() == "3D face of photo"
    width, height = page.locator("img").evaluate("(i) => [i.naturalWidth, i.naturalHeight]")
    assert (width, height) == cut_out(photo, face.landmarks).image.size
    assert is_line(drawn(page)).sum() > 500
    assert page.locator("svg circle").count() == 72


@pytest.mark.parametrize("in_photo", [True, False])
def test_a_missing_landmark_has_no_dot_and_no_place(page_of, face, photo, in_photo):
    landmarks = face.landmarks.copy()
    landmarks[3] = np.nan
    page = page_of([replace(face, landmarks=landmarks)], [photo if in_photo else None])
    radii = "(all) => all.map((dot) => Number(dot.getAttribute('r')) > 0)"
    dots = page.locator("svg circle").evaluate_all(radii)
    assert dots == [i != 3 for i in range(72)]
    page.get_by_text("Coordinates").click()
    page.locator("tbody").wait_for()
    cells = page.locator("tbody tr").nth(3).locator("td").all_inner_texts()
    assert cells[5:] == ["–", "–"] and "–" not in cells[:5]


def test_the_table_keeps_small_units_and_any_name(page_of, face, photo, tmp_path):
    names = [f'{i}, "left"' for i in range(72)]
    table = ["number,name", *(f'{i},"{i}, ""left"""' for i in range(72))]
    (tmp_path / "parts.csv").write_text("\n".join(table))
    small = replace(
        face,
        scheme=str(tmp_path / "parts.csv"),
        landmarks=face.landmarks / 1e5,
        pose=replace(face.pose, scale=face.pose.scale / 1e5,
                     translation=face.pose.translation / 1e5),
    )  # fmt: skip
    page = page_of([small], [None])
    page.get_by_text("Coordinates").click()
    link = page.get_by_role("link", name="Download as CSV").get_attribute("href")
    rows = pd.read_csv(io.StringIO(unquote(link.partition(",")[2])), comment="#")
    assert [*rows.name] == names
    off = rows[["image_x", "image_y"]].to_numpy() - small.landmarks
    assert np.abs(off).max() < 1e-4 * np.ptp(small.landmarks)


@pytest.mark.parametrize(
    ("button", "angles"), [("Front", (0, 0, 0)), ("Side", (90, 0, 0)), ("As in the photo", POSE)]
)
def test_each_button_turns_the_shape_as_it_says(page_of, face, photo, button, angles):
    page = page_of([face], [photo])
    page.get_by_role("button", name=button).click()
    drawn(page)
    extent = face.xyz.min(0), face.xyz.max(0)
    centred = face.xyz - np.mean(extent, axis=0)
    radius = np.linalg.norm(centred, axis=1).max()
    seen = (centred @ rotation_of(*angles).T)[:, :2]
    gaps = np.linalg.norm(seen[:, None] - seen, axis=2) + 9 * np.eye(len(seen))
    lonely = int(gaps.min(1).argmax())  # no other is as near the pointer
    canvas = page.locator("canvas").bounding_box()
    pixels = middle(page) + 0.44 * canvas["width"] / radius * seen[lonely] * (1, -1)
    page.mouse.move(*pixels)
    drawn(page)
    marked = "(dots) => dots.flatMap((d, i) => d.classList.contains('marked') ? [i] : [])"
    assert page.locator("svg circle").evaluate_all(marked) == [lonely]


def test_dragging_keys_and_wheel_turn_and_zoom_and_reset_goes_back(page_of, face, photo):
    page = page_of([face], [photo])
    first = drawn(page)
    x, y = middle(page)

    def after(*actions):
        page.mouse.move(x, y)
        for act, *arguments in actions:
            act(*arguments)
        page.mouse.move(5, 5)
        return drawn(page)

    wheel = page.mouse.wheel
    # As long as the canvas has not been chosen, the wheel scrolls the page.
    assert np.array_equal(after((wheel, 0, -200)), first)
    drag = (page.mouse.down,), (page.mouse.move, x + 80, y + 20), (page.mouse.up,)
    dragged = after(*drag)
    turned = after((page.keyboard.press, "ArrowLeft"))  # since it was dragged it has the focus
    zoomed = after((wheel, 0, -400))
    for before, now in pairwise((first, dragged, turned, zoomed)):
        assert not np.array_equal(before, now)
    assert is_line(zoomed).any()
    page.get_by_role("button", name="Reset").click()
    page.mouse.move(5, 5)
    assert np.array_equal(drawn(page), first)


def test_a_finger_that_moves_sideways_turns_the_shape(page_of, face, photo):
    page = page_of([face], [photo], **PHONE)
    first = drawn(page)
    x, y = middle(page)
    touch = page.context.new_cdp_session(page)
    for kind, at in (("Start", 0), ("Move", 30), ("Move", 60), ("Move", 90), ("End", None)):
        points = [] if at is None else [{"x": x + at, "y": y}]
        touch.send("Input.dispatchTouchEvent", {"type": f"touch{kind}", "touchPoints": points})
    assert not np.array_equal(drawn(page), first)
    assert page.evaluate("document.documentElement.scrollWidth") <= 390


def test_a_hostile_name_is_text(page_of, face, photo):
    hostile = replace(face, name=HOSTILE, source=Path("/x") / "<b>y<", notes=(f"see {HOSTILE}",))
    page = page_of([hostile], [photo])
    drawn(page)
    page.get_by_text("Coordinates").click()
    assert page.title() == f"3D face of {HOSTILE}"
    assert page.locator("h1").inner_text() == f"3D face of {HOSTILE}"
    assert page.locator("h2").inner_text() == HOSTILE
    assert page.locator(".note").inner_text() == f"see {HOSTILE}"
    assert page.locator("dd").first.inner_text() == "<b>y<"
    assert page.locator("img").count() == 1
    assert page.evaluate("window.ran") is None


def test_only_the_scripts_of_the_page_run_and_nothing_is_loaded(tmp_path, browser, face, photo):
    path = tmp_path / "page.html"
    write_page(path, [face], [photo])
    text = path.read_text(encoding="utf-8")
    other = "<script>window.ran = 1</script><img src=x onerror='window.ran = 1'></main>"
    path.write_text(text.replace("</main>", other), encoding="utf-8")
    context = browser.new_context(offline=True)
    page = context.new_page()
    requests = []
    page.on("request", lambda request: requests.append(request.url[:60]))
    page.goto(path.as_uri())
    refused = page.evaluate("fetch('data:,x').then(() => false, () => true)")
    ran, cards = page.evaluate("window.ran"), page.locator(".card").count()
    context.close()
    assert refused
    assert ran is None
    assert cards == 1
    assert all(url.startswith((path.as_uri()[:60], "data:image/")) for url in requests)


def test_several_faces_are_drawn_as_they_come_into_sight(page_of, face, photo):
    faces = [replace(face, name=f"photo-{i}") for i in range(5)]
    faces[3] = replace(faces[3], photo=None, unit="mm", xyz=160 * face.xyz)
    page = page_of(faces, [None if face.photo is None else photo for face in faces])
    assert page.title() == "5 faces in 3D"
    assert page.locator("h2").all_inner_texts() == [face.name for face in faces]
    assert page.locator("img").count() == 4
    for which in range(5):
        assert is_line(drawn(page, which)).sum() > 500
    assert "millimetres" in page.locator(".facts").nth(3).inner_text()
    assert "one view does not show the true size" in page.locator(".facts").nth(2).inner_text()
    sizes = page.locator("canvas").evaluate_all("(all) => all.map((c) => c.width)")
    assert sizes[0] == 0  # far out of sight: hundreds of faces would not fit into memory


def test_json_in_html_holds_no_markup_and_stays_what_it_is():
    value = {"</script><!--": ["&<>", 1.5, None, "é\u2028\udcff"]}
    text = json_in_html(value)
    assert not set("<>&") & set(text)
    assert text.isascii()
    assert json.loads(text) == value
    with pytest.raises(ValueError, match="JSON"):
        json_in_html([float("nan")])


def test_the_mesh_is_where_the_landmarks_are(page_of, face, photo):
    page = page_of([face], [photo], mesh=True)
    page.get_by_role("button", name="Side").click()
    both = drawn(page)
    page.get_by_role("button", name="Surface").click()
    # Above the axes and the scale bar, below the angles.
    rows = slice(len(both) // 10, -len(both) // 5)
    x = np.flatnonzero(is_line(drawn(page)[rows]).any(0))
    solid = np.flatnonzero((both[rows, :, 3] == 255).any(0))
    # The tip of the nose ends both, the back of the head is behind all landmarks.
    assert abs(solid.max() - x.max()) < 12
    assert solid.min() < x.min() - 60
