"""Commands that are killed or find the disk full: the same command goes on to the same tables.

`KILLS=6 FUZZ=10` (`make nightly`) kills more often and changes ten times as many bytes.
"""

import os
import pickle
import resource
import shutil
import signal
import subprocess
import tempfile
from collections import Counter
from pathlib import Path

import numpy as np
import pytest
import runs
from places import MEDIAPIPE

from data_gen.datasets.dataset import load_dataset
from deepmds_keras.errors import InputError
from deepmds_keras.files import read_arrays
from experiments.__main__ import PARENT
from experiments.inputs import image_files
from experiments.presets import TINY
from experiments.records import read_record
from experiments.report.check_results import digits
from experiments.run import Run

KILLS = int(os.environ.get("KILLS", 4))
FLIPS = 20 * int(os.environ.get("FUZZ", 1))  # in each file
QUIET = {"stdout": subprocess.DEVNULL}
FLAME = [] if MEDIAPIPE else ["MEDIAPIPE=no"]


class Disk:
    """A folder with room for so much: a file system in memory or, where a container forbids to
    mount one, a limit on each file.

    It is not among pytest's folders, which pytest could not remove if the test were killed.
    """

    def __init__(self):
        self.folder = Path(tempfile.mkdtemp(prefix="disk-"))
        mount = ["mount", "-t", "tmpfs", "-o", "size=1g", "tmpfs", str(self.folder)]
        self.mounted = subprocess.run(mount, capture_output=True).returncode == 0

    def starve(self, process, size):
        """Leave room for so many bytes to a process that has just started."""
        if not self.mounted:
            resource.prlimit(process.pid, resource.RLIMIT_FSIZE, (size, resource.RLIM_INFINITY))
            return
        disk = os.statvfs(self.folder)
        used = (disk.f_blocks - disk.f_bfree) * disk.f_frsize
        self._resize(used + max(size, disk.f_frsize))

    def relieve(self):
        if self.mounted:
            self._resize(1 << 30)

    def close(self):
        if self.mounted:
            subprocess.run(["umount", "--lazy", str(self.folder)], check=True)
        shutil.rmtree(self.folder)

    def _resize(self, size):
        subprocess.run(["mount", "-o", f"remount,size={size}", str(self.folder)], check=True)


@pytest.fixture
def disk():
    disk = Disk()
    yield disk
    disk.close()


def tables(folder):
    """Every CSV of the results, without what tells how long something took."""
    paths = sorted((folder / "results").rglob("*.csv"))
    return {path.relative_to(folder): digits(path).to_csv() for path in paths}


@pytest.mark.slow
@pytest.mark.parametrize(
    "target, variables, before",
    [
        ("reproduce-bfm", ["MOBILEFACE=yes"], None),
        ("reproduce-flame", FLAME, None),
        ("reproduce-celeba", [], "whole_bfm"),
        ("ablation", [], "whole_bfm"),
        ("stream", ["FACES=700"], "whole_bfm"),
    ],
)
def test_what_was_killed_or_starved_goes_on_to_the_same_tables(
    target, variables, before, request, disk, tmp_path
):
    reference = tmp_path / "undisturbed"
    reference.mkdir()
    if before:
        for name in ("build", ".snakemake"):
            shutil.copytree(request.getfixturevalue(before) / name, reference / name)
            shutil.copytree(reference / name, disk.folder / name)
    assert runs.command(target, reference, *variables, stderr=None, **QUIET).wait() == 0
    rng = np.random.default_rng(len(target))
    for kill in range(KILLS):
        process = runs.command(target, disk.folder, *variables, **QUIET)
        try:
            process.wait(rng.uniform(4, 25))
        except subprocess.TimeoutExpired:
            # With all processes of its session, or alone: the others then end by themselves.
            end = os.killpg if kill % 2 else os.kill
            end(process.pid, signal.SIGKILL)
        process.communicate()
    process = runs.command(target, disk.folder, *variables, **QUIET)
    disk.starve(process, int(rng.uniform(0, 2e5)))
    errors = process.communicate()[1]
    if process.returncode:
        assert "error: " in errors and "Traceback" not in errors, errors
    disk.relieve()
    assert runs.command(target, disk.folder, *variables, stderr=None, **QUIET).wait() == 0
    assert tables(disk.folder) == tables(reference)
    left = [path for path in disk.folder.rglob(".*.partial") if "records" in path.parts]
    assert not left


@pytest.mark.slow
def test_steps_run_as_jobs_of_a_cluster(tmp_path):
    """By Snakemake's generic executor, and a script that runs jobs in another place."""
    record = "build/openhead/bfm-tiny-paper-seed0/records/train-zhao.json"
    # What clusters hand on from the machine on which `make` runs.
    environment = runs.ENVIRONMENT | {PARENT: "99999999@head-node"}

    def submitted(script):
        path = tmp_path / "submit.sh"
        path.write_text(f"#!/bin/bash\n{script}")
        path.chmod(0o755)
        cluster = f"--executor cluster-generic --cluster-generic-submit-cmd {path} --jobs 2"
        command = [*runs.SNAKEMAKE, record, *cluster.split(), "--latency-wait", "30"]
        return subprocess.run(
            [*command, "--quiet", "all", "--config", "PRESET=tiny"], cwd=tmp_path, text=True,
            env=environment, timeout=300, capture_output=True,
        )  # fmt: skip

    fails = submitted('touch "${1%/*}"/{1,2}.jobfailed\necho job-7\n')
    assert fails.returncode == 1
    assert fails.stderr.startswith(
        "error: sample faces and their views, job job-7: For further error details see the cl"
    )
    runs_them = 'echo "$1" >> jobs.txt\nsh "$1" > "$1.log" 2>&1 &\necho $!\n'
    assert submitted(runs_them).returncode == 0
    assert len((tmp_path / "jobs.txt").read_text().splitlines()) == 2
    assert read_record(tmp_path / record)["step"] == "tracks.train zhao"


# Damaged files.


def readers(run):
    """Every file that steps read, with what reads it as they do."""

    def dataset(path):
        read = load_dataset(path)
        return vars(read) | {"cameras": vars(read.cameras)}

    def images(path):
        files = image_files(run, path.parent.name)
        files.check(read_record(run.record_file("images"))["checksums"][path.parent.name])
        return files[:], files.landmarks()

    for path in sorted(run.work.rglob("[!.]*.*")):
        if path.name == "pieces-of.json":
            continue
        if path.suffix == ".json":
            yield path, read_record
        elif path.stem in ("train", "test"):
            yield path, dataset
        elif path.suffix == ".npz":
            yield path, read_arrays
        else:
            yield path, images


def test_every_changed_byte_is_reported_or_changes_nothing(whole_bfm, tmp_path):
    shutil.copytree(whole_bfm / "build", tmp_path / "build")
    run = Run("openhead", TINY, build=tmp_path / "build")
    rng, outcomes = np.random.default_rng(0), Counter()
    for path, read in readers(run):
        whole, content = path.read_bytes(), pickle.dumps(read(path))
        for position in rng.integers(0, len(whole), FLIPS):
            changed = bytearray(whole)
            changed[position] ^= 1 << rng.integers(8)
            path.write_bytes(changed)
            try:
                unnoticed = pickle.dumps(read(path))
            except InputError as error:
                assert path.name in str(error) and "\n" not in str(error), (path, position)
                outcomes[path.suffix, "reported"] += 1
            else:  # in what nobody reads: times in an archive, the layout of a record
                assert content == unnoticed, (path, position)
                outcomes[path.suffix, "harmless"] += 1
        path.write_bytes(whole)
    assert outcomes[".npy", "harmless"] == 0
    assert outcomes[".json", "reported"] > 3 * outcomes[".json", "harmless"]


@pytest.mark.parametrize("text", ["", "[]", "{", "3", "null", "[" * 100_000, "\0"])
def test_what_is_no_record_is_named(tmp_path, text):
    path = tmp_path / "faces.json"
    path.write_text(text)
    with pytest.raises(InputError, match=r"faces\.json must be an unchanged record"):
        read_record(path)
