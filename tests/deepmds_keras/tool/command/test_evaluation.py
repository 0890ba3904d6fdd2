"""`deepmds evaluate`: any file of true landmarks is scored, whichever way its axes point."""

import csv
import sys

import numpy as np
import pytest
from places import SHARED

from data_gen.views import sample_expressive
from deepmds_keras import InputError, convert, predict_landmarks
from deepmds_keras.geometry.alignment import align
from deepmds_keras.geometry.units import centre
from deepmds_keras.geometry.views import in_camera_frame, sample_perspective_cameras
from deepmds_keras.tool.command.evaluation import evaluate, read_truth

CAMERAS = sample_perspective_cameras(
    60, np.random.default_rng(0), yaw=80, pitch=20, roll=20, field_of_view=(0, 1)
)


@pytest.fixture(scope="module")
def truth(head):
    """`(60, 68, 3)` landmarks of turned faces, x right, y up, z towards the viewer."""
    rng, model = np.random.default_rng(1), head.at_landmarks("ibug68")
    return in_camera_frame(model.shape(*sample_expressive(model, 60, rng)), CAMERAS)


def errors(rows, landmarks=51, yaw="all"):
    return {r["method"]: r["error"] for r in rows if (r["landmarks"], r["yaw"]) == (landmarks, yaw)}


def test_lifting_is_far_below_the_mean_shape_and_exact_landmarks_are_best_as_such(truth, tmp_path):
    np.save(tmp_path / "truth.npy", truth)
    rows = evaluate(tmp_path / "truth.npy", out=tmp_path)
    for landmarks in (51, 68):
        mse = errors(rows, landmarks)
        assert mse["lifting, exact"] < mse["lifting"] < 0.25 * mse["mean shape"]
    with open(tmp_path / "errors.csv", newline="") as file:
        assert [float(row["error"]) for row in csv.DictReader(file)] == [r["error"] for r in rows]
    assert (tmp_path / "errors.png").read_bytes().startswith(b"\x89PNG")
    by_yaw = {
        r["yaw"]: r["n_faces"] for r in rows if (r["landmarks"], r["method"]) == (51, "lifting")
    }
    assert by_yaw.pop("all") == sum(by_yaw.values()) == 60
    for turns, n in by_yaw.items():
        low, high = map(int, turns.split(" to "))
        there = (np.abs(CAMERAS.yaw) >= low) & (np.abs(CAMERAS.yaw) < high)
        assert n == pytest.approx(there.sum(), abs=4)
    with pytest.raises(InputError, match="errors.csv already exists.* --overwrite"):
        evaluate(tmp_path / "truth.npy", out=tmp_path)


@pytest.mark.parametrize("axes", [(1, -1, 1), (1, 1, -1), (1, -1, -1)])
def test_which_way_axes_point_does_not_matter(truth, axes, tmp_path):
    np.save(tmp_path / "truth.npy", truth[:, 17:])
    np.save(tmp_path / "other.npy", np.tile(7e200 * (truth[:, 17:] * axes - 9), (4, 1, 1)))
    first, second = (evaluate(tmp_path / f"{n}.npy", out=tmp_path / n) for n in ("truth", "other"))
    for one, other in zip(first, second, strict=True):
        assert one["error"] == pytest.approx(other["error"], rel=1e-3)
        n = one["n_faces"]
        ratio = np.sqrt((4 * n - 1) / (n - 1))  # of the same faces, and of four copies of them
        assert one["standard_error"] == pytest.approx(ratio * other["standard_error"], rel=1e-3)


def test_coordinates_may_come_first_as_in_aflw2000_of_3ddfa(truth, tmp_path):
    np.save(tmp_path / "first.npy", truth.swapaxes(1, 2))
    np.testing.assert_array_equal(read_truth(tmp_path / "first.npy"), truth)


def test_a_table_and_landmarks_of_a_detector_are_taken(truth, tmp_path, command):
    lines = ["Face, X, Y, Z"]
    lines += [f"{i},{x},{y},{z}" for i, face in enumerate(truth[:9, 17:]) for x, y, z in face]
    (tmp_path / "truth.csv").write_text("\n".join(lines))
    np.testing.assert_array_equal(read_truth(tmp_path / "truth.csv"), truth[:9, 17:])
    noise = np.random.default_rng(0).normal(0, 3, (9, 51, 2))
    np.save(tmp_path / "seen.npy", (truth[:9, 17:, :2] + noise) * (1, -1))
    given = ("evaluate", tmp_path / "truth.csv", "--out", tmp_path / "out")
    status, output, _ = command(*given, "--landmarks", tmp_path / "seen.npy")
    assert status == 0
    assert "9 faces" in output and "51, lifting " in output and "exact" not in output
    np.save(tmp_path / "seen.npy", np.where(np.arange(9)[:, None, None] == 4, np.nan, noise))
    with pytest.raises(InputError, match="seen.npy must have .* Received none for face 5"):
        evaluate(tmp_path / "truth.csv", landmarks=tmp_path / "seen.npy", out=tmp_path / "gap")


def test_landmarks_are_converted_and_must_not_be_upside_down(truth, tmp_path):
    np.save(tmp_path / "truth.npy", truth[:9, 17:])
    for name, seen in {"51": truth[:9, 17:], "68": truth[:9]}.items():
        np.save(tmp_path / f"{name}.npy", seen[..., :2] * (1, -1))
    rows = [
        evaluate(tmp_path / "truth.npy", landmarks=tmp_path / f"{name}.npy", out=tmp_path / name)
        for name in ("51", "68")
    ]
    assert rows[0] == rows[1]
    np.save(tmp_path / "up.npy", truth[:9, :, :2])
    with pytest.raises(InputError, match="up.npy.*--y-up"):
        evaluate(tmp_path / "truth.npy", landmarks=tmp_path / "up.npy", out=tmp_path / "up")
    jaw = np.where(np.arange(68)[:, None] < 20, truth[:9, :, :2] * (1, -1), np.nan)
    np.save(tmp_path / "jaw.npy", np.r_[truth[:8, :, :2] * (1, -1), jaw[8:]])
    with pytest.raises(InputError, match="jaw.npy, face 9 of 9, must have at least 6 .* 3"):
        evaluate(tmp_path / "truth.npy", landmarks=tmp_path / "jaw.npy", out=tmp_path / "jaw")
    with pytest.raises(InputError, match="51.npy.*y must point up for --y-up; omit it"):
        seen = tmp_path / "51.npy"
        evaluate(tmp_path / "truth.npy", landmarks=seen, y_up=True, out=tmp_path / "up")
    np.save(tmp_path / "whole.npy", truth[:9])
    with pytest.raises(InputError, match="51.npy must have .*whole.npy, ibug68.* ibug51.* jaw"):
        evaluate(tmp_path / "whole.npy", landmarks=tmp_path / "51.npy", out=tmp_path / "up")
    with pytest.raises(InputError, match="landmarks must be given with y_up"):
        evaluate(tmp_path / "truth.npy", y_up=True, out=tmp_path / "up")


def test_landmarks_of_mediapipe_are_lifted_with_its_own_errors(truth, tmp_path):
    np.save(tmp_path / "truth.npy", truth[:9, 17:])
    seen = convert(truth[:9, :, :2] * (1, -1), "ibug68", "mediapipe", missing="nan")
    np.save(tmp_path / "seen.npy", seen)
    rows = evaluate(tmp_path / "truth.npy", landmarks=tmp_path / "seen.npy", out=tmp_path)
    lifted = [face.xyz for face in predict_landmarks(seen)]
    shape = centre(truth[:9, 17:])
    eyes = ((shape[:, 19] - shape[:, 28]) ** 2).sum(1)
    expected = ((align(np.array(lifted), shape) - shape) ** 2).mean((1, 2)) / eyes
    assert errors(rows)["lifting"] == pytest.approx(expected.mean(), rel=1e-3)


def test_shipped_weights_may_be_named_and_no_figure_of_other_errors_stays(
    truth, tmp_path, monkeypatch
):
    np.save(tmp_path / "truth.npy", truth[:9])
    every = evaluate(tmp_path / "truth.npy", out=tmp_path)
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    for name in ("lifting", "lifting-ibug68"):
        rows = evaluate(tmp_path / "truth.npy", model=name, out=tmp_path, overwrite=True)
        assert errors(rows, 68) == errors(every, 68)
    assert not (tmp_path / "errors.png").exists()
    with pytest.raises(InputError, match="model must be lifting-.* are not lifters"):
        evaluate(tmp_path / "truth.npy", model="deepmds", out=tmp_path / "other")


@pytest.mark.skipif(not (SHARED / "sfm").is_dir(), reason="../shared/sfm is absent")
def test_eos_is_scored_on_the_landmarks_that_all_have(truth, tmp_path):
    pytest.importorskip("eos", reason="eos-py has no wheel here")
    np.save(tmp_path / "truth.npy", truth)
    mse = errors(evaluate(tmp_path / "truth.npy", eos=SHARED / "sfm", out=tmp_path), 49)
    assert mse["lifting"] < mse["eos"] < mse["mean shape"]


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (np.zeros((3, 50, 3)), "must hold 51 or 68 landmarks .x, y, z. per face.*\\(3, 50, 3\\)"),
        (np.zeros((3, 51, 2)), "\\(3, 51, 2\\)"),
        (np.full((3, 51, 3), np.nan), "finite"),
        (np.full((3, 51, 3), "a"), "numbers"),
        (
            np.arange(3 * 51 * 3).reshape(3, 51, 3) ** 3.0 * [[[1]], [[0]], [[1]]],
            "face 2 of 3, .* all 51 landmarks coincide",
        ),
        ("x,y,z\n" + "1,2,\n" * 51, "finite"),
        (b"no array", "one array in NumPy's format"),
        ("x,y\n1,2\n", "columns x, y, z"),
        ("face,x,y,z\n1,1,2,3\n1,1,2,3\n2,1,2,3\n", "same number of landmarks in each"),
    ],
)
def test_unusable_truths_are_named(content, message, tmp_path):
    path = tmp_path / ("truth.csv" if isinstance(content, str) else "truth.npy")
    if isinstance(content, str):
        path.write_text(content)
    elif isinstance(content, bytes):
        path.write_bytes(content)
    else:
        np.save(path, content)
    with pytest.raises(InputError, match=f"truth.*{message}"):
        evaluate(path, out=tmp_path / "out")
    assert not (tmp_path / "out").exists()
