"""The page of 3D faces in a real browser: it is drawn, turns, and loads and runs nothing else."""

import base64
import io
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from data_gen.models.openhead import load_openhead
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
FRONT = {"rotation": np.eye(3)}
SIDE = {"rotation": np.array([[0.0, 0, 1], [0, 1, 0], [-1, 0, 0]])}


@pytest.fixture(scope="module")
def shape():
    model = load_openhead()
    return normalise(model.mean[model.landmarks["bfm72"]][None])[0]


@pytest.fixture(scope="module")
def face(shape):
    """A head that is turned, looks up and leans, in a photo of 640 x 480."""
    angles = np.deg2rad([20, 12, -8])
    (a, b, c), (p, q, r) = np.cos(angles), np.sin(angles)
    rotation = (
        np.array([[c, -r, 0], [r, c, 0], [0, 0, 1]])
        @ np.array([[1, 0, 0], [0, b, q], [0, -q, b]])
        @ np.array([[a, 0, p], [0, 1, 0], [-p, 0, a]])
    )
    view = 180 * shape @ rotation[:2].T + (330, -420)
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


def coloured(image, colour):
    """Number of pixels of about one colour, faint ones left out."""
    near = (np.abs(image[..., :3].astype(int) - colour) < 40).all(-1)
    return int((near & (image[..., 3] > 100)).sum())


def middle(page):
    box = page.locator("canvas").first.bounding_box()
    return box["x"] + box["width"] / 2, box["y"] + box["height"] / 2


def test_the_photo_is_loaded_and_the_shape_drawn(page_of, face, photo):
    page = page_of([face], [photo])
    assert page.title() == "3D face of photo"
    width, height = page.locator("img").evaluate("(i) => [i.naturalWidth, i.naturalHeight]")
    assert (width, height) == cut_out(photo, face.landmarks).image.size
    assert coloured(drawn(page), (201, 79, 0)) > 500
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


@pytest.mark.parametrize(
    ("button", "pose"), [("Front", FRONT), ("Side", SIDE), ("As in the photo", {})]
)
def test_each_button_turns_the_shape_as_it_says(page_of, face, photo, button, pose):
    page = page_of([face], [photo])
    page.get_by_role("button", name=button).click()
    drawn(page)
    extent = face.xyz.min(0), face.xyz.max(0)
    centred = face.xyz - np.mean(extent, axis=0)
    radius = np.linalg.norm(centred, axis=1).max()
    seen = (centred @ pose.get("rotation", face.pose.rotation).T)[:, :2]
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
    page.mouse.move(*middle(page))
    page.mouse.wheel(0, -200)  # scrolls the page, as long as the canvas has not been chosen
    page.mouse.move(5, 5)
    assert np.array_equal(drawn(page), first)

    x, y = middle(page)
    page.mouse.move(x, y)
    page.mouse.down()
    page.mouse.move(x + 80, y + 20, steps=4)
    page.mouse.up()
    page.mouse.move(5, 5)
    dragged = drawn(page)
    assert not np.array_equal(dragged, first)

    page.keyboard.press("ArrowLeft")  # the canvas has the focus since it was dragged
    turned = drawn(page)
    assert not np.array_equal(turned, dragged)

    page.mouse.move(*middle(page))
    page.mouse.wheel(0, -400)
    page.mouse.move(5, 5)
    zoomed = drawn(page)
    assert coloured(zoomed, (201, 79, 0)) > 0
    assert not np.array_equal(zoomed, turned)

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
        assert coloured(drawn(page, which), (201, 79, 0)) > 500
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
    without = page_of([face], [photo], mesh=True)
    without.get_by_role("button", name="Side").click()
    without.get_by_role("button", name="Surface").click()
    # Above the axes and the scale bar, below the angles.
    both, lines = (image[len(image) // 10 : -len(image) // 5]
                   for image in (drawn(page), drawn(without)))  # fmt: skip
    x = np.flatnonzero((np.abs(lines[..., :3].astype(int) - (201, 79, 0)) < 40).all(-1).any(0))
    solid = (both[..., 3] == 255).any(0).nonzero()[0]
    # The tip of the nose ends both, the back of the head is behind all landmarks.
    assert abs(solid.max() - x.max()) < 12
    assert solid.min() < x.min() - 60
