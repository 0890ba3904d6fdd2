"""The printed digits do not depend on the solver; `test_faults` is of threads and repetition."""

import shutil

import numpy as np
import pytest
import runs

from deepmds_keras.files import read_arrays, write_arrays
from experiments.inputs import load_faces
from experiments.methods import DEEP_MDS, load, methods_of
from experiments.presets import TINY
from experiments.run import Run

pytestmark = pytest.mark.slow


@pytest.fixture
def batched(whole_bfm, tmp_path):
    """The BFM experiment with the predictions of the batched solver in place of scikit-learn's."""
    shutil.copytree(whole_bfm / "build", tmp_path / "build")
    run = Run("openhead", TINY, build=tmp_path / "build", jobs=1)
    test = load_faces(run, "test")
    for method in DEEP_MDS:
        path = run.prediction_file(method)
        arrays, described = read_arrays(path)
        model = load(run, method).set_params(solver="numba")
        predicted = np.float32(model.predict(test.views))
        assert np.abs(predicted - arrays["shapes"]).max() < 1e-3
        write_arrays(path, arrays | {"shapes": predicted}, described)
    return tmp_path


def test_both_solvers_print_the_same_table(whole_bfm, batched):
    methods = [method.id for method in methods_of("bfm")]
    runs.succeed("tracks.bfm", batched, *methods)
    for name in ("bfm/table.tex", "parameters/table.tex"):
        first, second = (
            (runs.results(folder, "").joinpath(name)).read_text(encoding="utf-8")
            for folder in (whole_bfm, batched)
        )
        assert first == second, name
