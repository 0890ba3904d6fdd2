"""Frames of videos: all of them, upright, at their times; of a damaged file what there is."""

import builtins
import itertools

import numpy as np
import pytest
from writers.videos import write_video

from deepmds_keras.errors import InputError
from deepmds_keras.video.frames import Video

pytest.importorskip("av")


def counted(n):
    """Grey images, each a little lighter, with a red corner at the left and a blue one above it."""
    images = (
        np.zeros((n, 64, 96, 3), np.uint8) + np.uint8(np.linspace(20, 200, n))[:, None, None, None]
    )
    images[:, 32:, :32], images[:, :32, :32] = (255, 0, 0), (0, 0, 255)
    return images


def brightness(frame):
    return frame.image[:, 48:].mean()


@pytest.mark.parametrize("suffix", [".mp4", ".mov", ".mkv", ".webm", ".avi"])
def test_every_frame_comes_once_in_order_and_again(tmp_path, suffix):
    video = Video(write_video(tmp_path / f"a{suffix}", counted(30)))
    for _ in range(2):
        frames = list(video)
        assert [frame.index for frame in frames] == list(range(30))
        assert np.allclose([frame.time for frame in frames], np.arange(30) / 25, atol=2e-3)
        assert np.allclose(
            [brightness(frame) for frame in frames], np.linspace(20, 200, 30), atol=6
        )
    assert (video.n_frames, video.damage) == (30, None)
    red, blue = frames[0].image[48, 16], frames[0].image[16, 16]
    assert np.argmax(red) == 0 and np.argmax(blue) == 2 and frames[0].image.shape == (64, 96, 3)


def test_of_every_nth_frame_index_and_time_are_the_videos(tmp_path):
    video = Video(write_video(tmp_path / "a.mp4", counted(10)), every=4)
    assert [(frame.index, round(frame.time, 3)) for frame in video] == [
        (0, 0),
        (4, 0.16),
        (8, 0.32),
    ]
    assert video.n_frames == 3


def test_phones_that_drop_frames_and_begin_late_keep_their_times(tmp_path):
    times = [500, 533, 700, 733, 1900]
    video = Video(write_video(tmp_path / "a.mkv", counted(5), times))
    assert np.allclose([frame.time for frame in video], [0, 0.033, 0.2, 0.233, 1.4], atol=2e-3)


@pytest.mark.parametrize("turns", [1, 2, 3])
def test_frames_are_turned_as_a_player_turns_them(tmp_path, turns):
    upright = counted(2)
    stored = np.ascontiguousarray(np.rot90(upright, -turns, axes=(1, 2)))
    video = Video(write_video(tmp_path / "a.mp4", stored, rotation=90 * turns))
    image = next(iter(video)).image
    assert image.shape == upright[0].shape and image.flags.c_contiguous
    assert np.abs(image.astype(int) - upright[0]).mean() < 10


def test_pixels_that_are_no_squares_become_squares(tmp_path):
    image = next(iter(Video(write_video(tmp_path / "a.mp4", counted(2), pixel="4/3")))).image
    assert image.shape == (64, 128, 3)


def noise(n):
    """Frames that are long in the file, about as long each."""
    return np.random.default_rng(0).integers(0, 255, (n, 48, 64, 3), np.uint8)


@pytest.mark.parametrize("suffix", [".mp4", ".mkv", ".avi"])
def test_a_file_that_was_cut_gives_what_is_left_and_says_so(tmp_path, suffix):
    path = write_video(tmp_path / f"a{suffix}", noise(25))
    content = path.read_bytes()
    path.write_bytes(content[: len(content) // 2])
    video = Video(path)
    assert 5 < len(list(video)) < 20
    assert "of the 1.0 s that it should have, the first " in video.damage
    path.write_bytes(content)
    assert len(list(video)) == 25 and video.damage is None


@pytest.mark.parametrize("suffix", [".mp4", ".mkv", ".avi"])
def test_a_hole_in_the_file_is_said(tmp_path, suffix):
    path = write_video(tmp_path / f"a{suffix}", noise(25))
    content = bytearray(path.read_bytes())
    fifth = len(content) // 5
    content[2 * fifth : 3 * fifth] = bytes(fifth)
    path.write_bytes(content)
    video = Video(path)
    assert 15 < len(list(video)) <= 25
    assert "of its frames could be read in part, or not at all" in video.damage


PLAYLIST = (
    b"#EXTM3U\n#EXT-X-TARGETDURATION:9\n#EXTINF:9,\nhttp://127.0.0.1:9/a.ts\n#EXT-X-ENDLIST\n"
)


@pytest.mark.parametrize("content", [b"", b"hello", PLAYLIST, b"\0\0\0\x18ftypmp42"])
def test_what_is_no_video_is_named(tmp_path, content):
    path = tmp_path / "a:b.mp4"
    path.write_bytes(content)
    with pytest.raises(InputError, match="a:b.mp4 must be a video that can be read. Received: "):
        list(Video(path))


def test_paths_that_are_no_files_are_named(tmp_path):
    with pytest.raises(InputError, match="a path that does not exist"):
        Video(tmp_path / "none.mp4")
    with pytest.raises(InputError, match="a folder or device"):
        Video(tmp_path)


def test_the_extra_is_named_where_pyav_is_missing(tmp_path, monkeypatch):
    path, ordinary = write_video(tmp_path / "a.mp4", counted(2)), builtins.__import__

    def without(name, *arguments):
        if name == "av":
            raise ImportError("No module named 'av'")
        return ordinary(name, *arguments)

    monkeypatch.setattr(builtins, "__import__", without)
    with pytest.raises(InputError, match=r"pip install 'deepmds-keras\[video\]'"):
        Video(path)


def test_one_frame_is_in_memory_at_a_time(tmp_path):
    """Frames of which none is kept, of more bytes in all than the process may use."""
    import resource

    path = write_video(tmp_path / "a.mp4", [np.zeros((480, 640, 3), np.uint8)] * 65)
    frames = iter(Video(path))
    assert len(list(itertools.islice(frames, 5))) == 5
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    assert sum(1 for _ in frames) == 60  # 55 MB of RGB
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 20_000  # kB
