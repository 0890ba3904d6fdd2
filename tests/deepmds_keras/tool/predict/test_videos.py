"""Videos: every frame upright at its time, faces followed and smoothed, landmarks drawn."""

import gc
import json
import re
import struct
from fractions import Fraction
from types import SimpleNamespace

import av
import numpy as np
import pytest

from deepmds_keras import InputError
from deepmds_keras.files import read_npz
from deepmds_keras.tool.predict import videos
from deepmds_keras.tool.predict.face_lifter import FaceLifter
from deepmds_keras.tool.predict.faces import FrameRef
from deepmds_keras.tool.predict.video_faces import find_in_video, follow_faces
from deepmds_keras.tool.predict.videos import Video, tell_tracks, write_landmark_video

CODECS = {".avi": "mpeg4", ".mov": "mpeg4", ".webm": "libvpx"}  # others: libx264
SIDE = 64
# 68 points about as those of a face, of 20 pixels.
FACE = np.random.default_rng(3).uniform(0, 20, (68, 2))
LARGE = np.random.default_rng(0).uniform(0, 100, (51, 2))
PLAYLIST = (
    b"#EXTM3U\n#EXT-X-TARGETDURATION:9\n#EXTINF:9,\nhttp://127.0.0.1:9/a.ts\n#EXT-X-ENDLIST\n"
)


def write_video(path, images, pixel=1, codec=None):
    """The images, 25 a second, in the container of the suffix; `pixel` is width by height."""
    codec = codec or CODECS.get(path.suffix, "libx264")
    options = {"movflags": "faststart"} if path.suffix in (".mp4", ".mov") else {}
    with av.open(str(path), "w", options=options) as output:
        stream = output.add_stream(codec, rate=25, options={"g": "10"})
        stream.height, stream.width = images[0].shape[:2]
        stream.pix_fmt, stream.bit_rate = "yuv420p", 2_000_000
        stream.codec_context.sample_aspect_ratio = Fraction(pixel)
        for image in images:
            output.mux(stream.encode(av.VideoFrame.from_ndarray(image)))
        output.mux(stream.encode())
    return path


@pytest.fixture
def squares(add_detector):
    """A detector of white squares: of each the 68 points of `FACE`, from its upper left corner."""

    def find(image, before=None):
        columns = np.flatnonzero((image.min(-1) > 180).any(0))
        starts = columns[np.diff(columns, prepend=-9) > 1]
        faces = np.array([FACE + (x, 5) for x in starts]).reshape(-1, 68, 2)
        return faces, np.ones(len(faces))

    add_detector("squares", find)


def scene(*places, ground=(90, 90, 90)):
    """A frame with white squares of 20 pixels at these columns."""
    image = np.zeros((SIDE, 4 * SIDE, 3), np.uint8) + np.uint8(ground)
    for x in places:
        image[10:30, x : x + 20] = 255
    return image


@pytest.fixture
def clip(tmp_path):
    """Thirty frames: a face that moves, lost in frames 12 to 14; another from frame 20."""
    places = [[] if 12 <= i < 15 else [20 + 2 * i] for i in range(30)]
    places = [at + [200] * (i >= 20) for i, at in enumerate(places)]
    return write_video(tmp_path / "clip.mp4", [scene(*at) for at in places])


def counted(n):
    """Grey images, each a little lighter, with a red corner at the left and a blue one above it."""
    images = np.zeros((n, 64, 96, 3), np.uint8)
    images += np.uint8(np.linspace(20, 200, n))[:, None, None, None]
    images[:, 32:, :32], images[:, :32, :32] = (255, 0, 0), (0, 0, 255)
    return images


def at(*places):
    """Faces of about 100 pixels, each moved to the right by so many pixels."""
    return np.stack([LARGE + (x, 0) for x in places]) if places else np.zeros((0, 51, 2))


def follow(frames, times=None, cuts=()):
    times = np.arange(len(frames)) / 25 if times is None else times
    return [[*n] for n in follow_faces(frames, times, [i in cuts for i in range(len(frames))])]


@pytest.mark.parametrize("suffix", [".mp4", ".mov", ".mkv", ".webm", ".avi"])
def test_every_frame_comes_once_in_order_and_again(tmp_path, suffix):
    video = Video(write_video(tmp_path / f"a{suffix}", counted(30)))
    for _ in range(2):
        frames = list(video)
        assert [frame.index for frame in frames] == list(range(30))
        assert np.allclose([frame.time for frame in frames], np.arange(30) / 25, atol=2e-3)
        light = [frame.image[:, 48:].mean() for frame in frames]
        assert np.allclose(light, np.linspace(20, 200, 30), atol=6)
    assert video.n_frames == 30
    red, blue = frames[0].image[48, 16], frames[0].image[16, 16]
    assert np.argmax(red) == 0 and np.argmax(blue) == 2 and frames[0].image.shape == (64, 96, 3)
    assert [frame.index for frame in Video(video.path, 4)] == [*range(0, 30, 4)]


@pytest.mark.parametrize("suffix", [".avi", ".mp4", ".mov", ".mkv"])
@pytest.mark.parametrize("codec", ["libx264", "mpeg4"])
def test_times_grow_evenly_even_where_frames_are_stored_in_another_order(tmp_path, suffix, codec):
    path = write_video(tmp_path / f"a{suffix}", counted(30), codec=codec)
    with av.open(str(path)) as file:
        kinds = {int(frame.pict_type) for frame in file.decode(video=0)}
    assert (av.video.frame.PictureType.B in kinds) == (codec == "libx264")
    times = [frame.time for frame in Video(path)]
    assert times[0] == 0 and np.allclose(np.diff(times), 1 / 25, atol=2e-3)


def test_pixels_that_are_no_squares_become_squares(tmp_path):
    frame = next(iter(Video(write_video(tmp_path / "a.mp4", counted(2), pixel="4/3"))))
    assert frame.image.shape == (64, 128, 3)


def set_matrix(path, a, b, c, d):
    """Note in an MP4 that a player moves x to (a x, b x), and y to (c y, d y)."""
    content = bytearray(path.read_bytes())
    start = content.find(b"tkhd") + 44
    matrix = (a << 16, b << 16, 0, c << 16, d << 16, 0, 0, 0, 1 << 30)
    content[start : start + 36] = struct.pack(">9i", *matrix)
    path.write_bytes(content)


@pytest.mark.parametrize("x", [1, -1])
@pytest.mark.parametrize("y", [1, -1])
@pytest.mark.parametrize("swapped", [False, True])
def test_frames_are_mirrored_and_turned_by_the_display_matrix(tmp_path, x, y, swapped):
    upright = counted(2)
    stored = upright[:, ::y, ::x]
    stored = np.ascontiguousarray(stored.swapaxes(1, 2) if swapped else stored)
    path = write_video(tmp_path / "a.mp4", stored)
    set_matrix(path, *((0, y, x, 0) if swapped else (x, 0, 0, y)))
    image = next(iter(Video(path))).image
    assert image.shape == upright[0].shape and image.flags.c_contiguous
    assert np.abs(image.astype(int) - upright[0]).mean() < 10


def test_frames_that_were_seen_do_not_stay_in_memory(tmp_path):
    path = write_video(tmp_path / "a.mp4", counted(40))
    set_matrix(path, 0, 1, -1, 0)
    gc.collect()
    gc.disable()  # it finds them late
    try:
        most = max(sum(isinstance(o, av.VideoFrame) for o in gc.get_objects()) for _ in Video(path))
    finally:
        gc.enable()
    assert most < 10


@pytest.mark.parametrize("turn", [0, 1, 2, 3])
def test_a_video_that_lies_without_saying_so_is_turned_once(tmp_path, add_detector, turn):
    looked_at = []

    def find(image, before=None):
        looked_at.append(image.shape)
        y, x = np.argwhere(image.min(-1) > 180).mean(0)
        # Right eye, left eye, mouth; found where the white square is in the left upper quarter.
        face = np.zeros((68, 2)) + (x, y)
        face[36:42] += (-3, -3)
        face[42:48] += (3, -3)
        upright = image.shape[0] > image.shape[1] and x < SIDE / 2 and y < 2 * SIDE
        return face[None], np.array([0.95 if upright else 0.5])

    add_detector("square", find)
    frame = np.full((4 * SIDE, SIDE, 3), 90, np.uint8)
    frame[40:50, 16:26] = 255
    frame = np.ascontiguousarray(np.rot90(frame, -turn))
    path = write_video(tmp_path / "a.mp4", [frame] * 5)
    found = find_in_video(path, "a", detector="square")
    assert len(looked_at) == 5 + (4 if turn else 1)
    y, x = np.argwhere(frame.min(-1) > 180).mean(0)
    np.testing.assert_allclose(found.landmarks[:, 0], [[x, y]] * 5, atol=2)


@pytest.mark.parametrize("every", [1, 2, 3])
@pytest.mark.parametrize("turn", [0, 1])
def test_faces_are_looked_for_where_they_were_in_four_frames_in_a_row(
    tmp_path, add_detector, every, turn
):
    looked_at = []

    def find(image, before=None):
        looked_at.append(before)
        upright = image.shape[0] > image.shape[1]
        face = FACE + (len(looked_at), 0)
        return face[None], np.array([0.95 if upright else 0.5])

    add_detector("moving", find)
    images = np.rot90(np.zeros((11, 2 * SIDE, SIDE, 3), np.uint8), turn, axes=(1, 2))
    path = write_video(tmp_path / "a.mp4", images)
    find_in_video(path, "a", detector="moving", every=every)
    n_frames = -(-11 // every)
    start = len(looked_at) - n_frames
    for i, before in enumerate(looked_at[start:]):
        if i % (4 // every) == 0:
            assert before is None
        else:
            np.testing.assert_array_equal(before, FACE[None] + (start + i, 0))


@pytest.mark.parametrize("suffix", [".mp4", ".mkv", ".avi"])
@pytest.mark.parametrize("damage", ["cut", "hole"])
def test_of_a_damaged_file_there_is_what_can_be_decoded(tmp_path, suffix, damage):
    noise = np.random.default_rng(0).integers(0, 255, (25, 48, 64, 3), np.uint8)
    path = write_video(tmp_path / f"a{suffix}", noise)
    content = bytearray(path.read_bytes())
    fifth = len(content) // 5
    if damage == "cut":
        content = content[: len(content) // 2]
    else:
        content[2 * fifth : 3 * fifth] = bytes(fifth)
    path.write_bytes(content)
    assert (5 < len(list(Video(path))) < 20) if damage == "cut" else len(list(Video(path))) > 10


@pytest.mark.parametrize("every", [1, 2])
def test_a_video_that_breaks_off_is_remarked(squares, tmp_path, every):
    whole = write_video(tmp_path / "a.mp4", [scene(5 + x, 90) for x in range(60)])
    cut = tmp_path / "b.mp4"
    cut.write_bytes(whole.read_bytes()[: 2 * whole.stat().st_size // 3])
    assert not find_in_video(whole, "a", detector="squares", every=every).remarks
    (remark,) = find_in_video(cut, "b", detector="squares", every=every).remarks
    n_read, n = map(int, re.findall(r"\d+", remark))
    assert 5 < n_read == len([*Video(cut, every)]) < n == 60 // every


def test_pyav_19_is_not_told_how_to_read_metadata(tmp_path, monkeypatch):
    path, open_any = write_video(tmp_path / "a.mp4", counted(3)), av.open

    def open_as_19(file, mode="r", format=None, options=None):
        return open_any(file, mode, format, options)

    monkeypatch.setattr(av, "__version__", "19.0.2")
    monkeypatch.setattr(av, "open", open_as_19)
    assert len(list(Video(path))) == 3


@pytest.mark.parametrize("content", [b"", b"hello", PLAYLIST, b"\0\0\0\x18ftypmp42", None])
def test_what_is_no_video_is_named(tmp_path, content):
    path = tmp_path / "a:b.mp4"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(InputError, match="a:b.mp4 must be a readable video. Received: "):
        list(Video(path))


def test_two_faces_that_pass_each_other_in_turns_of_order_keep_their_numbers():
    left, right = np.linspace(0, 150, 40), np.linspace(400, 250, 40)
    frames = [
        at(a, b) if i % 3 else at(b, a) for i, (a, b) in enumerate(zip(left, right, strict=True))
    ]
    assert follow(frames) == [[2, 1] if i % 3 else [1, 2] for i in range(40)]
    # Of all pairs the second number and the first face are nearest; not of both pairs together.
    assert follow([at(0, 60), at(35, 95)]) == [[1, 2], [1, 2]]


@pytest.mark.parametrize(("lost", "expected"), [(20, 1), (30, 2)])
def test_a_face_that_is_lost_for_less_than_a_second_keeps_its_number(lost, expected):
    assert follow([at(0), *[at()] * lost, at(10)]) == [[1], *[[]] * lost, [expected]]


def test_somebody_elsewhere_or_of_another_size_is_somebody_else():
    assert follow([at(0), at(150)])[1] == follow([at(0), 5 * at(0)])[1] == [2]
    assert follow([at(0), at(0, 300), at(300, 600)]) == [[1], [1, 2], [2, 3]]
    assert follow([at(0), at(20), at(40)], [0, 3, 6]) == [[1], [1], [1]]
    assert follow([]) == []


def test_a_cut_ends_all_tracks_but_those_of_faces_that_stay():
    assert follow([at(0), at(10), at(20)], cuts=[1]) == [[1], [2], [2]]
    assert follow([at(0), at(0.5), at(20)], cuts=[1]) == [[1], [1], [1]]


def test_a_hard_cut_between_two_people_begins_a_track_and_a_flash_or_a_pan_none(squares, tmp_path):
    """The second is where the first was, but for a few pixels."""
    first = [scene(20)] * 10
    second = [scene(24, ground=(20, 120, 20))] * 10
    flash = [scene(20, ground=(20, 120, 20))] + first
    for frames, tracks in (
        (first + second, [1] * 10 + [2] * 10),
        (first + flash, [1] * 21),
        ([scene(20 + 8 * i, ground=(8 * i,) * 3) for i in range(20)], [1] * 20),
    ):
        detections = find_in_video(
            write_video(tmp_path / "a.mp4", frames), "a", detector="squares", smooth=3
        )
        assert [ref.track for ref in detections.frame_refs] == tracks
        if frames[-1] is second[-1]:  # it is not smoothed over the cut
            assert np.allclose(detections.landmarks[10:, 0, 0] - FACE[0, 0], 24, atol=0.5)


def test_angles_of_tracks_are_written_as_those_of_faces():
    faces = [
        SimpleNamespace(frame_ref=FrameRef(i, i / 10, 1), pose=SimpleNamespace(yaw=yaw), notes=())
        for i, yaw in enumerate([-0.4, 12.4])
    ]
    (line,) = tell_tracks(faces, 3)
    assert line.endswith("found in 2 frames; yaw 0° to +12°")
    assert [*tell_tracks(faces[:1], 3)][0].endswith("found in 1 frame; yaw 0° to 0°")


def test_the_command_writes_a_row_for_each_frame_and_face(tmp_path, squares, clip, command):
    out = tmp_path / "out"
    given = ("predict", clip, "--detector", "squares", "--jobs", 1, "--out", out)
    status, output, _ = command(*given, "--format", "npz,json")
    assert status == 0
    assert re.search(r"track 1: 0.0 to 1.2 s, .* 27 frames", output)
    arrays = read_npz(out / "clip.npz")
    frames = [i for i in range(30) if not 12 <= i < 15]
    one, two = (arrays["track"] == track for track in (1, 2))
    assert list(arrays["frame"][one]) == frames and [*arrays["frame"][two]] == [*range(20, 30)]
    assert np.allclose(arrays["time"], arrays["frame"] / 25, atol=1e-3)
    seen = arrays["landmarks"][one, 0, 0] - FACE[0, 0]
    assert np.allclose(seen, 20 + 2 * np.array(frames), atol=1)
    faces = json.loads((out / "clip.json").read_bytes())["faces"]
    assert [face["frame"] for face in faces] == list(arrays["frame"])
    # Dots are yellow: much less blue than red.
    marked = [(f.image[..., 0] > f.image[..., 2] + 60.0).any() for f in Video(out / "clip.mp4")]
    assert marked == [not 12 <= i < 15 for i in range(30)]


def test_drawn_landmarks_are_at_their_times_and_places(tmp_path, squares, clip, monkeypatch):
    monkeypatch.setattr(videos, "_SIDE", 128)
    faces = [face for _, some in FaceLifter("squares").predict_video(clip, 2) for face in some]
    write_landmark_video(tmp_path / "a b:c.mp4", faces[0].source, faces, 2)
    frames = list(Video(tmp_path / "a b:c.mp4"))
    assert np.allclose([frame.time for frame in frames], np.arange(15) / 12.5, atol=2e-3)
    x = [np.nonzero(f.image[..., 0] > f.image[..., 2] + 60.0)[1].mean() for f in frames[:6]]
    assert frames[0].image.shape == (32, 128, 3)
    assert np.allclose(np.diff(x), 2, atol=0.7), "half of four pixels a frame"


def test_from_python_a_video_gives_its_frames_with_their_faces(squares, clip, tmp_path):
    lifter = FaceLifter("squares")
    seen = list(lifter.predict_video(clip, every=3))
    assert [frame.index for frame, _ in seen] == [*range(0, 30, 3)]
    for frame, faces in seen:
        tracks = [1] * (frame.index != 12) + [2] * (frame.index >= 20)
        assert [face.frame_ref.track for face in faces] == tracks
        assert all(face.frame_ref.frame == frame.index for face in faces)
        assert frame.image.shape == (SIDE, 4 * SIDE, 3)
    late = lifter.predict_video(clip, every=3, smooth="causal")
    behind = [
        now[0].landmarks[0, 0] - then[0].landmarks[0, 0]
        for (_, now), (frame, then) in zip(seen, late, strict=True)
        if frame.index < 12
    ]
    assert behind[0] == 0 and min(behind[1:]) > 0.5, "it moves to the right"
    for name, value in (("every", 0), ("every", 1.5), ("smooth", -1), ("smooth", "a")):
        with pytest.raises(InputError, match=f"{name} must be"):
            next(lifter.predict_video(clip, **{name: value}))
    nobody = write_video(tmp_path / "nobody.mp4", [scene()] * 3)
    with pytest.raises(InputError, match="no face found by squares, in any frame"):
        next(lifter.predict_video(nobody))
