"""Runs that are killed, starved of space, damaged and run twice at once: nothing wrong comes out.

`KILLS=30 FUZZ=10` (`make nightly`) kills stages three times as often and changes ten times as many
bytes.
"""

import os
import shutil
from collections import Counter

import faults
import numpy as np
import pytest
import runs
from places import MEDIAPIPE

from data_gen.datasets.dataset import load_dataset
from deepmds_keras.io.archives import read_arrays
from deepmds_keras.io.errors import InputError
from experiments.inputs import image_files
from experiments.manifest import MANIFEST, files_of, read_manifest
from experiments.presets import TINY
from experiments.records import load_record, read_record, with_checksum, write_json
from experiments.run import Run
from experiments.running import locked

KILLS = int(os.environ.get("KILLS", 10))
FLIPS = 20 * int(os.environ.get("FUZZ", 1))  # in each file
_BFM = ("faces", "networks", "predictions", "images", "mobileface", "bfm")
_FLAME = ["frames", "scans", "networks", "predictions", "rings", "ringnet", "flame"]
if MEDIAPIPE:
    _FLAME.insert(2, "mediapipe")
_SMOKE = ("--preset", "smoke")
# Arguments and stages of an experiment; those of other tracks go on from the build of "bfm".
EXPERIMENTS = {
    "bfm": (_SMOKE, _BFM),
    "flame": ((*_SMOKE, "--track", "flame"), _FLAME),
    "celeba": ((*_SMOKE, "--track", "celeba"), ("photos", "predictions", "mobileface", "celeba")),
    "ablation": (_SMOKE, ("ablation",)),
    "stream": ((*_SMOKE, "--faces", "700"), ("stream",)),
}
CHECKPOINTS = {"networks", "ablation"}  # folders of what is written again and again
_PASSES = -(-KILLS // 12)  # of the longest
STORMS = [
    (name, number) for name in EXPERIMENTS for number in range(_PASSES if name == "bfm" else 1)
]


@pytest.fixture(
    scope="module",
    params=[pytest.param(own, marks=pytest.mark.slow) for own in ("quick", *STORMS)],
    ids=lambda own: own if own == "quick" else f"{own[0]}-{own[1]}",
)
def storm(request, tmp_path_factory):
    """An experiment, done in spite of everything; in every second pass with a single thread.

    The quick one is of two stages, at the smallest size.
    """
    disk = faults.Disk(tmp_path_factory.mktemp("storm") / "disk")
    if request.param == "quick":
        whole, number = request.getfixturevalue("whole_bfm"), 1
        name, more, stages, kills = "bfm", ("--jobs", "1"), ("networks", "bfm"), 2
        shutil.copytree(whole.folder / "build", disk.folder / "build")
    else:
        whole, (name, number) = request.getfixturevalue("smoke_bfm"), request.param
        more, stages = EXPERIMENTS[name]
        kills = len(range(number, KILLS, _PASSES)) if name == "bfm" else KILLS // 5
    if name != "bfm":
        folder = tmp_path_factory.mktemp(name)
        for own in (folder, disk.folder) if name != "flame" else ():
            shutil.copytree(whole.folder / "build", own / "build")
        whole = runs.measure(stages, folder, *more)
    storm = faults.Storm(whole, disk, np.random.default_rng([number, len(stages)]), more)
    storm.pass_over(stages, kills, faults.ONE_THREAD if number % 2 == 0 else {})
    print(f"\n{name}, pass {number}:", dict(Counter(event.what for event in storm.events)))
    yield storm
    disk.close()


def test_the_tables_are_those_of_an_undisturbed_run(storm):
    """Whatever happened on the way, and with one thread as with many."""
    tables = faults.tables(storm.folder)
    assert tables
    for name, rows in tables.items():
        assert rows == faults.tables(storm.reference.folder)[name], name
    build = storm.folder / "build"
    for path in sorted(build.rglob("*.np[yz]")):
        other = storm.reference.folder / "build" / path.relative_to(build)
        if path.parent.name == "predictions":  # which tell how long they took
            assert faults.same(read_arrays(path)[0], read_arrays(other)[0]), path
        else:
            assert path.read_bytes() == other.read_bytes(), path


def test_stages_were_killed_in_the_middle_of_their_work(storm):
    kills = [event for event in storm.events if event.what.startswith("killed")]
    assert all(event.status == -9 for event in kills)
    # Some had written something, and none took away or changed what other stages had.
    assert any(event.added or event.changed for event in kills)
    for event in kills:
        others = event.changed - storm.reference.sizes[event.stage].keys()
        assert {path.parent.name for path in others} <= CHECKPOINTS, event.stage


def test_a_full_disk_ends_each_stage_with_one_line_and_earlier_files_whole(storm):
    starved = [event for event in storm.events if event.what == "full disk"]
    assert {event.stage for event in starved} == {event.stage for event in storm.events}
    for event in starved:
        line = event.said.splitlines()[-1]
        assert (event.status, event.said.count("error: ")) == (2, 1), event.said
        _, _, line = line.partition("error: ")  # after the bar of a process that was ended
        assert "No space left on device. " in line or "File too large. " in line, line
        assert "Free some space and run again" in line
        assert "Traceback" not in event.said
        assert {path.parent.name for path in event.changed} <= CHECKPOINTS


def test_of_two_runs_in_one_folder_one_gives_way(storm):
    for stage in {*faults.LONG} & {event.stage for event in storm.events}:
        last = [event for event in storm.events if event.stage == stage][-2:]
        assert [(event.what, event.status) for event in last] == [("refused", 2), ("done", 0)]
        assert "is in use by another run" in last[0].said.splitlines()[-1]
        assert "Traceback" not in last[0].said


def test_nothing_half_written_and_no_lock_is_left(storm):
    build = storm.folder / "build"
    assert not [path for path in build.rglob("*") if path.suffix in (".tmp", ".partial")]
    for lock in storm.folder.rglob(".lock"):
        with locked(lock.parent):
            pass
    for folder in {path.parent for path in storm.folder.rglob(MANIFEST)}:
        assert read_manifest(folder)["files"] == files_of(folder)


@pytest.mark.slow
def test_one_thread_and_one_process_give_the_digits_of_many(whole_bfm, tmp_path):
    """The others were forked, too, from a process that had loaded its libraries."""
    for stage in _BFM:
        done = runs.Stage(stage, tmp_path, "--jobs", "1", environment=faults.ONE_THREAD).done()
        assert done.returncode == 0, done.stderr
    assert faults.tables(tmp_path) == faults.tables(whole_bfm.folder)


def readers(run):
    """Every file that stages read, with what reads it as they do."""

    def dataset(path):
        read = load_dataset(path)
        return vars(read) | {"cameras": vars(read.cameras)}

    for path in sorted(run.work.rglob("[!.]*.*")):
        if path.suffix == ".json":
            yield path, read_record
        elif path.stem in ("train", "test"):
            yield path, dataset
        elif path.suffix == ".npz":
            yield path, read_arrays
        else:

            def images(path):
                files = image_files(run, path.parent.name)
                files.check(load_record(run, "images")["checksums"][path.parent.name])
                return files[:], files.landmarks(range(len(files)))

            yield path, images


def test_every_changed_byte_is_reported_or_changes_nothing(whole_bfm, tmp_path):
    shutil.copytree(whole_bfm.folder / "build", tmp_path / "build")
    run = Run("openhead", TINY, build=tmp_path / "build")
    rng = np.random.default_rng(0)
    outcomes = Counter()
    for path, read in readers(run):
        whole, content = path.read_bytes(), read(path)
        for position, bits in faults.flips(whole, FLIPS, rng):
            changed = bytearray(whole)
            changed[position] ^= bits
            path.write_bytes(changed)
            try:
                unnoticed = read(path)
            except InputError as error:
                assert path.name in str(error) and "\n" not in str(error), (path, position)
                outcomes[path.suffix, "reported"] += 1
            else:
                # In what nobody reads: times in an archive, the layout of a record.
                extra = {"path": path, "position": position, "bits": bits}
                assert harmless(path, content, unnoticed), extra
                outcomes[path.suffix, "harmless"] += 1
        path.write_bytes(whole)
    print("\nbytes changed:", dict(outcomes))
    assert outcomes[".npy", "harmless"] == 0
    assert outcomes[".json", "reported"] > 3 * outcomes[".json", "harmless"]


def harmless(path, content, unnoticed):
    if path.suffix == ".json":  # whose checksum itself has another name
        return content.items() <= unnoticed.items() and len(unnoticed) <= len(content) + 1
    return faults.same(content, unnoticed)


@pytest.fixture
def copy(whole_bfm, tmp_path):
    for name in ("build", "results"):
        shutil.copytree(whole_bfm.folder / name, tmp_path / name)
    return tmp_path


@pytest.mark.parametrize(
    ("name", "stage"),
    [("networks/dissimilarity-paper-constant.npz", "networks"), ("predictions.json", "bfm")],
)
def test_a_stage_names_the_damaged_file_that_it_reads(copy, name, stage):
    """Also where another process of the stage reads it."""
    (path,) = copy.rglob(name)
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 1
    path.write_bytes(content)
    before = faults.tables(copy)
    refused = runs.run(stage, copy)
    assert refused.returncode == 2
    assert str(path) in refused.stderr.splitlines()[-1]
    assert "Traceback" not in refused.stderr
    assert faults.tables(copy) == before


@pytest.mark.slow
def test_two_seeds_at_once_write_what_they_write_alone(whole_bfm, copy):
    """One file of theirs is the same: the table of parameters."""
    work = runs.work(copy, "bfm")
    shutil.copytree(work, work.with_name(work.name.replace("seed0", "seed1")))
    running = [runs.Stage("bfm", copy, "--seed", seed) for seed in "01"]
    ended = [stage.done() for stage in running]
    assert [done.returncode for done in ended] == [0, 0], ended
    tables = faults.tables(copy)
    for name, rows in faults.tables(whole_bfm.folder).items():
        assert tables[name] == rows, name
    for name in ("bfm", "bfm-seed1", "parameters"):
        folder = runs.results(copy, name)
        assert read_manifest(folder)["files"] == files_of(folder)
        assert "table.csv" in files_of(folder)


def test_a_record_of_an_earlier_version_is_read_and_other_texts_are_not(tmp_path):
    path = tmp_path / "faces.json"
    record = {"rows": [["ours", "mse", 0.1]], "seconds": 1.5, "text": "é", "by_epoch": {1: 2}}
    as_read = record | {"by_epoch": {"1": 2}}
    for written in (record, with_checksum(record)):
        write_json(path, written)
        assert read_record(path) == as_read
    write_json(path, with_checksum(record) | {"seconds": 1.6})
    with pytest.raises(InputError, match="faces.json must be a record as it was written"):
        read_record(path)
    for text in ("", "[]", "{", "3", "null", "[" * 100_000, "\0"):
        path.write_text(text)
        with pytest.raises(InputError, match="faces.json must be a record as it was written"):
            read_record(path)
    path.unlink()
    with pytest.raises(InputError, match="faces.json must be there"):
        read_record(path)
