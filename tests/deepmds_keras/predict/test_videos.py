"""`deepmds predict` on videos: a row for each frame and face, and a video to look at."""

import json
import os
import re
import signal
import subprocess
import sys
import time

import numpy as np
import pandas as pd
import pytest
from places import ROOT
from writers.heads import drawn_heads
from writers.videos import write_video

from deepmds_keras.__main__ import main
from deepmds_keras.detection.detectors import DETECTORS, Detector
from deepmds_keras.predict import videos
from deepmds_keras.predict.landmark_files import read_landmarks
from deepmds_keras.video import preview
from deepmds_keras.video.frames import Video

pytest.importorskip("av")
GREY, SIDE = 90, 64
# 68 points about as those of a face, of 20 pixels.
FACE = np.random.default_rng(3).uniform(0, 20, (68, 2))


@pytest.fixture(scope="module")
def heads(apart):
    """Images of five open heads, and their 51 landmarks in pixels."""
    return apart(drawn_heads)


@pytest.fixture
def squares(monkeypatch):
    """A detector of white squares: of each the 68 points of `FACE`, from its upper left corner."""

    def find(image):
        columns = np.flatnonzero((image.min(-1) > 180).any(0))
        starts = columns[np.diff(columns, prepend=-9) > 1]
        return np.array([FACE + (x, 5) for x in starts]).reshape(-1, 68, 2), 1.0

    row = Detector("ibug68", lambda _: find, lambda: True, "nobody's")
    monkeypatch.setitem(DETECTORS, "dlib", row)


@pytest.fixture
def run(capsys, tmp_path):
    """Runs the command in this process: `run(*arguments)` → status, stdout, stderr's lines."""

    def run(*arguments, out=tmp_path / "out"):
        capsys.readouterr()
        options = ("--detector", "dlib", "--jobs", 1)
        with pytest.raises(SystemExit) as ended:
            main([str(each) for each in ("predict", *arguments, *options, "--out", out)])
        said = capsys.readouterr()
        lines = [line.strip() for line in re.split(r"[\r\n]+", said.err)]
        return ended.value.code, said.out, [line for line in lines if line[:4] in ("erro", "note")]

    return run


def scene(*places):
    """A frame with white squares of 20 pixels at these columns."""
    image = np.full((SIDE, 4 * SIDE, 3), GREY, np.uint8)
    for x in places:
        image[10:30, x : x + 20] = 255
    return image


@pytest.fixture
def clip(tmp_path):
    """Thirty frames: a face that moves, lost in frames 12 to 14; another from frame 20."""
    places = [[] if 12 <= i < 15 else [20 + 2 * i] for i in range(30)]
    places = [at + [200] * (i >= 20) for i, at in enumerate(places)]
    return write_video(tmp_path / "clip.mp4", [scene(*at) for at in places])


def test_a_row_for_each_frame_and_face(tmp_path, run, squares, clip):
    status, said, errors = run(clip, "--format", "csv,npz,json")
    assert (status, errors) == (0, [])
    assert "faces in 27 frames" in said
    assert "track 1: 0.0 to 1.2 s, found in 27 frames" in said
    with np.load(tmp_path / "out" / "clip.npz") as file:
        arrays = dict(file)
    frames = [i for i in range(30) if not 12 <= i < 15]
    one, two = (arrays["track"] == track for track in (1, 2))
    assert list(arrays["frame"][one]) == frames
    assert list(arrays["frame"][two]) == [*range(20, 30)]
    assert (np.diff(arrays["frame"]) >= 0).all()
    assert np.allclose(arrays["time"], arrays["frame"] / 25, atol=1e-3)
    assert np.isfinite(arrays["shape"]).all() and len(arrays["shape"]) == 37
    seen = arrays["landmarks"][one, 0, 0] - FACE[0, 0]
    assert np.allclose(seen, 20 + 2 * np.array(frames), atol=1)

    table = pd.read_csv(tmp_path / "out" / "clip.csv", comment="#")
    assert list(table.columns[:4]) == ["face", "frame", "time", "track"]
    for key in ("frame", "time", "track"):
        assert np.allclose(table[key].to_numpy().reshape(37, 68), arrays[key][:, None])
    again = read_landmarks(tmp_path / "out" / "clip.csv")
    assert np.allclose(again, arrays["landmarks"], atol=1e-3)
    faces = json.loads((tmp_path / "out" / "clip.json").read_bytes())["faces"]
    assert [face["frame"] for face in faces] == list(arrays["frame"])
    assert [face["track"] for face in faces] == list(arrays["track"])


def test_the_preview_and_pictures_show_the_tracks(tmp_path, run, squares, clip):
    assert run(clip, "--view")[0] == 0
    out = tmp_path / "out"
    assert len(list(out.glob("clip-*.png"))) == 2
    assert (out / "clip.html").read_text(encoding="utf-8").count("data:image/jpeg") == 2
    frames = list(Video(out / "clip.mp4"))
    assert len(frames) == 30
    # Dots are yellow: much less blue than red.
    marked = [(f.image[..., 0] > f.image[..., 2] + 60.0).any() for f in frames]
    assert marked == [not 12 <= i < 15 for i in range(30)]


def test_smoothing_goes_over_time_but_not_over_gaps(tmp_path, run, squares):
    """A face that stands still, then jumps while it is hidden, and stands still again."""
    places = [[20]] * 10 + [[]] * 2 + [[30]] * 10
    path = write_video(tmp_path / "a.mp4", [scene(*at) for at in places])
    assert run(path, "--smooth", 3, "--format", "npz")[0] == 0
    with np.load(tmp_path / "out" / "a.npz") as file:
        x, tracks = file["landmarks"][:, 0, 0] - FACE[0, 0], file["track"]
    assert np.allclose(x, [20] * 10 + [30] * 10, atol=0.5)
    assert {*tracks} == {1}
    jumping = write_video(tmp_path / "b.mp4", [scene(20 + 4 * (i % 2)) for i in range(20)])
    assert run(jumping, "--smooth", 3, "--format", "npz")[0] == 0
    with np.load(tmp_path / "out" / "b.npz") as file:
        assert np.abs(np.diff(file["landmarks"][:, 0, 0])).max() < 1


def test_every_nth_frame_keeps_its_index_and_is_smoothed_with_the_next(tmp_path, run, squares):
    path = write_video(tmp_path / "a.mp4", [scene(20 + 4 * (i % 4 // 2)) for i in range(20)])
    assert run(path, "--every", 2, "--smooth", 3, "--format", "npz")[0] == 0
    with np.load(tmp_path / "out" / "a.npz") as file:
        assert list(file["frame"]) == [*range(0, 20, 2)]
        assert np.abs(np.diff(file["landmarks"][:, 0, 0])).max() < 1
    assert len(list(Video(tmp_path / "out" / "a.mp4"))) == 10


def test_bad_videos_get_a_line_each_and_damaged_ones_a_note(tmp_path, run, squares, clip):
    noise = np.random.default_rng(0).integers(0, 120, (25, 64, 64, 3), np.uint8)
    noise[:, 10:30, 20:40] = 255
    cut = write_video(tmp_path / "cut.mkv", noise)
    cut.write_bytes(cut.read_bytes()[: cut.stat().st_size // 2])
    (tmp_path / "text.mp4").write_text("hello")
    write_video(tmp_path / "nobody.mp4", [scene()] * 3)
    names = ("text.mp4", "nobody.mp4", "cut.mkv", "clip.mp4", "none.webm")
    status, said, lines = run(*(tmp_path / name for name in names), "--format", "csv")
    assert status == 1
    wanted = {
        "text.mp4": "must be a video that can be read. Received: Invalid data",
        "nobody.mp4": "no face found by dlib",
        "none.webm": "does not exist",
        "cut.mkv": "note: .* of the 1.0 s that it should have, the first 0.. s could be read",
    }
    assert len(lines) == len(wanted)
    for name, text in wanted.items():
        (line,) = [line for line in lines if str(tmp_path / name) in line]
        assert re.search(text, line), name
    assert said.count("faces in") == 2
    text = (tmp_path / "out" / "cut.csv").read_text(encoding="utf-8")
    assert "the video is damaged" in text
    assert run(clip, cut, "--format", "csv")[1].startswith("2 of 2 sources are done already")


def test_a_folder_is_not_searched_for_videos_but_results_do_not_overwrite_one(run, squares, clip):
    status, _, (line,) = run(clip.parent)
    assert (status, "name videos" in line) == (1, True)
    status, _, (line,) = run(clip, out=clip.parent)
    assert (status, "must be another folder than that of" in line) == (1, True)


def test_dlib_follows_a_head_that_turns(tmp_path, run, heads):
    images, landmarks = heads
    order = [0, 1, 2, 3, 4]
    path = write_video(tmp_path / "turning.mov", images[order])
    assert run(path, "--format", "npz")[0] == 0
    with np.load(tmp_path / "out" / "turning.npz") as file:
        assert {*file["track"]} == {1} and list(file["frame"]) == order
        assert np.abs(file["landmarks"][:, -51:] - landmarks[order]).mean() < 4
        assert file["yaw"][4] > file["yaw"][0] + 20


@pytest.mark.parametrize("place", ["detection", "preview"])
def test_what_is_stopped_leaves_nothing_and_goes_on(
    tmp_path, run, squares, clip, monkeypatch, place
):
    def stop(*arguments):
        raise KeyboardInterrupt

    with monkeypatch.context() as patched:
        if place == "detection":
            patched.setattr(videos, "follow_faces", stop)
        else:
            patched.setattr(preview, "_drawn", stop)
        assert run(clip, "--format", "csv")[0] == 130
    out = tmp_path / "out"
    assert not [file.name for file in out.iterdir() if "partial" in file.name]
    assert not (out / "clip.mp4").exists()
    assert run(clip, "--format", "csv")[0] == 0
    assert {"clip.csv", "clip.mp4"} < {file.name for file in out.iterdir()}


@pytest.mark.slow
def test_a_run_that_is_stopped_leaves_nothing_half_written(tmp_path, heads):
    path = write_video(tmp_path / "a.mp4", [heads[0][2]] * 300)
    out = tmp_path / "out"
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    command = [sys.executable, "-m", "deepmds_keras", "predict", path, "--out", out]
    started = subprocess.Popen(
        [*map(str, command), "--detector", "dlib", "--jobs", "1"],
        stderr=subprocess.PIPE,
        text=True,
        env=environment,
    )
    while not (out / "deepmds.json").exists() and started.poll() is None:
        time.sleep(0.02)
    time.sleep(0.5)
    started.send_signal(signal.SIGINT)
    _, errors = started.communicate()
    assert started.returncode == 130, errors
    assert "Traceback" not in errors
    assert [file.name for file in out.iterdir()] == ["deepmds.json"]
    assert json.loads((out / "deepmds.json").read_bytes()) == {}
