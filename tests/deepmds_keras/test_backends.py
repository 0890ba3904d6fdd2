"""The networks train behind either backend of Keras, and the same weights give the same shapes."""

import json
import re

import numpy as np
import pytest
from places import python

from deepmds_keras.errors import InputError, needs

BACKENDS = ("tensorflow", "jax")
# Trains both methods for a few steps, and predicts with the shipped networks.
CODE = """
import sys
import keras
import numpy as np
from deepmds_keras import DeepMDS, LandmarkLifter

file, backend = sys.argv[1:]
assert keras.backend.backend() == backend
mean = LandmarkLifter.pretrained("ibug51").weights_["mean"].T

def sample(n, rng):
    shapes = mean + 0.02 * rng.standard_normal((n, 51, 3))
    return shapes[..., :2], shapes, 0.001

views, shapes, _ = sample(96, np.random.default_rng(0))
small = DeepMDS(51, autoencoder_epochs=4, dissimilarity_epochs=2, dissimilarity_steps=50)
for losses in small.fit(views, shapes).history_.values():
    assert losses["train"][-1] < losses["train"][0], losses
assert small.predict(views[:2]).shape == (2, 51, 3)

errors = LandmarkLifter(51, steps=200, batch_size=32).fit(sample).history_["inference"]
assert errors[-1] < errors[0], errors

np.save(file, DeepMDS.pretrained("deepmds-ibug51").predict(views[:8]))
"""


def test_a_backend_that_is_there_in_part_is_named():
    error = ModuleNotFoundError("No module named 'torch.utils'", name="torch.utils")
    message = "KERAS_BACKEND must be tensorflow.* Received torch"
    with pytest.raises(InputError, match=message), needs("Keras", "keras"):
        raise error


@pytest.mark.slow
@pytest.mark.parametrize(
    ("setting", "message"),
    [
        ({"backend": "openvino"}, "KERAS_BACKEND must be .*tensorflow.* Received .?openvino"),
        ({"floatx": "float16"}, r"keras.json\) must be one of float32. Received 'float16'"),
    ],
)
def test_other_settings_of_keras_are_refused_by_name(setting, message, tmp_path, monkeypatch):
    (tmp_path / "keras.json").write_text(json.dumps(setting))
    monkeypatch.delenv("KERAS_BACKEND", raising=False)
    done = python("-c", "from deepmds_keras import DeepMDS", KERAS_HOME=str(tmp_path))
    assert re.search(f"InputError: .*{message}", done.stderr), done.stderr


@pytest.mark.slow
def test_both_backends_train_and_give_the_same_shapes_from_the_same_weights(tmp_path):
    for backend in BACKENDS:
        words = ("-c", CODE, tmp_path / f"{backend}.npy", backend)
        done = python(*words, KERAS_BACKEND=backend)
        assert done.returncode == 0, done.stderr
    tensorflow, jax = (np.load(tmp_path / f"{backend}.npy") for backend in BACKENDS)
    assert np.ptp(tensorflow) > 0.5
    assert np.abs(tensorflow - jax).max() < 1e-4
