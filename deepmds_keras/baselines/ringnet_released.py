"""RingNet as its authors trained it: runs the TensorFlow 1 graph that they license."""

from __future__ import annotations

import glob
import math
from pathlib import Path

import numpy as np
import tensorflow as tf
from google.protobuf.message import DecodeError
from tensorflow.core.protobuf.meta_graph_pb2 import MetaGraphDef

from deepmds_keras.checks import check_images
from deepmds_keras.errors import InputError

IMAGE_SIZE = 224
N_VERTICES = 5023  # FLAME's
_MM = 1000.0  # the graph gives metres
# The authors load the file where a placeholder `input_images` exists. TensorFlow then calls the
# file's the same with `_1`, so that the file may have it under either name.
_INPUTS = ("input_images_1:0", "input_images:0")
_VERTICES = "Flamenetnormal_2/Add_9:0"
_UNUSABLE = {"PyFunc", "PyFuncStateless", "EagerPyFunc", "ReadFile", "WriteFile", "MatchingFiles"}


class ReleasedRingNet:
    """The released RingNet, Sanyal et al. 2019, arXiv:1905.06817; inference only.

    Its vertices are FLAME's, in the pose of the face in the image: what is compared with them is to
    be aligned first. Any rotation is left in, and none is added.

    Args:
        checkpoint_prefix: Path of the checkpoint without its suffixes, `.../ring_6_68641`; its
            `.meta`, `.index` and `.data-…` are to be there, see https://ringnet.is.tue.mpg.de.
        landmark_vertices: `(L, 3)` int, the vertices of the triangle in which each landmark lies.
        landmark_weights: `(L, 3)` their barycentric weights.

    Raises:
        InputError: A file is missing or damaged, or the graph lacks the tensors, has them in other
            shapes or cannot be run; or landmarks of another mesh.
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
        meta = _read_meta(prefix)
        self._graph = tf.Graph()
        with self._graph.as_default():
            try:
                saver = tf.compat.v1.train.import_meta_graph(meta, clear_devices=True)
            except (tf.errors.OpError, ValueError, KeyError, TypeError, RuntimeError) as error:
                raise InputError(
                    f"{prefix}.meta must be a graph of operations that TensorFlow {tf.__version__} "
                    f"has. {_line(error)}"
                ) from None
            if saver is None:
                raise InputError(f"{prefix}.meta must say how it is restored. Received no saver.")
            self._input, self._vertices = _tensors(prefix, self._graph)
            _check_runnable(prefix, self._vertices.op)
            self._session = tf.compat.v1.Session(graph=self._graph)
            try:
                saver.restore(self._session, prefix)
            except (tf.errors.OpError, ValueError) as error:
                raise InputError(
                    f"{prefix} must be the checkpoint of its .meta. {_line(error)}"
                ) from None

    def predict(self, images: np.ndarray) -> np.ndarray:
        """Landmarks of the faces in images.

        Args:
            images: `(n, 224, 224, 3)` uint8, RGB, a loose square about each face.

        Returns:
            `(n, L, 3)` millimetres.

        Raises:
            InputError: Images of another kind or size.
        """
        corners = []
        try:
            for image in check_images(images, IMAGE_SIZE):  # the graph takes one at a time
                scaled = image[None] / np.float32(127.5) - 1
                vertices = self._session.run(self._vertices, {self._input: scaled})[0]
                corners.append(vertices[self.landmark_vertices])
        except tf.errors.OpError as error:
            raise InputError(f"{self.checkpoint_prefix} cannot be run. {_line(error)}") from None
        millimetres = np.stack(corners).astype(float) * _MM
        return np.einsum("nlvc,lv->nlc", millimetres, self.landmark_weights)

    @property
    def n_parameters(self) -> int:
        """Trainable parameters."""
        variables = self._graph.get_collection(tf.compat.v1.GraphKeys.TRAINABLE_VARIABLES)
        return sum(math.prod(variable.shape) for variable in variables)


def _read_meta(prefix: str) -> MetaGraphDef:
    folder, name = Path(prefix).parent, Path(prefix).name
    for suffix in (".meta", ".index", ".data-*"):
        if not any(folder.glob(glob.escape(name) + suffix)):
            raise InputError(
                f"{prefix}{suffix} does not exist; checkpoint_prefix must be the path of RingNet's "
                "checkpoint without suffix, such as ring_6_68641."
            )
    try:
        return MetaGraphDef.FromString(Path(prefix + ".meta").read_bytes())
    except DecodeError as error:
        raise InputError(f"{prefix}.meta must be a MetaGraph. {_line(error)}") from None


def _tensors(prefix: str, graph: tf.Graph) -> list[tf.Tensor]:
    """Input and vertices, of the shapes that RingNet's have."""
    names = {tensor.name: tensor for op in graph.get_operations() for tensor in op.outputs}
    image = _INPUTS[0] if _INPUTS[0] in names else _INPUTS[1]
    needed = {image: (1, IMAGE_SIZE, IMAGE_SIZE, 3), _VERTICES: (1, N_VERTICES, 3)}
    for name, shape in needed.items():
        tensor = names.get(name)
        if tensor is None:
            kinds = ("Placeholder", "Add", "AddV2")
            like = [other for other, t in names.items() if t.op.type in kinds]
            raise InputError(
                f"{prefix}.meta must have the tensor {name}. "
                f"Received inputs and sums {', '.join(like[:20]) or 'none'}."
            )
        if tensor.dtype != tf.float32 or not tensor.shape.is_compatible_with(shape):
            raise InputError(
                f"{prefix}.meta: {name} must be float32 of shape {shape}. "
                f"Received {tensor.dtype.name} of shape {tensor.shape}."
            )
    return [names[name] for name in needed]


def _check_runnable(prefix: str, output: tf.Operation) -> None:
    """The output must come of the image alone: no code outside the file, no other files."""
    waiting, seen = [output], set()
    while waiting:
        op = waiting.pop()
        if op in seen:
            continue
        seen.add(op)
        if op.type in _UNUSABLE:
            raise InputError(
                f"{prefix}.meta must be run without anything else. Received the operation "
                f"{op.name} ({op.type}), which uses what the file does not hold."
            )
        waiting += [tensor.op for tensor in op.inputs] + list(op.control_inputs)


def _line(error: Exception) -> str:
    return f"Received {type(error).__name__}: {' '.join(str(error).split())[:200]}"
