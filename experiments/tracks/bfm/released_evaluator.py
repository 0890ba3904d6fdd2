"""Scores Zhao's net as the authors' evaluation script does, and a net that makes no error."""

from __future__ import annotations

import numpy as np

# Rows that the script treats so; it aligns every other method's shape as it is, with reflection.
ZHAO = ("zhao", "zhao_authors", "zhao_frontal")
TRUE_DEPTH = "zhao_true_depth"
# The authors give the net frontal views, so that the paper's number stands beside those.
BESIDE = {"zhao": "zhao_frontal"}
_NOTE = (
    "scored as the released evaluator does: the true x and y, joined to the predicted depth of the "
    "face before, rescaled by itself to [0, 1]"
)
REMARKS = dict.fromkeys((*ZHAO, TRUE_DEPTH), _NOTE)


def as_released(predictions: dict[str, dict], truth: np.ndarray) -> dict[str, dict]:
    """Shapes that the released evaluator compares with the ground truth for each prediction.

    The script that evaluates Zhao's net reads depth alone, and from the file before. It rescales it
    to [0, 1] by itself and joins it to the true x and y, whose own depth spans less than half of
    that. It then averages one face only, which is not done here.

    Args:
        predictions: Method to arrays with `shapes`, `(n, L, 3)`.
        truth: `(n, L, 3)` normalised true landmarks.

    Returns:
        The same, with `shapes` of Zhao's rows replaced and the true depth added as a row.
    """
    shapes = {method: predictions[method]["shapes"] for method in ZHAO if method in predictions}
    shapes[TRUE_DEPTH] = truth
    replaced = {method: {"shapes": _joined(own[..., 2], truth)} for method, own in shapes.items()}
    return predictions | replaced


def _joined(depth: np.ndarray, truth: np.ndarray) -> np.ndarray:
    low, high = depth.min(1, keepdims=True), depth.max(1, keepdims=True)
    alone = np.roll((depth - low) / (high - low), 1, axis=0)
    return np.concatenate([truth[..., :2], alone[..., None]], axis=2)
