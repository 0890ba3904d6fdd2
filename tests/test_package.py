"""What is published: sdist and wheel, and the wheel alone in an empty environment."""

import shutil
import subprocess
import sys

import pytest
from places import ROOT

pytestmark = pytest.mark.slow
PHOTO = ROOT / "docs" / "pictures" / "portraits.jpg"
PYTHONS = ("python3.11", "python3.12", "python3.13")


def run(*command, **options):
    done = subprocess.run(command, capture_output=True, text=True, **options)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def there(python):
    """Whether a version of Python is on this machine, and not only a name for it."""
    found = shutil.which(python)
    return found is not None and subprocess.run([found, "--version"]).returncode == 0


def environment(python, folder, *packages):
    """The programs of a new virtual environment."""
    run(python, "-m", "venv", str(folder))
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
    said = run(str(tools / "twine"), "check", "--strict", *map(str, files))
    assert said.count("PASSED") == 2


@pytest.mark.parametrize("python", [sys.executable, *filter(there, PYTHONS)])
def test_the_wheel_alone_predicts(files, tmp_path, python):
    programs = environment(python, tmp_path / "venv", f"{files[0]}[dlib]")
    deepmds = str(programs / "deepmds")
    said = run(deepmds, "predict", str(PHOTO), "--out", "out", "--view", cwd=tmp_path)
    assert "3 faces" in said
    names = {path.name for path in (tmp_path / "out").iterdir()}
    assert {"portraits.csv", "portraits.json", "portraits.html"} <= names
