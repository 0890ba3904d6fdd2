"""The rules make every committed table, from all that their steps read, and nothing too often."""

import json
import os
import shutil
import subprocess
from pathlib import Path

import pandas as pd
import pytest
import runs
from places import MEDIAPIPE, ROOT, SHARED, committed

from deepmds_keras.errors import InputError
from experiments import records
from experiments.given import check_given
from experiments.inputs import embedding_file
from experiments.methods import METHODS
from experiments.objects.shapes import OBJECTS, object_file
from experiments.plan import Plan
from experiments.records import MANIFEST, new_results, publish, read_manifest, steps_of
from experiments.run import Run, run_of_variables


def dry_run(folder, *words):
    """Lines of Snakemake's plan for targets or files, with defaults but for `--config`."""
    done = subprocess.run(
        [*runs.SNAKEMAKE, "--dry-run", *words],
        cwd=folder, env=runs.ENVIRONMENT, capture_output=True, text=True,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout + done.stderr
    return (done.stdout + done.stderr).splitlines()


def planned(folder, *words):
    """Rules that Snakemake would run."""
    rules = ("rule ", "localrule ")
    return {
        line.split()[1].strip(":") for line in dry_run(folder, *words) if line.startswith(rules)
    }


def tables(model):
    """Every committed CSV file of a model, and of both, by the protocol of its folder."""
    paths = [path.relative_to(committed()) for path in (committed() / "results").rglob("*.csv")]
    paths = [
        p for p in paths if "published" not in p.parts and (model in p.parts or len(p.parts) == 3)
    ]
    posed = [str(path) for path in paths if path.parts[2].endswith("-posed")]
    return [str(path) for path in paths if str(path) not in posed], posed


@pytest.mark.parametrize("model", ["openhead", "ict"])
def test_every_committed_table_is_made_anew_where_there_are_only_results(tmp_path, model):
    shutil.copytree(committed() / "results", tmp_path / "results")
    (tmp_path / "ict_light.npz").touch()
    (tmp_path / "objects").mkdir()
    for name in OBJECTS:
        object_file(tmp_path / "objects", name).touch()
    given = {"openhead": ["OBJECTS=objects"], "ict": ["DATA=ict_light.npz"]}[model]
    given.append(f"MODEL={model}")
    paths, posed = tables(model)
    if model == "ict":  # those of both models, but for the audit, are made with the open head
        paths = [path for path in paths if "ict" in path]
    made = planned(tmp_path, *paths, "--config", *given)
    last = {"bfm", "bfm_evaluator_released", "flame", "celeba", "seeds", "ablation"}
    last |= {"hard_views", "component_ablation", "transfer", "audited"}
    if model == "openhead":
        last |= {"stream", "pretrained", "real_faces", "surface", "all_claims"}
        last |= {"bench", "footprint", "released_weights", "objects"}
    assert made >= last
    assert "bfm" in planned(tmp_path, *posed, "--config", "PROTOCOL=posed", *given)


def test_rows_say_how_much_memory_a_training_takes():
    """What committed runs took; a machine runs no more at once than it has memory for."""
    taken = {}
    for path in (committed() / "results").rglob(MANIFEST):
        for step in steps_of(read_manifest(path.parent)):
            kind, _, method = step.get("name", "").partition("-")
            if kind in ("train", "predict") and method in METHODS:
                taken[method] = max(taken.get(method, 0), step["peak_memory_mb"])
    assert {"ringnet", "mobileface", "deep_mds"} <= taken.keys()
    assert all(memory <= METHODS[method].memory_mb for method, memory in taken.items()), taken


@pytest.mark.slow
def test_a_file_given_later_runs_the_steps_that_read_it_and_no_other(tmp_path):
    targets, tiny = ["bench", "pretrained"], ["--config", "PRESET=tiny"]
    for line in dry_run(tmp_path, *targets, *tiny):
        kind, _, names = line.strip().partition(": ")
        for name in names.replace(" (update)", "").split(", ") if kind == "output" else ():
            (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
            (tmp_path / name).touch()
    words = [*runs.SNAKEMAKE, *targets, "--touch", "--forceall", "--quiet", "all", *tiny]
    subprocess.run(words, cwd=tmp_path, env=runs.ENVIRONMENT, check=True)
    assert planned(tmp_path, *targets, *tiny) == set()
    surrey = ("sfm_shape_3448.bin", "expression_blendshapes_3448.bin", "ibug_to_sfm.txt")
    surrey += ("sfm_3448_edge_topology.json", "sfm_model_contours.json")
    for name in (*surrey, "ict_light.npz"):
        (tmp_path / name).touch()
        os.utime(tmp_path / name, (0, 0))
    by_surrey = planned(tmp_path, *targets, *tiny, f"SFM={tmp_path}")
    assert by_surrey == {"bench", "pretrained"}
    by_ict = planned(tmp_path, *targets, *tiny, f"DATA={tmp_path}")
    assert by_ict == {"portraits", "photo_network", "pretrained"}


def test_an_option_reaches_the_steps_that_use_it(tmp_path):
    steps = runs.plan("reproduce-bfm", tmp_path, "SEEDS=2", "FACES=9")
    names = ("--seeds", "--data", "--sfm", "--faces", "--mobileface")
    options = {name: {words[0] for words in steps if name in words} for name in names}
    assert options == {
        "--seeds": {"tracks.bfm"},
        "--data": set(),
        "--sfm": set(),
        "--faces": set(),
        "--mobileface": {"tracks.train", "tracks.predict", "tracks.times", "tracks.bfm"},
    }


# Results appear whole.


class Killed(BaseException):
    pass


@pytest.mark.parametrize("system", ["exchanges", "cannot"])
def test_results_are_those_of_one_run_whenever_it_is_killed(tmp_path, monkeypatch, system):
    folder, content = tmp_path / "bfm", {"old": "1", "new": "2"}
    if system == "cannot":
        monkeypatch.setattr(records.ctypes, "CDLL", lambda name: object())

    def run(text, killed_at=None):
        calls = []

        def killing(function):
            def call(*arguments, **options):
                calls.append(function)
                if len(calls) == killed_at:
                    raise Killed
                return function(*arguments, **options)

            return call

        new = new_results(folder)
        (new / "table.csv").write_text(text)
        (new / "figures").mkdir()
        (new / "figures" / f"{text}.png").write_text(text)
        written = ["table.csv", f"figures/{text}.png"]
        (new / MANIFEST).write_text(json.dumps({"files": dict.fromkeys(written, text)}))
        with monkeypatch.context() as patched:
            patched.setattr(Path, "rename", killing(Path.rename))
            patched.setattr(Path, "unlink", killing(Path.unlink))
            patched.setattr(shutil, "rmtree", killing(shutil.rmtree))
            patched.setattr(shutil, "copy2", killing(shutil.copy2))
            patched.setattr(records, "_exchange", killing(records._exchange))
            try:
                publish(folder)
            except Killed:
                return True
        return False

    run(content["old"])
    (folder / "notes.txt").write_text("a user's")
    for killed_at in range(1, 10):
        was_killed = run(content["new"], killed_at)
        if (folder / MANIFEST).exists():
            (text,) = {*read_manifest(folder)["files"].values()}
            for name in read_manifest(folder)["files"]:
                assert (folder / name).read_text() == text
            assert system == "cannot" or (folder / "notes.txt").exists()
        else:
            assert system == "cannot", "no old results, and no new ones"
        if not was_killed:
            break
    assert not was_killed and (folder / "table.csv").read_text() == content["new"]
    assert not (folder / "figures" / "1.png").exists()
    assert [path.name for path in tmp_path.iterdir()] == ["bfm"]


# What is read is declared: `runs` refuses what is not.


@pytest.mark.slow
@pytest.mark.skipif(not (SHARED / "released").is_dir(), reason="../shared is absent")
@pytest.mark.parametrize(
    "target, variables",
    [
        ("released-weights", [f"AUTHORS={SHARED / 'released/bfm'}"]),
        ("pretrained", [f"SFM={SHARED / 'sfm'}"]),
    ],
)
def test_files_of_both_models_and_of_others_are_in_the_manifest(tmp_path, target, variables):
    given = [*variables, f"DATA={SHARED / 'ict-facekit'}"]
    runs.make(target, tmp_path, *given)
    folder = tmp_path / "results" / "tiny"
    name = "released-weights" if target == "released-weights" else "openhead/pretrained"
    inputs = [step.get("inputs", {}) for step in steps_of(read_manifest(folder / name))]
    assert {"openhead.npz", "ict_light.npz"} <= inputs[-1].keys()
    others = {"deep_dissim_ours2.h5"} if variables[0][0] == "A" else {"ibug_to_sfm.txt"}
    assert others <= inputs[-1].keys()


def test_the_licensed_ringnet_is_a_method_of_its_own(tmp_path):
    for suffix in ("index", "meta", "data-00000-of-00001"):
        (tmp_path / f"net.{suffix}").touch()
    given = {"RINGNET": str(tmp_path / "net"), "MEDIAPIPE": "yes" if MEDIAPIPE else "no"}
    with pytest.raises(InputError, match="RINGNET has its landmarks on FLAME's mesh: DATA= must"):
        check_given(run_of_variables(given, "flame"))
    for name in ("generic_model.pkl", "flame_static_embedding.pkl"):
        (tmp_path / name).touch()
    words = [f"{name}={value}" for name, value in given.items()]
    steps = runs.plan("reproduce-flame", tmp_path, f"DATA={tmp_path}", *words)
    (predict,) = (words for words in steps if words[:2] == ["tracks.predict", "ringnet_licensed"])
    assert predict[predict.index("--record") + 1].endswith("predict-ringnet_licensed.json")
    inputs = {str(tmp_path / name) for name in ("net.meta", "generic_model.pkl")}
    assert inputs < {*predict[predict.index("--inputs") :]}
    assert not any("ringnet" in words for words in steps), "ours is not trained"


def test_landmarks_on_the_meshes_of_coma_are_those_of_flame_itself_and_an_input(tmp_path):
    data, name = tmp_path / "data", "flame_static_embedding.pkl"
    for file in (data / name, data / "FLAME" / name, data / "FLAME" / "flame2023.pkl"):
        file.parent.mkdir(parents=True, exist_ok=True)
        file.touch()
    (data / "CoMA").mkdir()
    assert embedding_file(Run(model="flame", data=str(data))) == data / "FLAME" / name
    (data / "FLAME" / "flame2023.pkl").unlink()
    steps = runs.plan("reproduce-flame", tmp_path, f"DATA={data}", "RINGNET=no", "MEDIAPIPE=no")
    (frames,) = (words for words in steps if words[0] == "datasets.frames")
    assert str(data / name) in frames[frames.index("--inputs") :]


# A new method is a row and a builder, whatever it sees.

_ROWS = """
from deepmds_keras.files import read_arrays, write_arrays
from experiments.inputs import load_faces, load_images
from experiments.method import Method
from experiments.methods import METHODS

class Mean:
    n_parameters, epochs = 216, 1

    def fit(self, inputs, shapes, progress, checkpoint):
        assert len(inputs) == len(shapes)
        write_arrays(checkpoint, {"mean": shapes.mean(0) * 1.01}, {})
        progress({"train": 0.0})
        return self.restore(checkpoint)

    def restore(self, checkpoint):
        self.mean = read_arrays(checkpoint)[0]["mean"]
        return self

    def predict(self, inputs):
        assert inputs.shape[1:] in ((72, 2), (32, 32, 3)), inputs.shape
        return self.mean[None].repeat(len(inputs), 0)

def views(run):
    train = load_faces(run, "train")
    return train.views, train.shapes

def images(run):
    images = load_images(run, "train")
    return images[:], load_faces(run, "train").shapes[: len(images)]

for id, row in {
    "of_views": {"data": views, "checkpoint": lambda run: run.network_file("of_views")},
    "of_images": {"data": images, "checkpoint": lambda run: run.work / "of_images" / "net.npz",
                  "inputs": "images", "image_size": 32},
}.items():
    METHODS[id] = Method(id=id, title=id, description="made up", tracks=("bfm",),
                         build=lambda run: Mean(), complexity="O(n)", drawn=False, **row)
"""


@pytest.mark.slow
def test_a_new_method_is_a_row_and_a_builder(whole_bfm, tmp_path, monkeypatch):
    """Both kinds are trained, predicted, timed and in the table."""
    shutil.copytree(whole_bfm / "build", tmp_path / "build")
    (tmp_path / "made_up_rows.py").write_text(_ROWS)
    monkeypatch.setitem(runs.ENVIRONMENT, "TEST_MODULES", "made_up_rows")
    monkeypatch.setitem(runs.ENVIRONMENT, "PYTHONPATH", f"{ROOT}{os.pathsep}{tmp_path}")
    made_up, others = ("of_views", "of_images"), ("mean_shape", "zhao_frontal", "deep_mds")
    for method in made_up:
        runs.succeed("tracks.train", tmp_path, method)
        runs.succeed("tracks.predict", tmp_path, method)
    times = runs.work(tmp_path, "bfm") / "records" / "times.json"
    runs.succeed("tracks.times", tmp_path, *others, *made_up, "--record", str(times))
    runs.succeed("tracks.bfm", tmp_path, *others, *made_up)
    results = runs.results(tmp_path, "bfm")
    values = pd.read_csv(results / "table.csv").set_index(["method", "metric"])["mean"]
    counts = pd.read_csv(runs.results(tmp_path, "parameters") / "table.csv").set_index("method")
    for method in made_up:
        # The alignment takes the scale out.
        assert values[method, "mse"] == pytest.approx(values["mean_shape", "mse"], rel=0.2)
        assert values[method, "ms_per_face"] > 0
        assert counts.loc[method, "trainable"] == 216
        assert method in (results / "table.tex").read_text(encoding="utf-8").replace("\\_", "_")

    # The rules find what they are made from.
    monkeypatch.syspath_prepend(tmp_path)
    before = {**METHODS}
    try:
        import made_up_rows  # noqa: F401

        monkeypatch.chdir(tmp_path)
        plan = Plan({"PRESET": "tiny"})
        assert {*made_up} <= {*plan.compared("bfm")}
        assert plan.compared("bfm", images=False)[-1] == "of_views"
        (images,), (faces,) = (plan.to_train(method, "bfm") for method in reversed(made_up))
        assert images.endswith("records/images.json") and faces.endswith("records/faces.json")
        assert plan.to_predict("of_images", "bfm")[-1] == images
    finally:
        METHODS.clear()
        METHODS.update(before)
