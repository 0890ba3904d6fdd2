"""The released RingNet: a checkpoint of its tensors' names is run as it is; others are refused."""

import numpy as np
import pytest
from tensorflow.core.protobuf.meta_graph_pb2 import MetaGraphDef
from writers.ringnet import write_checkpoint

from deepmds_keras import InputError
from deepmds_keras.baselines.ringnet_released import ReleasedRingNet

TRIANGLES = np.array([[0, 1, 2], [10, 20, 30], [5020, 5021, 5022]])
WEIGHTS = np.array([[1.0, 0.0, 0.0], [0.2, 0.3, 0.5], [0.0, 0.5, 0.5]])


@pytest.mark.parametrize("image", ["input_images_1", "input_images"])
def test_landmarks_are_those_of_the_graph(tmp_path, image):
    arrays = write_checkpoint(tmp_path / "ring_6_68641", image=image)
    images = np.random.default_rng(1).integers(0, 256, (3, 224, 224, 3), np.uint8)
    model = ReleasedRingNet(tmp_path / "ring_6_68641", TRIANGLES, WEIGHTS)
    colours = (images / 127.5 - 1).mean((1, 2))
    metres = (colours @ arrays["to_vertices"]).reshape(3, 5023, 3)
    metres += (colours @ arrays["to_parameters"])[:, None, :3]
    wanted = 1000 * np.einsum("nlvc,lv->nlc", metres[:, TRIANGLES], WEIGHTS)
    assert np.allclose(model.predict(images), wanted, atol=1e-2)
    assert model.n_parameters == 3 * (159 + 3 * 5023)
    for wrong in (images[0], images.astype(float), images[:, :96], images[:0]):
        with pytest.raises(InputError, match=r"images must be uint8 of shape .* Received"):
            model.predict(wrong)
    with pytest.raises(InputError, match="landmark_vertices must be whole numbers below 5023"):
        ReleasedRingNet(tmp_path / "ring_6_68641", TRIANGLES + 1, WEIGHTS)


@pytest.mark.parametrize("suffix", [".meta", ".index", ".data-00000-of-00001"])
def test_missing_and_damaged_files_are_named(tmp_path, suffix):
    write_checkpoint(tmp_path / "ring")
    path = tmp_path / f"ring{suffix}"
    path.write_bytes(b"\xff" + path.read_bytes()[:50])
    with pytest.raises(InputError, match=r"ring.* must be .* Received"):
        ReleasedRingNet(tmp_path / "ring", TRIANGLES, WEIGHTS)
    path.unlink()
    with pytest.raises(InputError, match=r"ring\.[a-z]+.* does not exist"):
        ReleasedRingNet(tmp_path / "ring", TRIANGLES, WEIGHTS)


def small_images(graph):
    placeholder = next(node for node in graph.node if node.name == "input_images_1")
    for dim in placeholder.attr["shape"].shape.dim[1:3]:
        dim.size = 96
    del placeholder.attr["_output_shapes"]


@pytest.mark.parametrize(
    ("options", "change", "message"),
    [
        ({"scope": "Flame"}, None, "KeyError: .*Flamenetnormal_2/Add_9:0"),
        ({"python": True}, None, "PyFunc.* uses what the file does not hold"),
        (
            {},
            lambda graph: graph.node.add(name="custom", op="RenderFace"),
            r"which TensorFlow .* can run\. Received .*RenderFace",
        ),
        ({}, small_images, r"input_images_1:0 is float32 of shape \(1, 96, 96, 3\), not \(1, 224"),
    ],
)
def test_graphs_that_are_not_ringnets_are_refused(tmp_path, options, change, message):
    write_checkpoint(tmp_path / "ring", **options)
    if change:
        meta = MetaGraphDef.FromString((tmp_path / "ring.meta").read_bytes())
        change(meta.graph_def)
        (tmp_path / "ring.meta").write_bytes(meta.SerializeToString())
    with pytest.raises(InputError, match=message):
        ReleasedRingNet(tmp_path / "ring", TRIANGLES, WEIGHTS)
