"""Times are of all methods, in turns, on one thread."""

import runs
from places import python

from deepmds_keras.files import read_arrays
from experiments.records import read_record

_STEP = """
import sys, numpy, tensorflow
from threadpoolctl import threadpool_info
from experiments.presets import TINY
from experiments.run import Run
from experiments.tracks import times

order = []
class Model:
    def __init__(self, name):
        self.name = name
    def predict(self, seen):
        threads = tensorflow.config.threading
        assert threads.get_intra_op_parallelism_threads() == 1
        assert threads.get_inter_op_parallelism_threads() == 1
        assert all(pool["num_threads"] == 1 for pool in threadpool_info())
        order.append(self.name)
        return seen

times.load = lambda run, name: Model(name)
times.inputs_for = lambda run, method: numpy.zeros((3, 72, 2))
timed = times.main(Run(preset=TINY), "mean_shape", "mobileface")["times"]
print(*order, *timed)
"""


def test_methods_take_turns_on_one_thread():
    done = python("-c", _STEP)
    assert done.returncode == 0, done.stderr
    assert done.stdout.split() == 3 * ["mean_shape", "mobileface"]


def test_every_method_is_timed_in_this_step_alone(whole_bfm):
    work = runs.work(whole_bfm, "bfm")
    times = read_record(work / "records" / "times.json")["times"]
    predictions = {path.stem: path for path in (work / "predictions").glob("*.npz")}
    assert times.keys() == predictions.keys() and "mobileface" in times
    assert not any("ms_per_face" in read_arrays(path)[1] for path in predictions.values())
