"""The package without its extras: lifters predict, and what does not says what to install."""

import ast
import configparser
import re

import numpy as np
from faces import mean_landmarks
from places import ROOT, python

import deepmds_keras

# Modules of the packages that each extra brings, none of which the small installation has.
EXTRAS = {
    "keras": ("tensorflow", "keras", "h5py", "sklearn"),
    "experiments": ("pandas", "vtkmodules", "jinja2", "filelock"),
    "fast": ("numba",),
    "onnx": ("onnx",),
    "video": ("av",),
    "mesh": ("trimesh",),
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


def run(code, *arguments):
    """In an installation without any extra."""
    return python("-c", HIDE + code, *arguments)


def test_a_lifter_predicts_from_the_command_and_from_python(tmp_path):
    np.save(tmp_path / "face.npy", mean_landmarks("ibug51")[:, :2] * (1, -1))
    code = "from deepmds_keras.__main__ import main; main(sys.argv[1:])"
    done = run(code, "predict", tmp_path / "face.npy", "--out", tmp_path / "out")
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "out" / "face.csv").exists()
    code = """
import numpy as np
import deepmds_keras
face, = deepmds_keras.predict_landmarks(np.load(sys.argv[1]))
print(face.xyz.shape, face.std.shape)
"""
    done = run(code, tmp_path / "face.npy")
    assert done.stdout == "(51, 3) (51, 3)\n", done.stderr


def test_every_name_of_the_package_loads_or_says_that_it_needs_keras():
    code = """
import deepmds_keras
for name in deepmds_keras.__all__:
    try:
        getattr(deepmds_keras, name)
    except deepmds_keras.MissingPackageError as error:
        assert "from the repository, pip install '.[keras]'" in str(error)
        print(name)
"""
    done = run(code)
    assert not done.returncode, done.stderr
    assert {*done.stdout.split()} == {
        *("DeepMDS", "build_autoencoder", "build_dissimilarity_net", "embed")
    }


def test_editors_see_the_names_that_are_loaded_later():
    source = (ROOT / "deepmds_keras" / "__init__.py").read_text(encoding="utf-8")
    imports = [node for node in ast.walk(ast.parse(source)) if isinstance(node, ast.ImportFrom)]
    assert {*deepmds_keras.__all__} <= {alias.name for node in imports for alias in node.names}


def test_the_extras_are_those_of_the_messages():
    setup = configparser.ConfigParser()
    setup.read(ROOT / "setup.cfg", encoding="utf-8")
    texts = (p.read_text(encoding="utf-8") for p in (ROOT / "deepmds_keras").rglob("*.py"))
    named = re.compile(r"""pip install '\.\[(\w+)\]|needs\(.*, "(\w+)"\)""")
    extras = {"".join(extra) for text in texts for extra in named.findall(text)}
    assert {"keras", "fast", "dlib"} <= extras <= {*setup["options.extras_require"]}
