"""Traces array programs that take `xp` into graphs of ONNX nodes."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

TYPES = {"f": 1, "b": 9}  # of ONNX, for kinds of NumPy
_REDUCTIONS = {"sum": "ReduceSum", "mean": "ReduceMean"}
_ELEMENTWISE = {
    **{"exp": "Exp", "log": "Log", "sqrt": "Sqrt", "tanh": "Tanh"},
    **{"maximum": "Max", "clip": "Clip", "isnan": "IsNaN"},
}


class Node(NamedTuple):
    """An ONNX operator, the names of its inputs and output, and its attributes."""

    kind: str
    inputs: list[str]
    output: str
    attributes: dict[str, Any]


class Graph:
    """The nodes and constants traced so far."""

    def __init__(self):
        self.nodes: list[Node] = []
        self.constants: dict[str, np.ndarray] = {}
        self._names: dict[tuple, str] = {}

    def input(self, name: str, shape: tuple[int, ...], kind: str = "f") -> Tensor:
        """Add an input with a batch axis of any size before `shape`; `kind` is NumPy's."""
        return Tensor(self, name, np.ones((2, *shape), kind))

    def add(self, kind: str, example: np.ndarray, *inputs, **attributes) -> Tensor:
        """Add a node; `example` has the output's type, and its shape for a batch of two."""
        name = f"t{len(self.nodes)}"
        self.nodes.append(Node(kind, [*map(self._name, inputs)], name, attributes))
        return Tensor(self, name, example)

    def _name(self, value) -> str:
        if isinstance(value, Tensor):
            return value.name
        # Lists are axes and sizes; everything else takes part in the arithmetic.
        value = np.asarray(value, np.int64 if isinstance(value, list) else np.float32)
        name = self._names.setdefault(
            (value.dtype, value.shape, value.tobytes()), f"c{len(self.constants)}"
        )
        self.constants[name] = value
        return name


def _operator(kind: str, function: Callable, swapped: bool = False) -> Callable:
    """A method of `Tensor` that adds a node of one or two inputs."""

    def method(self, *others):
        inputs = [self, *others][:: -1 if swapped else 1]
        return self.graph.add(kind, function(*map(_example, inputs)), *inputs)

    return method


class Tensor:
    """An array with unknown values that supports NumPy's operations."""

    __array_ufunc__ = None  # so that NumPy leaves `array @ tensor` to the tensor

    def __init__(self, graph: Graph, name: str, example: np.ndarray):
        self.graph, self.name, self.example = graph, name, example

    @property
    def shape(self) -> tuple[int, ...]:
        return self.example.shape

    __add__, __radd__ = _operator("Add", np.add), _operator("Add", np.add, True)
    __sub__, __rsub__ = _operator("Sub", np.subtract), _operator("Sub", np.subtract, True)
    __mul__, __rmul__ = _operator("Mul", np.multiply), _operator("Mul", np.multiply, True)
    __truediv__ = _operator("Div", np.divide)
    __rtruediv__ = _operator("Div", np.divide, True)
    __matmul__, __rmatmul__ = _operator("MatMul", np.matmul), _operator("MatMul", np.matmul, True)
    __and__, __or__ = _operator("And", np.logical_and), _operator("Or", np.logical_or)
    __neg__, __invert__ = _operator("Neg", np.negative), _operator("Not", np.logical_not)

    def __getitem__(self, index) -> Tensor:
        index = index if isinstance(index, tuple) else (index,)
        kept = [part for part in index if part is not None]
        cuts = [part if isinstance(part, slice) else slice(part, part + 1 or None) for part in kept]
        starts, ends, axes = [], [], []
        for axis, cut in enumerate(cuts):
            if cut != slice(None):
                starts.append(cut.start or 0)
                ends.append(np.iinfo(np.int64).max if cut.stop is None else cut.stop)
                axes.append(axis)
        out = self
        if axes:
            out = self.graph.add("Slice", self.example[tuple(cuts)], out, starts, ends, axes)
        numbers = [axis for axis, part in enumerate(kept) if isinstance(part, int)]
        if numbers:
            out = self.graph.add("Squeeze", out.example.squeeze(tuple(numbers)), out, numbers)
        example = self.example[index]
        left = [part for part in index if not isinstance(part, int)]
        new = [i for i, part in enumerate(left) if part is None]
        return self.graph.add("Unsqueeze", example, out, new) if new else out


def _example(value):
    return getattr(value, "example", value)


class Tracer:
    """The NumPy functions in use, for tensors; known values are computed at once."""

    def __getattr__(self, name):
        function = getattr(np, name)

        def either(a, *others, **options):
            if not isinstance(a, Tensor):
                return function(a, *others, **options)
            example, add = function(a.example, *others, **options), a.graph.add
            if name == "transpose":
                return add("Transpose", example, a, perm=list(*others))
            if name in _REDUCTIONS:
                return add(_REDUCTIONS[name], example, a, [*others], keepdims=len(options))
            return add(_ELEMENTWISE[name], example, a, *others)

        return either

    def reshape(self, a, shape):
        return a.graph.add("Reshape", a.example.reshape(shape), a, list(shape))

    def where(self, condition, a, b):
        example = np.where(*map(_example, (condition, a, b)))
        return condition.graph.add("Where", example, condition, a, b)

    def float32(self, a):
        return a.graph.add("Cast", np.float32(a.example), a, to=TYPES["f"])

    def concatenate(self, parts, axis):
        known = next((part for part in parts if isinstance(part, Tensor)), None)
        if known is None:
            return np.concatenate(parts, axis)
        example = np.concatenate([*map(_example, parts)], axis)
        return known.graph.add("Concat", example, *parts, axis=axis)

    def stack(self, parts, axis):
        return self.concatenate([part[(slice(None),) * axis + (None,)] for part in parts], axis)

    def cross(self, a, b):
        x, y = ([part[:, i : i + 1] for i in range(3)] for part in (a, b))
        turns = [(1, 2), (2, 0), (0, 1)]
        return self.concatenate([x[i] * y[j] - x[j] * y[i] for i, j in turns], 1)

    @property
    def linalg(self) -> Tracer:
        return self

    def inv(self, a: Tensor) -> Tensor:
        """Invert symmetric positive definite matrices `(n, k, k)` by Gauss-Jordan elimination.

        ONNX has no inverse. With the diagonal scaled to ones, pivoting is not needed.
        """
        eye = np.eye(a.shape[-1], dtype=np.float32)
        scale = 1 / self.sqrt(self.sum(a * eye, 2, keepdims=True))
        scale = scale * self.transpose(scale, (0, 2, 1))
        out = a * scale
        for i, unit in enumerate(eye):
            row, column = out[:, i : i + 1], out[:, :, i : i + 1]
            out = out - (column - unit[:, None]) / row[:, :, i : i + 1] * (row + unit)
        return out * scale
