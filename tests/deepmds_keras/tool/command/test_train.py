"""`deepmds train`: what it holds out, reports and writes, a stopped run, and what it refuses."""

import numpy as np
import pytest
from places import ROOT, SHARED
from scipy.spatial.transform import Rotation

from deepmds_keras import InputError, LandmarkLifter
from deepmds_keras.lifting import trainer
from deepmds_keras.tool.command import train as module
from deepmds_keras.tool.command.train import train
from experiments.objects.shapes import read_shapes

L, N = 9, 70
TURN = Rotation.from_euler("xyz", (20, 50, -70), degrees=True).as_matrix()
OPTIONS = {"steps": 3, "noise": 0.05, "missing": 0.2, "seed": 0}


@pytest.fixture
def source(tmp_path, monkeypatch):
    monkeypatch.setattr(module, "_VIEWS", 300)
    rng = np.random.default_rng(0)
    mean, basis = rng.normal(0, 30, (L, 3)), rng.normal(0, 6, (2, L, 3))
    shapes = mean + np.tensordot(rng.standard_normal((N, 2)), basis, 1) + 500
    np.save(tmp_path / "shapes.npy", np.concatenate([shapes, shapes[:20]]))
    return tmp_path / "shapes.npy"


@pytest.fixture
def untrained(monkeypatch):
    """Training is left out; the principal components remain. What it was given is kept."""
    given = []

    def train_lifting_net(initial, block, held_out, *, checkpoint, **_):
        given.extend([block(0, 400), held_out])
        checkpoint.touch()
        return initial, {"train": [], "inference": []}

    monkeypatch.setattr(trainer, "train_lifting_net", train_lifting_net)
    return given


def test_the_command_writes_a_lifter_and_reports_beside_mean_and_ridge(
    source, untrained, tmp_path, command
):
    given = ("train", source, tmp_path / "new.npz", "--pitch", 30, "--noise", 0.1)
    status, output, errors = command(*given)
    assert status == 0, errors
    assert sorted(path.name for path in tmp_path.iterdir()) == ["new.npz", "shapes.npy"]
    lifter = LandmarkLifter.load(tmp_path / "new.npz")
    assert (lifter.n_landmarks, lifter.noise, lifter.missing, lifter.steps) == (L, 0.1, 0.2, 4000)
    head, levels, *rows = output.splitlines()
    assert "9 landmarks, trained on 63 shapes. Error on 7 others" in head
    assert levels.split()[-2:] == ["0", "0.05"]
    assert [row[:18].strip() for row in rows] == ["mean shape", "ridge regression", "lifter"]
    assert "step" in errors and "note" not in errors


def test_shapes_of_the_report_are_not_those_of_the_training(source, untrained, tmp_path):
    errors = train(source, tmp_path / "new.npz", **OPTIONS, field_of_view=0.0)
    block, held_out = untrained
    seen = {shape.tobytes() for faces in (block, held_out) for shape in faces.shapes}
    assert len(seen) == 63 and len({shape.tobytes() for shape in held_out.shapes}) == 6
    # Two components span the shapes, so that exact views give them away.
    assert errors["lifter"][0] < 0.02 * errors["mean shape"][0]
    assert errors["lifter"][0] < errors["lifter"][1] < errors["mean shape"][1]
    assert errors["mean shape"][0] == pytest.approx(errors["mean shape"][1])


def test_which_way_shapes_faced_is_nothing_to_learn_from_views_of_all_sides(
    source, untrained, tmp_path
):
    shapes = np.unique(np.load(source), axis=0)
    headings = np.random.default_rng(1).uniform(0, 360, (len(shapes), 1))
    turns = Rotation.from_euler("y", headings, degrees=True).as_matrix()
    np.save(tmp_path / "turning.npy", shapes @ turns)
    errors = {
        (name, yaw): train(file, tmp_path / f"{name}-{yaw}.npz", yaw=yaw, **OPTIONS)
        for name, yaw in (("shapes", 180), ("turning", 180), ("turning", 60))
        for file in [tmp_path / f"{name}.npy"]
    }
    error = {key: rows["mean shape"][0] for key, rows in errors.items()}
    assert error["turning", 180] == pytest.approx(error["shapes", 180], rel=0.3)
    assert error["turning", 60] > 5 * error["turning", 180]


def test_the_error_is_of_all_landmarks_in_squared_radii(source, untrained, tmp_path, monkeypatch):
    monkeypatch.setattr(module, "align", lambda shapes, truth, **_: truth + (0.03, 0, 0.04))
    errors = train(source, tmp_path / "new.npz", **OPTIONS)
    assert all(error == pytest.approx(0.0025) for row in errors.values() for error in row)


def test_a_command_that_is_stopped_goes_on_from_its_checkpoint_with_the_same_faces(
    source, untrained, tmp_path, monkeypatch
):
    """A checkpoint of other faces would be refused."""

    def stop(*_):
        raise KeyboardInterrupt

    checkpoint = tmp_path / "new.npz.checkpoint"
    with monkeypatch.context() as patched, pytest.raises(KeyboardInterrupt):
        patched.setattr(module, "_errors", stop)
        train(source, tmp_path / "new.npz", **OPTIONS)
    assert not (tmp_path / "new.npz").exists() and checkpoint.exists()
    assert {*train(source, tmp_path / "new.npz", **OPTIONS)} >= {"lifter", "mean shape"}
    assert not checkpoint.exists()
    for first, again in zip(untrained[:2], untrained[2:], strict=True):
        np.testing.assert_array_equal(first.views, again.views)
        np.testing.assert_array_equal(first.shapes, again.shapes)


def test_a_mirror_image_is_another_shape_and_a_turned_copy_none(source, tmp_path):
    shapes = np.unique(np.load(source), axis=0)
    np.save(tmp_path / "pairs.npy", np.concatenate([shapes, shapes * (-1, 1, 1), shapes @ TURN]))
    assert len(module._read_shapes(tmp_path / "pairs.npy")) == 2 * N


@pytest.mark.slow
@pytest.mark.skipif(not (SHARED / "objects").is_dir(), reason="../shared/objects is absent")
def test_the_page_on_objects_has_what_the_command_prints(tmp_path, command):
    np.save(tmp_path / "chairs.npy", read_shapes(SHARED / "objects" / "chairs.npz"))
    _, output, _ = command("train", tmp_path / "chairs.npy", tmp_path / "chair.npz")
    head, *rows = output.splitlines()
    page = (ROOT / "docs" / "objects.md").read_text(encoding="utf-8")
    first, *shown = page[page.index("chair.npz: ") :].splitlines()[: len(rows) + 1]
    assert head.endswith(first)
    for row, wanted in zip(rows, shown, strict=True):
        assert row[:18] == wanted[:18]
        numbers, expected = ([float(cell) for cell in x[18:].split()] for x in (row, wanted))
        assert numbers == pytest.approx(expected, rel=0.1)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda s: s[..., :2], r"must hold shapes \(n, L, 3\).* Received \(90, 9, 2\)"),
        (lambda s: s[:, :5], r"with 6 landmarks or more. Received \(90, 5, 3\)"),
        (lambda s: s[:0], r"must hold shapes .* Received \(0, 9, 3\)"),
        (lambda s: s[:9], "must hold 10 different shapes or more.* Received 9"),
        (lambda s: np.repeat(s[:1], 30, 0), "10 different shapes or more.* Received 1"),
        (lambda s: np.concatenate([s[:5], 7 * np.float32(s[:5] @ TURN) + 90]), "Received 5"),
        (lambda s: np.where(s == s[4, 2, 1], np.nan, s), "shape 5 of 90, must be finite.* mend: 2"),
        (lambda s: s.astype(str), "must hold numbers"),
    ],
)
def test_unusable_shapes_are_named(source, tmp_path, change, message):
    np.save(source, change(np.load(source)))
    with pytest.raises(InputError, match=f"shapes.npy.* {message}"):
        train(source, tmp_path / "new.npz", **OPTIONS)
    assert not (tmp_path / "new.npz").exists()


def test_files_that_exist_or_are_no_npz_are_refused(source, tmp_path):
    (tmp_path / "old.npz").touch()
    with pytest.raises(InputError, match="old.npz must be a new file.* exists"):
        train(source, tmp_path / "old.npz", **OPTIONS)
    with pytest.raises(InputError, match="new.onnx must be .*npz. Received the suffix '.onnx'"):
        train(source, tmp_path / "new.onnx", **OPTIONS)
