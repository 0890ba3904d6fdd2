"""What a run reads, and that no result can overwrite another or a source."""

import errno
import os
from itertools import permutations
from pathlib import Path

import pytest

from deepmds_keras import InputError
from deepmds_keras.predict.sources import (
    check_folder,
    find_sources,
    is_landmark_file,
    is_photo,
    name_faces,
    name_sources,
    said_skipped,
)


def touched(folder, *names):
    for name in names:
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).touch()
    return [folder / name for name in names]


def test_a_folder_gives_its_photos_by_name(tmp_path):
    touched(tmp_path, "b.JPG", "a.png", "c.webp", ".hidden.jpg", "._b.jpg", "notes.txt", "a.csv")
    touched(tmp_path, "deeper/d.jpg")
    (tmp_path / "folder.jpg").mkdir()
    sources, errors, skipped = find_sources([tmp_path])
    assert [path.name for path in sources] == ["a.png", "b.JPG", "c.webp"]
    assert not errors
    assert skipped == {"hidden": 2, ".txt": 1, ".csv": 1, "subfolder (--recursive)": 2}


def test_what_a_folder_does_not_give_is_counted_by_its_kind(tmp_path):
    touched(tmp_path, "a.jpg", "1.mp4", "2.MP4", "3.mp4", ".b", ".c.jpg", "within/d.jpg", "README")
    touched(tmp_path / "other", "a.jpg", "a/b.jpg", "b.mp4")
    _, _, skipped = find_sources([tmp_path, tmp_path / "other"])
    assert said_skipped(skipped) == "4 .mp4, 3 subfolders (--recursive), 2 hidden, 1 without suffix"
    assert said_skipped(find_sources([tmp_path / "a.jpg"])[2]) == ""


def test_folders_within_are_taken_if_asked_for_but_no_results_and_nothing_twice(tmp_path):
    touched(tmp_path, "b/b.jpg", "b/a/c.jpg", "a/d.heic", "e.jpg", ".hidden/f.jpg", "b/notes.txt")
    touched(tmp_path, "b/out/g.png", "b/out/deepmds.json")
    (tmp_path / "a" / "round").symlink_to(tmp_path)
    sources, errors, skipped = find_sources([tmp_path], recursive=True)
    names = ["e.jpg", "a/d.heic", "b/b.jpg", "b/a/c.jpg"]
    assert [str(path.relative_to(tmp_path)) for path in sources] == names
    assert not errors
    assert skipped == {"hidden": 1, "linked folder": 1, "folder of results": 1, ".txt": 1}


def test_a_folder_within_that_cannot_be_read_is_named(tmp_path, monkeypatch):
    touched(tmp_path, "a.jpg", "within/b.jpg")
    scandir = os.scandir

    def forbidden(path):
        """As for a user without rights: root, who may run the tests, reads every folder."""
        if Path(path).name == "within":
            raise PermissionError(errno.EACCES, os.strerror(errno.EACCES), str(path))
        return scandir(path)

    monkeypatch.setattr(os, "scandir", forbidden)
    sources, (error,), _ = find_sources([tmp_path], recursive=True)
    assert [path.name for path in sources] == ["a.jpg"]
    assert str(error).startswith(f"{tmp_path / 'within'} must be a folder that can be read")


def test_files_stay_in_order_and_are_taken_once(tmp_path):
    b, a, points = touched(tmp_path, "b.jpg", "a.jpg", "points.npy")
    sources, errors, _ = find_sources([points, b, str(tmp_path), tmp_path / "." / "b.jpg"])
    assert sources == [points, b, a]
    assert not errors


def test_one_bad_path_does_not_stop_the_others(tmp_path):
    photo, text, _ = touched(tmp_path, "a.jpg", "a.txt", "empty/.hidden.jpg")
    bad = [tmp_path / "none.jpg", text, tmp_path / "empty"]
    sources, errors, _ = find_sources([*bad, photo])
    assert sources == [photo]
    for path, error, said in zip(
        bad, errors, ("does not exist", "'.txt'", "must hold photos"), strict=True
    ):
        assert isinstance(error, InputError)
        assert str(error).startswith(f"{path} ")
        assert said in str(error)


def test_suffixes_tell_photos_from_landmarks():
    photos = [Path(name) for name in ("a.jpg", "a.JPEG", "a.tif", "a.HEIC")]
    points = [Path(name) for name in ("a.csv", "a.NPY", "a.pts", "a.json")]
    files = [*photos, *points, Path("a"), Path("a.mp4"), Path("jpg")]
    assert [path for path in files if is_photo(path)] == photos
    assert [path for path in files if is_landmark_file(path)] == points


def test_a_source_has_its_own_name_where_that_is_free():
    sources = [Path("x/a.jpg"), Path("b.c.png"), Path("a.png"), Path("y/a.jpg"), Path("z/a.jpg")]
    assert name_sources(sources) == ["a", "b.c", "a_png", "a_jpg", "a_jpg_2"]


def test_no_face_of_a_source_is_called_like_one_of_another():
    files = ("a.jpg", "A.png", "a-1.jpg", "a-1-1.jpg", "a_png.gif", "x/a-01.png", "a-b.jpg")
    for order in permutations(files, 4):
        names = name_sources([Path(name) for name in order])
        results = [
            {name, *name_faces(name, 3), *name_faces(name, 12)} for name in map(str.casefold, names)
        ]
        for i, own in enumerate(results):
            assert own.isdisjoint(set().union(*results[:i])), order


def test_several_faces_are_numbered_so_that_they_sort():
    assert name_faces("a", 1) == ["a"]
    assert name_faces("a", 2) == ["a-1", "a-2"]
    twelve = name_faces("a", 12)
    assert twelve[0] == "a-01"
    assert sorted(twelve) == twelve


def test_a_result_may_lie_beside_a_photo_but_not_overwrite_a_source(tmp_path):
    photo, points = touched(tmp_path, "a.jpg", "a.CSV")
    check_folder(tmp_path, [photo], [".csv", ".png"])
    check_folder(tmp_path / "out", [photo, points], [".csv", ".png"])
    with pytest.raises(InputError, match="a.CSV, which a result could overwrite"):
        check_folder(tmp_path / "out" / "..", [photo, points], [".csv", ".png"])


def test_no_name_is_that_of_the_mesh_of_another():
    assert name_sources([Path("a.jpg"), Path("a.mesh.jpg")]) == ["a", "a.mesh_jpg"]
