"""The package without its extras: lifters predict, and what does not says what to install."""

import configparser
import re
import subprocess
import sys

import numpy as np
import pytest
from places import ROOT

from data_gen.models.registry import load_model
from deepmds_keras.lifting.lifter import LandmarkLifter

# Modules of the packages that each extra brings, none of which the small installation has.
EXTRAS = {
    "keras": ("tensorflow", "keras", "h5py", "sklearn"),
    "experiments": ("pandas", "vtkmodules", "jinja2", "filelock"),
    "fast": ("numba",),
    "onnx": ("onnx",),
    "video": ("av",),
    "heic": ("pillow_heif",),
    "dlib": ("dlib",),
    "mediapipe": ("mediapipe",),
}
HIDE = f"""
import sys

class Without:
    def __init__(self, finder):
        self.finder = finder

    def find_spec(self, name, path=None, target=None):
        if name.split(".")[0] not in {sum(EXTRAS.values(), ())!r}:
            return self.finder.find_spec(name, path, target)

sys.meta_path[:] = map(Without, sys.meta_path)
"""


def python(code, *arguments):
    """Run code in an installation without any extra."""
    command = [sys.executable, "-c", HIDE + code, *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, cwd=ROOT)


@pytest.fixture(scope="module")
def landmarks():
    """`(51, 2)`, y down, of the mean of the open head."""
    model = load_model("openhead", None, "ibug51")
    return model.mean[model.landmarks["ibug51"]][:, :2] * (1, -1)


@pytest.fixture(scope="module")
def weights(tmp_path_factory):
    """Of a lifter that has learnt next to nothing."""
    rng = np.random.default_rng(0)
    shapes = rng.normal(size=(51, 3)) + 0.1 * rng.normal(size=(40, 51, 3))
    path = tmp_path_factory.mktemp("weights") / "lifter.npz"
    LandmarkLifter(51, steps=1, batch_size=8).fit(shapes[..., :2], shapes).save(path)
    return path


def test_a_lifter_predicts_from_the_command_and_from_python(tmp_path, weights, landmarks):
    np.save(tmp_path / "face.npy", landmarks)
    code = "from deepmds_keras.__main__ import main; main(sys.argv[1:])"
    out = tmp_path / "out"
    done = python(code, "predict", tmp_path / "face.npy", "--model", weights, "--out", out)
    assert done.returncode == 0, done.stderr
    assert (out / "face.csv").exists()
    code = """
import numpy as np
import deepmds_keras
face, = deepmds_keras.predict_landmarks(np.load(sys.argv[1]), model=sys.argv[2])
print(face.shape.shape, face.std.shape)
"""
    done = python(code, tmp_path / "face.npy", weights)
    assert done.stdout == "(51, 3) (51, 3)\n", done.stderr


@pytest.mark.parametrize(
    ("code", "extra"),
    [
        ("from deepmds_keras import DeepMDS", "keras"),
        ("from deepmds_keras import LandmarkLifter", "keras"),
        ("from deepmds_keras import embed", "keras"),
        ("from deepmds_keras.video.frames import import_av; import_av()", "video"),
    ],
)
def test_what_lacks_a_package_says_which_extra_brings_it(code, extra):
    done = python(code)
    assert done.returncode
    assert f"pip install 'deepmds-keras[{extra}]'" in done.stderr.splitlines()[-1]


def test_the_extras_are_those_of_the_messages():
    setup = configparser.ConfigParser()
    setup.read(ROOT / "setup.cfg", encoding="utf-8")
    extras = setup["options.extras_require"]
    for path in (ROOT / "deepmds_keras").rglob("*.py"):
        text = path.read_text(encoding="utf-8")
        for extra in re.findall(r"""deepmds-keras\[(\w+)\]|needs\(.*, "(\w+)"\)""", text):
            assert "".join(extra) in extras, path
