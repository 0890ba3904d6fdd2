"""The preview shows every frame at its time, with landmarks where they are."""

import numpy as np
import pytest

from deepmds_keras.video import preview
from deepmds_keras.video.frames import Frame, Video
from deepmds_keras.video.preview import write_preview

av = pytest.importorskip("av")
SQUARE = np.array([[30, 40], [90, 40], [90, 100], [30, 100]], float)
LINES = [(0, 1, 2, 3, 0)]


def black(times, height=141, width=161):
    image = np.zeros((height, width, 3), np.uint8)
    return (Frame(i, time, image) for i, time in enumerate(times))


@pytest.mark.parametrize("codec", ["libx264", "mpeg4"])
def test_frames_keep_their_times_and_landmarks_their_places(tmp_path, monkeypatch, codec):
    monkeypatch.setattr(preview, "_SETTINGS", {codec: preview._SETTINGS[codec]})
    path, times = tmp_path / "a b:c.mp4", [0, 0.033, 0.2, 0.24, 1.0]
    write_preview(path, black(times), {1: {"1": SQUARE}, 3: {"1": SQUARE + 20}}, LINES)
    video = Video(path)
    frames = list(video)
    assert video.damage is None
    assert np.allclose([frame.time for frame in frames], times, atol=2e-3)
    bright = [frame.image.mean(-1) > 100 for frame in frames]
    assert [each.any() for each in bright] == [False, True, False, True, False]
    for i, shift in ((1, 0), (3, 20)):
        assert frames[i].image.shape == (140, 160, 3)
        for x, y in (SQUARE + np.roll(SQUARE, 1, 0)) / 2 + shift:
            assert bright[i][int(y) - 2 : int(y) + 2, int(x) - 2 : int(x) + 2].any()
        assert not bright[i][
            int(45 + shift) : int(95 + shift), int(35 + shift) : int(85 + shift)
        ].any()


def test_large_frames_are_made_smaller_with_their_landmarks(tmp_path):
    path = tmp_path / "a.mp4"
    write_preview(path, black([0], 1080, 1920), {0: {"1": 8.0 * SQUARE}}, LINES)
    (frame,) = Video(path)
    assert frame.image.shape == (720, 1280, 3)
    rows, columns = np.nonzero(frame.image.mean(-1) > 100)
    assert abs(rows.max() - 8 * 100 / 1.5) < 8 and abs(columns.max() - 8 * 90 / 1.5) < 8


def test_two_frames_at_one_time_both_stay(tmp_path):
    write_preview(tmp_path / "a.mp4", black([0, 0.04, 0.04, 0.08]), {}, LINES)
    assert len(list(Video(tmp_path / "a.mp4"))) == 4


def test_a_file_that_cannot_be_written_is_an_error_of_the_system(tmp_path):
    with pytest.raises(OSError, match="No such file"):
        write_preview(tmp_path / "none" / "a.mp4", black([0]), {}, LINES)
