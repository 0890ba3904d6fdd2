"""The released RingNet: a checkpoint of its tensors' names is run as it is; others are refused."""

import numpy as np
import pytest
import tensorflow as tf
from tensorflow.core.protobuf.meta_graph_pb2 import MetaGraphDef
from writers.ringnet import write_checkpoint

from deepmds_keras import InputError
from deepmds_keras.baselines.ringnet_released import ReleasedRingNet

v1 = tf.compat.v1
TRIANGLES = np.array([[0, 1, 2], [10, 20, 30], [5020, 5021, 5022]])
WEIGHTS = np.array([[1.0, 0.0, 0.0], [0.2, 0.3, 0.5], [0.0, 0.5, 0.5]])


@pytest.fixture(scope="module")
def released(tmp_path_factory):
    prefix = tmp_path_factory.mktemp("ringnet") / "ring_6_68641"
    return prefix, write_checkpoint(prefix)


@pytest.fixture
def images():
    return np.random.default_rng(1).integers(0, 256, (3, 224, 224, 3), np.uint8)


def test_outputs_are_those_of_the_graph(released, images):
    prefix, arrays = released
    model = ReleasedRingNet(prefix, TRIANGLES, WEIGHTS)
    colours = (images / 127.5 - 1).mean((1, 2))
    parameters = colours @ arrays["to_parameters"]
    metres = (colours @ arrays["to_vertices"]).reshape(3, 5023, 3) + parameters[:, None, :3]
    assert np.allclose(model.parameters(images), parameters, atol=1e-5)
    assert model.vertices(images).shape == (3, 5023, 3)
    assert np.allclose(model.vertices(images), 1000 * metres, atol=1e-2)
    assert model.n_parameters == 3 * (159 + 3 * 5023)
    landmarks = model.predict(images)
    assert landmarks.shape == (3, 3, 3)
    assert np.allclose(landmarks[:, 0], 1000 * metres[:, 0], atol=1e-2)
    second = 0.2 * metres[:, 10] + 0.3 * metres[:, 20] + 0.5 * metres[:, 30]
    assert np.allclose(landmarks[:, 1], 1000 * second, atol=1e-2)
    assert tf.executing_eagerly()


def test_input_has_either_of_its_names(released, images, tmp_path):
    write_checkpoint(tmp_path / "ring", image="input_images")
    models = [
        ReleasedRingNet(path, TRIANGLES, WEIGHTS) for path in (released[0], tmp_path / "ring")
    ]
    assert np.array_equal(*(model.vertices(images[:1]) for model in models))


@pytest.mark.parametrize("suffix", [".meta", ".index", ".data-00000-of-00001"])
def test_missing_and_damaged_files_are_named(released, tmp_path, suffix):
    for file in released[0].parent.glob("ring_6_68641.*"):
        (tmp_path / file.name).write_bytes(file.read_bytes())
    path = tmp_path / f"ring_6_68641{suffix}"
    path.write_bytes(b"\xff" + path.read_bytes()[:50])
    with pytest.raises(InputError, match=r"ring_6_68641.* must be .* Received"):
        ReleasedRingNet(tmp_path / "ring_6_68641", TRIANGLES, WEIGHTS)
    path.unlink()
    with pytest.raises(InputError, match=r"ring_6_68641\.[a-z]+.* does not exist"):
        ReleasedRingNet(tmp_path / "ring_6_68641", TRIANGLES, WEIGHTS)


def test_another_graph_is_refused_with_what_it_has(tmp_path):
    write_checkpoint(tmp_path / "other", scope="Flame")
    with pytest.raises(InputError, match=r"none called Flamenetnormal_2/Add_9:0 .*Flame/Add_9:0"):
        ReleasedRingNet(tmp_path / "other", TRIANGLES, WEIGHTS)
    write_checkpoint(tmp_path / "functions", python=True)
    with pytest.raises(InputError, match=r"PyFunc.*Python function, which the file does not hold"):
        ReleasedRingNet(tmp_path / "functions", TRIANGLES, WEIGHTS)


def test_unknown_operations_and_other_shapes_are_refused(released, tmp_path):
    def with_changed_graph(name, change):
        for file in released[0].parent.glob("ring_6_68641.*"):
            (tmp_path / f"{name}{file.suffix}").write_bytes(file.read_bytes())
        meta = MetaGraphDef.FromString((tmp_path / f"{name}.meta").read_bytes())
        change(meta.graph_def)
        (tmp_path / f"{name}.meta").write_bytes(meta.SerializeToString())
        return tmp_path / name

    def custom(graph):
        graph.node.add(name="custom", op="RenderFace")

    with pytest.raises(
        InputError, match=r"operations that TensorFlow .* has\. Received .*RenderFace"
    ):
        ReleasedRingNet(with_changed_graph("custom", custom), TRIANGLES, WEIGHTS)

    def small(graph):
        placeholder = next(node for node in graph.node if node.name == "input_images_1")
        for dim in placeholder.attr["shape"].shape.dim[1:3]:
            dim.size = 96
        del placeholder.attr["_output_shapes"]

    with pytest.raises(InputError, match=r"input_images_1:0 must be float32 of shape \(1, 224"):
        ReleasedRingNet(with_changed_graph("small", small), TRIANGLES, WEIGHTS)


def test_landmarks_and_images_of_another_kind_are_refused(released, images):
    with pytest.raises(InputError, match=r"must have one shape \(L, 3\)"):
        ReleasedRingNet(released[0], TRIANGLES, WEIGHTS[:2])
    with pytest.raises(InputError, match="landmark_vertices must be whole numbers below 5023"):
        ReleasedRingNet(released[0], TRIANGLES + 1, WEIGHTS)
    model = ReleasedRingNet(released[0], TRIANGLES, WEIGHTS)
    for wrong in (images[0], images.astype(float), images[:, :96], images[:0]):
        with pytest.raises(InputError, match=r"images must be uint8 of shape .* Received"):
            model.predict(wrong)
