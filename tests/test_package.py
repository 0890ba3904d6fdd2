"""What is published: sdist and wheel, and the wheel with its extras in empty environments."""

import shutil
import subprocess
import sys
import zipfile

import pytest
from places import ROOT

pytestmark = pytest.mark.slow
PICTURES = ROOT / "docs" / "pictures"
PHOTO = PICTURES / "portraits.jpg"
PYTHONS = ("python3.11", "python3.12", "python3.13")


def run(*command, **options):
    done = subprocess.run(command, capture_output=True, text=True, **options)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def version_of(python):
    """Of a Python on this machine, None where there is only its name: `(3, 11)`."""
    if shutil.which(python) is None:
        return None
    code = "import sys; print(*sys.version_info[:2])"
    done = subprocess.run([python, "-c", code], capture_output=True, text=True)
    return tuple(map(int, done.stdout.split())) or None


def environment(python, folder, *packages):
    """The programs of a new virtual environment."""
    run(python, "-m", "venv", str(folder))
    if packages:
        run(str(folder / "bin" / "python"), "-m", "pip", "install", "-q", *packages)
    return folder / "bin"


@pytest.fixture(scope="module")
def tools(tmp_path_factory):
    return environment(sys.executable, tmp_path_factory.mktemp("tools"), "build", "twine")


@pytest.fixture(scope="module")
def files(tools, tmp_path_factory):
    """The two files, made of what git knows."""
    folder = tmp_path_factory.mktemp("package")
    run("git", "clone", "-q", str(ROOT), str(folder / "sources"))
    run(str(tools / "python"), "-m", "build", "--outdir", str(folder), str(folder / "sources"))
    return sorted(path for path in folder.iterdir() if path.is_file())


def test_twine_finds_nothing_wrong(tools, files):
    assert [path.suffix for path in files] == [".whl", ".gz"]
    output = run(str(tools / "twine"), "check", "--strict", *map(str, files))
    assert output.count("PASSED") == 2
    names = zipfile.ZipFile(files[0]).namelist()
    assert "deepmds_keras/py.typed" in names
    licences = {name.rpartition("/licenses/")[2] for name in names if "/licenses/" in name}
    assert licences == {"LICENSE", "THIRD_PARTY_NOTICES.md"}


@pytest.mark.parametrize("python", [sys.executable, *filter(version_of, PYTHONS)])
def test_the_wheel_alone_predicts(files, tmp_path, python):
    programs = environment(python, tmp_path / "venv", f"{files[0]}[dlib]")
    deepmds = str(programs / "deepmds")
    photos = [str(PHOTO), str(PICTURES / "astronaut.jpg")]
    output = run(deepmds, "predict", *photos, "--out", "out", "--view", cwd=tmp_path)
    assert "portraits.jpg: 3 faces" in output
    assert "astronaut.jpg: 2 faces" in output  # dlib takes the badge for one, too
    names = {path.name for path in (tmp_path / "out").iterdir()}
    assert {f"{photo}.{kind}" for photo in ("portraits", "astronaut")
            for kind in ("csv", "png", "html")} <= names  # fmt: skip


@pytest.mark.parametrize("extras", [("mediapipe", "keras", "onnx"), ("keras", "onnx", "mediapipe"),
                                    ("mediapipe,keras,onnx",)], ids="-".join)  # fmt: skip
def test_extras_work_together_in_whatever_order_they_are_installed(files, tmp_path, extras):
    programs = environment(sys.executable, tmp_path / "venv")
    for extra in extras:
        run(str(programs / "python"), "-m", "pip", "install", "-q", f"{files[0]}[{extra}]")
    run(str(programs / "python"), "-m", "pip", "check")
    deepmds = str(programs / "deepmds")
    run(deepmds, "predict", str(PHOTO), "--detector", "mediapipe", "--out", "out", cwd=tmp_path)
    landmarks = str(tmp_path / "out" / "portraits.csv")
    output = run(deepmds, "predict", landmarks, "--model", "deepmds", "--out", "net", cwd=tmp_path)
    assert "3 faces" in output
    run(deepmds, "export", "model.onnx", cwd=tmp_path)
