"""The Basel Face Model 2009 at the 68 iBUG landmarks, from the files of the repository 3DDFA.

Zhu et al. 2016, "Face alignment across large poses", doi:10.1109/CVPR.2016.23;
github.com/cleardusk/3DDFA (MIT licence). Its numbers are those of the Basel Face Model, whose
licence allows research only: nothing of them, nor weights trained on them, may be passed on.
"""

from pathlib import Path

import numpy as np

from data_gen.models.array_files import load_plain_pickle
from data_gen.models.morphable_model import MorphableModel
from deepmds_keras.errors import InputError, brief, naming
from deepmds_keras.files import map_npy, sha256_of

MEAN = "train.configs/u_shp.npy"
_KEYPOINTS, _FITS = "train.configs/keypoints_sim.npy", "train.configs/param_whitening.pkl"
_IDENTITY, _EXPRESSION = "c++/weights/w_shp_base.txt", "c++/weights/w_exp_base.txt"
_EXPRESSION_MEAN = "train.configs/u_exp.npy"
N_VERTICES, N_LANDMARKS = 53_215, 68  # the Basel model has 53,490
_N_POSE, _N_IDENTITY, _N_EXPRESSION = 12, 40, 10  # parameters of a fit, in this order
_MM = 1e-3  # the files are in micrometres


def bfm68_files(checkout: Path) -> list[Path]:
    """The six files that `load_bfm68` reads."""
    names = (MEAN, _EXPRESSION_MEAN, _KEYPOINTS, _IDENTITY, _EXPRESSION, _FITS)
    return [checkout / name for name in names]


def load_bfm68(checkout: str | Path) -> MorphableModel:
    """Reads the mean, the first 40 identity components and ten expressions at the landmarks.

    The standard deviations are those of 3DDFA's fits to the photos of 300W-LP. That is a low
    estimate: fits are regularised, and 159 components are missing. The neutral face is the mean
    shape alone, where the authors' weights of Deep-MDS have it (`bfm_mean`); the mean expression
    would move it 7.7 mm downwards.

    Returns:
        A model of 68 vertices without triangles; landmarks `"ibug68"` and `"ibug51"`.

    Raises:
        InputError: A file is missing, damaged, or of another size.
    """
    files = bfm68_files(Path(checkout))
    mean, expression_mean, keypoints, identity, expression, fits = files
    vertices = _vertices(keypoints)
    parameters = load_plain_pickle(fits)
    try:
        sd = np.array(parameters["param_std"], float)[_N_POSE:]
        mean_expression = np.array(parameters["param_mean"], float)[-_N_EXPRESSION:]
        identity_sd, expression_sd = sd[:_N_IDENTITY], sd[_N_IDENTITY:]
        if len(sd) != _N_IDENTITY + _N_EXPRESSION:
            raise ValueError(f"{_N_POSE + len(sd)} parameters")
    except (TypeError, KeyError, ValueError, IndexError) as error:
        raise InputError(
            f"{fits}: must hold param_mean and param_std of 62 parameters. "
            f"Received {brief(repr(error))}."
        ) from None
    expressions = _components(expression, _N_EXPRESSION)
    with naming(checkout):
        return MorphableModel(
            name="bfm68",
            mean=_points(mean)[vertices],
            identity_basis_times_sd=_components(identity, _N_IDENTITY) * identity_sd[:, None, None],
            identity_sd=identity_sd * _MM,
            triangles=np.empty((0, 3), int),
            landmarks={"ibug68": np.arange(N_LANDMARKS), "ibug51": np.arange(17, N_LANDMARKS)},
            expression_mean=_points(expression_mean)[vertices]
            + np.tensordot(mean_expression, expressions, 1),
            expression_basis=expressions * expression_sd[:, None, None],
            sha256=sha256_of(files),
        )


def _vertices(file: Path) -> np.ndarray:
    """`(68,)` numbers of the landmarks' vertices, of the rows of x, y and z of each."""
    rows = _array(file, (3 * N_LANDMARKS,)).reshape(-1, 3)
    vertices = rows[:, 0] // 3
    of_vertices = (rows == 3 * vertices[:, None] + np.arange(3)).all()
    if not of_vertices or vertices.min() < 0 or vertices.max() >= N_VERTICES:
        raise InputError(
            f"{file}: must hold the rows of x, y and z of {N_LANDMARKS} of {N_VERTICES} vertices. "
            "Received other numbers."
        )
    return vertices.astype(int)


def _points(file: Path) -> np.ndarray:
    """`(53215, 3)` millimetres."""
    return _array(file, (3 * N_VERTICES, 1)).reshape(-1, 3) * _MM


def _components(file: Path, n: int) -> np.ndarray:
    """`(n, 68, 3)` offsets in millimetres by a coefficient of 1."""
    return _array(file, (3 * N_LANDMARKS, n)).T.reshape(n, -1, 3) * _MM


def _array(file: Path, shape: tuple[int, ...]) -> np.ndarray:
    """Numbers of a npy or text file.

    Raises:
        InputError: It cannot be read, or holds other arrays.
    """
    try:
        array = np.loadtxt(file) if file.suffix == ".txt" else map_npy(file)
    except (OSError, ValueError) as error:
        raise InputError(f"{file}: must hold numbers. Received {brief(str(error))}.") from None
    if array.shape != shape or array.dtype.kind not in "fiu":
        raise InputError(
            f"{file}: must hold numbers of shape {shape}. Received {array.dtype} {array.shape}."
        )
    return array.astype(float)
