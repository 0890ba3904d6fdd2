"""Topics on shapes: bias, constant answers, depth without error, ranks of distances, samplings."""

import numpy as np
import pandas as pd
from scipy.stats import wilcoxon

from deepmds_keras.geometry.alignment import align
from deepmds_keras.geometry.classical_scaling import doubly_centred, pairwise_distances
from deepmds_keras.metrics import depth_corr
from experiments.audit.measure import Evidence
from experiments.inputs import load_faces
from experiments.scoring.intervals import LEVEL
from experiments.scoring.scores import load_prediction
from experiments.streams import Stream

SAMPLINGS = (20, 50)  # more than the paper's
_BIASED = (
    "mean_shape", "ridge", "zhao", "aldrian", "mobileface", "deep_mds", "deep_mds_released",
    "deep_mds_cosine", "deep_mds_weights", "landmark_lifter",
)  # fmt: skip
_DIMENSIONS = (1, 2, 3, 4, 5, 6)
_CLOUDS = 50  # random ones of each dimension
_ROUNDING = 1e-9  # share of the largest singular value below which others are 0


def bias(evidence: Evidence) -> pd.DataFrame:
    """Position of each method's shapes between the true ones and the mean training shape.

    Returns:
        `method` and what `bias_of` returns, over all test faces.
    """
    truth = evidence.test.shapes.astype(float)
    mean = evidence.scores("mean_shape").aligned
    methods = [method for method in _BIASED if method in evidence.methods]
    rows = [bias_of(evidence.scores(method).aligned, mean, truth) for method in methods]
    return pd.DataFrame(rows, index=pd.Index(methods, name="method")).reset_index()


def bias_of(predicted: np.ndarray, mean: np.ndarray, truth: np.ndarray) -> dict[str, float]:
    """Position of predictions `(n, L, 3)` between mean shape and truth, to which both are aligned.

    Returns:
        `slope`: of the regression through the origin of predicted on true offsets from the mean,
        over all coordinates of all faces, and its standard error over faces `slope_se`. Errors
        that have nothing to do with the face leave it at 1, however large they are.
    """
    n = len(truth)
    offset, predicted_offset = (
        shapes.reshape(n, -1) for shapes in (truth - mean, predicted - mean)
    )
    products, sizes = (predicted_offset * offset).sum(1), (offset**2).sum(1)
    slope = products.sum() / sizes.sum()
    # Of a ratio of two sums over faces, to first order.
    slope_se = np.sqrt(((products - slope * sizes) ** 2).sum() * n / (n - 1)) / sizes.sum()
    return {"slope": slope, "slope_se": slope_se}


def constants(evidence: Evidence) -> pd.DataFrame:
    """Error of the mean frontal view of the training faces, as the answer to all: `answer, mse`."""
    frontal_views = load_faces(evidence.run, "train").shapes[..., :2]
    error = frontal_views.var(0, dtype=float).mean()
    return pd.DataFrame({"answer": ["frontal_view"], "mse": [error]})


def depth(evidence: Evidence) -> pd.DataFrame:
    """Depth correlation of answers with little or no knowledge of the depth: `answer, share`.

    They are aligned like predictions; the share is relative to the maximum.
    """
    truth, rng = evidence.shapes, evidence.rng(Stream.AUDIT_CRITERIA)
    flat = truth.copy()
    flat[..., 2] = truth[..., 2].mean(1, keepdims=True)
    answers = {
        "truth": truth,
        "mean_shape": load_prediction(evidence.run, "mean_shape")[0]["shapes"][evidence.audited],
        "flat": flat,
        "cloud": rng.standard_normal(truth.shape),
        "point": np.zeros_like(truth),
    }
    sums = {name: depth_corr(align(shape, truth), truth).mean() for name, shape in answers.items()}
    shares = pd.Series(sums, name="share") / sums["truth"]
    return shares.rename_axis("answer").reset_index()


def ranks(evidence: Evidence) -> pd.DataFrame:
    """Ranks of squared distances, doubly centred: `points, dimensions, centred`."""
    shapes, rng = evidence.shapes, evidence.rng(Stream.AUDIT_DISSIMILARITY)
    clouds = [rng.standard_normal((_CLOUDS, shapes.shape[1], size)) for size in _DIMENSIONS]
    rows = []
    for name, points in (*(("cloud", cloud) for cloud in clouds), ("faces", shapes)):
        matrices = doubly_centred(pairwise_distances(points))
        of_faces = np.linalg.matrix_rank(matrices, rtol=_ROUNDING)
        rows.append((name, points.shape[-1], int(np.median(of_faces))))
    return pd.DataFrame(rows, columns=["points", "dimensions", "centred"])


def samplings(evidence: Evidence) -> pd.DataFrame:
    """How often samplings of one test set separate methods that differ by chance alone.

    Returns:
        `samplings` (their number, or `faces` for all faces) and `rate` of false positives.
    """
    preset = evidence.run.preset
    rates = false_positives(
        evidence.scores("deep_mds").mse - evidence.scores("deep_mds_cosine").mse,
        sorted({preset.n_subsets, *SAMPLINGS}),
        preset.subset_size,
        evidence.rng(Stream.AUDIT_SIGNIFICANCE),
        preset.simulations,
    )
    return pd.Series(rates, name="rate").rename_axis("samplings").reset_index()


def false_positives(
    difference: np.ndarray,
    samplings: list[int],
    size: int,
    rng: np.random.Generator,
    simulations: int,
) -> dict[str, float]:
    """Share of cases in which methods that differ by chance alone test as different.

    In every simulation the two methods swap their errors on a random half of the faces, so that
    neither is better. Then follows the paper's procedure: random samplings of the faces, and the
    Wilcoxon test over their mean differences.

    Args:
        difference: `(n,)` error of one method less that of the other, for each face.
        size: Faces in each, at most n.

    Returns:
        Number of samplings → share; that of the test over all faces is under `"faces"`.
    """
    n, most = len(difference), max(samplings)
    exchanged = rng.choice([-1.0, 1.0], (simulations, n)) * difference
    means = np.empty((simulations, most))
    for row, errors in zip(means, exchanged, strict=True):
        faces = np.argpartition(rng.random((most, n)), size - 1, axis=1)[:, :size]
        row[:] = errors[faces].mean(1)
    tested = {str(k): means[:, :k] for k in samplings} | {"faces": exchanged}
    return {name: np.mean(wilcoxon(t, axis=1).pvalue < LEVEL) for name, t in tested.items()}
