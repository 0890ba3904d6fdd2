"""Topics on shapes: bias, constant answers, depth without error, ranks of distances, samplings."""

from __future__ import annotations

import numpy as np
import pandas as pd
from scipy.stats import norm, rankdata, wilcoxon

from deepmds_keras import metrics
from deepmds_keras.alignment import align
from deepmds_keras.embedding import check_dissimilarities, pairwise_distances
from deepmds_keras.normalisation import centre
from experiments.audit.measure import Evidence
from experiments.inputs import load_faces
from experiments.scoring.scores import load_prediction, score
from experiments.streams import Stream

LEVEL = 0.05  # of significance
SIMULATIONS = 500
SAMPLINGS = (20, 50)  # more than the paper's
_BIASED = (
    "mean_shape", "linear", "zhao", "aldrian", "mobileface", "ours", "ours_released", "ours_stable",
    "authors_weights", "lifting",
)  # fmt: skip
_CONSTANTS = 25  # faces taken for a constant answer, over which its error is averaged
_DIMENSIONS = (1, 2, 3, 4, 5, 6)
_CLOUDS = 50  # random ones of each dimension
_FEW_POINTS, _MANY_DIMENSIONS = 5, 10
_EIGENVALUES = 8  # listed
_ROUNDING = 1e-9  # share of the largest singular value below which others are 0


def bias(evidence: Evidence) -> pd.DataFrame:
    """Position of each method's shapes between the true ones and the mean training shape.

    Returns:
        `method` and what `bias_of` returns, over all test faces.
    """
    truth = evidence.test.shapes.astype(float)
    mean = evidence.scores("mean_shape").aligned
    methods = [method for method in _BIASED if evidence.run.prediction_file(method).exists()]
    rows = [bias_of(evidence.scores(method).aligned, mean, truth) for method in methods]
    return pd.DataFrame(rows, index=pd.Index(methods, name="method")).reset_index()


def bias_of(predicted: np.ndarray, mean: np.ndarray, truth: np.ndarray) -> dict[str, float]:
    """Position of predictions between mean shape and ground truth, to which both are aligned.

    Args:
        predicted, mean, truth: `(n, L, 3)`.

    Returns:
        `slope`: of the regression through the origin of predicted on true offsets from the mean,
        over all coordinates of all faces, and its standard error over faces `slope_se`. Errors
        that have nothing to do with the face leave it at 1, however large they are.
        `systematic_share`: of the mean error over faces in the mean squared error.
    """
    n = len(truth)
    offset, predicted_offset, error = (
        difference.reshape(n, -1)
        for difference in (truth - mean, predicted - mean, predicted - truth)
    )
    products, sizes = (predicted_offset * offset).sum(1), (offset**2).sum(1)
    slope = products.sum() / sizes.sum()
    # Of a ratio of two sums over faces, to first order.
    slope_se = np.sqrt(((products - slope * sizes) ** 2).sum() * n / (n - 1)) / sizes.sum()
    systematic_share = (error.mean(0) ** 2).sum() / (error**2).sum(1).mean()
    return {"slope": slope, "slope_se": slope_se, "systematic_share": systematic_share}


def constants(evidence: Evidence) -> pd.DataFrame:
    """Errors of one answer to all views: `answer, mse`.

    The answers are what Deep-MDS makes of one test view, a training face, and last the mean of the
    training faces' frontal views, as the answer to these.
    """
    run, test = evidence.run, evidence.test[evidence.audited]
    rng = np.random.default_rng([run.seed, Stream.AUDIT_RANKING])
    train = load_faces(run, "train").shapes

    def error_of_some(shapes: np.ndarray) -> float:
        chosen = rng.choice(len(shapes), min(_CONSTANTS, len(shapes)), replace=False)
        answers = (np.broadcast_to(shapes[face], test.shapes.shape) for face in chosen)
        return float(np.mean([score(answer, test).mse.mean() for answer in answers]))

    errors = {
        "own_output": error_of_some(load_prediction(run, "ours")[0]["shapes"]),
        "training_face": error_of_some(train),
        "frontal_view": train[..., :2].var(0, dtype=float).mean(),
    }
    return pd.Series(errors, name="mse").rename_axis("answer").reset_index()


def depth(evidence: Evidence) -> pd.DataFrame:
    """Depth correlation of answers that know little or nothing of the depth.

    Returns:
        `answer`, and shares of the maximum: `share` of the paper's criterion, `share_centred` with
        the origin at the mean of the landmarks, `share_across_faces` of the criterion that the
        paper cites.
    """
    rng = np.random.default_rng([evidence.run.seed, Stream.AUDIT_CRITERIA])
    truth = evidence.test.shapes[evidence.audited].astype(float)
    predicted, _ = load_prediction(evidence.run, "mean_shape")
    mean_shape, centred = predicted["shapes"][evidence.audited], centre(truth)
    answers = answers_without_depth(truth, mean_shape, rng)
    of_centred = answers_without_depth(centred, mean_shape, rng)
    criteria = [
        (
            answer,
            metrics.depth_corr(shapes, truth).mean(),
            metrics.depth_corr(of_centred[answer], centred).mean(),
            metrics.depth_corr_across_faces(shapes, truth),
        )
        for answer, shapes in answers.items()
    ]
    columns = ["answer", "share", "share_centred", "share_across_faces"]
    table = pd.DataFrame(criteria, columns=columns).set_index("answer")
    return (table / table.loc["truth"]).reset_index()


def answers_without_depth(
    truth: np.ndarray, mean_shape: np.ndarray, rng: np.random.Generator
) -> dict[str, np.ndarray]:
    """The truth and answers that know little or nothing of its depth, aligned as predictions are.

    Args:
        truth, mean_shape: `(n, L, 3)`.
        rng: Of a cloud of points.
    """
    flat = truth.copy()
    flat[..., 2] = truth[..., 2].mean(1, keepdims=True)
    answers = {
        "truth": truth,
        "mean_shape": mean_shape,
        "flat": flat,
        "cloud": rng.standard_normal(truth.shape),
        "point": np.zeros_like(truth),
    }
    return {name: align(answer, truth) for name, answer in answers.items()}


def ranks(evidence: Evidence) -> pd.DataFrame:
    """Ranks of matrices of distances between points: random clouds, faces, and two special cases.

    Returns:
        `points`, their `dimensions`, and the ranks of the `distances`, of their squares `squared`,
        and of these doubly `centred`.
    """
    shapes = evidence.test.shapes[evidence.audited].astype(float)
    rng = np.random.default_rng([evidence.run.seed, Stream.AUDIT_DISSIMILARITY])
    clouds = [rng.standard_normal((_CLOUDS, shapes.shape[1], size)) for size in _DIMENSIONS]
    few = rng.standard_normal((_CLOUDS, _FEW_POINTS, _MANY_DIMENSIONS))
    special = [("faces in a plane", shapes * (1, 1, 0)), ("five points", few)]
    rows = []
    for name, points in (*[("cloud", cloud) for cloud in clouds], ("faces", shapes), *special):
        distances = pairwise_distances(points)
        matrices = (distances, np.square(distances), doubly_centred(distances))
        of_faces = (np.linalg.matrix_rank(matrix, rtol=_ROUNDING) for matrix in matrices)
        rows.append((name, points.shape[-1], *(int(np.median(each)) for each in of_faces)))
    columns = ["points", "dimensions", "distances", "squared", "centred"]
    return pd.DataFrame(rows, columns=columns)


def spectra(evidence: Evidence) -> pd.DataFrame:
    """Largest eigenvalues of squared dissimilarities, doubly centred, means over audited faces.

    Returns:
        `matrix` (`true` 3D distances, `learnt` dissimilarities, or distances in the `frontal`
        view), number of the `eigenvalue` from the largest in absolute value, and its `share` of the
        sum of absolute values, with the sign that it has for most faces.
    """
    model, views = evidence.method("ours"), evidence.test.views[evidence.audited]
    shapes = evidence.test.shapes[evidence.audited].astype(float)
    matrices = {
        "true": pairwise_distances(shapes),
        "learnt": check_dissimilarities(np.abs(model.dissimilarities(views))),
        "frontal": pairwise_distances(model.frontalise(views).astype(float)),
    }
    rows = []
    for name, dissimilarities in matrices.items():
        values = np.linalg.eigvalsh(doubly_centred(dissimilarities))
        order = np.argsort(-np.abs(values), axis=1)
        shares = np.take_along_axis(values, order, 1) / np.abs(values).sum(1, keepdims=True)
        means = np.abs(shares).mean(0) * np.where(np.median(shares, 0) < 0, -1, 1)
        rows += [(name, place, share) for place, share in enumerate(means[:_EIGENVALUES], 1)]
    return pd.DataFrame(rows, columns=["matrix", "eigenvalue", "share"])


def doubly_centred(dissimilarities: np.ndarray) -> np.ndarray:
    """`(n, L, L)` → minus half the squares, whose rows and columns sum to 0 (Torgerson 1952)."""
    centring = np.eye(dissimilarities.shape[-1]) - 1 / dissimilarities.shape[-1]
    return -0.5 * centring @ np.square(dissimilarities) @ centring


def samplings(evidence: Evidence) -> pd.DataFrame:
    """How often samplings of one test set tell methods apart that only chance does.

    Returns:
        `samplings` (their number, or `faces`: the test over all faces) and `rate` of false
        positives over `simulations`.
    """
    preset = evidence.run.preset
    rates = false_positives(
        evidence.scores("ours").mse - evidence.scores("ours_stable").mse,
        sorted({preset.n_subsets, *SAMPLINGS}),
        preset.subset_size,
        np.random.default_rng([evidence.run.seed, Stream.AUDIT_SIGNIFICANCE]),
    )
    table = pd.Series(rates, name="rate").rename_axis("samplings").reset_index()
    return table.assign(simulations=SIMULATIONS)


def false_positives(
    difference: np.ndarray,
    samplings: list[int],
    size: int,
    rng: np.random.Generator,
    simulations: int = SIMULATIONS,
) -> dict[str, float]:
    """Share of cases in which methods that only chance tells apart come out as different.

    In every simulation the two methods exchange their errors for a random half of the faces, so
    that neither is the better one. Then the paper's procedure: random samplings of the faces, and
    the Wilcoxon test over their mean differences.

    Args:
        difference: `(n,)` error of one method less that of the other, for each face.
        samplings: Numbers of samplings.
        size: Faces of each, at most n.

    Returns:
        By number of samplings; and of the test over all faces under `"faces"`.
    """
    n, most = len(difference), max(samplings)
    signs = rng.choice([-1.0, 1.0], (simulations, n))
    means = np.empty((simulations, most))
    for row, exchanged in zip(means, signs * difference, strict=True):
        faces = np.argpartition(rng.random((most, n)), size - 1, axis=1)[:, :size]
        row[:] = exchanged[faces].mean(1)
    rates = {
        str(k): float(np.mean(wilcoxon(means[:, :k], axis=1).pvalue < LEVEL)) for k in samplings
    }
    ranked = rankdata(np.abs(difference))
    z = signs @ (ranked * np.sign(difference)) / np.sqrt((ranked**2).sum())
    return rates | {"faces": float(np.mean(2 * norm.sf(np.abs(z)) < LEVEL))}
