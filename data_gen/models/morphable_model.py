"""The linear statistical shape model into which every face model file is read."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from data_gen.models.mesh import check_triangles, orient_outwards
from deepmds_keras.errors import InputError, naming

# Of expression weights that go from 0 to 1; fits to photos then stay between about -0.5 and 0.7.
BLENDSHAPE_SD = 0.3
_FIELDS = ("expression_mean", "colour_mean")
_BASES = ("identity_basis_times_sd", "expression_basis", "colour_basis_times_sd")


@dataclass(frozen=True, eq=False)
class MorphableModel:
    """A 3D morphable model: a mean face, and offsets at one standard deviation of each component.

    Blanz and Vetter 1999, doi:10.1145/311535.311556. Units are millimetres; +x points to the
    subject's left, +y up, +z out of the face.

    Attributes:
        name: Identifier, as in `MODEL=` on the command line.
        mean: `(V, 3)` float, vertices of the mean face.
        identity_basis_times_sd: `(K, V, 3)` float, offsets at one standard deviation, so that
            identity coefficients are standard normal.
        identity_sd: `(K,)` standard deviation of each component over the whole mesh, where this
            is only a part of it: a number times an orthonormal component. None: see `component_sd`.
        triangles: `(T, 3)` int, 0-based vertex numbers, counter-clockwise seen from outside.
        landmarks: Scheme name (`"bfm72"`, `"ibug68"`, `"ibug51"`) to `(L,)` 0-based vertex numbers.
        expression_mean: `(V, 3)` float, added whenever an expression is given; zero for most.
        expression_basis: `(E, V, 3)` float, offsets at weight one, or None.
        expression_names: `E` names, empty where the file has none.
        expression_sd: Standard deviation of the expression weights about zero. 1 for principal
            components, which are scaled to it; `BLENDSHAPE_SD` for blendshapes.
        colour_mean: `(V, 3)` float in [0, 1], or None.
        colour_basis_times_sd: `(C, V, 3)` float, or None.
        sha256: Hash of the file(s) that the model was read from.

    Raises:
        InputError: Shapes disagree, numbers are not finite, or triangles or landmarks are not
            vertex numbers. The message names the model and the field.
    """

    name: str
    mean: np.ndarray
    identity_basis_times_sd: np.ndarray
    triangles: np.ndarray
    landmarks: dict[str, np.ndarray] = field(default_factory=dict)
    identity_sd: np.ndarray | None = None
    expression_mean: np.ndarray | None = None
    expression_basis: np.ndarray | None = None
    expression_names: tuple[str, ...] = ()
    expression_sd: float = 1.0
    colour_mean: np.ndarray | None = None
    colour_basis_times_sd: np.ndarray | None = None
    sha256: str = ""

    def __post_init__(self):
        with naming(self.name):
            self._check()

    def _check(self) -> None:
        for label in ("mean", *_FIELDS, *_BASES):
            array, n_axes = getattr(self, label), 3 if label in _BASES else 2
            if array is None:
                continue
            if array.ndim != n_axes or array.shape[-2:] != (self.n_vertices, 3):
                raise InputError(
                    f"{label} must be of shape ({'K, ' * (n_axes - 2)}{self.n_vertices}, 3). "
                    f"Received {array.shape}."
                )
            if array.dtype.kind not in "fiu" or not np.isfinite(array).all():
                raise InputError(f"{label} must be finite numbers. Received NaN, infinity or text.")
        check_triangles(self.triangles, self.n_vertices)
        for scheme, vertices in self.landmarks.items():
            if len(vertices) and not 0 <= vertices.min() <= vertices.max() < self.n_vertices:
                raise InputError(
                    f"landmarks {scheme} must be vertex numbers below {self.n_vertices}. "
                    f"Received {vertices.min()} to {vertices.max()}."
                )
        n_expressions = 0 if self.expression_basis is None else len(self.expression_basis)
        if len(self.expression_names) not in (0, n_expressions):
            raise InputError(
                f"expression_names must name {n_expressions} expressions. "
                f"Received {len(self.expression_names)}."
            )

    @property
    def n_vertices(self) -> int:
        return len(self.mean)

    @property
    def n_identity(self) -> int:
        return len(self.identity_basis_times_sd)

    @property
    def component_sd(self) -> np.ndarray:
        """`(K,)` norm over the mesh of the offsets at one standard deviation, millimetres."""
        if self.identity_sd is not None:
            return self.identity_sd
        return np.linalg.norm(self.identity_basis_times_sd.reshape(self.n_identity, -1), axis=1)

    def scaled(self, scale: float) -> MorphableModel:
        """The same model with so many times the standard deviation of identity."""
        if scale == 1:  # not to hold a large basis twice
            return self
        sd = None if self.identity_sd is None else scale * self.identity_sd
        basis = scale * self.identity_basis_times_sd
        return replace(self, identity_basis_times_sd=basis, identity_sd=sd)

    def shape(self, identity: np.ndarray, expression: np.ndarray | None = None) -> np.ndarray:
        """Vertices of the faces with the given coefficients.

        Args:
            identity: `(n, k)` or `(k,)` standard-normal coefficients, `k <= K`.
            expression: `(n, e)` or `(e,)` weights, `e <= E`; None is the neutral face.

        Returns:
            `(n, V, 3)` or `(V, 3)` vertices in millimetres.
        """
        vertices = self.mean + _combine(identity, self.identity_basis_times_sd)
        if expression is not None:
            vertices = vertices + _combine(expression, self.expression_basis)
            if self.expression_mean is not None:
                vertices = vertices + self.expression_mean
        return vertices

    def sample(self, n: int, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
        """Neutral faces of standard-normal identity coefficients.

        Returns:
            `(n, K)` coefficients and `(n, V, 3)` vertices in millimetres.
        """
        identity = rng.standard_normal((n, self.n_identity))
        return identity, self.shape(identity)

    def restrict(self, vertices: np.ndarray, triangles: np.ndarray | None = None) -> MorphableModel:
        """The same model on some vertices only, such as its landmarks.

        Args:
            vertices: `(L,)` 0-based vertex numbers, in the new order.
            triangles: `(T, 3)` int, of the new vertices; none by default.
        """

        def pick(basis):
            # Contiguous, unlike by an index: a basis is not copied again for every face.
            return None if basis is None else np.take(basis, vertices, axis=-2)

        return replace(
            self,
            triangles=np.empty((0, 3), int) if triangles is None else triangles,
            landmarks={},
            **{label: pick(getattr(self, label)) for label in ("mean", *_FIELDS, *_BASES)},
        )

    def at_landmarks(self, scheme: str) -> MorphableModel:
        """The same model at the landmarks of a scheme only.

        Raises:
            InputError: The model has no such landmarks.
        """
        if scheme not in self.landmarks:
            raise InputError(
                f"scheme must be one of {', '.join(self.landmarks) or 'none'} for {self.name}. "
                f"Received {scheme!r}."
            )
        return self.restrict(self.landmarks[scheme])


def model_of(file: Path, **fields) -> MorphableModel:
    """`MorphableModel(**fields)` of a file, its triangles turned outwards.

    Raises:
        InputError: As `MorphableModel`, or there are no triangles; the message names the file.
    """
    with naming(file):
        model = MorphableModel(**fields)
    if not len(model.triangles):
        raise InputError(f"{file}: must hold a mesh. Received no triangles.")
    return replace(model, triangles=orient_outwards(model.mean, model.triangles))


def _combine(coefficients: np.ndarray, basis: np.ndarray) -> np.ndarray:
    coefficients = np.asarray(coefficients)
    k = coefficients.shape[-1]
    flat = coefficients @ basis[:k].reshape(k, -1)
    return flat.reshape(*coefficients.shape[:-1], *basis.shape[1:])
