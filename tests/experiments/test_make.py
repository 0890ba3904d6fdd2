"""`make` runs what is missing or made from other files, and nothing that is there."""

import functools
import importlib.util
import itertools
import json
import os
import re
import resource
import shlex
import shutil
import signal
import subprocess
import sys
import time
from datetime import datetime

import pandas as pd
import pytest
import runs
from filelock import FileLock
from places import ROOT

from data_gen.models.registry import MODELS
from data_gen.views import PROTOCOLS
from experiments import make, records
from experiments.__main__ import main
from experiments.presets import PRESETS
from experiments.progress.step_names import in_words
from experiments.records import (
    commits_of,
    environment,
    listing,
    read_manifest,
    read_record,
    steps_of,
)
from experiments.run import AUTHORS_FILES, EVALUATORS, MOBILEFACES, options_of, run_of_variables


@pytest.fixture
def copy(whole_bfm, tmp_path):
    """The whole BFM experiment, to be changed."""
    for name in ("build", "results", ".snakemake"):
        shutil.copytree(whole_bfm / name, tmp_path / name)
    return tmp_path


def ended(process, seconds=300):
    """Status and texts of a process."""
    output, errors = process.communicate(timeout=seconds)
    return process.returncode, output, errors


def names(steps):
    """Step and items of the words of steps: `"tracks.train deep_mds"`."""
    return [" ".join(words[: words.index("--track")]) for words in steps]


def stamps(folder):
    """When files were written, but those with temporary names, and Snakemake's."""
    paths = (path for path in folder.rglob("[!.]*") if path.is_file())
    return {path: path.stat().st_mtime_ns for path in paths if ".snakemake" not in path.parts}


def weights(folder, content):
    folder.mkdir()
    for name in AUTHORS_FILES["bfm"]:
        (folder / name).write_bytes(content)
    return f"AUTHORS={folder}"


# Nothing more than what is asked for.


def test_a_second_call_prints_the_table_and_does_nothing(copy):
    before, used = stamps(copy), resource.getrusage(resource.RUSAGE_CHILDREN)
    status, output, errors = ended(runs.command("reproduce-bfm", copy))
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    assert (status, errors) == (0, "")
    assert "Deep-MDS" in output and "Step" not in output
    assert stamps(copy) == before
    # Of the processor, whatever else it does: 2 s on the machine that the tables are of.
    assert after.ru_utime + after.ru_stime - used.ru_utime - used.ru_stime < 8


@pytest.mark.parametrize(
    "variables, expected",
    [
        ([], []),
        (["MOBILEFACE=no"], ["tracks.times", "tracks.bfm"]),
        (["EVALUATOR=released"], ["tracks.bfm"]),
        (["MOBILEFACE=paper"],
         ["tracks.train mobileface", "tracks.predict mobileface", "tracks.times", "tracks.bfm"]),
        (["SEEDS=2"],
         ["datasets.faces",
          *(f"tracks.train {m}" for m in ("deep_mds", "deep_mds_released", "deep_mds_cosine")),
          *(f"tracks.predict {m}"
            for m in ("mean_shape", "deep_mds", "deep_mds_released", "deep_mds_cosine")),
          "studies.seed", "studies.seed", "tracks.bfm"]),
    ],
)  # fmt: skip
def test_another_variable_runs_what_depends_on_it(whole_bfm, variables, expected):
    planned = names(runs.plan("reproduce-bfm", whole_bfm, *variables))
    assert sorted(name.split(" mean_shape ridge")[0] for name in planned) == sorted(expected)


def test_weights_of_the_authors_run_their_row_and_the_table(whole_bfm, tmp_path):
    planned = names(runs.plan("reproduce-bfm", whole_bfm, weights(tmp_path / "a", b"1")))
    assert planned[0] == "tracks.predict deep_mds_weights"
    steps = sorted(name.split()[0].removeprefix("tracks.") for name in planned)
    assert steps == ["bfm", "predict", "preview", "times"]


def test_another_file_of_a_face_model_makes_everything_anew(tmp_path):
    folder = runs.work(tmp_path, "bfm", model="bfm2009")
    record = folder / "records/faces.json"
    for path in (tmp_path / "a.mat", tmp_path / "b.mat", record):
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(b"")
    given = ["MODEL=bfm2009", f"DATA={tmp_path}/a.mat"]
    done = [*runs.SNAKEMAKE, str(record.relative_to(tmp_path)), "--touch", "--forceall"]
    done += ["--quiet", "all", "--config", "PRESET=tiny", *given]
    subprocess.run(done, cwd=tmp_path, env=runs.ENVIRONMENT, check=True)
    assert "datasets.faces" not in names(runs.plan("reproduce-bfm", tmp_path, *given))
    other = names(runs.plan("reproduce-bfm", tmp_path, given[0], f"DATA={tmp_path}/b.mat"))
    assert other[0] == "datasets.faces"


@pytest.mark.parametrize(
    "lost",
    [pytest.param("table.csv", marks=pytest.mark.slow), "figures/summary.png", "manifest.json"],
)
def test_results_that_were_deleted_are_written_again_and_a_dry_run_says_so(copy, lost):
    path = runs.results(copy, "bfm") / lost
    path.unlink()
    before = stamps(copy)
    status, planned, errors = ended(runs.command("reproduce-bfm", copy, "DRY=1"))
    assert (status, errors) == (0, "")
    assert planned.startswith("Step 1 of 1: score each method and draw") and "left" not in planned
    assert stamps(copy) == before
    if lost == "table.csv":
        assert ended(runs.command("reproduce-bfm", copy))[0] == 0
        assert path.exists()


def test_the_steps_of_a_target_are_drawn(tmp_path):
    status, output, _ = ended(runs.command("audit", tmp_path, "DAG=audit.svg"))
    assert status == 0
    drawn = (tmp_path / "audit.svg").read_text(encoding="utf-8")
    assert drawn.startswith("<?xml") and "ablation" in drawn


@pytest.mark.parametrize("variable", ["DAG=audti.svg", "DRY=1", ""])
def test_a_reason_of_snakemake_is_told(tmp_path, variable):
    status, _, errors = ended(runs.command("audti", tmp_path, *filter(None, [variable])))
    assert status == 2 and errors.count("\n") == 1 + (variable == "")
    assert errors.startswith("error: ") and errors.count("No rule to produce audti") == 1


def with_step(folder, shell, *options):
    """Ask Snakemake for the record of one more step, `hello`, that runs `shell`."""
    rules = folder / "more.smk"
    rules.write_text(
        f"include: {str(ROOT / 'experiments/Snakefile')!r}\n"
        f"rule hello:\n    output: record('bfm', 'hello')\n    shell: {shell}\n"
    )
    snakemake = [sys.executable, "-m", "snakemake", "-s", str(rules), "hello", "--cores", "1"]
    return subprocess.run(
        [*snakemake, *options, "--config", "PRESET=tiny"],
        cwd=folder, env=runs.ENVIRONMENT, capture_output=True, text=True,
    )  # fmt: skip


def test_a_step_that_is_killed_is_named(tmp_path):
    shell = "'kill -9 $$ # --record {output[0]:q} --inputs'"
    done = with_step(tmp_path, shell, "--quiet", "all")
    assert (done.returncode, done.stderr) == (1, "error: hello: ended by SIGKILL.\n")


@pytest.mark.slow
def test_a_run_by_snakemake_is_that_of_its_steps_and_begins_with_the_landmark_methods(
    whole_bfm, tmp_path
):
    status, _, errors = ended(runs.command("reproduce-bfm", tmp_path, "JOBS=1"), seconds=None)
    assert status == 0, errors
    records = [read_record(path) for path in runs.work(tmp_path, "bfm").glob("records/*.json")]
    started = {record["name"]: datetime.fromisoformat(record["started"]) for record in records}
    assert started["preview"] < started["train-mobileface"] < started["bfm"]
    # One job is one: Snakemake 9.10 to 9.16 forget a job that is started alone.
    records.sort(key=lambda record: (record["started"], record["seconds"]))
    for first, second in itertools.pairwise(records):
        between = (started[second["name"]] - started[first["name"]]).total_seconds()
        assert between > first["seconds"] - 1  # starts are in whole seconds
    tables = [runs.results(folder, "bfm") / "metrics.csv" for folder in (tmp_path, whole_bfm)]
    # A forked step has no oneDNN, by which MobileFace is trained.
    rows = "metric == 'mse' and method != 'mobileface'"
    errors = [pd.read_csv(table).query(rows).reset_index(drop=True) for table in tables]
    pd.testing.assert_frame_equal(*errors)


def test_folders_may_have_spaces(tmp_path):
    index = tmp_path / "my data" / "scans of today.csv"
    index.parent.mkdir()
    index.write_text("scan\n")
    switches = ("RINGNET=no", "MEDIAPIPE=no")
    steps = runs.plan("reproduce-flame", tmp_path, f"CASIA_INDEX={index}", *switches)
    (scans,) = (words for words in steps if words[0] == "datasets.scans")
    assert str(index) in scans[scans.index("--inputs") :]


# Errors.


@pytest.mark.parametrize(
    "target, variables, message",
    [
        ("reproduce-bfm", ["MODEL=foo"], "invalid choice: 'foo'"),
        ("reproduce-bfm", ["MOBILEFACE=nein"], "MOBILEFACE must be one of"),
        ("reproduce-bfm", ["SEEDS=1"], "SEEDS must be at least 2. Received 1."),
        ("reproduce-bfm", ["JOBS=0"], "JOBS must be at least 1, or -1"),
        ("reproduce-bfm", ["BFM_SCALE=2"], "BFM_SCALE must be a positive number, and 1 unless"),
        ("scales", ["MODEL=bfm68", "BFM_SCALE=0"], "BFM_SCALE must be a positive number"),
        ("scales", ["MODEL=bfm68", "BFM_SCALE=nan"], "BFM_SCALE must be a positive number"),
        ("reproduce-flame", ["MODEL=bfm68"], "MODEL=bfm68 works only on the BFM track"),
        ("reproduce-flame", ["MODEL=flame", "DATA=empty"], "COMA= must be the folder of"),
        (
            "reproduce-flame",
            ["MODEL=flame", "DATA=empty", "COMA=empty"],
            "CASIA= must be the folder",
        ),
        ("scales", [], "MODEL must be bfm68, whose scale is unknown. Received openhead"),
        ("reproduce-flame", ["RINGNET=ja"], "RINGNET must be yes, no or the path"),
        *(
            (target, ["MODEL=bfm68"], "MOBILEFACE must be no with MODEL=bfm68, which has no mesh")
            for target in ("reproduce-bfm", "audit")
        ),
        ("reproduce-bfm", ["MODEL=bfm2009"], "DATA= must be the file of bfm2009"),
        ("reproduce-bfm", ["AUTHORS=."], "AUTHORS must be a folder with AE_occ2orth_BFM.h5"),
        ("reproduce-flame", ["EVALUATOR=released"], "EVALUATOR must be paper"),
        *(
            ("ablation", [f"{name}=missing"], f"{name} must be a file or folder")
            for name in ("DATA", "COMA", "CASIA", "CASIA_INDEX", "CELEBA", "TF_FLAME")
        ),
        ("lifting", ["SFM=empty"], "must hold sfm_shape_3448.bin, from eos's folder share"),
        ("reproduce-flame", ["COMA=empty"], "empty: must hold the data set CoMA"),
        ("reproduce-flame", ["CASIA=empty"], "empty: must hold CASIA-3D FaceV1"),
        ("reproduce-celeba", ["CELEBA=empty"], "empty: must hold CelebA"),
        ("reproduce-celeba", ["TF_FLAME=empty"], "TF_FLAME=empty must be a folder with photos"),
        ("reproduce-flame", ["TF_FLAME=empty"], "TF_FLAME=empty must be a folder with photos"),
        ("released-weights", [], "AUTHORS must be the folder of the authors' released weights"),
        ("reproduce-bfm", ["SEDS=10"], "unrecognized arguments: --seds 10"),
        ("reproduce-bfm", ["PROT=posed"], "unrecognized arguments: --prot posed"),
        ("check", ["PRESET=smoke"], "PRESET must be full"),
        ("reproduce-bfm", ["SNAKEMAKE=-n '"], "SNAKEMAKE must be words as a shell has them"),
    ],
)
def test_a_wrong_variable_is_one_line(tmp_path, monkeypatch, capsys, target, variables, message):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "empty").mkdir()
    with pytest.raises(SystemExit) as ended_by:
        make.main([target, "MEDIAPIPE=no", *variables])
    errors = capsys.readouterr().err
    assert ended_by.value.code == 2
    assert errors.startswith("error: ") and message in errors and errors.count("\n") == 1


def test_without_mediapipe_its_row_must_be_left_out(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(make, "has_mediapipe", lambda: False)
    monkeypatch.setattr(make, "_planned", lambda command: "")
    with pytest.raises(SystemExit):
        make.main(["reproduce-flame", "DRY=1"])
    assert capsys.readouterr().err.startswith("error: MEDIAPIPE must be no if MediaPipe")
    make.main(["reproduce-flame", "DRY=1", "MEDIAPIPE=no"])
    make.main(["reproduce-bfm", "DRY=1"])
    assert capsys.readouterr() == (2 * "Nothing to do.\n", "")


@pytest.mark.slow
def test_unusable_weights_are_named_before_the_long_work(tmp_path):
    process = runs.command("reproduce-bfm", tmp_path, weights(tmp_path / "authors", b"no weights"))
    assert "AE_occ2orth_BFM.h5 must be a Keras 2 weight file" in process.stderr.readline()
    process.terminate()
    status, output, errors = ended(process)
    assert status and errors.strip() in ("", "Stopped; the same command goes on from here.")
    assert "images" not in output and "Step 10 of" not in output


@pytest.mark.slow
@pytest.mark.parametrize("name", ["records/train-deep_mds.json", "test.npz"])
def test_a_damaged_file_is_named(copy, name):
    path = runs.work(copy, "bfm") / name
    path.write_bytes(path.read_bytes()[:-40] + bytes(40))
    os.utime(path, (0, 0))  # not newer than what was made from it
    shutil.rmtree(runs.results(copy, "bfm"))
    status, _, errors = ended(runs.command("reproduce-bfm", copy))
    assert status == 2 and path.name in errors
    assert errors.splitlines()[1:] == ["Stopped; the same command goes on from here."]


@pytest.mark.parametrize(
    ("name", "record", "step"),
    [
        ("test.npz", "faces", ["tracks.predict", "ridge"]),
        ("predictions/ridge.npz", "predict-ridge", ["tracks.preview", "ridge"]),
        ("images/train/0000.npy", "images", ["tracks.train", "mobileface"]),
    ],
)
def test_arrays_that_were_deleted_are_made_anew_as_the_error_says(copy, name, record, step):
    work = runs.work(copy, "bfm").relative_to(copy)
    (copy / work / name).unlink()
    errors = runs.run(step[0], copy, *step[1:]).stderr
    force = f"--forcerun {work}/records/{record}.json"
    assert f"SNAKEMAKE='{force}'" in errors and errors.count("\n") == 1
    _, planned, _ = ended(runs.command("reproduce-bfm", copy, "DRY=1", f"SNAKEMAKE={force}"))
    assert in_words(work / "records" / f"{record}.json") in planned


@pytest.mark.parametrize(
    ("step", "record"),
    [
        (["studies.scales"], "scale-0.75-seed0"),
        (["studies.ablation"], "variant-same_face-seed0"),
        (["objects.table"], "object-chairs-seed0"),
        (["audit.audit", "poses"], "audit-poses"),
    ],
)
def test_scores_that_were_deleted_are_made_anew_as_the_error_says(tmp_path, step, record):
    path = runs.work(tmp_path, "bfm") / "records" / f"{record}.json"
    path.parent.mkdir(parents=True)
    path.touch()
    done = runs.run(step[0], tmp_path, *step[1:])
    assert (done.returncode, done.stderr.count("\n")) == (2, 1)
    assert f"SNAKEMAKE='--forcerun {path.relative_to(tmp_path)}'" in done.stderr


# Several commands, and ends.


def test_a_second_command_waits_and_says_so(copy):
    lock = FileLock(copy / "build/openhead/.lock")
    with lock:
        process = runs.command("reproduce-bfm", copy)
        assert process.stdout.readline().startswith("Another command works in build/openhead")
        time.sleep(1)
        assert process.poll() is None
    status, output, _ = ended(process)
    assert status == 0 and "Deep-MDS" in output


@pytest.mark.slow
def test_ctrl_c_ends_all_within_seconds_and_the_command_goes_on(tmp_path):
    process = runs.command("reproduce-bfm", tmp_path, "MOBILEFACE=no")
    while "train " not in process.stdout.readline():
        assert process.poll() is None
    time.sleep(1)
    start = time.monotonic()
    process.send_signal(signal.SIGINT)
    status, _, errors = ended(process)
    assert time.monotonic() - start < 5 + 2  # two for a machine that does other things
    assert status == 128 + signal.SIGINT
    assert errors.strip() == "Stopped; the same command goes on from here."
    at_work = subprocess.run(["pgrep", "-g", str(process.pid)], capture_output=True)
    assert at_work.stdout == b""
    left = names(runs.plan("reproduce-bfm", tmp_path, "MOBILEFACE=no"))
    assert "datasets.faces" not in left and "tracks.train deep_mds" in left


# Records and manifests.


def test_a_manifest_lists_the_steps_behind_a_table_and_what_was_written(whole_bfm):
    folder = runs.results(whole_bfm, "bfm")
    manifest = read_manifest(folder)
    steps = [step["step"] for step in manifest["steps"]]
    assert steps[0] == "datasets.faces" and steps[-1].startswith("tracks.bfm ")
    assert {"tracks.train deep_mds", "tracks.predict deep_mds", "datasets.images"} <= {*steps}
    assert manifest["command"] == "make reproduce-bfm PRESET=tiny"
    assert commits_of(manifest) == {environment()["commit"]} - {None}  # none without git
    for step in steps_of(manifest):
        assert step["seconds"] >= 0 and step["processor"] and step["packages"]["numpy"]
    (model,) = manifest["steps"][0]["inputs"]
    assert model.endswith("openhead.npz")
    written = {p.relative_to(folder).as_posix() for p in folder.rglob("*") if p.is_file()}
    assert {*manifest["files"], "manifest.json"} == written


def test_steps_of_one_second_stand_after_what_they_need(tmp_path):
    needs = {"faces": [], "train": ["faces"], "predict": ["train", "faces"], "times": ["predict"]}
    for name, before in needs.items():
        record = {"step": name, "started": "2026", "needs": [str(tmp_path / b) for b in before]}
        records.write_record(tmp_path / name, record)
    last = {"step": "bfm", "needs": [str(tmp_path / name) for name in ("times", "predict")]}
    steps = [step["step"] for step in records.steps_behind(last)]
    assert steps == [*needs, "bfm"]


def test_what_most_steps_have_in_common_stands_once_in_a_manifest(tmp_path):
    preset = {"name": "full", "faces": 9}
    for name in "abc":
        record = {"step": name, "started": name, "needs": [], "preset": preset, "commit": "1"}
        records.write_record(tmp_path / name, record)
    last = {"step": "d", "needs": [str(tmp_path / name) for name in "abc"], "commit": "2"}
    last |= {"preset": {"name": "full"}, "left_out": None, "command": "make d"}
    folder = tmp_path / "results"
    records.new_results(folder)
    records.write_manifest(folder, last)
    (written,) = tmp_path.glob(".results*/manifest.json")
    manifest = json.loads(written.read_text())
    of_folder = {"published_sha256", "files", "command"}
    steps = [{k: v for k, v in s.items() if k not in of_folder} for s in steps_of(manifest)]
    behind = records.steps_behind(last)
    del behind[-1]["command"]
    assert steps == behind
    assert written.read_text().count('"faces": 9') == 1 and commits_of(manifest) == {"1", "2"}


def test_the_commit_is_that_of_the_code_and_says_if_it_was_changed(tmp_path, monkeypatch):
    monkeypatch.setattr(records, "git", functools.partial(records.git, folder=tmp_path))
    assert records._commit() is None
    code, written = tmp_path / "experiments", tmp_path / "deepmds_keras" / "pretrained"
    for folder in (code, written):
        folder.mkdir(parents=True)
        (folder / "file.py").touch()
    for words in ("init", "add .", "-c user.name=a -c user.email=a commit -m a"):
        subprocess.run(["git", *words.split()], cwd=tmp_path, check=True, capture_output=True)
    commit = records._commit()
    assert len(commit) == 12
    (written / "file.py").write_text("of a run")
    (tmp_path / "new.txt").touch()
    assert records._commit() == commit
    (code / "new.py").touch()
    assert records._commit() == f"{commit}+", "a module that git does not know is code too"
    (code / "new.py").unlink()
    (code / "file.py").write_text("another")
    assert records._commit() == f"{commit}+"
    monkeypatch.setattr(records, "git", functools.partial(records.git, folder=code))
    assert records._commit() is None, "of a repository around it"


def test_a_listing_goes_through_links_to_folders_and_takes_those_to_nothing(tmp_path):
    for name in ("folder", "linked"):
        (tmp_path / name).mkdir()
    (tmp_path / "folder" / "link").symlink_to(tmp_path / "linked")
    listings = [listing(tmp_path / "folder")]
    (tmp_path / "linked" / "file").touch()
    listings.append(listing(tmp_path / "folder"))
    (tmp_path / "folder" / "nothing").symlink_to("nowhere")
    assert len({*listings, listing(tmp_path / "folder")}) == 3


def test_the_command_line_of_a_run_is_that_run(tmp_path):
    variables = {"MODEL": "ict", "DATA": str(tmp_path), "PRESET": "smoke", "SEED": "3",
                 "PROTOCOL": "released", "RINGNET": "net", "MEDIAPIPE": "no", "JOBS": "2",
                 "FACES": "9", "SEEDS": "4", "COMA": ""}  # fmt: skip
    run = run_of_variables(variables, "flame")
    assert (run.model, run.seed, run.jobs, run.streamed_faces) == ("ict", 3, 2, 9)
    assert (run.ringnet, run.coma, run.all_seeds) == ("net", None, range(3, 7))
    words = options_of(run)
    given = dict(zip(words[::2], words[1::2], strict=True))
    again = {name[2:].replace("-", "_").upper(): value for name, value in given.items()}
    assert run_of_variables(again | {"TRACK": "flame"}, "flame") == run


def make_without_setup(*words):
    """What `make` prints, which has nothing to set up and runs nothing."""
    words = ["make", "--no-print-directory", "-n", "-o", ".venv/.ready", *words]
    environment = {k: v for k, v in os.environ.items() if k not in ("MAKELEVEL", "MAKEFLAGS")}
    done = subprocess.run(words, cwd=ROOT, capture_output=True, text=True, env=environment)
    return done.returncode, done.stdout, done.stderr


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("reproduce-bfm SEDS=10", "SEDS is no variable of this Makefile. The nearest is SEEDS"),
        ("docs PRESETS=smoke", "PRESETS is no variable of this Makefile. The nearest is PRESET"),
        ("surface PRESET=smoke", "make surface does not use PRESET. It uses DATA."),
        ("surface MODEL=ict", "make surface does not use MODEL."),
        ("real-faces REAL=a MODEL=ict", "make real-faces does not use MODEL."),
        ("footprint SEED=1", "make footprint does not use SEED."),
        ("docs DRY=1", "make docs does not use DRY."),
        ("check DRY=1", "make check does not use DRY."),
        ("all-results DRY=1", "make all-results does not use DRY."),
        ("reproduce-bfm REAL=a", "make reproduce-bfm does not use REAL."),
        ("ablation SEEDS=10", "make ablation does not use SEEDS."),
        ("dag TARGET=nonsense", "TARGET must be one of reproduce-bfm "),
    ],
)
def test_a_variable_that_a_target_does_not_use_is_refused(words, message):
    status, output, errors = make_without_setup(*words.split())
    assert (status, output) == (2, "") and message in errors and errors.count("\n") == 1


def test_real_faces_take_the_size_and_the_seed():
    status, output, _ = make_without_setup("real-faces", "REAL=a", "PRESET=smoke", "SEED=3")
    assert status == 0 and "'PRESET=smoke'" in output and "'SEED=3'" in output


def test_help_has_every_variable_with_its_values():
    words = subprocess.run(["make", "help"], cwd=ROOT, capture_output=True, text=True).stdout
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
    named = {line.split()[0] for line in makefile.splitlines() if " ?=" in line}
    named |= {*MODELS, *PROTOCOLS, *EVALUATORS, *MOBILEFACES} | {*PRESETS} - {"tiny"}
    assert named <= {*re.findall(r"[\w]+", words)}


def test_the_makefile_hands_on_every_variable_and_needs_all_for_all_results():
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
    given = {"DATA": "it's a folder", "SEEDS": "7", "DRY": "1"}
    words = [f"{name}={value}" for name, value in given.items()]
    status, output, _ = make_without_setup("audit", *words)
    assert status == 0
    for name, value in given.items():
        assert f"'{name}={value}'".replace("it's", "it'\\''s") in output
    done = subprocess.run(
        ["make", "-o", ".venv/.ready", "all-results", "DATA=.", "BFM68=.", "AUTHORS=."],
        cwd=ROOT, capture_output=True, text=True,
    )  # fmt: skip
    assert done.returncode and "error: SFM must be a file or folder" in done.stderr
    folders = [f"{name}=." for name in ("DATA", "BFM68", "AUTHORS", "SFM", "REAL", "OBJECTS")]
    status, output, _ = make_without_setup("all-results", *folders)
    commands = [words for words in output.splitlines() if "experiments.make" in words]
    assert status == 0 and len(commands) > 20
    for line in commands:
        words = shlex.split(line.partition("experiments.make ")[2])[1:]
        run_of_variables(dict(word.split("=", 1) for word in words))
    defaults = {line.split()[0] for line in makefile.splitlines() if " ?=" in line}
    handed_on = makefile.partition("VARIABLES :=")[2].partition("\n\n")[0].split()
    assert defaults - {"PYTHON", "VENV", "TARGET", "BFM68"} == {*handed_on} - {"\\"}


# A new step.


def test_a_new_step_is_a_module_and_a_rule(tmp_path):
    (tmp_path / "hello.py").write_text(
        "from experiments.records import new_results\n"
        "def main(run, *items):\n"
        "    folder = run.experiment_results('hello')\n"
        "    (new_results(folder) / 'text.txt').write_text(' '.join(items))\n"
        "    return {'greeted': len(items), 'results': [folder]}\n"
    )
    name = "experiments.hello"
    spec = importlib.util.spec_from_file_location(name, tmp_path / "hello.py")
    sys.modules[name] = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(sys.modules[name])
    before = os.getcwd()
    os.chdir(tmp_path)
    try:
        main(["hello", "a", "b", "--preset", "tiny", "--record", "build/records/hello.json"])
    finally:
        os.chdir(before)
        del sys.modules[name]
    record = read_record(tmp_path / "build/records/hello.json")
    assert record["step"] == "hello a b" and record["greeted"] == 2
    manifest = json.loads((runs.results(tmp_path, "hello") / "manifest.json").read_text())
    assert [*manifest["files"]] == ["text.txt"]
    planned = with_step(tmp_path, "step('hello a b')", "--dry-run", "--printshellcmds")
    assert "-m experiments hello a b --track bfm --seed 0" in planned.stdout + planned.stderr
