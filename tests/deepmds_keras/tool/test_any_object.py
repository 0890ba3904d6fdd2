"""The tool on other objects than faces: a saved lifter of 14 landmarks, with names and without."""

import json
import re

import numpy as np
import pandas as pd
import pytest
from PIL import Image

from deepmds_keras import (
    FaceLifter,
    InputError,
    LandmarkLifter,
    load_scheme,
    predict_landmarks,
    read_landmarks,
    sample_views,
)
from deepmds_keras.geometry.units import centre_and_scale
from deepmds_keras.lifting.unrolled_fit import initial_weights
from deepmds_keras.tool.command.evaluation import evaluate
from deepmds_keras.tool.command.onnx_export import export

L = 14


def shapes_of(n_landmarks):
    rng = np.random.default_rng(0)
    mean, basis = rng.normal(0, 30, (n_landmarks, 3)), rng.normal(0, 4, (3, n_landmarks, 3))
    return mean + np.tensordot(rng.standard_normal((60, 3)), basis, 1)


def write_model(path, shapes):
    """Write a lifter that has learnt no more than the principal components."""
    lifter, known = LandmarkLifter(shapes.shape[1]), centre_and_scale(shapes)
    lifter.weights_ = initial_weights(np.swapaxes(known, 1, 2), 0)
    lifter.mean_shape_, lifter.default_sd_, lifter.history_ = known.mean(0), 0.0, {}
    lifter.save(path)
    return path


@pytest.fixture(scope="module")
def shapes():
    return shapes_of(L)


@pytest.fixture(scope="module")
def model(shapes, tmp_path_factory):
    return write_model(tmp_path_factory.mktemp("model") / "chair.npz", shapes)


@pytest.fixture
def points(shapes, tmp_path):
    """File of five views in pixels, y down."""
    views, _ = sample_views(shapes[:5], 1, field_of_view=0)
    np.save(tmp_path / "points.npy", views * (4, -4) + 300)
    return tmp_path / "points.npy"


@pytest.fixture
def scheme(tmp_path):
    rows = [f"{i},part_{i}" for i in range(L)]
    (tmp_path / "parts.csv").write_text("\n".join(["number,name", *rows]))
    (tmp_path / "parts_polylines.csv").write_text("polyline,landmarks\n1,0-1-2-3\n")
    return tmp_path / "parts.csv"


def test_the_command_lifts_them_as_python_does(model, points, scheme, tmp_path, command):
    out = tmp_path / "out"
    given = ("predict", points, "--model", model, "--out", out, "--view", "--jobs", 1)
    status, output, errors = command(*given, "--format", "csv,json,npz,ply,obj")
    assert status == 0, errors
    assert "points.npy: 5 shapes" in output
    assert "<title>5 shapes in 3D</title>" in (out / "points.html").read_text(encoding="utf-8")
    views = np.load(points) * (1, -1)
    expected = LandmarkLifter.load(model).predict(views)
    arrays = np.load(out / "points.npz")
    np.testing.assert_allclose(arrays["shape"], expected, atol=1e-5)
    table = pd.read_csv(out / "points.csv", comment="#")
    assert [*table.name[:L]] == [f"landmark_{i}" for i in range(1, L + 1)]
    seen = table[["image_x", "image_y"]].to_numpy().reshape(5, L, 2)
    np.testing.assert_allclose(seen, np.load(points), atol=1e-3)
    assert np.array_equal(read_landmarks(out / "points.csv", scheme="unnamed-14"), seen)
    with Image.open(out / "points.png") as picture:
        assert picture.size == (1800, 600)
    assert "landmark_14" in (out / "points.html").read_text(encoding="utf-8")
    assert command(*given, "--scheme", scheme, "--format", "json,obj", "--overwrite")[0] == 0
    content = json.loads((out / "points.json").read_bytes())
    assert content["landmark_names"] == [f"part_{i}" for i in range(L)]
    assert content["landmark_numbers"] == [*range(L)]
    assert "l 1 2 3 4" in (out / "points-1.obj").read_text()


def test_python_lifts_landmarks_and_refuses_photos(model, points, scheme):
    faces = predict_landmarks(np.load(points), model=model)
    named = predict_landmarks(np.load(points), model=model, scheme=scheme)
    for face, same in zip(faces, named, strict=True):
        assert np.array_equal(face.xyz, same.xyz) and not face.notes
        assert face.residuals.max() < 0.03 * np.ptp(face.landmarks, axis=0).max()
    lifter = FaceLifter(model=model)
    with pytest.raises(InputError, match="chair.npz needs its 14 landmarks. They are not a face"):
        lifter.predict(np.zeros((64, 64, 3), np.uint8))
    with pytest.raises(InputError, match=r"L = 14.* Received \(1, 51, 2\)"):
        lifter.predict_landmarks(np.zeros((51, 2)))
    with pytest.raises(InputError, match="must have 51, 68, 72, 468 or 478 .* Received 14"):
        predict_landmarks(np.load(points))
    with pytest.raises(InputError, match="parts.csv need their own model"):
        predict_landmarks(np.load(points), scheme=scheme)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--mesh"], "the scheme of a head must be one of .* Received 'unnamed-14'"),
        (["--interocular", "90"], "must have the outer corners of both eyes"),
        (["--scheme", "ibug51"], "points.npy must have 51 landmarks per face. Received 14"),
    ],
)
def test_what_only_faces_have_is_refused(model, points, tmp_path, command, arguments, message):
    given = ("predict", points, "--model", model, "--out", tmp_path / "out", "--jobs", 1)
    status, _, errors = command(*given, *arguments)
    assert status != 0 and re.search(message, errors), errors
    assert not [*tmp_path.glob("out/points*")]


def test_it_is_exported_with_the_names_of_its_landmarks(model, points, scheme, tmp_path, command):
    import onnx
    import onnxruntime

    export(tmp_path / "chair.onnx", str(model))
    views = np.float32(np.load(points) * (1, -1))
    inputs = {"view": views, "visible": np.ones((5, L), bool),
              "landmark_sd": np.full((5, L), np.nan, "f")}  # fmt: skip
    shape = onnxruntime.InferenceSession(tmp_path / "chair.onnx").run(None, inputs)[0]
    assert np.abs(shape - LandmarkLifter.load(model).predict(views)).max() < 1e-4
    assert command("export", tmp_path / "named.onnx", "--model", model, "--scheme", scheme)[0] == 0
    for file, first in (("chair", "landmark_1"), ("named", "part_0")):
        metadata = onnx.load(tmp_path / f"{file}.onnx").metadata_props
        names = next(json.loads(entry.value) for entry in metadata if entry.key == "landmark_names")
        assert names[0] == first
    with pytest.raises(InputError, match="ibug51 must have the 14 landmarks of .*chair.npz"):
        export(tmp_path / "other.onnx", str(model), "ibug51")


def test_it_is_evaluated_in_the_size_of_the_shapes(model, shapes, tmp_path, capsys):
    turned = shapes @ np.linalg.qr(np.random.default_rng(1).normal(size=(3, 3)))[0]
    np.save(tmp_path / "truth.npy", 9 * turned + 70)
    rows = evaluate(tmp_path / "truth.npy", model=str(model), out=tmp_path)
    error = {row["method"]: row["error"] for row in rows if row["yaw"] == "all"}
    known = centre_and_scale(shapes)
    off = ((known - known.mean(0)) ** 2).mean() / (known**2).mean()
    assert error["mean shape"] == pytest.approx(off, rel=0.3)
    assert error["lifting, exact"] < 0.02 * error["mean shape"]
    said = capsys.readouterr().out
    assert said.startswith(f"{len(shapes)} shapes; ")
    assert "mean squared coordinate of the truth" in said
    figure = np.asarray(Image.open(tmp_path / "errors.png").convert("L"))
    assert figure[[0, -1]].min() == figure[:, [0, -1]].min() == 255, "a label is cut off"
    np.save(tmp_path / "few.npy", shapes[:, :12])
    with pytest.raises(InputError, match="few.npy must hold 14 landmarks"):
        evaluate(tmp_path / "few.npy", model=str(model), out=tmp_path / "few")


def test_a_model_of_as_many_landmarks_as_a_face_with_irises_is_of_all_of_them(tmp_path, command):
    shapes = shapes_of(478)
    model = write_model(tmp_path / "all.npz", shapes)
    np.save(tmp_path / "points.npy", shapes[:5, :, :2] * (4, -4) + 300)
    np.save(tmp_path / "truth.npy", shapes)
    out = tmp_path / "out"
    given = ("predict", tmp_path / "points.npy", "--model", model, "--out", out, "--format", "npz")
    status, _, errors = command(*given)
    assert status == 0, errors
    assert np.load(out / "points.npz")["shape"].shape == (5, 478, 3)
    rows = evaluate(tmp_path / "truth.npy", model=str(model), out=out)
    assert {row["landmarks"] for row in rows} == {478}
    export(tmp_path / "all.onnx", str(model))


def test_a_scheme_says_that_as_many_landmarks_as_a_face_has_are_none(tmp_path, command):
    shapes = shapes_of(51)
    model = write_model(tmp_path / "stool.npz", shapes)
    rows = [f"{i},part_{i}" for i in range(51)]
    (tmp_path / "stool.csv").write_text("\n".join(["number,name", *rows]))
    np.save(tmp_path / "truth.npy", shapes)
    given = ("evaluate", tmp_path / "truth.npy", "--model", model, "--out", tmp_path / "out")
    status, output, errors = command(*given, "--scheme", tmp_path / "stool.csv")
    assert status == 0, errors
    # In the unit of other objects, and turned as little as they are.
    assert "of the mean squared coordinate" in output and "90 to 180" not in output
    (tmp_path / "short.csv").write_text("\n".join(["number,name", *rows[:9]]))
    with pytest.raises(InputError, match=r"short.csv must have the 51 .* Received 9\."):
        evaluate(tmp_path / "truth.npy", model=model, scheme=tmp_path / "short.csv", out=tmp_path)
    with pytest.raises(InputError, match="scheme must be that of a model"):
        evaluate(tmp_path / "truth.npy", scheme=tmp_path / "stool.csv", out=tmp_path)


def test_a_face_in_an_order_of_ones_own_is_evaluated_in_that_order(tmp_path):
    of, order = load_scheme("ibug51"), np.arange(51)[::-1]
    rows = [f"{i},{of.names[k]},{of.groups[k]}" for i, k in enumerate(order)]
    (tmp_path / "own.csv").write_text("\n".join(["number,name,group", *rows]))
    same = [f"{i},{of.numbers[k]}" for i, k in enumerate(order)]
    (tmp_path / "own_ibug68.csv").write_text("\n".join(["number,ibug68", *same]))
    mean = LandmarkLifter.pretrained("ibug51").mean_shape_[order]
    shapes = mean + np.random.default_rng(0).normal(0, 0.01, (60, 51, 3))
    model = write_model(tmp_path / "model.npz", shapes)
    np.save(tmp_path / "truth.npy", 100 * shapes)
    np.save(tmp_path / "seen.npy", 100 * shapes[..., :2] * (1, -1))
    given = {"truth": tmp_path / "truth.npy", "model": model, "scheme": tmp_path / "own.csv"}
    alone, seen = (
        {row["method"]: row["error"] for row in evaluate(**given, **more) if row["yaw"] == "all"}
        for more in (
            {"out": tmp_path / "alone"},
            {"out": tmp_path / "seen", "landmarks": tmp_path / "seen.npy"},
        )
    )
    assert seen["lifting"] == alone["lifting"] < alone["mean shape"] / 2
    np.save(tmp_path / "truth.npy", 100 * shapes * (-1, 1, 1))
    with pytest.raises(InputError, match="truth.npy, face 1 of 60: x must point right"):
        evaluate(**given, out=tmp_path / "mirrored")
