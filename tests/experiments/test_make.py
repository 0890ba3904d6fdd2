"""What `make` would run: what is missing or made of other files, and nothing that is there."""

import re
import signal
import subprocess
import sys
import time
from dataclasses import replace
from importlib.util import find_spec

import pytest
import runs
from places import ROOT

from deepmds_keras.io.errors import InputError
from experiments.__main__ import main
from experiments.arguments import parse_run
from experiments.build_key import check_key, inputs_of, is_done, needs_of
from experiments.make import TARGETS, in_turns, missing, progress_line, usual_seconds
from experiments.presets import PAPER, SMOKE, TINY
from experiments.records import with_checksum, write_json
from experiments.run import AUTHORS_FILES, SCHEMES, Run
from experiments.running import locked
from experiments.stages import RESULTS, STAGES, SWITCHES, stage_of

MAKEFILE = (ROOT / "Makefile").read_text(encoding="utf-8")


@pytest.fixture
def run(tmp_path):
    return Run("openhead", SMOKE, build=tmp_path / "build", results=tmp_path / "results")


def finish(run, *stages):
    """Write the records of stages, as if they had run."""
    for stage in stages:
        check_key(run, stage, write=True)
        origin = {"needs": needs_of(run, stage), "inputs": inputs_of(run, stage)}
        write_json(run.record_file(stage), with_checksum(origin))


def would_run(run, target, **changes):
    return [stage.name for stage in missing(replace(run, **changes), target)]


# The registry and the Makefile.


def test_stages_stand_after_those_that_they_need_and_have_a_module():
    for number, stage in enumerate(STAGES):
        assert {need.id for need in stage.needed} <= {before.id for before in STAGES[:number]}
        assert stage.track in SCHEMES
        assert find_spec(f"experiments.{stage.module}"), stage
    assert len({stage.id for stage in STAGES}) == len(STAGES)
    # A name is of one module, whatever the track.
    assert len({(s.name, s.module) for s in STAGES}) == len({s.name for s in STAGES})


def test_every_stage_belongs_to_a_target_and_every_result_to_a_stage():
    needed = {need.id for stage in STAGES for need in stage.needed}
    assert {stage.id for stage in STAGES if stage.target is None} <= needed
    assert {result.stage for result in RESULTS} <= {stage.id for stage in STAGES}
    assert all(result.command.split()[1] in TARGETS for result in RESULTS)


def test_the_makefile_has_every_target_and_variable_of_the_registry():
    (line,) = re.findall(
        r"^(.*): \| \$\(READY\)\n\t@\$\(PY\) -m experiments make \$@", MAKEFILE, re.M
    )
    assert {*line.split()} == {*TARGETS}
    variables = {*re.findall(r"^([A-Z_]+) \?=", MAKEFILE, re.M)}
    assert {*SWITCHES} | {name for stage in STAGES for name in stage.reads} <= variables
    phony = re.search(r"^\.PHONY: (.*)", MAKEFILE, re.M)[1].split()
    assert {*TARGETS} <= {*phony}


def test_the_makefile_hands_on_what_it_is_given(tmp_path):
    """All variables, as the command line of the stages takes them."""
    for name in ("data", "coma", "casia", "celeba", "tf"):
        (tmp_path / name).mkdir()
    (tmp_path / "index.csv").touch()
    (tmp_path / "venv").mkdir()
    (tmp_path / "venv" / ".ready").touch()
    given = {"MODEL": "ict", "DATA": "data", "PRESET": "smoke", "SEED": "3", "PROTOCOL": "released",
             "COMA": "coma", "CASIA": "casia", "CASIA_INDEX": "index.csv", "CELEBA": "celeba",
             "TF_FLAME": "tf", "RINGNET": "net", "MOBILEFACE": "no", "MEDIAPIPE": "no", "JOBS": "2",
             "FACES": "9", "SEEDS": "4"}  # fmt: skip
    files = {"data", "coma", "casia", "index.csv", "celeba", "tf", "net"}
    words = [f"{name}={tmp_path / v if v in files else v}" for name, v in given.items()]
    command = ["make", "--no-print-directory", "-n", "reproduce-flame", f"VENV={tmp_path}/venv"]
    command += words
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True)
    *_, options = done.stdout.partition(" -m experiments make reproduce-flame ")
    run = parse_run("", options.replace("'", "").replace("--authors ", "").split())
    assert (run.model, run.seed, run.protocol, run.jobs) == ("ict", 3, "released", 2)
    assert run.preset == replace(SMOKE, streamed_faces=9)
    assert run.seeds == run.n_seeds == 4
    own = (run.data, run.coma, run.casia, run.casia_index, run.celeba, run.tf_flame, run.ringnet)
    assert {str(path) for path in own} == {str(tmp_path / name) for name in files}
    assert {*run.without} == {"MOBILEFACE", "MEDIAPIPE"}
    refused = subprocess.run(
        ["make", "-n", "reproduce-bfm", "MOBILEFACE=nein"],
        cwd=ROOT, capture_output=True, text=True,
    )  # fmt: skip
    assert "MOBILEFACE must be yes, paper or no. Received nein" in refused.stderr


# What is missing.


def test_only_what_is_missing_is_run(run):
    finish(run, "faces", "networks", "predictions", "bfm")
    alone = {"without": ("MOBILEFACE",)}
    assert would_run(run, "reproduce-bfm", **alone) == []
    assert would_run(run, "reproduce-bfm") == ["images", "mobileface", "bfm"]
    assert would_run(run, "reproduce-bfm", **alone, evaluator="released") == ["bfm"]
    finish(run, "images", "mobileface", "bfm")
    assert would_run(run, "reproduce-bfm") == would_run(run, "reproduce-bfm", **alone) == []
    run.record_file("networks").unlink()
    assert would_run(run, "reproduce-bfm", **alone) == ["networks", "predictions", "bfm"]


def turns(run, target):
    return [[stage.name for stage in turn] for turn in in_turns(run, target, missing(run, target))]


def test_the_table_of_what_comes_soon_is_made_first(run):
    soon, later = turns(run, "reproduce-bfm")
    assert soon == ["faces", "networks", "predictions", "bfm"]
    assert later == ["images", "mobileface", "bfm"]
    finish(run, *soon)
    assert turns(run, "reproduce-bfm") == [later], "it is there"
    finish(run, *later)
    assert turns(run, "reproduce-bfm") == [[]]
    without = replace(run, build=run.build / "other", without=("MOBILEFACE",))
    assert turns(without, "reproduce-bfm") == [soon]
    assert len(turns(run, "ablation")) == 1
    flame = replace(run, track="flame")
    assert turns(flame, "reproduce-flame")[1][-1] == "flame"
    quick = replace(flame, without=("MEDIAPIPE", "RINGNET"))
    assert turns(quick, "reproduce-flame")[0][-1] == "celeba-flame-stand-in"


def test_progress_says_which_stage_of_how_many_and_how_long_the_rest_takes(run):
    stages = [stage_of("bfm", name) for name in ("faces", "networks", "bfm")]
    assert progress_line(stages, 3, {}) == "Stage 1 of 3: faces"
    line = progress_line(stages[1:], 3, {"bfm/networks": 200.0, "bfm/bfm": 40.0})
    assert line == "Stage 2 of 3: networks, about 4 min 0 s left"
    assert progress_line(stages[1:], 3, {"bfm/bfm": 40.0}).endswith("about 40 s left or more")
    assert usual_seconds(run) == {}
    assert usual_seconds(replace(run, preset=PAPER, results=ROOT / "results"))["bfm/networks"] > 30


def test_a_damaged_manifest_and_stages_of_other_tracks_do_not_mislead_progress(run):
    for folder, track, seconds in (("bfm", "bfm", 300.0), ("celeba", "celeba", 8.0)):
        record = {"stage": "mobileface", "seconds": seconds, "build": f"{track}-smoke-paper-seed0"}
        made = {"preset": {"name": "smoke"}, "track": track, "stages": [record]}
        write_json(run.model_results / folder / "manifest.json", made)
    (run.model_results / "flame").mkdir()
    (run.model_results / "flame" / "manifest.json").write_text("{")
    assert usual_seconds(run) == {"bfm/mobileface": 300.0, "celeba/mobileface": 8.0}


def test_other_seeds_are_trained_where_they_are_asked_for(run):
    run = replace(run, without=("MOBILEFACE",))
    finish(run, "faces", "networks", "predictions", "bfm")
    assert would_run(run, "reproduce-bfm") == []
    assert would_run(run, "reproduce-bfm", seeds=3) == ["seed", "seeds", "bfm"]
    assert would_run(run, "seeds") == ["seed", "seeds", "rounding"]
    finish(replace(run, seeds=3), "seed", "seeds", "bfm")
    assert would_run(run, "reproduce-bfm", seeds=3) == would_run(run, "reproduce-bfm") == []
    assert would_run(run, "reproduce-bfm", seeds=4) == ["seeds", "bfm"]


def test_what_was_made_of_another_run_of_a_stage_is_run_again(run):
    finish(run, "faces", "networks", "predictions", "bfm")
    record = {"started": "later", "needs": needs_of(run, "networks"), "inputs": {}}
    write_json(run.record_file("networks"), with_checksum(record))
    assert would_run(run, "reproduce-bfm", without=("MOBILEFACE",)) == ["predictions", "bfm"]


def test_the_audit_always_runs_after_what_it_needs(run):
    run = replace(run, without=("MOBILEFACE",))
    finish(run, "faces", "networks", "predictions", "bfm")
    assert would_run(run, "ablation") == ["ablation"]
    assert would_run(run, "audit") == ["ablation", "audit"]
    finish(run, "ablation")
    assert would_run(run, "ablation") == ["ablation"]
    assert would_run(run, "audit") == ["audit"]
    run.record_file("predictions").unlink()
    assert would_run(run, "audit") == ["predictions", "bfm", "audit"]


def test_the_flame_track_runs_what_is_missing(run):
    run = replace(run, track="flame")
    assert {*would_run(run, "reproduce-flame")} == {
        *("frames", "networks", "scans", "predictions", "mediapipe", "rings", "ringnet", "flame"),
        "celeba-flame-stand-in",
    }
    assert "celeba-flame-stand-in" not in would_run(run, "reproduce-flame", tf_flame=str(ROOT))
    drawn = "celeba-flame-stand-in"
    finish(run, "frames", "networks", "scans", "predictions", "flame", drawn)

    def without(*names, **changes):
        return would_run(run, "reproduce-flame", without=names, **changes)

    assert without("RINGNET", "MEDIAPIPE") == []
    assert without("RINGNET") == ["mediapipe", "flame"]
    assert without("MEDIAPIPE") == ["rings", "ringnet", "flame", drawn]
    licensed = without("MEDIAPIPE", ringnet="x/ring_6_68641")
    assert licensed == ["ringnet-licensed", "flame", drawn]


def test_the_celeba_experiment_takes_the_networks_of_the_bfm_track(run):
    finish(run, "faces", "images", "networks", "mobileface")
    run = replace(run, track="celeba")
    everything = ["photos", "predictions", "mobileface", "celeba"]
    assert would_run(run, "reproduce-celeba") == everything
    alone = would_run(run, "reproduce-celeba", without=("MOBILEFACE",))
    assert alone == ["photos", "predictions", "celeba"]
    figure = would_run(
        run, "reproduce-celeba", tf_flame=str(ROOT), without=("MOBILEFACE", "RINGNET")
    )
    assert {*figure} == {*alone, "frames", "networks", "celeba-flame"}


def test_data_sets_are_found_in_the_folder_of_data_and_have_folders_of_their_own(tmp_path):
    (tmp_path / "CelebA" / "img_align_celeba").mkdir(parents=True)
    (tmp_path / "COMA_data").mkdir()
    for track, given in (
        ("celeba", ["--data", str(tmp_path)]),
        ("celeba", ["--data", str(tmp_path / "CelebA")]),
        ("celeba", ["--celeba", str(tmp_path / "CelebA")]),
        ("bfm", ["--data", str(tmp_path)]),
    ):
        found = parse_run("", ["--track", track, *given])
        assert found.celeba == str(tmp_path / "CelebA"), given
        assert found.work.name.endswith("seed0-real") == (track == "celeba")
    flame = parse_run("", ["--track", "flame", "--data", str(tmp_path)])
    assert flame.coma == str(tmp_path / "COMA_data") and flame.work.name.endswith("seed0-coma")
    assert parse_run("", ["--track", "celeba"]).celeba is None


# What it is made of.


def weights(folder, content, track="bfm"):
    folder.mkdir()
    for name in AUTHORS_FILES[track]:
        (folder / name).write_bytes(content)
    return str(folder)


def test_other_weights_of_the_authors_make_their_row_anew(run, tmp_path):
    run = replace(run, without=("MOBILEFACE",))
    finish(run, "faces", "networks", "predictions", "bfm")
    first, same, other = (weights(tmp_path / n, n[:1].encode()) for n in ("a", "a2", "b"))
    anew = ["authors", "predictions", "bfm"]
    assert would_run(run, "reproduce-bfm", authors=first) == anew
    finish(replace(run, authors=first), *anew)
    assert would_run(run, "reproduce-bfm", authors=first) == []
    assert would_run(run, "reproduce-bfm", authors=same) == []
    assert would_run(run, "reproduce-bfm", authors=other) == anew
    assert would_run(run, "reproduce-bfm") == []  # a row that is there may stay
    # Predictions made without are not taken for those with them.
    finish(run, "predictions", "bfm")
    assert would_run(run, "reproduce-bfm", authors=first) == ["predictions", "bfm"]


def test_another_face_model_is_refused_in_the_folder_of_the_first(run, tmp_path):
    first, other = tmp_path / "a.mat", tmp_path / "b.mat"
    first.write_bytes(b"a face model")
    other.write_bytes(b"another one")
    run = replace(run, model="bfm2009", data=str(first), without=("MOBILEFACE",))
    finish(run, "faces", "networks", "predictions", "bfm")
    assert would_run(run, "reproduce-bfm") == []
    moved = first.rename(tmp_path / "c.mat")
    assert would_run(run, "reproduce-bfm", data=str(moved)) == []
    with pytest.raises(InputError, match=r"DATA=.*b\.mat must be what .*bfm2009.* was made of"):
        missing(replace(run, data=str(other)), "reproduce-bfm")


def test_other_data_sets_are_refused_by_the_names_and_sizes_of_their_files(run, tmp_path):
    def celeba(name, *photos):
        (tmp_path / name / "img_align_celeba").mkdir(parents=True)
        for photo, content in photos:
            (tmp_path / name / "img_align_celeba" / photo).write_bytes(content)
        return replace(run, track="celeba", celeba=str(tmp_path / name))

    first = celeba("first", ("000001.jpg", b"12"))
    finish(first, "photos")
    assert is_done(celeba("copy", ("000001.jpg", b"34")), "photos")
    for number, photos in enumerate([[("000001.jpg", b"123")], [("000002.jpg", b"12")]]):
        with pytest.raises(InputError, match="CELEBA=.* must be what .*-real was made of"):
            check_key(celeba(f"other{number}", *photos), "photos")
    # Another table of scans is no other data set: it is for their stage to run again.
    assert "CASIA_INDEX" in stage_of("flame", "scans").reads


@pytest.mark.parametrize("option", ["data", "coma", "casia", "celeba", "tf-flame", "casia-index"])
@pytest.mark.parametrize("command", [["make", "reproduce-bfm"], ["show"], ["faces"]])
def test_a_path_that_does_not_exist_is_refused_whatever_is_done(run, capsys, option, command):
    finish(run, "faces", "networks", "predictions", "bfm")
    folders = ["--preset", "smoke", "--build", str(run.build), "--results", str(run.results)]
    with pytest.raises(SystemExit) as ended:
        main([*command, *folders, "--without", "MOBILEFACE", f"--{option}", "/nonexistent"])
    said = capsys.readouterr().err
    assert ended.value.code == 2 and said.count("\n") == 1
    assert said.startswith(f"error: --{option} must be") and "/nonexistent" in said


@pytest.mark.slow
def test_unusable_weights_of_the_authors_are_found_before_the_long_work(tmp_path):
    command = [sys.executable, "-m", "experiments", "make"]
    command += runs.arguments("reproduce-bfm", tmp_path)
    given = ["--authors", weights(tmp_path / "authors", b"no weights")]
    refused = subprocess.run(
        [*command, *given], cwd=ROOT, env=runs.ENVIRONMENT, capture_output=True, text=True
    )
    assert refused.returncode == 2 and refused.stderr.count("\n") == 1
    assert "AE_occ2orth_BFM.h5 must be a Keras 2 weight file" in refused.stderr
    assert not [*tmp_path.rglob("faces.json")] + [*tmp_path.rglob("*.npz")]


def test_a_command_that_is_ended_leaves_no_stage_at_work(run, tmp_path):
    run = replace(run, preset=TINY)
    command = [sys.executable, "-m", "experiments", "make"]
    command += runs.arguments("reproduce-bfm", tmp_path, "--without", "MOBILEFACE")
    quiet = {"stdout": subprocess.DEVNULL, "cwd": ROOT, "env": runs.ENVIRONMENT}
    with subprocess.Popen(command, **quiet) as ours:
        while not run.record_file("faces").exists():
            assert ours.poll() is None
            time.sleep(0.05)
        time.sleep(1)  # for the next stage to start
        ours.terminate()
    assert ours.returncode == 128 + signal.SIGTERM
    with locked(run.work):
        assert not run.record_file("networks").exists()
