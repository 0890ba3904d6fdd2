"""`deepmds export`: the ONNX model gives what the lifter predicts, and says what it is."""

import json
import subprocess
import sys

import numpy as np
import onnx
import onnxruntime as runtime
import pytest
from places import ROOT
from scipy.spatial.transform import Rotation

from data_gen.models.registry import load_model
from deepmds_keras import InputError, LandmarkLifter
from deepmds_keras.files import read_table
from deepmds_keras.geometry.units import normalise
from deepmds_keras.landmarks import FOLDER, load_scheme
from deepmds_keras.lifting.unrolled_fit import initial_weights
from deepmds_keras.tool.command.onnx_export import export

L = 51


@pytest.fixture(scope="module")
def shapes():
    model = load_model("openhead", scheme="ibug51")
    model = model.at_landmarks("ibug51")
    rng = np.random.default_rng(0)
    return normalise(model.shape(rng.standard_normal((300, 199)), 0.3 * rng.random((300, 51))))


@pytest.fixture(scope="module")
def weights(shapes, tmp_path_factory):
    """File of a lifter, of which no part does nothing."""
    lifter, rng = LandmarkLifter(L), np.random.default_rng(1)
    arrays = initial_weights((shapes - shapes.mean(1, keepdims=True)).swapaxes(1, 2), 0)
    lifter.weights_ = {
        name: array if array.any() else np.float32(0.1 * rng.standard_normal(array.shape))
        for name, array in arrays.items()
    }
    lifter.mean_shape_, lifter.default_sd_, lifter.history_ = shapes.mean(0), 0.01, []
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
    options = {}
    if incomplete:
        visible, sd = rng.random((n, L)) > 0.5, rng.uniform(0, 6, (n, L)).astype(np.float32)
        views[:, 3], views[0, 4] = np.nan, 1e6 * ~visible[0, 4]
        sd[:, 3] = np.inf
        options = {"visible": visible, "landmark_sd": sd}
    shapes, std, pose = LandmarkLifter.load(weights).estimate(views, **options)
    session = runtime.InferenceSession(model)
    outputs = session.run(None, {"view": views, "visible": visible, "landmark_sd": sd})
    camera = pose.rotation, pose.scale / 400, pose.translation / 400, pose.perspective
    outputs[3:5] = outputs[3] / 400, outputs[4] / 400
    for output, wanted, least in zip(
        outputs, (shapes, std, *camera), (*[1e-5] * 2, *[2e-3] * 4), strict=True
    ):
        assert output.shape == wanted.shape
        assert np.abs(output - wanted).max() < least


def test_the_model_says_what_it_takes_and_gives(model):
    read = onnx.load(model)
    metadata = {entry.key: entry.value for entry in read.metadata_props}
    scheme = load_scheme("ibug51")
    assert metadata["scheme"] == "ibug51"
    assert json.loads(metadata["landmark_names"]) == [*scheme.names]
    assert json.loads(metadata["landmark_numbers"]) == [*scheme.numbers]
    assert "normalised" in metadata["unit"]
    assert "+y up" in metadata["axes"]
    assert metadata["weights"] == "lifter: given by the user"
    assert {"licence", "view_axes", "camera_axes", "camera_unit"} <= metadata.keys()
    assert [entry.name for entry in read.graph.input] == ["view", "visible", "landmark_sd"]
    outputs = ["shape", "shape_sd", "rotation", "scale", "translation", "perspective"]
    assert [entry.name for entry in read.graph.output] == outputs
    assert model.stat().st_size < 250_000


def test_each_node_has_a_name_of_its_own_as_some_runtimes_need(model):
    names = [node.name for node in onnx.load(model).graph.node]
    assert "" not in names
    assert len({*names}) == len(names)


def test_the_command_writes_a_model_and_never_over_a_file(weights, tmp_path, command, monkeypatch):
    path = tmp_path / "own.onnx"
    status, output, _ = command("export", path, "--model", weights)
    assert status == 0 and str(path) in output
    content = path.read_bytes()
    assert "exists" in command("export", path, "--model", weights)[2]
    assert path.read_bytes() == content
    monkeypatch.setitem(sys.modules, "onnx", None)
    with pytest.raises(InputError, match=r"\[onnx\]"):
        export(tmp_path / "other.onnx", str(weights))


def test_weights_of_another_model_are_refused(tmp_path, command):
    for model in ("deepmds", "deepmds-ibug51", "unknown"):
        said = command("export", tmp_path / "model.onnx", "--model", model)[2]
        assert "lifting-ibug51" in said and "LandmarkLifter" in said and "or deepmds" not in said
    assert not [*tmp_path.iterdir()]


@pytest.mark.slow
def test_the_javascript_of_the_docs_lifts_points_of_mediapipe(tmp_path):
    page = (ROOT / "docs/onnx.md").read_text(encoding="utf-8")
    code = page.split("```js\n")[1].split("```")[0]
    rng, points = np.random.default_rng(0), np.zeros((478, 2))
    views = LandmarkLifter.pretrained("ibug51").weights_["mean"].T[:, :2] * (1, -1)
    numbers = [int(row["number"]) for row in read_table(FOLDER / "mediapipe_ibug68.csv")]
    points[numbers] = views / 4 + 0.5 + rng.normal(0, 0.002, (51, 2))
    export(tmp_path / "lifter.onnx", "lifting-ibug51")
    (tmp_path / "points.json").write_text(
        json.dumps([{"x": x, "y": y} for x, y in points.tolist()])
    )
    (tmp_path / "run.mjs").write_text(
        'import * as ort from "onnxruntime-web";\nimport { readFileSync } from "node:fs";\n'
        + code
        + 'const session = await ort.InferenceSession.create(readFileSync("lifter.onnx"));\n'
        'const points = JSON.parse(readFileSync("points.json"));\n'
        "const face = await lift(ort, session, points, 640, 480);\n"
        "console.log(JSON.stringify({ ...face, xyz: [...face.xyz], sd: [...face.sd] }));\n"
    )
    subprocess.run(["npm", "install", "--silent", "onnxruntime-web"], cwd=tmp_path, check=True)
    ended = subprocess.run(
        ["node", "run.mjs"], cwd=tmp_path, check=True, capture_output=True, text=True
    )
    face = json.loads(ended.stdout)
    given = points[numbers] * (640, -480)
    wanted = LandmarkLifter.pretrained("ibug51").estimate(given[None])
    assert np.abs(np.reshape(face["xyz"], (51, 3)) - wanted.shapes[0]).max() < 1e-4
    assert np.abs(np.reshape(face["sd"], (51, 3)) - wanted.std[0]).max() < 1e-4
    for angle in ("yaw", "pitch", "roll"):
        assert abs(face[angle] - getattr(wanted.pose[0], angle)) < 0.1
