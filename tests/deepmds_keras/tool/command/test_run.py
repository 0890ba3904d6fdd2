"""`deepmds predict` as people run it: photos and landmarks in, files out, a line for what fails."""

import json
import os
import signal
import subprocess
import sys
import time

import numpy as np
import pandas as pd
import pytest
from PIL import Image
from places import ROOT

from data_gen.views import sample_photo_views
from deepmds_keras.files import read_npz
from deepmds_keras.landmarks import convert, load_scheme
from deepmds_keras.tool.command import process, run
from deepmds_keras.tool.detection import (
    DETECTORS,
    Detector,
    default_detector,
    dlib_landmarks,
    mediapipe_landmarks,
)
from deepmds_keras.tool.predict import photo_faces
from deepmds_keras.tool.predict.landmark_files import read_landmarks
from deepmds_keras.weights import pretrained_path

ALL = "csv,json,npz,ply,obj"


@pytest.fixture(scope="module")
def landmarks(heads):
    """`(51, 2)` of one face, frontal but for its errors."""
    return heads[1][2] + np.random.default_rng(0).normal(0, 0.5, (51, 2))


@pytest.fixture
def predict(command, tmp_path):
    """Runs `deepmds predict`: `predict(*arguments)` → status, stdout, lines of errors and notes.

    Results lie in `tmp_path / "out"`, unless the arguments say otherwise.
    """

    def predict(*arguments):
        out = [] if "--out" in arguments else ["--out", tmp_path / "out"]
        status, output, errors = command("predict", *arguments, *out, "--jobs", 1)
        listed = ("error: ", "note: no effect")
        return status, output, [line for line in errors.splitlines() if line.startswith(listed)]

    return predict


@pytest.fixture
def faces24(monkeypatch, landmarks):
    """A detector that finds 24 faces in every photo, and counts how often it is opened."""
    opened = []

    def open_model(landmarker):
        opened.append(landmarker)
        points = convert(landmarks, "ibug51", "ibug68", missing="nan")
        points[:17] = points[17:34] + (0, 60)
        faces = points / 4 + 20 * np.arange(24)[:, None, None]
        return lambda photo: (faces, np.ones(24))

    monkeypatch.setitem(DETECTORS, "dlib", Detector("ibug68", open_model, lambda: True, "none"))
    photo_faces._opened.cache_clear()
    return opened


def written(folder):
    """Names of the files in a folder, but for the lock and the records."""
    own = (".deepmds-lock", ".deepmds-results")
    return sorted(path.name for path in folder.iterdir() if path.name not in own)


def save(path, landmarks):
    np.save(path, landmarks)
    return path


def command_line(*arguments):
    return [sys.executable, "-m", "deepmds_keras", *map(str, arguments)]


def test_photos_give_a_table_and_a_picture_each_and_no_noise(tmp_path, heads):
    """As a user has it: another process, another folder, several processes."""
    Image.fromarray(heads[0][1]).save(tmp_path / "turned.png")
    for name, image in (("two.png", np.hstack(heads[0][[2, 4]])), ("one.jpg", heads[0][3])):
        Image.fromarray(image).save(tmp_path / name)
    arguments = ("turned.png", "two.png", "one.jpg", "--jobs", 2)
    done = subprocess.run(
        command_line("predict", *arguments), cwd=tmp_path, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    assert len(done.stderr.splitlines()) == (default_detector() == "dlib"), done.stderr
    assert "two.png: 2 faces → deepmds-out/two.csv, two.png" in done.stdout
    out = tmp_path / "deepmds-out"
    names = [f"{name}.{kind}" for name in ("turned", "two", "one") for kind in ("csv", "png")]
    assert written(out) == sorted(names)
    table = pd.read_csv(out / "turned.csv", comment="#")[-51:]  # dlib has the jaw before them
    assert tuple(table.name) == load_scheme("ibug51").names
    assert np.abs(table[["image_x", "image_y"]] - heads[1][1]).mean().max() < 4
    with Image.open(out / "two.png") as picture:
        assert picture.width > picture.height  # of both faces


def test_each_bad_source_gets_one_line_and_the_others_are_done(tmp_path, predict, landmarks):
    folder = tmp_path / "in"
    folder.mkdir()
    (folder / "text.jpg").write_text("hello")
    Image.new("RGB", (200, 200)).save(folder / "nobody.png")
    (folder / "broken.json").write_text("{")
    os.mkfifo(folder / "pipe.jpg")
    save(folder / "upside_down.npy", landmarks * (1, -1))
    save(folder / "count.npy", landmarks[:50])
    save(folder / "good.npy", landmarks)
    odd = save(folder / "new\nline 'and' \"more\"\udcff.npy", landmarks)
    bad = [folder / "missing.jpg", folder / "..", ""]
    status, output, errors = predict(*sorted(folder.iterdir()), *bad)
    assert status == 1
    expected = {
        "text.jpg": "no image",
        "nobody.png": "no face found by",
        "broken.json": "must be JSON",
        "pipe.jpg": "Received a pipe or device",
        "upside_down.npy": "--y-up",
        "count.npy": "Received 50",
        "missing.jpg": "does not exist",
        "..": "must hold photos",
    }
    for name, text in expected.items():
        (line,) = [line for line in errors if f"{folder / name}" in line.split(" must ")[0]]
        assert text in line, name
    assert "a source must be the name" in "".join(errors)
    assert len(errors) == len(expected) + 1
    assert output.count("1 face →") == 2 and "new\\nline" in output
    results = {f"{name}.{kind}" for name in ("good", odd.stem) for kind in ("csv", "png")}
    assert {*written(tmp_path / "out")} == results


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ([], "the following arguments are required: SOURCE"),
        (["a.jpg", "--jobs", "0"], "must be 1 or more, or -1. Received '0'"),
        (["a.jpg", "--interocular", "0"], "must be a number above 0"),
        (["a.jpg", "--interocular", "nan"], "must be a number"),
        (["a.jpg", "--smooth", "-1"], "not negative, or causal. Received '-1'"),
        (["a.jpg", "--format", "csv,stl"], "Received 'stl'"),
        (["a.jpg", "--detector", "mtcnn"], "mtcnn"),
    ],
)
def test_wrong_arguments_are_named(command, arguments, message):
    status, _, errors = command("predict", *arguments)
    assert status == 2
    assert message in errors.splitlines()[-1]


@pytest.mark.parametrize("n", [51, 68, 72, 478])
def test_landmarks_of_every_order_are_taken(tmp_path, predict, head, landmarks, n):
    scheme = {51: "ibug51", 68: "ibug68", 72: "bfm72"}.get(n, "mediapipe")
    points = convert(landmarks, "ibug51", scheme, missing="nan")
    if n == 72:
        points = sample_photo_views(head, "bfm72", 2, np.random.default_rng(0))[0]
        points = points * (1, -1)
    points = np.where(np.isnan(points), 0, points)  # what is not among the 51 is not looked at
    points = np.concatenate([points, np.zeros((n - len(points), 2))]) if n == 478 else points
    status, _, errors = predict(save(tmp_path / "points.npy", points), "--format", "json")
    assert (status, errors) == (0, [])
    content = json.loads((tmp_path / "out" / "points.json").read_bytes())
    target = "ibug51" if n == 478 else scheme
    assert (content["scheme"], content["model"]["name"]) == (target, f"lifting-{target}")


def test_gaps_and_odd_faces_stop_nothing_and_stay_in_the_results(tmp_path, predict, landmarks):
    frames = landmarks + np.random.default_rng(1).normal(0, 1, (8, 51, 2))
    alone = save(tmp_path / "alone.npy", frames[[0, 3, 4, 7]])
    frames[1] = np.nan
    frames[2] *= (1, -1)  # upside down, which the others are not: estimated, with a note
    frames[5, 3:] = np.nan
    frames[6] = 7
    points = save(tmp_path / "f.npy", frames)
    status, output, (line,) = predict(points, alone, "--format", "csv,json,npz,ply")
    assert status == 1
    assert f"{points}: 2 of 8 faces cannot be used and are gaps: 6, 7. The first must" in line
    assert "f.npy: 5 faces, 3 gaps →" in output
    out, seen = tmp_path / "out", [0, 3, 4, 7]
    arrays, expected = read_npz(out / "f.npz"), read_npz(out / "alone.npz")
    for key in ("shape", "landmarks", "yaw", "roll", "rotation"):
        np.testing.assert_allclose(arrays[key][seen], expected[key], atol=1e-6)
        assert np.isnan(arrays[key][[1, 5, 6]]).all(), key
    records = json.loads((out / "f.json").read_bytes())["faces"]
    assert [face["shape"] is None for face in records] == [i in (1, 5, 6) for i in range(8)]
    assert records[1]["notes"] == []
    assert any("stands unlike the other faces" in note for note in records[2]["notes"])
    assert len([*out.glob("f-*.ply")]) == 5
    for kind in ("csv", "json"):  # what was written is read with its gaps
        again = read_landmarks(out / f"f.{kind}")
        np.testing.assert_allclose(again, arrays["landmarks"], rtol=1e-5)


@pytest.mark.parametrize("way", [2, "causal"])
def test_options_reach_the_results(tmp_path, predict, landmarks, way):
    frames = landmarks + np.random.default_rng(1).normal(0, 2, (8, 51, 2))
    frames[4] = np.nan  # smoothing does not cross it
    frames[5:] += 50
    points = save(tmp_path / "frames.npy", frames * (1, -1))
    arguments = (points, "--y-up", "--interocular", 90, "--format", "npz")
    for folder, options in (("rough", ()), ("smooth", ("--smooth", way))):
        assert predict(*arguments, *options, "--out", tmp_path / folder)[0] == 0
    rough, smooth = (read_npz(tmp_path / folder / "frames.npz") for folder in ("rough", "smooth"))
    assert np.allclose(rough["landmarks"], frames, equal_nan=True)
    assert json.loads(str(rough["description"]))["unit"] == "mm"
    seen = ~np.isnan(rough["yaw"])
    apart = np.linalg.norm(rough["shape"][seen, 28] - rough["shape"][seen, 19], axis=1)
    assert np.allclose(apart, 90)
    jitter = [np.nanstd(np.diff(arrays["shape"], axis=0)) for arrays in (rough, smooth)]
    assert jitter[1] < 0.5 * jitter[0]
    steps = [np.nanmean(a["landmarks"][5] - a["landmarks"][3]) for a in (rough, smooth)]
    assert steps[1] == pytest.approx(steps[0], abs=2)


def test_rows_that_are_not_smoothed_are_counted(tmp_path, predict, landmarks):
    frames = np.repeat(landmarks[None], 4, axis=0)
    frames[1, 3], frames[2] = np.nan, np.nan
    points = save(tmp_path / "frames.npy", frames)
    for option, said in ((2, True), (0, False)):
        printed = predict(points, "--smooth", option, "--format", "csv", "--overwrite")[1]
        assert ("1 of 4 rows lack landmarks and are not smoothed" in printed) == said


def test_a_photo_is_read_once_and_the_detector_opened_once(tmp_path, predict, faces24, monkeypatch):
    for i in range(20):
        Image.new("RGB", (900, 900)).save(tmp_path / f"{i:02d}.png")
    read = []
    monkeypatch.setattr(
        process, "read_photo", lambda path, real=process.read_photo: read.append(path) or real(path)
    )
    options = ("--detector", "dlib", "--view", "--format", "ply")
    assert predict(*sorted(tmp_path.glob("*.png")), *options)[0] == 0
    assert len(read) == 20 and len(faces24) == 1
    assert len([*(tmp_path / "out").glob("00-*.ply")]) == 24
    assert (tmp_path / "out" / "00.png").is_file()


def test_what_is_done_is_skipped_until_source_or_options_change(tmp_path, predict, landmarks):
    first, second = (save(tmp_path / f"{name}.npy", landmarks) for name in "ab")
    out = tmp_path / "out"

    def redone(*options):
        """What a run writes, by the times of the files."""
        before = {path: path.stat().st_mtime_ns for path in out.glob("*.csv")}
        status, output, errors = predict(first, second, *options)
        after = {path: path.stat().st_mtime_ns for path in out.glob("*.csv")}
        new = sorted(path.stem for path, _ in after.items() - before.items())
        assert ("are skipped; --overwrite" in output) == (len(new) + len(errors) < 2)
        return status, new

    assert redone() == (0, ["a", "b"])
    assert redone() == (0, [])
    assert redone("--overwrite") == (0, ["a", "b"])
    (out / "a.png").unlink()
    assert redone() == (0, ["a"]), "which replaces what is left of the same results"
    save(second, landmarks + 1)
    assert redone() == (1, []), "whose former results are in the way"
    assert redone("--overwrite") == (0, ["a", "b"])
    assert redone("--jobs", 2) == redone("--every", 2) == (0, []), "which have no effect on these"
    assert redone("--overwrite", "--format", "csv,ply") == (0, ["a", "b"])
    assert redone("--format", "ply,csv") == (0, []), "the same formats"


@pytest.mark.parametrize(
    "options", [("--interocular", 90), ("--format", "json"), ("--view", "--mesh"), ("--y-up",)]
)
def test_other_options_are_never_skipped(tmp_path, predict, landmarks, options):
    points = save(tmp_path / "a.npy", landmarks)
    assert predict(points)[0] == 0
    before = (tmp_path / "out" / "a.csv").read_bytes()
    status, output, (line,) = predict(points, *options)
    assert (status, "skipped" in output) == (1, False)
    assert f"{tmp_path / 'out' / 'a.csv'} must be the result of {points} with these" in line
    assert "made with other " in line and "--overwrite" in line
    assert (tmp_path / "out" / "a.csv").read_bytes() == before
    if options != ("--y-up",):
        assert predict(points, *options, "--overwrite")[0] == 0
        assert predict(points, *options)[0] == 0


def test_a_new_source_of_the_same_stem_changes_nothing_of_what_is_done(
    tmp_path, predict, landmarks
):
    done, new = save(tmp_path / "a.npy", landmarks), tmp_path / "a.json"
    assert predict(done)[0] == 0
    new.write_text(json.dumps(landmarks.tolist()))
    status, output, errors = predict(new, done)
    assert (status, errors) == (0, []) and "1 of 2 sources are done" in output
    assert written(tmp_path / "out") == ["a.csv", "a.png", "a_json.csv", "a_json.png"]


def test_what_another_run_did_meanwhile_is_not_done_again(
    tmp_path, predict, landmarks, monkeypatch
):
    first, second = (save(tmp_path / f"{name}.npy", landmarks) for name in "ab")
    usable = run._usable

    def meanwhile(*arguments):
        monkeypatch.setattr(run, "_usable", usable)
        assert predict(first)[0] == predict(second, "--format", "json")[0] == 0
        return usable(*arguments)

    monkeypatch.setattr(run, "_usable", meanwhile)
    status, output, (line,) = predict(first, second)
    assert (status, "npy: 1 face" in output) == (1, False)
    assert "1 of 2 sources are done" in output and "b.json must be the result of" in line


def test_faces_that_cannot_be_used_are_said_again(tmp_path, predict, landmarks):
    points = save(tmp_path / "a.npy", [landmarks, 7 + 0 * landmarks])
    first, again = predict(points), predict(points)
    assert first[0] == again[0] == 1
    assert first[2] == again[2] and "1 of 2 faces cannot be used" in again[2][0]
    assert "1 of 1 sources are done" in again[1]


def test_y_up_of_landmarks_whose_y_points_down_is_to_be_omitted(tmp_path, predict, landmarks):
    status, _, (line,) = predict(save(tmp_path / "a.npy", landmarks), "--y-up")
    assert status == 1 and "y must point up for --y-up; omit it if y points down." in line


def test_weights_that_were_trained_again_are_other_weights(tmp_path, predict, landmarks):
    points, weights = save(tmp_path / "a.npy", landmarks), tmp_path / "mine.npz"
    weights.write_bytes(pretrained_path("lifting-ibug51").read_bytes())
    assert predict(points, "--model", weights)[0] == 0
    assert "skipped" in predict(points, "--model", weights)[1]
    os.utime(weights, ns=(10**18, 10**18))
    status, _, (line,) = predict(points, "--model", weights)
    assert (status, "made with other weights" in line) == (1, True)


def test_a_result_is_never_taken_for_that_of_another_source(tmp_path, predict, landmarks):
    """Even of the same name, size and time."""
    first, second = (tmp_path / folder / "x.npy" for folder in ("d1", "d2"))
    for path, points in ((first, landmarks), (second, landmarks + (0, 5))):
        path.parent.mkdir()
        os.utime(save(path, points), ns=(10**18, 10**18))
    assert predict(first, "--format", "csv,json")[0] == 0
    status, output, (line,) = predict(second)
    assert (status, "skipped" in output) == (1, False) and f"Received one of {first}." in line
    assert predict(first, "--format", "csv,json")[0] == 0, "which is still there"
    assert predict(second, "--overwrite")[0] == 0
    assert written(tmp_path / "out") == ["x.csv", "x.png"], "and no table of the first"
    read = read_landmarks(tmp_path / "out" / "x.csv")[0]
    np.testing.assert_allclose(read, landmarks + (0, 5), rtol=1e-5)


def test_results_without_a_record_are_of_an_unknown_source(tmp_path, predict, landmarks):
    points = save(tmp_path / "a.npy", landmarks)
    assert predict(points)[0] == 0
    records = tmp_path / "out" / ".deepmds-results"
    whole = records.read_text()
    records.write_text(whole[: len(whole) // 2])  # a run was killed
    status, _, (line,) = predict(points)
    assert (status, "Received one of an unknown source" in line) == (1, True)
    assert predict(points, "--overwrite")[0] == 0
    assert predict(points)[0] == 0


def test_a_face_that_replaced_one_of_another_source_is_not_taken_for_it(
    tmp_path, predict, landmarks
):
    two, other = save(tmp_path / "a.npy", [landmarks] * 2), save(tmp_path / "a-1.npy", landmarks)
    assert predict(two, "--format", "ply")[0] == 0
    assert predict(other, "--format", "ply")[0] == 1, "a-1.ply is there"
    assert predict(other, "--format", "ply", "--overwrite")[0] == 0
    assert predict(two, "--format", "ply")[0] == 1


def test_files_of_others_are_replaced_only_if_asked_for(tmp_path, predict, landmarks):
    first, second = (save(tmp_path / f"{name}.npy", landmarks) for name in "ab")
    out = tmp_path / "out"
    out.mkdir()
    (out / "a.csv").write_text("mine")
    status, output, (line,) = predict(first, second)
    assert (status, "b.npy: 1 face" in output) == (1, True)
    assert f"{out / 'a.csv'} already exists" in line and "--overwrite" in line
    assert (out / "a.csv").read_text() == "mine"
    assert written(out) == ["a.csv", "b.csv", "b.png"]
    assert predict(first, second, "--overwrite")[0] == 0
    assert (out / "a.csv").read_text().startswith("# 3D landmarks")


@pytest.mark.parametrize(
    ("photo", "options"),
    [("a.jpg", ()), ("a.jpg", ("--overwrite",)), ("b/a.jpg", ("--recursive",))],
)
def test_results_do_not_go_into_a_folder_of_sources(tmp_path, predict, heads, photo, options):
    (tmp_path / photo).parent.mkdir(exist_ok=True)
    Image.fromarray(heads[0][1]).save(tmp_path / photo)
    status, _, (line,) = predict(tmp_path, "--out", tmp_path, *options)
    assert (status, "must not be a folder of sources" in line) == (1, True)
    assert written(tmp_path) == [photo.split("/")[0]]


def test_two_runs_at_once_do_not_share_a_folder(tmp_path, predict, landmarks):
    points = save(tmp_path / "a.npy", landmarks)
    code = (
        "import sys; from pathlib import Path; from deepmds_keras.tool.command.run import _locked\n"
    )
    code += "with _locked(Path(sys.argv[1])): print('locked', flush=True); input()"
    other = subprocess.Popen(
        [sys.executable, "-c", code, tmp_path / "out"],
        cwd=ROOT, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
    )  # fmt: skip
    assert other.stdout.readline() == "locked\n"
    status, output, (line,) = predict(points)
    assert (status, output, "in use by another run" in line) == (1, "", True)
    other.kill()
    other.communicate()
    assert predict(points)[0] == 0
    assert written(tmp_path / "out") == ["a.csv", "a.png"]


@pytest.mark.parametrize("place", ["write_output", "overlay"])
def test_a_stopped_run_leaves_no_half_of_a_source_and_goes_on(
    tmp_path, predict, landmarks, monkeypatch, place
):
    points = save(tmp_path / "a.npy", landmarks)

    def stop(*arguments, **options):
        raise KeyboardInterrupt

    with monkeypatch.context() as patched:
        patched.setattr(process, place, stop)
        assert predict(points)[0] == 130
    assert written(tmp_path / "out") == []
    assert predict(points)[0] == 0


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="no /dev/full")
def test_a_full_output_gets_one_line(tmp_path, landmarks):
    points = save(tmp_path / "a.npy", landmarks)
    with open("/dev/full", "w") as full:
        arguments = command_line("predict", points, "--out", tmp_path / "out")
        done = subprocess.run(arguments, cwd=ROOT, stdout=full, stderr=subprocess.PIPE, text=True)
    assert done.returncode == 1
    assert done.stderr == "error: the output cannot be written: No space left on device.\n"
    assert written(tmp_path / "out") == ["a.csv", "a.png"]


@pytest.mark.skipif(os.name != "posix", reason="no sh")
def test_a_closed_output_stops_nothing(tmp_path, landmarks):
    points = save(tmp_path / "a.npy", landmarks)
    command = command_line("predict", points, "--out", tmp_path / "out")
    words = ["sh", "-c", 'exec "$@" >&-', "sh", *command]
    done = subprocess.run(words, cwd=ROOT, stderr=subprocess.PIPE, text=True)
    assert (done.returncode, done.stderr) == (0, "")
    assert written(tmp_path / "out") == ["a.csv", "a.png"]


@pytest.mark.slow
@pytest.mark.skipif(os.name != "posix", reason="no signals to a group of processes")
def test_ctrl_c_gets_one_line_whatever_the_processes_are_at(tmp_path, heads):
    for i in range(60):
        Image.fromarray(heads[0][1]).save(tmp_path / f"{i}.png")
    for when in ("begin", "found"):
        command = command_line("predict", tmp_path, "--out", tmp_path / when, "--jobs", 2)
        run = subprocess.Popen(
            command, cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
            start_new_session=True,
        )  # fmt: skip
        if when == "found":
            run.stdout.readline()
        else:
            while not any((tmp_path / when).glob("*.partial")):
                time.sleep(0.05)
            time.sleep(0.3)
        os.killpg(run.pid, signal.SIGINT)
        errors = [line for line in run.communicate()[1].splitlines() if line[:5] != "note:"]
        assert (run.returncode, errors) == (130, ["Stopped. The same command goes on from here."])


def test_a_folder_that_takes_no_results_is_named_before_the_work(tmp_path, predict, landmarks):
    points = save(tmp_path / "a.npy", landmarks)
    (tmp_path / "file").touch()
    for out in (tmp_path / "file", tmp_path / "file" / "within"):
        status, output, (line,) = predict(points, "--out", out)
        assert (status, output, str(tmp_path / "file") in line) == (1, "", True)
    (tmp_path / "out" / "a.csv").mkdir(parents=True)
    good = save(tmp_path / "b.npy", landmarks)
    status, output, (line,) = predict(points, good)
    assert (status, "a.csv already exists" in line) == (1, True)
    assert "--overwrite" not in line, "it does not replace folders"
    assert (tmp_path / "out" / "b.csv").is_file()


def test_without_a_detector_photos_are_refused_and_landmarks_done(
    tmp_path, predict, landmarks, monkeypatch
):
    for name in ("dlib", "mediapipe"):
        monkeypatch.setitem(sys.modules, name, None)
    photo_faces._opened.cache_clear()
    for module in (dlib_landmarks, mediapipe_landmarks):
        module.shared_detector.cache_clear()
    Image.new("RGB", (200, 200)).save(tmp_path / "photo.png")
    points = save(tmp_path / "a.npy", landmarks)
    for detector in ("dlib", "mediapipe"):
        status, output, (line,) = predict(tmp_path / "photo.png", "--detector", detector)
        assert (status, output) == (1, "")
        assert f"pip install '.[{detector}]'" in line
    assert not (tmp_path / "out").exists()
    status, _, (line,) = predict(tmp_path / "photo.png", points)
    assert status == 1 and "1 photos or videos cannot be used. " in line
    assert (tmp_path / "out" / "a.csv").is_file()


def test_options_without_effect_are_named(tmp_path, predict, heads, landmarks):
    Image.fromarray(heads[0][1]).save(tmp_path / "a.png")
    options = ("--smooth", 2, "--every", 3, "--y-up", "--image-size", 640, 480)
    status, _, (line,) = predict(tmp_path / "a.png", *options)
    names = "--smooth, --every, --y-up, --image-size"
    assert (status, line) == (0, f"note: no effect on these sources: {names}.")
    points = save(tmp_path / "b.npy", landmarks)
    assert predict(points, "--smooth", 2)[2] == []
    assert predict(points, "--overwrite", "--every", 2)[2] == [
        "note: no effect on these sources: --every."
    ]


def test_mesh_writes_a_head_for_each_face(predict, landmarks, tmp_path):
    points = save(tmp_path / "two.npy", np.stack([landmarks, 2 * landmarks]))
    status, _, errors = predict(points, "--view", "--mesh", "--interocular", 90, "--format", ALL)
    assert (status, errors) == (0, [])
    kinds = ("ply", "obj", "mesh.ply", "mesh.obj")
    faces = {f"two-{n}.{kind}" for n in (1, 2) for kind in kinds}
    tables = {f"two.{kind}" for kind in ("csv", "json", "npz", "png", "html")}
    assert {*written(tmp_path / "out")} == faces | tables
    for n in (1, 2):
        lines = (tmp_path / "out" / f"two-{n}.mesh.obj").read_text().splitlines()
        vertices = np.array([line.split()[1:] for line in lines if line[0] == "v"], float)
        assert 180 < np.ptp(vertices[:, 1]) < 400  # millimetres of a head


def test_faces_with_missing_landmarks_are_estimated_but_by_the_networks_of_the_paper(
    predict, landmarks, tmp_path
):
    faces = np.stack([landmarks, landmarks + 5])
    faces[1, 3] = np.nan
    np.save(tmp_path / "some.npy", faces)
    status, _, errors = predict(tmp_path / "some.npy", "--format", ALL)
    assert (status, errors) == (0, [])
    table = pd.read_csv(tmp_path / "out" / "some.csv", comment="#")
    assert np.isfinite(table[["x", "y", "z", "image_x"]]).all(axis=None)
    assert table["residual"].isna().sum() == 1
    written = json.loads((tmp_path / "out" / "some.json").read_text())["faces"][1]
    assert written["landmarks"][3] == [None, None] and None not in written["shape"][3]
    np.save(tmp_path / "jawless.npy", convert(faces[0], "ibug51", "ibug68", missing="nan"))
    np.save(tmp_path / "alone.npy", faces[1])
    sources = [tmp_path / f"{name}.npy" for name in ("some", "jawless", "alone")]
    status, output, errors = predict(*sources, "--model", "deepmds", "--out", tmp_path / "paper")
    assert status == 1 and "jawless.npy: 1 face →" in output, "whose 51 landmarks are all there"
    assert "1 of 2 faces cannot be used and are gaps: 2" in errors[0]
    assert "alone.npy: each face must have all landmarks for the model deepmds" in errors[1]
