"""What a run reads, and that no result can be called like another."""

import errno
import os
from itertools import permutations
from pathlib import Path

import pytest

from deepmds_keras import InputError
from deepmds_keras.tool.command.sources import find_sources, list_skipped, name_sources
from deepmds_keras.tool.predict.faces import name_faces


def touched(folder, *names):
    for name in names:
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).touch()
    return [folder / name for name in names]


def test_a_folder_gives_its_photos_by_name_and_counts_the_rest(tmp_path):
    touched(tmp_path, "b.JPG", "a.png", "c.webp", "1.mp4", "2.MP4", "3.mp4", ".b", ".c.jpg")
    touched(tmp_path, "README", "within/d.jpg")
    (tmp_path / "folder.jpg").mkdir()
    sources, errors, skipped = find_sources([tmp_path])
    assert [path.name for path in sources] == ["a.png", "b.JPG", "c.webp"]
    assert not errors
    counts = {"hidden": 2, ".mp4": 3, "without suffix": 1, "subfolder (--recursive)": 2}
    assert skipped == counts
    listed = list_skipped(skipped)
    assert "3 .mp4, " in listed and "2 subfolders (--recursive)" in listed


def test_subfolders_are_taken_if_asked_for_but_no_results_and_nothing_twice(tmp_path):
    touched(tmp_path, "b/b.jpg", "b/a/c.jpg", "a/d.heic", "e.jpg", ".hidden/f.jpg", "b/notes.txt")
    touched(tmp_path, "b/out/g.png", "b/out/.deepmds-lock")
    (tmp_path / "a" / "round").symlink_to(tmp_path)
    sources, errors, skipped = find_sources([tmp_path], recursive=True)
    names = ["e.jpg", "a/d.heic", "b/b.jpg", "b/a/c.jpg"]
    assert [str(path.relative_to(tmp_path)) for path in sources] == names
    assert not errors
    assert skipped == {"hidden": 1, "linked folder": 1, "folder of results": 1, ".txt": 1}


@pytest.mark.parametrize("listed", [False, True])
def test_a_subfolder_that_cannot_be_read_is_named(tmp_path, monkeypatch, listed):
    """As for a user without rights: root, who may run the tests, reads every folder."""
    touched(tmp_path, "a.jpg", "within/b.jpg")

    def refusing(function, names):
        def refuse(path, *arguments, **options):
            if isinstance(path, (str, Path)) and any(name in names for name in Path(path).parts):
                raise PermissionError(errno.EACCES, os.strerror(errno.EACCES), str(path))
            return function(path, *arguments, **options)

        return refuse

    monkeypatch.setattr(os, "scandir", refusing(os.scandir, [] if listed else ["within"]))
    monkeypatch.setattr(os, "stat", refusing(os.stat, ["b.jpg", ".deepmds-lock"]))
    sources, errors, skipped = find_sources([tmp_path], recursive=True)
    assert [path.name for path in sources] == ["a.jpg"]
    if listed:
        assert skipped == {"no file": 1} and not errors
    else:
        assert str(errors[0]).startswith(f"{tmp_path / 'within'} cannot be read: ")


def test_files_stay_in_order_are_taken_once_and_bad_ones_are_named(tmp_path):
    b, a, points, text, _ = touched(
        tmp_path, "b.jpg", "a.jpg", "points.npy", "a.txt", "empty/.hidden.jpg"
    )
    bad = [tmp_path / "none.jpg", "https://example.com/a.jpg", text, tmp_path / "empty"]
    paths = [*bad, points, b, str(tmp_path), tmp_path / "." / "b.jpg", a]
    sources, errors, _ = find_sources(paths)
    assert sources == [points, b, a]
    for path, error, message in zip(
        bad, errors, (*["does not exist"] * 2, "'.txt'", "must hold photos"), strict=True
    ):
        assert isinstance(error, InputError)
        assert str(error).startswith(f"{path} ") and message in str(error)


def test_a_source_gives_its_name_to_the_results_where_that_is_free():
    names = ("x/a.jpg", "b.c.png", "a.png", "y/a.jpg", "z/a.jpg", "d.mesh.jpg")
    expected = ["a", "b.c", "a_png", "a_jpg", "a_jpg_2", "d.mesh_jpg"]
    assert name_sources([*map(Path, names)], {}) == expected
    assert name_sources([Path("p-1.jpg"), Path("p-2.jpg")], {}) == ["p-1", "p-2"]


def test_sources_that_are_done_keep_their_names():
    new, done, late = Path("a.jpg"), Path("a.png"), Path("b.jpg")
    known = {str(done.resolve()): "a", str(late.resolve()): "b_jpg"}
    assert name_sources([new, done, late], known) == ["a_jpg", "a", "b_jpg"]


def test_no_face_of_a_source_is_called_like_one_of_another():
    files = ("a.jpg", "A.png", "a-1.jpg", "a-1-1.jpg", "a_png.gif", "x/a-01.png", "a-b.jpg")
    for order in permutations(files, 4):
        names = name_sources([Path(name) for name in order], {})
        results = [
            {name, *name_faces(name, 3), *name_faces(name, 12)} for name in map(str.casefold, names)
        ]
        for i, names in enumerate(results):
            assert names.isdisjoint(set().union(*results[:i])), order


def test_several_faces_are_numbered_so_that_they_sort():
    assert name_faces("a", 1) == ["a"]
    assert name_faces("a", 2) == ["a-1", "a-2"]
    assert name_faces("a", 12) == sorted(name_faces("a", 12))
