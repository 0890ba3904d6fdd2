"""Tasks on a cluster whose workers come and go: the same files, and refusals of what is no cluster.

Every scheduler and worker is a process of its own.
"""

import os
import shutil
import signal
import socket
import subprocess
import sys

import clusters
import distributed
import faults
import pytest
import runs
from places import ROOT

from deepmds_keras.io.archives import read_arrays
from deepmds_keras.io.errors import InputError
from experiments.tasks import unordered

pytestmark = pytest.mark.slow
_COMMAND = """
import sys
from experiments.running import exit_on_user_error
from experiments.tasks import unordered
sys.modules |= dict.fromkeys(sys.argv[1:])
with exit_on_user_error():
    print(*unordered(-1, abs, [(-1,)]))
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
def copy_of_whole(smoke_bfm, tmp_path):
    """A copy of the undisturbed run, without images, tables and their records."""
    folder = tmp_path / "run"
    shutil.copytree(smoke_bfm.folder / "build", folder / "build")
    (work,) = folder.glob("build/*/*")
    shutil.rmtree(work / "images")
    for name in ("images", "mobileface", "bfm"):
        (work / f"{name}.json").unlink()
    return folder


def finish(process):
    said = process.communicate(timeout=600)[0]
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
    done = runs.run("bfm", folder, "--preset", "smoke")
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


def test_images_are_the_same_though_dask_loses_a_worker(dask, client, copy_of_whole, smoke_bfm):
    def at_work():
        return [address for address, tasks in client.processing().items() if tasks]

    dask.add_worker()
    client.wait_for_workers(3, timeout=60)
    processes = client.run(os.getpid)
    command = dask.start("images", copy_of_whole)
    clusters.wait_until(lambda: images_of_test_faces(copy_of_whole), command)
    busy = clusters.wait_until(lambda: at_work(), command)[0]
    os.kill(processes[busy], signal.SIGKILL)
    assert command.poll() is None
    finish(command)
    assert len(client.scheduler_info()["workers"]) == 2
    assert_as_undisturbed(copy_of_whole, smoke_bfm.folder)


def test_images_are_the_same_though_ray_loses_a_worker(tmp_path, copy_of_whole, smoke_bfm):
    folder = tmp_path / "ray"
    folder.mkdir()

    def at_work(ray):
        own = clusters.family(ray.processes[0])
        return [process for process in own if process.name().startswith("ray::PoolActor.run")]

    with clusters.ray_cluster(folder) as ray:
        command = ray.start("images", copy_of_whole)
        clusters.wait_until(
            lambda: images_of_test_faces(copy_of_whole) and alone(at_work(ray)), command
        ).kill()
        assert command.poll() is None
        finish(command)
    assert_as_undisturbed(copy_of_whole, smoke_bfm.folder)


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
    done = runs.run("stream", alone, "--preset", "smoke", "--jobs", "1")
    assert done.returncode == 0, done.stderr
    files = sorted(alone.rglob("stream/*/*.npz"))
    assert len(files) == 20
    for path in [*files, next(alone.rglob("stream/table.csv"))]:
        other = copy_of_whole / path.relative_to(alone)
        assert path.read_bytes() == other.read_bytes(), path


def test_a_task_is_done_again_where_its_worker_was_lost(dask, client, monkeypatch):
    """In the place and by the settings of the command."""
    monkeypatch.setenv("TF_ENABLE_ONEDNN_OPTS", "0")
    before, lost, results = set(), None, []
    for own, *result in unordered(-1, clusters.told, ((k,) for k in range(30))):
        results.append(tuple(result))
        before.add(own)
        if len(before) == 2 and lost is None:
            lost = own
            os.kill(lost, signal.SIGKILL)
    assert sorted(results) == [(k, os.getcwd(), "0") for k in range(30)]
    assert before >= {lost} and len(client.scheduler_info()["workers"]) == 1


def test_what_a_task_refuses_is_refused_here(dask, client):
    with pytest.raises(InputError, match=r"^k must be below 3\. Received 3\.$"):
        list(unordered(-1, clusters.refused, ((k,) for k in range(8))))


def test_a_cluster_that_goes_away_is_refused(dask, client):
    client.close()
    with pytest.raises(InputError, match="DASK_ADDRESS=.* must stay in reach"):
        for _ in unordered(-1, clusters.told, ((k,) for k in range(100))):
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
            cwd=ROOT, capture_output=True, text=True,
            env=clusters.ALONE | {k: value.format(**at) for k, value in environment.items()},
        )  # fmt: skip
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr.startswith("error: ") and done.stderr.count("\n") == 1
    assert words in done.stderr


@pytest.mark.parametrize("name", ["", "loky"])
def test_without_a_name_the_tasks_stay_on_this_machine(name, monkeypatch):
    monkeypatch.setenv("JOBLIB_BACKEND", name)
    assert sorted(unordered(2, abs, ((-k,) for k in range(4)))) == [0, 1, 2, 3]
