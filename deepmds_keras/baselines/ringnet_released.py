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
N_PARAMETERS = 159  # camera 3, pose 6, shape 100, expression 50
_MM = 1000.0  # the graph gives metres
# The authors load the file beside a placeholder of their own called `input_images`. TensorFlow
# would then call the file's the same with `_1`, so that the file may have it under either name.
_INPUTS = ("input_images_1:0", "input_images:0")
_PARAMETERS, _VERTICES = "add_2:0", "Flamenetnormal_2/Add_9:0"
_UNUSABLE = dict.fromkeys(
    ("PyFunc", "PyFuncStateless", "EagerPyFunc"),
    "calls a Python function, which the file does not hold",
) | dict.fromkeys(("ReadFile", "WriteFile", "MatchingFiles"), "uses files")


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
        self.checkpoint_prefix = str(checkpoint_prefix)
        self.landmark_vertices = np.asarray(landmark_vertices)
        self.landmark_weights = np.asarray(landmark_weights, float)
        _check_landmarks(self.landmark_vertices, self.landmark_weights)
        meta = _read_meta(self.checkpoint_prefix)
        self._graph = tf.Graph()
        with self._graph.as_default():
            saver = _import(self.checkpoint_prefix, meta)
            self._input, self._outputs = _tensors(self.checkpoint_prefix, self._graph)
            _check_runnable(self.checkpoint_prefix, self._outputs)
            self._session = tf.compat.v1.Session(graph=self._graph)
            try:
                saver.restore(self._session, self.checkpoint_prefix)
            except (tf.errors.OpError, ValueError) as error:
                raise InputError(
                    f"{self.checkpoint_prefix} must be the checkpoint of its .meta. {_line(error)}"
                ) from None

    def parameters(self, images: np.ndarray) -> np.ndarray:
        """Camera (scale, x, y), pose (neck and jaw, axis-angle), shape and expression.

        Args:
            images: `(n, 224, 224, 3)` uint8, RGB, a loose square about each face.

        Returns:
            `(n, 159)`.

        Raises:
            InputError: Images of another kind or size.
        """
        return self._run(images, 0)

    def vertices(self, images: np.ndarray) -> np.ndarray:
        """FLAME's vertices, `(n, 5023, 3)` millimetres; arguments and errors as `parameters`."""
        return self._run(images, 1) * _MM

    def predict(self, images: np.ndarray) -> np.ndarray:
        """Landmarks, `(n, L, 3)` millimetres; arguments and errors as `parameters`."""
        corners = self.vertices(images)[:, self.landmark_vertices]
        return np.einsum("nlvc,lv->nlc", corners, self.landmark_weights)

    @property
    def n_parameters(self) -> int:
        """Trainable parameters."""
        variables = self._graph.get_collection(tf.compat.v1.GraphKeys.TRAINABLE_VARIABLES)
        return sum(math.prod(variable.shape) for variable in variables)

    def _run(self, images: np.ndarray, output: int) -> np.ndarray:
        images = check_images(images, IMAGE_SIZE)
        tensor = self._outputs[output]
        try:
            found = [  # the graph takes one image at a time
                self._session.run(tensor, {self._input: image[None] / np.float32(127.5) - 1})
                for image in images
            ]
        except tf.errors.OpError as error:
            raise InputError(f"{self.checkpoint_prefix} cannot be run. {_line(error)}") from None
        return np.concatenate(found).astype(float)


def _check_landmarks(vertices: np.ndarray, weights: np.ndarray) -> None:
    if vertices.ndim != 2 or vertices.shape[1] != 3 or weights.shape != vertices.shape:
        raise InputError(
            "landmark_vertices and landmark_weights must have one shape (L, 3). "
            f"Received {vertices.shape} and {weights.shape}."
        )
    if not np.issubdtype(vertices.dtype, np.integer) or (
        len(vertices) and not 0 <= vertices.min() <= vertices.max() < N_VERTICES
    ):
        raise InputError(f"landmark_vertices must be whole numbers below {N_VERTICES}.")


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


def _import(prefix: str, meta: MetaGraphDef) -> tf.compat.v1.train.Saver:
    """Puts the file's graph into the current one."""
    try:
        saver = tf.compat.v1.train.import_meta_graph(meta, clear_devices=True)
    except (tf.errors.OpError, ValueError, KeyError, TypeError, RuntimeError) as error:
        raise InputError(
            f"{prefix}.meta must be a graph of operations that TensorFlow {tf.__version__} has. "
            f"{_line(error)}"
        ) from None
    if saver is None:
        raise InputError(f"{prefix}.meta must say how it is restored. Received no saver.")
    return saver


def _tensors(prefix: str, graph: tf.Graph) -> tuple[tf.Tensor, tuple[tf.Tensor, tf.Tensor]]:
    """Input and outputs, of the shapes that RingNet's have."""
    names = {tensor.name: tensor for op in graph.get_operations() for tensor in op.outputs}
    image = next((name for name in _INPUTS if name in names), _INPUTS[0])
    needed = {
        image: (1, IMAGE_SIZE, IMAGE_SIZE, 3),
        _PARAMETERS: (1, N_PARAMETERS),
        _VERTICES: (1, N_VERTICES, 3),
    }
    missing = [name for name in needed if name not in names]
    if missing:
        kinds = ("Placeholder", "Add", "AddV2")
        like = [name for name, tensor in names.items() if tensor.op.type in kinds]
        raise InputError(
            f"{prefix}.meta must have the tensors {', '.join(needed)}. Received none called "
            f"{', '.join(missing)} among {len(names)}; its inputs and sums are "
            f"{', '.join(like[:20]) or 'none'}."
        )
    for name, shape in needed.items():
        if names[name].dtype != tf.float32 or not names[name].shape.is_compatible_with(shape):
            raise InputError(
                f"{prefix}.meta: {name} must be float32 of shape {shape}. "
                f"Received {names[name].dtype.name} of shape {names[name].shape}."
            )
    return names[image], (names[_PARAMETERS], names[_VERTICES])


def _check_runnable(prefix: str, outputs: tuple[tf.Tensor, ...]) -> None:
    """The outputs must come of the image alone: no code outside the file, no other files."""
    waiting, seen = [tensor.op for tensor in outputs], set()
    while waiting:
        op = waiting.pop()
        if op in seen:
            continue
        seen.add(op)
        why = _UNUSABLE.get(op.type)
        if why:
            raise InputError(
                f"{prefix}.meta must be run without anything else. Received the operation "
                f"{op.name} ({op.type}), which {why}."
            )
        waiting += [tensor.op for tensor in op.inputs] + list(op.control_inputs)


def _line(error: Exception) -> str:
    return f"Received {type(error).__name__}: {' '.join(str(error).split())[:200]}"
