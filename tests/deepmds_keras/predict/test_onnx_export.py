"""`deepmds export`: the ONNX model gives what the lifter predicts, and says what it is."""

import json
import sys

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from data_gen.models.registry import load_model
from deepmds_keras import InputError, LandmarkLifter
from deepmds_keras.__main__ import main
from deepmds_keras.landmarks import load_scheme
from deepmds_keras.lifting.network import SIZES, initial_weights
from deepmds_keras.normalisation import normalise
from deepmds_keras.predict.onnx_export import export

onnx = pytest.importorskip("onnx", reason="onnx is an extra")
runtime = pytest.importorskip("onnxruntime", reason="onnxruntime has no wheel for Python 3.10")
L = 51


@pytest.fixture(scope="module")
def shapes():
    model = load_model("openhead", scheme="ibug51")
    model = model.restrict(model.landmarks["ibug51"])
    rng = np.random.default_rng(0)
    return normalise(model.shape(rng.standard_normal((300, 199)), 0.3 * rng.random((300, 51))))


@pytest.fixture(scope="module")
def weights(shapes, tmp_path_factory):
    """File of a lifter, of which no part does nothing."""
    lifter, rng = LandmarkLifter(L), np.random.default_rng(1)
    arrays = initial_weights((shapes - shapes.mean(1, keepdims=True)).swapaxes(1, 2),
                             SIZES["small"], 0)  # fmt: skip
    lifter.weights_ = {
        name: array if array.any() else np.float32(0.1 * rng.standard_normal(array.shape))
        for name, array in arrays.items()
    }
    lifter.training_sd_, lifter.history_ = 0.01, []
    path = tmp_path_factory.mktemp("weights") / "lifter.npz"
    lifter.save(path)
    return path


@pytest.fixture(scope="module")
def model(weights):
    path = weights.with_name("lifter.onnx")
    export(path, str(weights))
    return path


@pytest.mark.parametrize("incomplete", [False, True])
@pytest.mark.parametrize("n", [1, 7])
def test_onnxruntime_gives_what_predict_gives(shapes, weights, model, n, incomplete):
    rng = np.random.default_rng(n)
    turns = Rotation.from_euler("yxz", rng.uniform(-50, 50, (n, 3)), degrees=True)
    views = (shapes[:n] @ turns.as_matrix())[..., :2] * 400 + (3000, -2000)
    views = np.float32(views + rng.normal(0, 1, views.shape))
    visible, sd = np.ones((n, L), bool), np.full((n, L), np.nan, np.float32)
    told = {}
    if incomplete:
        visible, sd = rng.random((n, L)) > 0.5, rng.uniform(0, 6, (n, L)).astype(np.float32)
        views[:, 3], views[0, 4] = np.nan, 1e6 * ~visible[0, 4]
        told = {"visible": visible, "landmark_sd": sd}
    wanted = LandmarkLifter.load(weights).predict(views, return_std=True, **told)
    session = runtime.InferenceSession(model)
    found = session.run(None, {"view": views, "visible": visible, "landmark_sd": sd})
    for one, other in zip(found, wanted, strict=True):
        assert one.shape == (n, L, 3)
        assert np.abs(one - other).max() < 1e-5


def test_the_model_says_what_it_takes_and_gives(model):
    read = onnx.load(model)
    told = {entry.key: entry.value for entry in read.metadata_props}
    scheme = load_scheme("ibug51")
    assert told["scheme"] == "ibug51"
    assert json.loads(told["landmark_names"]) == [*scheme.names]
    assert json.loads(told["landmark_numbers"]) == [*scheme.numbers]
    assert "normalised" in told["unit"]
    assert "+y up" in told["axes"]
    assert told["weights"] == "lifter: given by the user"
    assert [entry.name for entry in read.graph.input] == ["view", "visible", "landmark_sd"]
    assert [entry.name for entry in read.graph.output] == ["shape", "shape_sd"]
    assert model.stat().st_size < 250_000


def test_the_command_writes_a_model_and_never_over_a_file(weights, tmp_path, capsys, monkeypatch):
    path = tmp_path / "own.onnx"
    main(["export", str(path), "--model", str(weights)])
    assert str(path) in capsys.readouterr().out
    content = path.read_bytes()
    with pytest.raises(SystemExit) as ended:
        main(["export", str(path), "--model", str(weights)])
    assert ended.value.code == 1
    assert "exists" in capsys.readouterr().err
    assert path.read_bytes() == content
    monkeypatch.setitem(sys.modules, "onnx", None)
    with pytest.raises(InputError, match=r"deepmds-keras\[onnx\]"):
        export(tmp_path / "other.onnx", str(weights))


def test_weights_of_another_model_are_refused(tmp_path):
    with pytest.raises(InputError, match="LandmarkLifter"):
        export(tmp_path / "model.onnx", "deepmds-ibug51")
    with pytest.raises(InputError, match="deepmds-ibug51"):
        export(tmp_path / "model.onnx", "unknown")
    assert not [*tmp_path.iterdir()]
