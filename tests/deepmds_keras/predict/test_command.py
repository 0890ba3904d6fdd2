"""`deepmds predict` as people run it: photos and landmarks in, files out, a line for what fails."""

import json
import signal
import subprocess
import sys
import time

import numpy as np
import pandas as pd
import pytest
from PIL import Image
from places import MEDIAPIPE, ROOT, SHARED
from writers.heads import drawn_heads

from data_gen.models.openhead import load_openhead
from data_gen.views.photo_views import sample_photo_views
from deepmds_keras import DeepMDS, __version__
from deepmds_keras.__main__ import main
from deepmds_keras.camera import HeadPose
from deepmds_keras.detection import dlib_landmarks, mediapipe_landmarks
from deepmds_keras.detection.detectors import default_detector
from deepmds_keras.landmarks import load_scheme
from deepmds_keras.landmarks.conversion import convert
from deepmds_keras.predict import command, source_files
from deepmds_keras.predict.arguments import parse
from deepmds_keras.predict.landmark_files import read_landmarks

TABLES = ("csv", "json", "ply", "obj", "png")


@pytest.fixture(scope="module")
def heads(apart):
    """Images of five open heads, and their 51 landmarks in pixels."""
    return apart(drawn_heads)


@pytest.fixture(scope="module")
def landmarks(heads):
    """`(51, 2)` of one face, frontal but for its errors."""
    return heads[1][2] + np.random.default_rng(0).normal(0, 0.5, (51, 2))


@pytest.fixture
def run(capsys, tmp_path):
    """Runs the command in this process: `run(*arguments)` → status, stdout, errors.

    Results lie in `tmp_path / "out"`, unless the arguments say otherwise.
    """

    def run(*arguments, jobs=1):
        out = [] if "--out" in arguments else ["--out", tmp_path / "out"]
        capsys.readouterr()
        with pytest.raises(SystemExit) as ended:
            main([str(each) for each in ("predict", *arguments, *out, "--jobs", jobs)])
        said = capsys.readouterr()
        lines = said.err.splitlines()
        return ended.value.code, said.out, [line for line in lines if line.startswith("error: ")]

    return run


def command_line(*arguments):
    return [sys.executable, "-m", "deepmds_keras", *map(str, arguments)]


def written(folder):
    return sorted(path.name for path in folder.iterdir())


def arrays_of(path):
    """All arrays of an npz, which is closed again."""
    with np.load(path) as file:
        return dict(file)


def save(path, landmarks):
    np.save(path, landmarks)
    return path


def test_help_is_answered_without_what_takes_long_to_load():
    code = """
import sys
from deepmds_keras.__main__ import main
from deepmds_keras.camera import HeadPose
try:
    main(["predict", "--help"])
finally:
    print({"tensorflow", "keras", "sklearn", "matplotlib", "pandas"} & {*sys.modules})
"""
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True)
    assert done.stdout.endswith("set()\n")
    assert "--interocular" in done.stdout
    assert (done.returncode, done.stderr) == (0, "")


def test_a_photo_gives_its_face_and_no_noise(tmp_path, heads):
    """As a user has it: another process, another folder, several of them side by side."""
    Image.fromarray(heads[0][1]).save(tmp_path / "turned.png")
    for name, image in (("two.png", np.hstack(heads[0][[2, 4]])), ("one.jpg", heads[0][3])):
        Image.fromarray(image).save(tmp_path / name)
    arguments = ("turned.png", "two.png", "one.jpg", "--view", "--jobs", 2)
    done = subprocess.run(
        command_line("predict", *arguments), cwd=tmp_path, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    lines = done.stderr.splitlines()  # no bar, where there is no terminal
    assert len(lines) == (default_detector() == "dlib"), lines
    assert "two.png: 2 faces → deepmds-out/two.csv" in done.stdout
    out = tmp_path / "deepmds-out"
    faces = [f"{face}.{kind}" for face in ("two-1", "two-2") for kind in ("ply", "obj", "png")]
    pages = ["two.csv", "two.json", "two.html", "turned.html", "one.html"]
    single = [f"{name}.{kind}" for name in ("turned", "one") for kind in TABLES]
    whole = ["deepmds.json", "index.html", "summary.png"]
    assert written(out) == sorted([*faces, *pages, *single, *whole])

    table = pd.read_csv(out / "turned.csv", comment="#")
    assert tuple(table.name) == load_scheme("ibug51").names
    off = table[["image_x", "image_y"]] - heads[1][1]
    assert np.abs(off).mean().max() < 4
    yaws = [
        face["pose"]["yaw"]
        for name in ("turned", "two", "one")
        for face in json.loads((out / f"{name}.json").read_bytes())["faces"]
    ]
    assert np.allclose(sorted(yaws), [-10, 0, 10, 20], atol=10)
    assert np.allclose(yaws[0], -10, atol=8)


def test_a_photo_without_note_of_which_way_is_up_is_turned_until_it_has_a_face(
    tmp_path, run, heads
):
    """The same shape as of the upright photo, and landmarks and pose in the photo as it is."""
    upright = heads[0][1]
    for quarters in range(4):
        Image.fromarray(np.rot90(upright, quarters)).save(tmp_path / f"{quarters}.png")
    status, said, errors = run(*(tmp_path / f"{i}.png" for i in range(4)), "--format", "json")
    assert (status, errors) == (0, [])
    found = [json.loads((tmp_path / "out" / f"{i}.json").read_bytes())["faces"] for i in range(4)]
    rolls = []
    for quarters, (face,) in enumerate(found):
        x, y = heads[1][1].T
        n = len(upright)
        seen = np.stack([(x, y), (y, n - x), (n - x, n - y), (n - y, x)][quarters], 1)
        assert np.abs(np.subtract(face["landmarks"], seen)).mean() < 4
        np.testing.assert_allclose(face["shape"], found[0][0]["shape"], atol=0.03)
        pose = HeadPose(**{k: np.array(v) for k, v in face["pose"].items()})
        projected = pose.project(np.array(face["shape"])) * (1, -1)
        assert np.linalg.norm(projected - seen, axis=1).mean() < 12
        rolls.append(face["pose"]["roll"])
        assert any("does not stand upright" in note for note in face["notes"]) == (quarters > 0)
    turned = np.subtract(rolls, rolls[0]) - np.arange(4) * 90
    np.testing.assert_allclose((turned + 180) % 360, 180, atol=2)


def test_each_bad_source_gets_one_line_and_the_others_are_done(tmp_path, run, landmarks):
    folder = tmp_path / "in"
    folder.mkdir()
    (folder / "text.jpg").write_text("hello")
    (folder / "empty.jpg").touch()
    (folder / "huge.png").write_bytes(b"P5 16000 16001 255\n")
    Image.new("RGB", (200, 200)).save(folder / "nobody.png")
    (folder / "broken.json").write_text("{")
    arrays = {
        "upside_down": landmarks * (1, -1),
        "mirrored": landmarks * (-1, 1),
        "count": landmarks[:50],
        "nan": np.where(landmarks == landmarks[3], np.nan, landmarks),
        "point": np.ones((51, 2)),
        "good": landmarks,
    }
    for name, array in arrays.items():
        save(folder / f"{name}.npy", array)
    odd = save(folder / "new\nline 'and' \"more\"\udcff.npy", landmarks)
    files = sorted(folder.iterdir())
    status, said, errors = run(*files, folder / "missing.jpg", folder / "notes.txt", folder / "..")
    assert status == 1
    for name, wanted in {
        "text.jpg": "no image",
        "empty.jpg": "0 bytes",
        "huge.png": "at most 256,000,000 pixels. Received 16000 x 16001",
        "nobody.png": "no face found by",
        "broken.json": "must be JSON",
        "upside_down.npy": "--y-up",
        "mirrored.npy": "a mirrored face",
        "count.npy": "Received 50",
        "nan.npy": "finite",
        "point.npy": "one point 51 times",
        "missing.jpg": "does not exist",
        "notes.txt": "does not exist",
        "..": "must hold photos",
    }.items():
        (line,) = [line for line in errors if str(folder / name) in line.split(" must ")[0]]
        assert wanted in line, name
    assert len(errors) == 13
    assert said.count("1 face →") == 2
    assert "new\\nline" in said
    out = tmp_path / "out"
    results = {f"{name}.{kind}" for name in ("good", odd.stem) for kind in TABLES}
    assert {*written(out)} == results | {"deepmds.json", "summary.png"}


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ([], "the following arguments are required: SOURCE"),
        (["a.jpg", "--jobs", "0"], "must be 1 or more, or -1. Received '0'"),
        (["a.jpg", "--interocular", "0"], "must be above 0"),
        (["a.jpg", "--interocular", "nan"], "must be a number"),
        (["a.jpg", "--smooth", "-1"], "not negative. Received '-1'"),
        (["a.jpg", "--format", "csv,stl"], "Received 'stl'"),
        (["a.jpg", "--detector", "mtcnn"], "mtcnn"),
    ],
)
def test_wrong_arguments_are_named(capsys, arguments, said):
    with pytest.raises(SystemExit) as ended:
        main(["predict", *arguments])
    assert ended.value.code == 2
    assert said in capsys.readouterr().err.splitlines()[-1]


def test_the_version_is_said(capsys):
    with pytest.raises(SystemExit):
        main(["--version"])
    assert capsys.readouterr().out == f"deepmds-keras {__version__}\n"


@pytest.mark.parametrize("n", [51, 68, 468, 478])
def test_landmarks_of_every_order_are_taken(tmp_path, run, landmarks, n):
    scheme = {51: "ibug51", 68: "ibug68"}.get(n, "mediapipe")
    points = convert(landmarks, "ibug51", scheme, missing="nan")
    points = np.where(np.isnan(points), 0, points)  # what is not among the 51 is not looked at
    points = np.concatenate([points, np.zeros((n - len(points), 2))])
    status, _, errors = run(save(tmp_path / "points.npy", points), "--format", "json")
    assert (status, errors) == (0, [])
    content = json.loads((tmp_path / "out" / "points.json").read_bytes())
    taken = "ibug68" if n == 68 else "ibug51"
    assert (content["scheme"], content["model"]["name"]) == (taken, f"lifting-{taken}")
    assert np.allclose(content["faces"][0]["landmarks"][-51:], landmarks, atol=1e-3)


def test_the_papers_72_landmarks_have_their_own_weights(tmp_path, run):
    views, _, _ = sample_photo_views(load_openhead(), "bfm72", 2, np.random.default_rng(0))
    status, said, _ = run(save(tmp_path / "points.npy", views), "--y-up", "--format", "json,ply")
    assert (status, "2 faces" in said) == (0, True)
    content = json.loads((tmp_path / "out" / "points.json").read_bytes())
    assert (content["scheme"], content["model"]["name"]) == ("bfm72", "lifting-bfm72")
    assert np.shape([face["shape"] for face in content["faces"]]) == (2, 72, 3)


def test_gaps_and_faces_that_cannot_be_used_stop_nothing_and_stay_in_the_results(
    tmp_path, run, landmarks
):
    frames = landmarks + np.random.default_rng(1).normal(0, 1, (8, 51, 2))
    alone = save(tmp_path / "alone.npy", frames[[0, 3, 4, 7]])
    frames[1] = np.nan
    frames[2] *= (1, -1)  # upside down
    frames[5, 3] = np.nan
    frames[6] = 7
    points = save(tmp_path / "f.npy", frames)
    status, said, (line,) = run(points, alone, "--format", "csv,json,npz,ply")
    assert status == 1
    assert f"{points}: 3 of 8 faces cannot be used and are gaps: 3, 6, 7. The first y must" in line
    assert "f.npy: 4 faces, 4 gaps →" in said
    out = tmp_path / "out"
    found, expected = arrays_of(out / "f.npz"), arrays_of(out / "alone.npz")
    seen = [0, 3, 4, 7]
    for key in ("shape", "landmarks", "yaw", "rotation"):
        np.testing.assert_allclose(found[key][seen], expected[key], atol=1e-6)
        assert np.isnan(np.delete(found[key], seen, 0)).all(), key
    assert found["face"].tolist() == [f"f-{i}" for i in range(1, 9)]
    records = json.loads((out / "f.json").read_bytes())["faces"]
    assert [i for i, face in enumerate(records) if face["shape"] is not None] == seen
    assert records[1]["notes"] == [] and "--y-up" in records[2]["notes"][0]
    assert pd.read_csv(out / "f.csv", comment="#").groupby("face").x.count().tolist() == [
        51 if i in seen else 0 for i in range(8)
    ]
    for kind in ("ply", "png"):
        assert [path.name for path in sorted(out.glob(f"f-*.{kind}"))] == [
            f"f-{i + 1}.{kind}" for i in seen
        ]
    for kind in ("csv", "json"):  # what was written is read with its gaps
        again = read_landmarks(out / f"f.{kind}")
        np.testing.assert_allclose(again, found["landmarks"], rtol=1e-5)


def test_smoothing_does_not_cross_gaps(tmp_path, run, landmarks):
    frames = np.repeat(landmarks[None], 6, 0)
    frames[3:] += 50
    frames[2] = np.nan
    points = save(tmp_path / "f.npy", frames)
    assert run(points, "--smooth", 3, "--format", "npz")[0] == 0
    np.testing.assert_allclose(arrays_of(tmp_path / "out" / "f.npz")["landmarks"], frames)


def test_options_reach_the_results(tmp_path, run, landmarks, monkeypatch):
    monkeypatch.setattr(source_files, "DRAWN_FACES", 1)
    frames = landmarks + np.random.default_rng(1).normal(0, 2, (8, 51, 2))
    points = save(tmp_path / "frames.npy", frames * (1, -1))
    arguments = (points, "--y-up", "--interocular", 90, "--format", "npz")
    for folder, options in (("rough", ()), ("smooth", ("--smooth", 2))):
        assert run(*arguments, *options, "--out", tmp_path / folder)[0] == 0
    rough, smooth = (arrays_of(tmp_path / folder / "frames.npz") for folder in ("rough", "smooth"))
    assert np.allclose(rough["landmarks"], frames)
    assert json.loads(str(rough["description"]))["unit"] == "mm"
    apart = np.linalg.norm(rough["shape"][:, 28] - rough["shape"][:, 19], axis=1)
    assert np.allclose(apart, 90)
    jitter = [np.diff(arrays["shape"], axis=0).std() for arrays in (rough, smooth)]
    assert jitter[1] < 0.5 * jitter[0]


def test_of_many_faces_only_the_first_are_drawn(tmp_path, run, landmarks, monkeypatch):
    monkeypatch.setattr(source_files, "DRAWN_FACES", 2)
    points = save(tmp_path / "many.npy", landmarks + np.zeros((5, 1, 1)))
    status, said, _ = run(points, "--view")
    assert status == 0
    names = ["many.csv", "many.html", "many.npz", "many.png"]
    assert written(tmp_path / "out") == ["deepmds.json", *names]
    assert "5 faces" in said
    assert "pictures are of the first 2" in said
    assert pd.read_csv(tmp_path / "out" / "many.csv", comment="#").face.nunique() == 5


def test_what_is_done_is_not_done_again_unless_something_changed(tmp_path, run, landmarks):
    first, second = (save(tmp_path / f"{name}.npy", landmarks) for name in "ab")
    out = tmp_path / "out"

    def made(*options, status=0):
        """What a run makes anew, by the times of the files."""
        before = {path: path.stat().st_mtime_ns for path in out.glob("*.csv")}
        ended, said, _ = run(first, second, "--format", "csv", *options)
        assert ended == status
        after = {path: path.stat().st_mtime_ns for path in out.glob("*.csv")}
        assert ("sources are done already" in said) == (len(after.items() - before.items()) < 2)
        return sorted(path.stem for path, _ in after.items() - before.items())

    assert made() == ["a", "b"]
    assert made() == []
    save(second, landmarks + 1)
    assert made() == ["b"]
    (out / "a.csv").unlink()
    assert made() == ["a"]
    assert made("--interocular", "90") == ["a", "b"]
    assert made("--interocular", "90") == []
    assert made("--interocular", "90", "--force") == ["a", "b"]
    assert made("--interocular", "90") == []


def test_what_no_run_wrote_is_never_overwritten(tmp_path, run, landmarks):
    first, second = (save(tmp_path / f"{name}.npy", landmarks) for name in "ab")
    out = tmp_path / "out"
    out.mkdir()
    for name in ("a.png", "summary.png"):
        (out / name).write_text("mine")
    for options in ((), ("--force",)):
        status, said, errors = run(first, second, "--format", "csv", *options)
        assert status == 1
        assert "b.npy: 1 face" in said
        (line,) = errors
        assert f"{out / 'a.png'} must not be there yet, or be in the record" in line
        assert {path.read_text() for path in (out / "a.png", out / "summary.png")} == {"mine"}
        assert written(out) == ["a.png", "b.csv", "b.png", "deepmds.json", "summary.png"]
    (out / "a.png").unlink()
    status, _, (line,) = run(first, second, "--format", "csv", "--force")
    assert (status, "summary.png must not" in line) == (1, True)
    assert (out / "summary.png").read_text() == "mine"
    (out / "summary.png").unlink()
    assert run(first, second, "--format", "csv", "--force")[0] == 0  # its own it may
    assert run(first, second, "--format", "csv", "--force")[0] == 0


def test_a_file_of_the_records_name_that_is_none_is_left(tmp_path, run, landmarks):
    points = save(tmp_path / "a.npy", landmarks)
    out = tmp_path / "out"
    out.mkdir()
    for content in ("hello", "[]", '{"a": {"files": 3}}'):
        (out / "deepmds.json").write_text(content)
        status, said, (line,) = run(points, "--force")
        assert (status, said) == (1, "")
        assert "deepmds.json must be the record of earlier results" in line
        assert (out / "deepmds.json").read_text() == content
        assert written(out) == ["deepmds.json"]


def test_files_that_a_source_gives_no_longer_stay_those_of_the_runs(tmp_path, run, landmarks):
    """One face, then two, then one: a.png of the first run is overwritten by the third."""
    for n in (1, 2, 1, 2):
        points = save(tmp_path / "a.npy", np.repeat(landmarks[None], n, 0))
        assert run(points, "--format", "ply")[0] == 0
    assert written(tmp_path / "out") == sorted(
        ["deepmds.json", *(f"a{i}.{kind}" for i in ("", "-1", "-2") for kind in ("ply", "png"))]
    )


def test_files_that_a_killed_run_wrote_are_known_to_the_next(tmp_path, run, landmarks, monkeypatch):
    """Killed after the files and before their record."""
    points = save(tmp_path / "a.npy", landmarks)

    def killed(*_):
        raise SystemError("no more")

    with monkeypatch.context() as patch:
        patch.setattr(command.Record, "add", killed)
        patch.setattr(source_files, "write_picture", killed)
        options = parse(["predict", str(points), "--out", str(tmp_path / "out"), "--jobs", "1"])
        with pytest.raises(SystemError):
            command.run(options)
    assert "a.csv" in written(tmp_path / "out")
    status, said, errors = run(points)
    assert (status, errors, "1 face" in said) == (0, [], True)


def test_other_weights_make_everything_anew(tmp_path, run, landmarks):
    points, weights = save(tmp_path / "a.npy", landmarks), tmp_path / "mine.npz"
    model = DeepMDS.pretrained("deepmds-ibug51")
    model.save(weights)
    arguments = (points, "--model", weights, "--format", "json")
    assert run(*arguments)[0] == 0
    content = json.loads((tmp_path / "out" / "a.json").read_bytes())
    assert content["model"]["name"] == str(weights)
    assert "done already" in run(*arguments)[1]
    model.set_params(seed=5).save(weights)
    assert "done already" not in run(*arguments)[1]


def test_results_that_another_source_overwrote_are_made_again(tmp_path, run, landmarks):
    for folder, shift in (("x", 0), ("y", 9)):
        (tmp_path / folder).mkdir()
        save(tmp_path / folder / "a.npy", landmarks + shift)
    for folder, shift in (("x", 0), ("y", 9), ("x", 0)):
        assert run(tmp_path / folder / "a.npy", "--format", "npz")[0] == 0
        assert np.allclose(arrays_of(tmp_path / "out" / "a.npz")["landmarks"], landmarks + shift)


@pytest.mark.slow
def test_ctrl_c_loses_nothing_that_is_done(tmp_path, landmarks):
    files = [save(tmp_path / f"{i:03d}.npy", landmarks) for i in range(60)]
    out = tmp_path / "out"
    arguments = command_line("predict", *files, "--out", out, "--jobs", 1)
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    started = subprocess.Popen(arguments, **pipes)
    while not (out / "003.png").exists() and started.poll() is None:
        time.sleep(0.02)
    started.send_signal(signal.SIGINT)
    _, errors = started.communicate()
    assert started.returncode == 130, errors
    assert errors.endswith("Stopped. The same command goes on from here.\n")
    assert "Traceback" not in errors
    done = json.loads((out / "deepmds.json").read_bytes())
    finished = [entry for entry in done.values() if "made" in entry]
    assert 3 <= len(finished) < 60
    assert not [name for name in written(out) if "partial" in name]
    complete = [path for path in files if (out / f"{path.stem}.png").exists()]
    assert len(complete) - len(finished) <= 1  # the one it was just at


def test_a_stop_whose_exception_was_lost_counts_after_the_source(tmp_path, landmarks):
    files = [save(tmp_path / f"{name}.npy", landmarks) for name in "abc"]
    options = parse(["predict", *map(str, files), "--out", str(tmp_path / "out"), "--jobs", "1"])
    with pytest.raises(KeyboardInterrupt):
        command.run(options, lambda: True)
    done = json.loads((tmp_path / "out" / "deepmds.json").read_bytes())
    assert [path for path, entry in done.items() if "made" in entry] == [str(files[0])]


def test_names_of_the_run_are_not_those_of_a_source(tmp_path, run, landmarks):
    files = [save(tmp_path / f"{name}.npy", landmarks) for name in ("deepmds", "Summary", "a")]
    assert run(*files, "--format", "json")[0] == 0
    record = json.loads((tmp_path / "out" / "deepmds.json").read_bytes())
    assert {*record} == {"", *map(str, files)}
    assert record[""]["files"] == ["summary.png"]
    assert (tmp_path / "out" / "deepmds_npy.json").exists()
    assert (tmp_path / "out" / "Summary_npy.png").exists()


def test_a_folder_that_takes_no_results_is_said_before_the_work(tmp_path, run, landmarks):
    points = save(tmp_path / "a.npy", landmarks)
    (tmp_path / "file").touch()
    for out in (tmp_path / "file", tmp_path / "file" / "within"):
        status, said, errors = run(points, "--out", out)
        assert (status, said) == (1, "")
        (line,) = errors
        assert str(tmp_path / "file") in line
    (tmp_path / "out" / "a.csv").mkdir(parents=True)
    good = save(tmp_path / "b.npy", landmarks)
    status, said, (line,) = run(points, good, "--format", "csv")
    assert status == 1
    assert "a.csv must not be there yet" in line
    assert (tmp_path / "out" / "b.csv").is_file()


def test_without_a_detector_photos_are_refused_and_landmarks_done(
    tmp_path, run, landmarks, monkeypatch
):
    for name, module in (("dlib", dlib_landmarks), ("mediapipe", mediapipe_landmarks)):
        monkeypatch.setitem(sys.modules, name, None)
        module.shared_detector.cache_clear()
    Image.new("RGB", (200, 200)).save(tmp_path / "photo.png")
    points = save(tmp_path / "a.npy", landmarks)
    for detector in ("dlib", "mediapipe"):
        status, said, (line,) = run(tmp_path / "photo.png", "--detector", detector)
        assert (status, said) == (1, "")
        assert f"pip install 'deepmds-keras[{detector}]'" in line
    assert not (tmp_path / "out").exists()
    status, _, (line,) = run(tmp_path / "photo.png", points, "--format", "csv")
    assert status == 1 and "1 photo cannot be used. MediaPipe with FaceMesh must be" in line
    assert (tmp_path / "out" / "a.csv").is_file()


def test_models_that_do_not_fit_are_named(tmp_path, run, landmarks):
    points = save(tmp_path / "a.npy", landmarks)
    for model, said in (
        ("openhead", "its name must be one of deepmds-bfm72, deepmds-ibug51"),
        (
            tmp_path / "none.npz",
            "none.npz must be a file that LandmarkLifter.save() or DeepMDS.save() wrote",
        ),
        (points, "a.npy must be an npz written by save()"),
        ("deepmds-bfm72", "a.npy must have 72 landmarks a face for the model deepmds-bfm72"),
    ):
        status, _, (line,) = run(points, "--model", model)
        assert status == 1
        assert said in line


@pytest.mark.parametrize("detector", ["dlib", "mediapipe"])
def test_either_detector_finds_the_faces_and_its_licence_is_told(
    tmp_path, run, heads, capsys, detector
):
    if detector == "mediapipe" and not MEDIAPIPE:
        pytest.skip("MediaPipe is not installed")
    Image.fromarray(heads[0][1]).save(tmp_path / "head.png")
    Image.new("RGB", (90, 120), "white").save(tmp_path / "nobody.png")
    (tmp_path / "text.jpg").write_text("hello")
    files = [tmp_path / name for name in ("nobody.png", "text.jpg", "head.png")]
    status, _, errors = run(*files, "--detector", detector, "--format", "npz,json")
    assert status == 1
    other = "mediapipe" if detector == "dlib" else "dlib"
    assert f"nobody.png: no face found by {detector}, " in errors[0]
    assert f"try --detector {other}" in errors[0]
    assert "text.jpg must be a photo" in errors[1]
    found = arrays_of(tmp_path / "out" / "head.npz")
    assert np.abs(found["landmarks"][0, -51:] - heads[1][1]).mean() < 4
    assert found["yaw"][0] == pytest.approx(-10, abs=8)
    described = json.loads((tmp_path / "out" / "head.json").read_bytes())["detector"]
    assert described["name"] == detector
    assert ("non-commercial" in described["licence"]) == (detector == "dlib")
    main_with = ["predict", str(files[2]), "--detector", detector, "--force", "--jobs", "1"]
    with pytest.raises(SystemExit):
        main([*main_with, "--out", str(tmp_path / "out")])
    assert capsys.readouterr().err.count("non-commercial") == (detector == "dlib")


def test_a_landmarker_is_mediapipes(tmp_path, run):
    Image.new("RGB", (200, 200)).save(tmp_path / "photo.png")
    landmarker = ("--landmarker", tmp_path / "none.task")
    assert parse(["predict", "a.jpg", *map(str, landmarker)]).detector == "mediapipe"
    status, _, (line,) = run(tmp_path / "photo.png", *landmarker)
    assert status == 1 and "none.task must be a face landmarker" in line
    status, _, (line,) = run(tmp_path / "photo.png", *landmarker, "--detector", "dlib")
    assert status == 1 and "goes with --detector mediapipe" in line


def test_the_photos_that_users_have_give_plausible_faces(tmp_path, run):
    photos = sorted((SHARED / "photos").glob("photo[12345]*"))
    if not photos:
        pytest.skip("../shared is absent")
    status, _, errors = run(*photos, "--format", "npz")
    assert (status, errors) == (0, [])
    scheme = load_scheme("ibug51")
    groups = np.array(scheme.groups)
    eyes, mouth = np.isin(groups, ["right_eye", "left_eye"]), groups == "outer_mouth"
    tip = scheme.names.index("nose_tip")
    for photo in photos:
        with np.load(tmp_path / "out" / f"{photo.stem}.npz") as found:
            shapes = found["shape"]
        for shape in shapes:
            assert shape[eyes, 1].mean() > shape[tip, 1] > shape[mouth, 1].mean()
            assert shape[tip, 2] == shape[:, 2].max()
            centred = shape - shape.mean(0) * (1, 0, 0)
            asymmetry = centred - centred[scheme.mirror] * (-1, 1, 1)
            assert np.linalg.norm(asymmetry, axis=1).mean() < 0.05


def test_mesh_writes_a_head_for_each_face(run, landmarks, tmp_path):
    np.save(tmp_path / "two.npy", np.stack([landmarks, 2 * landmarks]))
    np.save(tmp_path / "one.npy", landmarks)
    sources = tmp_path / "two.npy", tmp_path / "one.npy"
    status, _, errors = run(*sources, "--view", "--mesh", "--interocular", 90, "--format", "ply")
    assert (status, errors) == (0, [])
    for n in (1, 2):
        kinds = {path.name for path in (tmp_path / "out").glob(f"two-{n}.*")}
        assert {f"two-{n}.ply", f"two-{n}.mesh.ply", f"two-{n}.mesh.obj"} <= kinds
        lines = (tmp_path / "out" / f"two-{n}.mesh.obj").read_text().splitlines()
        vertices = np.array([line.split()[1:] for line in lines if line[0] == "v"], float)
        assert 180 < np.ptp(vertices[:, 1]) < 400  # millimetres of a head
    index = (tmp_path / "out" / "index.html").read_text()
    assert "./two.html" in index
    assert "./one.html" in index
