"""Tables of the anatomy and of the transfer as they are read."""

from __future__ import annotations

import pandas as pd

from experiments.face_models import FACE_MODELS, TITLES
from experiments.methods import title
from experiments.scoring.numbers import plus_minus, power

STEPS = {
    "mean_shape": "Mean shape",
    "deep_mds": "Deep-MDS, cosine schedule",
    "true_frontal": "The true frontal view, not the autoencoder's",
    "landmarks_known": "A dissimilarity net that knows which landmarks it sees",
    "whole_view": "One that also sees the whole view, as it was given",
    "lifting": "The distances of the lifting network",
    "true_distances": "The true distances",
    "limit": "Limit: with the face model and the camera known",
}
EMBEDDINGS = {"non_metric": "Non-metric MDS", "metric": "Metric MDS", "none": "Without MDS"}
_ANATOMY_UNIT, _TRANSFER_UNIT = 1e-6, 1e-5
_NOTHING = 1e-12  # an error that is rounding


def anatomy_cells(table: pd.DataFrame) -> pd.DataFrame:
    """A row a step, a column an embedding: mean ± standard error.

    Args:
        table: `step`, `embedding`, `mse` and its standard error `sem`.
    """
    found = {
        (row.step, row.embedding): _quoted(row.mse, row.sem, _ANATOMY_UNIT)
        for row in table.itertuples()
    }
    rows = [
        [STEPS[step], *(found.get((step, kind), "") for kind in EMBEDDINGS)]
        for step in dict.fromkeys(table["step"])
    ]
    return pd.DataFrame(rows, columns=[f"MSE ({power(_ANATOMY_UNIT)})", *EMBEDDINGS.values()])


def transfer_cells(table: pd.DataFrame) -> pd.DataFrame:
    """A row a model and method, a column a noise: mean ± standard error.

    Args:
        table: `tested`, `noise_mm`, `method`, `mse` and its standard error `sem`.
    """
    rows = []
    for (tested, method), own in table.groupby(["tested", "method"], sort=False):
        errors = [_quoted(*values, _TRANSFER_UNIT) for values in own[["mse", "sem"]].to_numpy()]
        rows.append([TITLES[tested], title(method), *errors])
    heads = [f"{noise:g} mm" for noise in dict.fromkeys(table["noise_mm"])]
    return pd.DataFrame(rows, columns=["Tested on", f"MSE ({power(_TRANSFER_UNIT)})", *heads])


def left_out_notes(left_out: list[str]) -> list[str]:
    """Why there is no test on some models."""
    return [
        f"Not tested on {TITLES[name]}, which DATA= does not hold: {FACE_MODELS[name][1]}."
        for name in left_out
    ]


def _quoted(mse: float, sem: float, unit: float) -> str:
    return "0" if mse < _NOTHING else plus_minus(mse, sem, unit)
