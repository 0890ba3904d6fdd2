"""Tasks on a cluster whose workers come and go: the same files, and refusals of what is no cluster.

Every scheduler and worker is a process of its own that does not know where the repository is.
"""

import os
import shutil
import signal
import socket
import subprocess
import sys
import time

import clusters
import distributed
import faults
import numpy as np
import pytest
from joblib import Parallel, delayed, effective_n_jobs

from deepmds_keras.io.errors import InputError
from deepmds_keras.weights import read_arrays
from experiments.cluster import cluster

_COMMAND = """
import sys
from experiments.cluster import cluster
from experiments.refusals import refusals_on_one_line
sys.modules |= dict.fromkeys(sys.argv[1:])
with refusals_on_one_line(), cluster():
    print("within")
"""


@pytest.fixture
def dask(tmp_path, monkeypatch):
    folder = tmp_path / "dask"
    folder.mkdir()
    with clusters.dask_cluster(folder) as started:
        for name, value in started.environment.items():
            monkeypatch.setenv(name, value)
        yield started


@pytest.fixture
def client(dask):
    """The scheduler's own word on who does what."""
    with distributed.Client(dask.environment["DASK_ADDRESS"], set_as_default=False) as own:
        own.wait_for_workers(2, timeout=60)
        own.get_task_stream()  # what was done is told from here on
        yield own


@pytest.fixture
def copy_of_whole(whole_bfm, tmp_path):
    """A copy of the undisturbed run, with its networks but without images, tables and records.

    Of the predictions, those are left out that take no other network to be loaded.
    """
    folder = tmp_path / "run"
    shutil.copytree(whole_bfm.folder / "build", folder / "build")
    (work,) = folder.glob("build/*/*")
    shutil.rmtree(work / "images")
    for name in ("images", "predictions", "mobileface", "bfm"):
        (work / f"{name}.json").unlink()
    for name in ("mean_shape", "linear", "aldrian", "ours"):
        (work / "predictions" / f"{name}.npz").unlink()
    return folder


def finish(process):
    said = process.communicate(timeout=100)[0]
    assert process.returncode == 0, said


def images_of_test_faces(folder):
    """The first of two files of images to be there: the other has eight times as many."""
    return next((folder / "build").glob("*/*/images/test/0000.npy"), None)


def alone(found):
    return found[0] if len(found) == 1 else None


def assert_as_undisturbed(folder, whole):
    """The experiment's last stages, here, make the same tables of the same files."""
    (record,) = whole.glob("build/*/*/mobileface.json")  # whose predictions were kept
    shutil.copy(record, folder / record.relative_to(whole))
    done = faults.run("bfm", folder)
    assert done.returncode == 0, done.stderr
    assert len(faults.tables(folder)) >= 3
    assert faults.tables(folder) == faults.tables(whole)
    arrays = sorted((folder / "build").rglob("*.np[yz]"))
    for path in arrays:
        other = whole / path.relative_to(folder)
        if path.parent.name == "predictions":  # which tell how long they took
            assert faults.same(read_arrays(path)[0], read_arrays(other)[0]), path
        else:
            assert path.read_bytes() == other.read_bytes(), path
    assert sum(path.suffix == ".npy" for path in arrays) == 4


def test_tables_are_the_same_though_dask_loses_workers(dask, client, copy_of_whole, whole_bfm):
    processes = client.run(os.getpid)

    def both_have_done_some():
        return len({task["worker"] for task in client.get_task_stream()}) == 2

    def at_work():
        return [address for address, tasks in client.processing().items() if tasks]

    command = dask.start("predictions", copy_of_whole)
    busy, *_ = clusters.wait_until(lambda: both_have_done_some() and at_work(), command)
    os.kill(processes[busy], signal.SIGKILL)
    assert command.poll() is None
    finish(command)
    # One that joins late does its part, too, and then all that is left.
    dask.add_worker()
    client.wait_for_workers(2, timeout=60)
    processes = client.run(os.getpid)
    command = dask.start("images", copy_of_whole)
    busy = clusters.wait_until(
        lambda: images_of_test_faces(copy_of_whole) and alone(at_work()), command
    )
    os.kill(processes[busy], signal.SIGKILL)
    assert command.poll() is None
    finish(command)
    assert len(client.scheduler_info()["workers"]) == 1
    assert_as_undisturbed(copy_of_whole, whole_bfm.folder)


def test_tables_are_the_same_though_ray_loses_a_worker(tmp_path, copy_of_whole, whole_bfm):
    folder = tmp_path / "ray"
    folder.mkdir()

    def at_work(ray):
        own = clusters.family(ray.processes[0])
        return [process for process in own if process.name().startswith("ray::do")]

    with clusters.ray_cluster(folder) as ray:
        finish(ray.start("predictions", copy_of_whole))
        command = ray.start("images", copy_of_whole)
        clusters.wait_until(
            lambda: images_of_test_faces(copy_of_whole) and alone(at_work(ray)), command
        ).kill()
        assert command.poll() is None
        finish(command)
    assert_as_undisturbed(copy_of_whole, whole_bfm.folder)


def test_a_stream_is_the_same_though_dask_loses_a_worker(dask, client, copy_of_whole, tmp_path):
    alone = tmp_path / "alone"
    shutil.copytree(copy_of_whole, alone)
    processes = client.run(os.getpid)
    command = dask.start("stream", copy_of_whole)
    clusters.wait_until(lambda: [*copy_of_whole.rglob("stream/shapes-*/*.npz")], command)
    busy = next(address for address, tasks in client.processing().items() if tasks)
    os.kill(processes[busy], signal.SIGKILL)
    assert command.poll() is None
    finish(command)
    done = faults.run("stream", alone, "--jobs", "1")
    assert done.returncode == 0, done.stderr
    files = sorted(alone.rglob("stream/*/*.npz"))
    assert len(files) == 20
    for path in [*files, next(alone.rglob("stream/table.csv"))]:
        other = copy_of_whole / path.relative_to(alone)
        assert path.read_bytes() == other.read_bytes(), path


def test_a_task_is_done_again_with_its_large_arguments(dask, client, monkeypatch):
    """Wherever its worker was lost, as in the place and by the settings of the command."""
    monkeypatch.setenv("TF_ENABLE_ONEDNN_OPTS", "0")
    large = np.ones(500_000)

    def work(large, k, *, factor):
        time.sleep(0.05)
        place = os.getcwd(), os.environ["TF_ENABLE_ONEDNN_OPTS"]
        return os.getpid(), place, factor * k * large.sum()

    tasks = (delayed(work)(large, k, factor=2) for k in range(30))
    before, lost, results = set(), None, []
    with cluster():
        for own, *result in Parallel(-1, return_as="generator_unordered")(tasks):
            results.append(tuple(result))
            before.add(own)
            if len(before) == 2 and lost is None:
                lost = own
                os.kill(lost, signal.SIGKILL)
    place = os.getcwd(), "0"
    assert sorted(results) == [(place, 1e6 * k) for k in range(30)]
    assert before >= {lost} and len(client.scheduler_info()["workers"]) == 1


def test_any_number_of_jobs_but_one_is_for_the_whole_cluster(dask, client):
    with cluster():
        assert [effective_n_jobs(n) for n in (-1, 8, 1, None)] == [2, 2, 1, 1]
        here = Parallel(1)(delayed(lambda: os.getpid())() for _ in range(3))
        there = Parallel(-1)(delayed(lambda: os.getpid())() for _ in range(3))
    assert {*here} == {os.getpid()}
    assert {*there} <= {*client.run(os.getpid).values()}


def test_what_a_task_refuses_is_refused_here(dask, client):
    def work(k):
        if k == 3:
            raise InputError("k must be below 3. Received 3.")

    with pytest.raises(InputError, match=r"^k must be below 3\. Received 3\.$"), cluster():
        Parallel(-1)(delayed(work)(k) for k in range(8))


def test_a_cluster_that_goes_away_is_refused(dask, client):
    def work():
        time.sleep(0.2)

    client.close()
    with pytest.raises(InputError, match="DASK_ADDRESS=.* must stay in reach"), cluster():
        for _ in Parallel(-1, return_as="generator")(delayed(work)() for _ in range(20)):
            dask.end()


@pytest.mark.parametrize(
    ("environment", "missing", "words"),
    [
        ({"JOBLIB_BACKEND": "spark"}, (), "JOBLIB_BACKEND must be one of loky, dask, ray. Rec"),
        ({"JOBLIB_BACKEND": "dask"}, (), "DASK_ADDRESS must be the address of the cluster, suc"),
        ({"JOBLIB_BACKEND": "ray"}, (), "RAY_ADDRESS must be the address of the cluster, such a"),
        ({"JOBLIB_BACKEND": "dask", "DASK_ADDRESS": "{free}"}, (), "Connection refused"),
        ({"JOBLIB_BACKEND": "ray", "RAY_ADDRESS": "{free}"}, (), "Connection refused"),
        ({"JOBLIB_BACKEND": "dask", "DASK_ADDRESS": "nowhere"}, (), "nowhere: no host and port"),
        ({"JOBLIB_BACKEND": "dask", "DASK_ADDRESS": "{open}"}, ("distributed",), "'.[cluster]'"),
        ({"JOBLIB_BACKEND": "ray", "RAY_ADDRESS": "{open}"}, ("ray",), "'.[cluster]'"),
    ],
)
def test_what_is_no_cluster_is_refused_on_one_line(environment, missing, words):
    with socket.create_server(("127.0.0.1", 0)) as server, socket.socket() as free:
        free.bind(("127.0.0.1", 0))  # but nobody listens
        at = {
            name: f"127.0.0.1:{own.getsockname()[1]}"
            for name, own in {"open": server, "free": free}.items()
        }
        done = subprocess.run(
            [sys.executable, "-c", _COMMAND, *missing],
            cwd=faults.ROOT, capture_output=True, text=True,
            env=clusters.ALONE | {k: value.format(**at) for k, value in environment.items()},
        )  # fmt: skip
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr.startswith("error: ") and done.stderr.count("\n") == 1
    assert words in done.stderr


def test_without_a_name_the_tasks_stay_on_this_machine(monkeypatch):
    for name in ("", "loky"):
        monkeypatch.setenv("JOBLIB_BACKEND", name)
        with cluster():
            assert effective_n_jobs(3) == 3
