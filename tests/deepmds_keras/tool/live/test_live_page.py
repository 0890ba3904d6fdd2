"""The live page in a real browser; MediaPipe's part is played by points that the tests give.

The slow tests have MediaPipe itself: they download its package once, into pytest's cache.
"""

import base64
import hashlib
import io
import json
import threading
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

import av
import numpy as np
import pytest
from faces import rotation_of
from PIL import Image
from places import MEDIAPIPE, ROOT

from deepmds_keras import InputError, LandmarkLifter, predict_photo
from deepmds_keras.files import read_table, write_bytes
from deepmds_keras.landmarks import FOLDER, load_scheme
from deepmds_keras.tool.detection import detector_sd, to_ibug
from deepmds_keras.tool.live import live_page
from deepmds_keras.tool.live.live_page import write_live_page
from deepmds_keras.tool.live.settings import settings
from deepmds_keras.tool.live.tasks_vision import SHA256, VERSION, read_tasks_vision
from deepmds_keras.tool.predict import landmark_files
from deepmds_keras.tool.predict.landmark_files import read_landmarks

PHOTO = ROOT / "docs" / "pictures" / "astronaut.jpg"
L, WIDTH, HEIGHT = 51, 640, 480
MEAN = LandmarkLifter.pretrained("ibug51").weights_["mean"].T.astype(float)
PICKS = [int(row["number"]) for row in read_table(FOLDER / "mediapipe_ibug68.csv")]
# What FaceLandmarker has that the page uses; `faces` is what it finds.
STANDS_IN = """
class Finder {
  static createFromOptions() { return Promise.resolve(new Finder()); }
  setOptions() { return Promise.resolve(); }
  detect() { return { faceLandmarks: self.faces ?? [] }; }
  detectForVideo() { return { faceLandmarks: self.faces ?? [] }; }
}
export { Finder as FaceLandmarker };"""
NO_WEBGL = """const { getContext } = HTMLCanvasElement.prototype;
HTMLCanvasElement.prototype.getContext = function (kind, ...options) {
  return kind.startsWith("webgl") ? null : getContext.call(this, kind, ...options);
};"""


@pytest.fixture(scope="module")
def page_file(tmp_path_factory):
    """The page, with STANDS_IN in place of MediaPipe."""
    folder = tmp_path_factory.mktemp("live")
    contents = dict.fromkeys(SHA256, b"") | {"vision_bundle.mjs": STANDS_IN.encode()}
    with pytest.MonkeyPatch.context() as patch:
        for name, content in contents.items():
            (folder / name).parent.mkdir(exist_ok=True)
            (folder / name).write_bytes(content)
            patch.setitem(SHA256, name, hashlib.sha256(content).hexdigest())
        (folder / "model.task").write_bytes(b"")
        patch.setattr(live_page, "LANDMARKER", folder / "model.task")
        write_live_page(folder / "live.html", model="lifting-ibug51", tasks_vision=folder)
    return folder / "live.html"


@pytest.fixture(scope="module")
def with_camera(launch):
    """A Chromium whose camera films a moving pattern."""
    return launch("--use-fake-device-for-media-stream")


@pytest.fixture
def opened(with_camera, page_file):
    """Opens the page: `opened(script)` → page; the script runs before those of the page."""
    contexts = []

    def opened(script="", allowed=("camera",)):
        context = with_camera.new_context(permissions=[*allowed], accept_downloads=True)
        contexts.append(context)
        context.set_default_timeout(10_000)
        page = context.new_page()
        page.add_init_script(script or "0")
        page.goto(page_file.as_uri())
        page.evaluate("ready.catch(() => {})")
        return page

    yield opened
    for context in contexts:
        context.close()


def points_of(landmarks):
    """478 points, as shares of the image, of which 51 are `landmarks` in pixels."""
    points = np.zeros((478, 2))
    points[PICKS] = landmarks / (WIDTH, HEIGHT)
    return [{"x": x, "y": y, "z": 0} for x, y in points.tolist()]


def frontal(middle=(300, 220), size=250):
    """Landmarks of a face in pixels, `(51, 2)`."""
    return MEAN[:, :2] * (size, -size) + middle


def show(page, *faces, time=0.0):
    """Have the page show one frame with these faces, landmarks `(51, 2)` in pixels."""
    page.evaluate(
        """([faces, time]) => {
          if (!record) begin("test");
          playing ??= element("canvas");  // a frame of a video, which is smoothed
          Object.assign(playing, { width: 640, height: 480, pause() {} });
          show(playing, 640, 480, time, { faceLandmarks: faces });
        }""",
        [[points_of(face) for face in faces], time],
    )


def until(page, expression):
    """Wait in Python: the page's policy refuses what Playwright would wait with in the page."""
    for _ in range(400):
        if page.evaluate(f"() => Boolean({expression})"):
            return
        page.wait_for_timeout(25)
    raise AssertionError(f"{expression} did not become true; {page.inner_text('#said')}")


def saved(page, button, folder):
    with page.expect_download() as download:
        page.get_by_role("button", name=button).click()
    path = folder / download.value.suggested_filename
    download.value.save_as(path)
    return path


@pytest.mark.parametrize("angles", [(0, 0, 0), (35, -20, 10), (-70, 15, -160)])
def test_the_shape_is_that_of_python(opened, angles):
    rng, lifter = np.random.default_rng(0), LandmarkLifter.pretrained("ibug51")
    shape = MEAN + 0.02 * rng.standard_normal((L, 3))
    found = 300 * (shape @ rotation_of(*angles).T)[:, :2] * (1, -1) + (320, 240)
    page = opened()
    face = page.evaluate(
        """(points) => {
          const landmarks = landmarksOf(points, settings.detector, 640, 480);
          return { landmarks, ...lifted(run, landmarks, settings.detector.sd) };
        }""",
        points_of(found),
    )
    landmarks = to_ibug(found[None], "mediapipe", "ibug51")[0]
    assert np.abs(face["landmarks"] - landmarks).max() < 1e-6
    radius = np.sqrt(((landmarks - landmarks.mean(0)) ** 2).sum(1).mean())
    sd = radius * detector_sd("mediapipe", "ibug51")
    wanted = lifter.estimate((landmarks * (1, -1))[None], landmark_sd=sd[None])
    assert np.abs(face["shape"] - wanted.shapes[0]).max() < 1e-5
    assert np.abs(face["std"] - wanted.std[0]).max() < 1e-5
    for name, angle in zip(("yaw", "pitch", "roll"), angles, strict=True):
        assert abs(face["pose"][name] - wanted.pose.as_dict()[name][0]) < 0.01
        assert abs(face["pose"][name] - angle) < 8


def test_faces_keep_their_numbers_and_files_are_read_back(opened, tmp_path):
    page = opened()
    left, right = frontal((150, 200), 120), frontal((460, 250), 200)
    page.evaluate("""begin('a "clip"')""")
    page.get_by_label("Smooth over time").uncheck()
    show(page, left, right)
    show(page, right + 4, left + 4, time=0.1)  # MediaPipe's order is any
    show(page, time=0.2)
    assert "No face" in page.get_by_role("status").inner_text()
    show(page, left + 9, time=0.3)
    table, content = (saved(page, f"Save as {kind}", tmp_path) for kind in ("CSV", "JSON"))
    shown = [right, left, right + 4, left + 4, left + 9]
    wanted = to_ibug(np.array(shown), "mediapipe", "ibug51")
    for path in (table, content):
        assert np.abs(read_landmarks(path) - wanted).max() < 1e-3
    faces = json.loads(content.read_bytes())["faces"]
    assert [face["track"] for face in faces] == [1, 2, 1, 2, 2]
    assert [face["frame"] for face in faces] == [0, 0, 1, 1, 3]
    assert [face["name"] for face in faces][:2] == ['a "clip"-0-1', 'a "clip"-0-2']
    rows = read_table(table)
    assert len(rows) == 5 * L
    assert [row["name"] for row in rows[:L]] == [*load_scheme("ibug51").names]
    shape = [[float(row[axis]) for axis in "xyz"] for row in rows[:L]]
    assert np.abs(shape - np.array(faces[0]["shape"])).max() < 1e-6
    assert "unit of x, y, z: normalised" in table.read_text(encoding="utf-8")


def test_the_longest_recording_can_be_read(opened):
    page = opened()
    show(page, frontal((301.2345, 222.3456), 123.456), time=123.456)
    per_face = page.evaluate("record.json().slice(1, -1).join('').length * KEPT")
    assert 5e7 < per_face < landmark_files._MAX_BYTES[".json"]


def test_a_face_that_was_gone_is_another_unless_no_frame_was_seen_meanwhile(opened):
    page, face = opened(), frontal()
    page.evaluate("begin('test')")
    for time in (0, 5, 5.1):
        show(page, face, time=time)
    for time in (5.2, 6.3):
        show(page, time=time)
    show(page, face, time=6.4)
    assert page.evaluate("record.records.map(({ track }) => track)") == [1, 1, 1, 2]


def test_smoothing_takes_jitter_and_hardly_lags(opened):
    page, rng = opened(), np.random.default_rng(0)
    face = frontal()[:8]
    radius = np.sqrt(((face - face.mean(0)) ** 2).sum(1).mean())
    still = face + rng.normal(0, 0.01 * radius, (60, 8, 2))
    moved = [face + (radius * i / 30, 0) for i in range(60)]  # a radius a second
    smoothed = """(frames) => {
      const follow = follower();
      return frames.map((face, i) => follow([face], i / 30, true)[0].landmarks);
    }"""
    calm = np.array(page.evaluate(smoothed, still.tolist()))
    jitter = [np.diff(frames[20:], axis=0).std() for frames in (calm, still)]
    assert jitter[0] < 0.35 * jitter[1]
    lag = moved[-1] - page.evaluate(smoothed, [frame.tolist() for frame in moved])[-1]
    assert 0 < lag[:, 0].mean() < 0.05 * radius


def test_the_pose_is_said_and_turns_the_view_until_someone_else_does(opened):
    page = opened()
    for angles in ((30, 0, 0), (-20, 10, 15)):
        view = 250 * (MEAN @ rotation_of(*angles).T)[:, :2] * (1, -1) + (300, 220)
        page.evaluate("begin('test')")
        show(page, view)
        yaw = float(page.locator("#pose").inner_text().split("°")[0][4:].replace("−", "-"))
        assert abs(yaw - angles[0]) < 6
    assert page.get_by_label("Turn with the head").is_checked()
    page.get_by_role("application").focus()
    page.keyboard.press("Tab")
    assert page.get_by_label("Turn with the head").is_checked()
    page.get_by_role("application").focus()
    page.keyboard.press("ArrowLeft")
    assert not page.get_by_label("Turn with the head").is_checked()


def test_the_discs_are_drawn_if_asked_for(opened):
    page = opened()
    show(page, frontal())
    # The alpha of one disc; lines and hidden landmarks are faint, too, but hardly ever just so.
    faint = """async () => {
      await new Promise(requestAnimationFrame), await new Promise(requestAnimationFrame);
      const { width, height } = at("shape");
      const { data } = at("shape").getContext("2d").getImageData(0, 0, width, height);
      return data.filter((value, i) => i % 4 === 3 && value === 33).length;
    }"""
    page.locator("#shape").scroll_into_view_if_needed()
    with_discs = page.evaluate(faint)
    page.get_by_label("Standard deviations").uncheck()
    show(page, frontal(), time=0.1)
    assert with_discs > 5 * page.evaluate(faint)


def test_the_camera_starts_and_stops(opened):
    page = opened()
    page.evaluate("(points) => { self.faces = [points]; }", points_of(frontal()))
    page.get_by_role("button", name="Camera").click()
    until(page, "frame >= 5")
    assert page.get_by_role("status").inner_text() == ""
    assert "1 in this frame" in page.locator("#kept").inner_text()
    times = page.evaluate("record.records.map(({ time }) => time)")
    assert times[0] == 0
    assert (np.diff(times) > 0).all()
    stream = page.evaluate_handle("playing.srcObject")
    page.get_by_role("button", name="Stop").click()
    assert page.get_by_role("button", name="Stop").is_disabled()
    ended = stream.evaluate("(s) => s.getTracks().every((track) => track.readyState === 'ended')")
    assert ended
    seen = page.evaluate("frame")
    page.wait_for_timeout(300)
    assert page.evaluate("frame") == seen


def drop(page, name, kind, content):
    page.evaluate(
        """([name, type, content]) => {
          const files = new DataTransfer();
          files.items.add(new File([decoded(content, Uint8Array)], name, { type }));
          dispatchEvent(new DragEvent("drop", { dataTransfer: files, cancelable: true }));
        }""",
        [name, kind, base64.b64encode(content).decode()],
    )


@pytest.mark.parametrize("how", ["button", "drop"])
def test_photos_are_opened_by_button_and_by_drop_upright(opened, how):
    buffer, photo = io.BytesIO(), Image.new("RGB", (60, 40), "red")
    exif = photo.getexif()
    exif[0x0112] = 6  # to be turned by a quarter
    photo.save(buffer, "jpeg", exif=exif)
    page = opened()
    if how == "drop":
        drop(page, "me.at.home.jpg", "image/jpeg", buffer.getvalue())
    else:
        with page.expect_file_chooser() as chooser:
            page.get_by_role("button", name="Photo or video").click()
        file = {"name": "me.at.home.jpg", "mimeType": "image/jpeg", "buffer": buffer.getvalue()}
        chooser.value.set_files([file])
    until(page, "frame === 1")
    assert page.evaluate("[at('photo').width, at('photo').height]") == [40, 60]
    assert "No face" in page.get_by_role("status").inner_text()
    assert page.locator("#said").get_attribute("role") == "status"


def test_what_is_opened_while_the_camera_is_asked_for_comes_next(opened):
    buffer = io.BytesIO()
    Image.new("RGB", (60, 40), "red").save(buffer, "png")
    page = opened(
        "MediaDevices.prototype.getUserMedia = () => new Promise((_, reject) => {"
        " self.answer = () => reject(new DOMException('no', 'NotAllowedError')); });"
    )
    page.get_by_role("button", name="Camera").click()
    until(page, "self.answer")
    drop(page, "me.png", "image/png", buffer.getvalue())
    until(page, "at('said').textContent.includes('Answer it first')")
    page.evaluate("answer()")
    until(page, "frame === 1")
    assert page.evaluate("at('photo').width") == 60


def test_a_video_is_analysed_to_its_end(opened, tmp_path):
    path = tmp_path / "clip.webm"
    with av.open(str(path), "w") as video:
        stream = video.add_stream("libvpx", rate=10)
        stream.width, stream.height, stream.pix_fmt = 64, 48, "yuv420p"
        for i in range(8):
            picture = av.VideoFrame.from_ndarray(np.full((48, 64, 3), 30 * i, np.uint8), "rgb24")
            video.mux(stream.encode(picture))
        video.mux(stream.encode())
    page = opened()
    page.evaluate("(points) => { self.faces = [points]; }", points_of(frontal()))
    drop(page, "clip.webm", "video/webm", path.read_bytes())
    until(page, "playing === null && frame > 2")
    assert page.get_by_role("status").inner_text() == "Stopped."
    assert page.evaluate("record.csv().length") > 2
    drop(page, "clip.webm", "video/webm", path.read_bytes())
    until(page, "playing !== null")
    page.evaluate("playing.dispatchEvent(new Event('error'))")  # as browsers do, once it is damaged
    until(page, "playing === null && at('said').textContent.includes('cannot be read')")
    drop(page, "clip.webm", "video/webm", b"no video")
    until(page, "at('said').textContent.startsWith('clip.webm must be a photo or a video')")
    sound = tmp_path / "sound.webm"
    with av.open(str(sound), "w") as video:
        stream = video.add_stream("libopus", rate=48_000, layout="mono")
        silence = av.AudioFrame.from_ndarray(np.zeros((1, 48_000), np.float32), "fltp", "mono")
        silence.sample_rate = 48_000
        video.mux([*stream.encode(silence), *stream.encode()])
    drop(page, "sound.webm", "video/webm", sound.read_bytes())
    until(page, "at('said').textContent.startsWith('sound.webm must be a photo or a video')")
    assert page.evaluate("playing === null")
    drop(page, "notes.txt", "text/plain", b"no photo")
    until(page, "at('said').textContent.startsWith('notes.txt must be a photo or a video')")


@pytest.mark.parametrize(
    ("script", "allowed", "said"),
    [
        ("", (), "The camera is not allowed"),
        ("MediaDevices.prototype.getUserMedia = () => Promise.reject("
         "new DOMException('none', 'NotFoundError'));", ("camera",), "No camera is found"),
        ("MediaDevices.prototype.getUserMedia = () => Promise.reject("
         "new DOMException('busy', 'NotReadableError'));", ("camera",), "Another program"),
        ("Object.defineProperty(navigator, 'mediaDevices', { value: undefined });", (),
         "gives no camera"),
        (NO_WEBGL, ("camera",), "no WebGL"),
    ],
)  # fmt: skip
def test_what_is_missing_is_said(opened, script, allowed, said):
    page = opened(script, allowed)
    page.get_by_role("button", name="Camera").click()
    until(page, f"at('said').textContent.includes({said!r})")


def test_the_policy_blocks_every_request(opened):
    received = []

    class Server(BaseHTTPRequestHandler):
        def do_GET(self):  # noqa: N802
            received.append(self.path)

        do_POST = do_GET  # noqa: N815

    server = ThreadingHTTPServer(("127.0.0.1", 0), Server)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    blocked = opened().evaluate(
        """async (place) => {
          const blocked = [];
          addEventListener("securitypolicyviolation", (e) => blocked.push(e.effectiveDirective));
          await fetch(`http://${place}/fetch`).catch(() => {});
          await fetch("data:,x").catch(() => {});
          navigator.sendBeacon(`http://${place}/beacon`, "x");
          try { new WebSocket(`ws://${place}/socket`); } catch {}
          for (const tag of ["img", "video", "script", "iframe"]) {
            document.body.append(element(tag, { src: `http://${place}/${tag}` }));
          }
          await new Promise((done) => setTimeout(done, 300));
          return blocked.sort();
        }""",
        f"127.0.0.1:{server.server_port}",
    )
    server.shutdown()
    server.server_close()
    assert received == []
    assert blocked == [*["connect-src"] * 4, "frame-src", "img-src", "media-src", "script-src-elem"]


def test_the_page_is_never_written_over_and_only_for_landmarks_that_are_found(page_file, tmp_path):
    with pytest.raises(InputError, match="exists"):
        write_live_page(page_file, model="lifting-ibug51")
    with pytest.raises(InputError, match=r"ibug51.* with bfm72"):
        write_live_page(tmp_path / "live.html", model="lifting-bfm72")
    assert not [*tmp_path.iterdir()]


def test_turns_of_the_training_are_claimed_of_shipped_weights_alone(tmp_path):
    name, own = "lifting-ibug51", tmp_path / "own.npz"
    lifter = LandmarkLifter.pretrained("ibug51")
    lifter.save(own)
    assert settings(lifter, name)["turns"] == {"yaw": 90, "pitch": 40}
    assert settings(lifter, str(own))["turns"] == {}


def test_the_page_says_how_many_faces_it_looks_for(page_file):
    text = " ".join(page_file.read_text(encoding="utf-8").split())
    assert "const MOST_FACES = 4;" in text and "up to four are drawn and kept" in text


# With MediaPipe


@pytest.fixture(scope="module")
def package(pytestconfig):
    """MediaPipe's package for browsers, as a folder."""
    folder = pytestconfig.cache.mkdir(f"tasks-vision-{VERSION}")
    if not all((folder / name).exists() for name in SHA256):
        for name, content in read_tasks_vision(None).items():
            write_bytes(folder / name, content)
    return folder


@pytest.fixture(scope="module")
def whole(tmp_path_factory, launch, package):
    """The page as users have it, in a Chromium whose camera films a face."""
    folder = tmp_path_factory.mktemp("whole")
    write_live_page(folder / "live.html", model="lifting-ibug51", tasks_vision=package)
    assert (folder / "live.html").stat().st_size < 8e6
    with open(folder / "camera.mjpeg", "wb") as film:
        for i in range(40):
            shift = 15 * np.sin(2 * np.pi * i / 40)
            frame = Image.open(PHOTO).convert("RGB").transform(
                (WIDTH, HEIGHT), Image.Transform.AFFINE, (0.7, 0, shift, 0, 0.7, 0)
            )  # fmt: skip
            frame.save(film, "jpeg", quality=85)
    browser = launch(
        "--use-fake-device-for-media-stream",
        f"--use-file-for-fake-video-capture={folder / 'camera.mjpeg'}",
        "--enable-unsafe-swiftshader",  # WebGL where there is no GPU
    )
    context = browser.new_context(offline=True, permissions=["camera"])
    page = context.new_page()
    page.goto((folder / "live.html").as_uri())
    page.evaluate("ready")
    yield page
    context.close()


@pytest.mark.slow
def test_mediapipe_follows_a_face_before_the_camera(whole):
    whole.get_by_role("button", name="Camera").click()
    until(whole, "record?.records.length >= 10")
    whole.get_by_role("button", name="Stop").click()
    records = whole.evaluate(
        "record.records.map(({ track, shape }) => ({ track, shape: [...shape] }))"
    )
    assert {record["track"] for record in records} == {1}
    shapes = np.reshape([record["shape"] for record in records], (-1, L, 3))
    assert np.abs(shapes - MEAN).max() < 0.15
    assert shapes.std(0).max() < 0.02


@pytest.mark.slow
@pytest.mark.skipif(not MEDIAPIPE, reason="no MediaPipe with FaceMesh")
def test_a_photo_gives_what_python_gives(whole):
    whole.locator("#file").set_input_files(PHOTO)
    until(whole, "record?.records.length === 1 && !record.records[0].smoothed")
    shape = np.reshape(whole.evaluate("[...record.records[0].shape]"), (L, 3))
    (face,) = predict_photo(PHOTO, detector="mediapipe")
    assert np.abs(shape - face.xyz).max() < 1e-3
