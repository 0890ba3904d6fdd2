"""RingNet as its authors trained it: runs the TensorFlow 1 graph that they license."""

import glob
import math
from pathlib import Path

import numpy as np
import tensorflow as tf
from tensorflow.core.protobuf.meta_graph_pb2 import MetaGraphDef

from deepmds_keras.baselines.images import check_images
from deepmds_keras.errors import InputError
from deepmds_keras.files import reading

IMAGE_SIZE = 224
N_VERTICES = 5023  # FLAME's
_MM = 1000.0  # the graph gives metres
# The authors load the file where a placeholder `input_images` exists. TensorFlow then calls the
# file's the same with `_1`, so that the file may have it under either name.
_INPUTS = ("input_images_1", "input_images")
_KIND = f"RingNet's checkpoint, which TensorFlow {tf.__version__} can run"
_VERTICES = "Flamenetnormal_2/Add_9:0"
_UNUSABLE = {"PyFunc", "PyFuncStateless", "EagerPyFunc", "ReadFile", "WriteFile", "MatchingFiles"}


class ReleasedRingNet:
    """The released RingNet, Sanyal et al. 2019, arXiv:1905.06817; inference only.

    Its vertices are FLAME's, in the pose of the face in the image; align before comparing.

    Args:
        checkpoint_prefix: Path of the checkpoint without its suffixes, `.../ring_6_68641`; its
            `.meta`, `.index` and `.data-…` must exist, see https://ringnet.is.tue.mpg.de.
        landmark_vertices: `(L, 3)` int, the vertices of the triangle in which each landmark lies.
        landmark_weights: `(L, 3)` their barycentric weights.

    Raises:
        InputError: A file is missing or damaged; the graph lacks a tensor, has another shape or
            cannot be run; or the landmarks belong to another mesh.
    """

    def __init__(
        self,
        checkpoint_prefix: str | Path,
        landmark_vertices: np.ndarray,
        landmark_weights: np.ndarray,
    ):
        self.checkpoint_prefix = prefix = str(checkpoint_prefix)
        self.landmark_vertices, self.landmark_weights = landmark_vertices, landmark_weights
        if np.max(landmark_vertices, initial=0) >= N_VERTICES:
            raise InputError(f"landmark_vertices must be whole numbers below {N_VERTICES}.")
        for suffix in (".meta", ".index", ".data-*"):
            if not glob.glob(glob.escape(prefix) + suffix):
                raise InputError(
                    f"{prefix}{suffix} does not exist; checkpoint_prefix must be the path of "
                    "RingNet's checkpoint without suffix, such as ring_6_68641."
                )
        self._graph = graph = tf.Graph()
        with reading(prefix, _KIND), graph.as_default():
            meta = MetaGraphDef.FromString(Path(prefix + ".meta").read_bytes())
            saver = tf.compat.v1.train.import_meta_graph(meta, clear_devices=True)
            operations = {operation.name for operation in graph.get_operations()}
            image = _INPUTS[0] if _INPUTS[0] in operations else _INPUTS[1]
            self._input = _tensor(graph, f"{image}:0", (1, IMAGE_SIZE, IMAGE_SIZE, 3))
            self._vertices = _tensor(graph, _VERTICES, (1, N_VERTICES, 3))
            _check_runnable(self._vertices.op)
            self._session = tf.compat.v1.Session(graph=graph)
            saver.restore(self._session, prefix)

    def predict(self, images: np.ndarray) -> np.ndarray:
        """Landmarks of the faces in images, each a loose square around a face.

        Images `(n, 224, 224, 3)` uint8, RGB, give `(n, L, 3)` millimetres.

        Raises:
            InputError: Images of another kind or size.
        """
        images, corners = check_images(images, IMAGE_SIZE), []
        with reading(self.checkpoint_prefix, _KIND):
            for image in images:  # the graph takes one at a time
                scaled = image[None] / np.float32(127.5) - 1
                vertices = self._session.run(self._vertices, {self._input: scaled})[0]
                corners.append(vertices[self.landmark_vertices])
        millimetres = np.stack(corners).astype(float) * _MM
        return np.einsum("nlvc,lv->nlc", millimetres, self.landmark_weights)

    @property
    def n_parameters(self) -> int:
        """Trainable parameters."""
        variables = self._graph.get_collection(tf.compat.v1.GraphKeys.TRAINABLE_VARIABLES)
        return sum(math.prod(variable.shape) for variable in variables)


def _tensor(graph: tf.Graph, name: str, shape: tuple[int, ...]) -> tf.Tensor:
    tensor = graph.get_tensor_by_name(name)
    if tensor.dtype != tf.float32 or not tensor.shape.is_compatible_with(shape):
        raise ValueError(f"{name} is {tensor.dtype.name} of shape {tensor.shape}, not {shape}")
    return tensor


def _check_runnable(output: tf.Operation) -> None:
    """Refuse an output that depends on more than the image: code or files outside the graph."""
    waiting, seen = [output], set()
    while waiting:
        op = waiting.pop()
        if op.type in _UNUSABLE:
            raise ValueError(f"{op.name} ({op.type}) uses what the file does not hold")
        if op not in seen:
            seen.add(op)
            waiting += [tensor.op for tensor in op.inputs] + list(op.control_inputs)
