"""The package of MediaPipe for browsers: from wherever it comes, it is the one that is meant."""

import hashlib
import io
import tarfile
from urllib.error import URLError

import pytest

from deepmds_keras import InputError
from deepmds_keras.tool.live import tasks_vision
from deepmds_keras.tool.live.tasks_vision import SHA256, read_tasks_vision

FILES = {name: f"content of {name}".encode() for name in SHA256}
HOW = "npm pack @mediapipe/tasks-vision@0.10.35"


def packed(files):
    """A tarball as npm packs files."""
    buffer = io.BytesIO()
    with tarfile.open(fileobj=buffer, mode="w:gz") as archive:
        for name, content in files.items():
            entry = tarfile.TarInfo(f"package/{name}")
            entry.size = len(content)
            archive.addfile(entry, io.BytesIO(content))
    return buffer.getvalue()


@pytest.fixture
def released(monkeypatch):
    """Has the package consist of FILES."""
    for name, content in FILES.items():
        monkeypatch.setitem(SHA256, name, hashlib.sha256(content).hexdigest())


@pytest.mark.usefixtures("released")
def test_download_tarball_and_folder_give_the_same_files(tmp_path, monkeypatch):
    addresses = []

    def answer(address, timeout):
        addresses.append(address)
        return io.BytesIO(packed(FILES))

    monkeypatch.setattr(tasks_vision, "urlopen", answer)
    assert read_tasks_vision(None) == FILES
    assert addresses == [
        "https://registry.npmjs.org/@mediapipe/tasks-vision/-/tasks-vision-0.10.35.tgz"
    ]
    (tmp_path / "package.tgz").write_bytes(packed(FILES))
    assert read_tasks_vision(tmp_path / "package.tgz") == FILES
    for name, content in FILES.items():
        (tmp_path / "folder" / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / "folder" / name).write_bytes(content)
    assert read_tasks_vision(tmp_path / "folder") == FILES


@pytest.mark.parametrize("changed", FILES)
@pytest.mark.usefixtures("released")
def test_a_file_of_another_version_is_refused_by_name(tmp_path, changed):
    path = tmp_path / "package.tgz"
    path.write_bytes(packed(FILES | {changed: b"other"}))
    with pytest.raises(InputError, match=f"package.tgz must be .* another {changed}, with sha256"):
        read_tasks_vision(path)


@pytest.mark.usefixtures("released")
def test_what_is_no_package_is_refused_with_how_to_get_it(tmp_path):
    whole = packed(FILES)
    for content in (b"", b"text", whole[: len(whole) // 2], packed({"README.md": b""})):
        (tmp_path / "package.tgz").write_bytes(content)
        with pytest.raises(InputError, match=HOW):
            read_tasks_vision(tmp_path / "package.tgz")
    for missing in (tmp_path, tmp_path / "none.tgz"):
        with pytest.raises(InputError, match=HOW):
            read_tasks_vision(missing)


def test_without_a_network_the_command_says_how_to_get_it(tmp_path, monkeypatch, command):
    def unreachable(address, timeout):
        raise URLError("no route to host")

    monkeypatch.setattr(tasks_vision, "urlopen", unreachable)
    said = command("live", tmp_path / "live.html")[2]
    assert HOW in said and "--tasks-vision" in said
    assert not [*tmp_path.iterdir()]
