"""Tables of the protocol `hard`: methods by conditions."""

from __future__ import annotations

import numpy as np
import pandas as pd

from experiments.lifting.views import CONDITIONS
from experiments.methods import title
from experiments.scoring.latex import tabular
from experiments.scoring.numbers import NOTHING, plus_minus

_UNIT = 1e-6


def with_limit(condition: str, method: str, errors: np.ndarray, best: np.ndarray) -> list[dict]:
    """Rows of the mean error, and of its ratio to the limit's on the same faces.

    Args:
        condition, method: Their ids.
        errors: `(n,)` mean squared errors of the method.
        best: `(n,)` of the limit.
    """
    n, ratio = len(errors), errors.mean() / best.mean()
    spread = (errors - ratio * best).std(ddof=1) / best.mean()
    found = {
        "mse": (errors.mean(), errors.std(ddof=1)),
        "times_limit": (ratio, spread),
    }
    return [
        {
            "condition": condition,
            "method": method,
            "metric": metric,
            "mean": mean,
            "standard_error": std / np.sqrt(n),
            "n_faces": n,
        }
        for metric, (mean, std) in found.items()
    ]


def latex(metrics: pd.DataFrame) -> str:
    r"""Errors and standard errors, methods by conditions, as a booktabs `tabular` to `\input`."""
    return tabular(_cells(metrics), "l" + "r" * len(CONDITIONS))


def text(metrics: pd.DataFrame) -> str:
    """The same for the terminal."""
    return _cells(metrics).to_string(index=False)


def _cells(metrics: pd.DataFrame) -> pd.DataFrame:
    errors = metrics[metrics["metric"] == "mse"].set_index(["method", "condition"])
    rows = []
    for method in errors.index.unique("method"):
        row = {"Method": title(method)}
        for condition in CONDITIONS:
            key = method, condition.id
            known = key in errors.index
            own = errors.loc[key, ["mean", "standard_error"]] if known else None
            row[condition.title] = plus_minus(*own, _UNIT) if known else NOTHING
        rows.append(row)
    return pd.DataFrame(rows)
