"""Training: seeds decide everything, a stopped run ends as one that was not, faces come in turn."""

import numpy as np
import pytest

from deepmds_keras import InputError, normalise
from deepmds_keras.networks import forward
from deepmds_keras.proximities import proximities
from deepmds_keras.training import (
    Recipe,
    face_order,
    steps_per_call,
    train_autoencoder,
    train_dissimilarity_net,
)


class StopTraining(Exception):  # noqa: N818 (no error)
    """Ends a training from its progress callback, as a kill between two epochs does."""


@pytest.fixture(scope="module")
def faces():
    rng = np.random.default_rng(0)
    shapes = normalise(rng.random((1, 12, 3)) + 0.1 * rng.normal(size=(64, 12, 3)))
    return np.float32(normalise(shapes[..., :2])), np.float32(shapes)


# Of a prime number of steps above 50, each is a call: one step is traced, not a loop of them.
RECIPE = Recipe(3, 53, "cosine", batch_size=8)


def autoencoder(faces, recipe=RECIPE, **options):
    return train_autoencoder(faces[0], faces[1][..., :2], recipe, **options)


def dissimilarity_net(faces, **options):
    return train_dissimilarity_net(*faces, RECIPE, **options)


@pytest.fixture(scope="module")
def whole(faces, tmp_path_factory):
    """An autoencoder, its losses and its checkpoint, which nobody may write to."""
    path = tmp_path_factory.mktemp("whole") / "checkpoint.npz"
    return *autoencoder(faces, checkpoint=path), path


@pytest.mark.slow
@pytest.mark.parametrize("train", [autoencoder, dissimilarity_net])
def test_a_run_that_was_stopped_ends_as_one_that_was_not(faces, tmp_path, train):
    epochs = []

    def stop_after_the_second(losses):
        epochs.append(losses)
        if len(epochs) == 2:
            raise StopTraining

    path = tmp_path / "checkpoint.npz"
    network, history = train(faces)
    with pytest.raises(StopTraining):
        train(faces, checkpoint=path, progress=stop_after_the_second)
    for _ in range(2):  # the second time nothing is left to do
        resumed, history_resumed = train(faces, checkpoint=path)
        for a, b in zip(network.get_weights(), resumed.get_weights(), strict=True):
            assert np.array_equal(a, b)
        assert history == history_resumed
    assert [p.name for p in tmp_path.iterdir()] == ["checkpoint.npz"]


def test_losses_fall_and_inference_is_that_of_the_network(faces):
    network, history = autoencoder(faces, Recipe(4, 500, "cosine", 3e-3, batch_size=8))
    assert history["train"][-1] < 0.1 * history["train"][0]
    views, frontal = faces[0].reshape(64, -1), faces[1][..., :2].reshape(64, -1)
    error = np.mean((network.predict(views, verbose=0) - frontal) ** 2)
    assert np.isclose(history["inference"][-1], error, rtol=1e-4)


@pytest.mark.slow
def test_released_variant_sees_self_pairs_too(faces):
    """The paper's pairs are those i < j; the released code also trains the diagonal towards 0."""
    recipe = Recipe(4, 500, "cosine", learning_rate=0.01)
    diagonals, points = {}, faces[0].reshape(-1, 2)
    for variant in ("paper", "released"):
        network, _ = train_dissimilarity_net(*faces, recipe, variant=variant)
        diagonals[variant] = np.abs(forward(network, proximities(points, points, variant))).mean()
    assert diagonals["released"] < 0.5 * diagonals["paper"]


def test_checkpoints_of_another_run_and_damaged_ones_are_refused(faces, whole, tmp_path):
    assert autoencoder(faces, seed=2)[1] != whole[1]
    with pytest.raises(InputError, match="checkpoint.npz is of another run; delete it"):
        autoencoder(faces, checkpoint=whole[2], seed=1)
    path = tmp_path / "checkpoint.npz"
    path.write_bytes(whole[2].read_bytes()[:1000])
    with pytest.raises(InputError, match="checkpoint.npz must be an npz written by save"):
        autoencoder(faces, checkpoint=path)
    with pytest.raises(InputError, match="schedule must be one of constant, cosine"):
        autoencoder(faces, Recipe(1, schedule="linear"))


def test_every_face_is_seen_equally_often_and_no_call_of_the_graph_is_a_partial_one():
    epochs = [face_order(10, 4, seed=0, epoch=epoch) for epoch in range(5)]
    assert np.array_equal(np.bincount(np.concatenate(epochs)), np.full(10, 2))
    assert not np.array_equal(np.sort(epochs[0]), np.sort(epochs[1]))
    assert [steps_per_call(steps) for steps in (1250, 1000, 97, 53, 7)] == [50, 50, 1, 1, 7]
