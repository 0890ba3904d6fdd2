"""The paper's table of trainable parameters and time complexity, with ours beside it."""

from __future__ import annotations

import pandas as pd

from experiments.inputs import load_landmark_model
from experiments.methods import METHODS, title
from experiments.metrics import METRICS
from experiments.published import printed
from experiments.records import write_csv, write_text
from experiments.run import Run
from experiments.scoring.latex import tabular
from experiments.scoring.numbers import NOTHING

_LEGEND = (
    "Paper: quoted from Kamyab and Azimifar. Total: with the moving "
    "statistics of batch normalisation. n: landmarks, t: iterations, k: components of the face "
    f"model. {NOTHING}: not measured here, or not in the paper."
)
_TIMES = ("ms_per_face", "ms_per_face_lowest", "ms_per_face_highest")
HEADS = {
    "method": "Method",
    "trainable": "Trainable",
    "total": "Total",
    "paper": "Trainable (paper)",
    "complexity_paper": "Complexity (paper)",
    "complexity": "Complexity",
    **{metric: METRICS[metric].head for metric in _TIMES},
}


def parameter_table(
    metrics: pd.DataFrame, n_landmarks: int = 72, n_coefficients: int = 199
) -> pd.DataFrame:
    """Parameters, complexity and measured time of every method, as strings.

    Args:
        metrics: As `metrics.csv`. Counts and times of methods that have no row stay empty.
        n_landmarks: For which our networks are counted; the paper counts at 72.
        n_coefficients: Of the face model, for which MobileFace is counted; the Basel model has 199.

    Returns:
        Columns as in `HEADS`; `paper` and `complexity_paper` as the paper prints them. `total`
        adds the moving statistics of batch normalisation, which nothing trains.
    """
    from deepmds_keras.networks import count_trainable  # who only prints a table has no Keras

    measured = metrics[metrics["subset"].isna()].set_index(["method", "metric"])["value"]
    quoted = printed("parameters", "n_parameters")
    quoted_times = printed("parameters", "time_complexity")
    rows = []
    for method in METHODS.values():
        if method.complexity is None:
            continue
        trainable = total = measured.get((method.id, "n_parameters"))
        if method.networks:
            networks = method.networks(n_landmarks, n_coefficients)
            trainable = count_trainable(*networks)
            total = sum(network.count_params() for network in networks)
        times = [measured.get((method.id, metric)) for metric in _TIMES]
        rows.append(
            (
                method.id,
                *("" if count is None else f"{count:.0f}" for count in (trainable, total)),
                quoted.get(method.paper, ""),
                quoted_times.get(method.paper, ""),
                method.complexity,
                *("" if time is None else f"{time:.3g}" for time in times),
            )
        )
    return pd.DataFrame(rows, columns=[*HEADS])


def latex(table: pd.DataFrame) -> str:
    r"""The table as a booktabs `tabular` to `\input`."""
    cells = table.assign(method=table["method"].map(title)).replace("", NOTHING)
    return tabular(cells.rename(columns=HEADS), "lrrrll" + 3 * "r", [_LEGEND])


def write_parameter_table(run: Run, metrics: pd.DataFrame) -> None:
    """Write `table.csv` and `table.tex` into `results/<model>/parameters`."""
    folder = run.model_results / "parameters"
    table = parameter_table(metrics, n_coefficients=len(load_landmark_model(run)[1]))
    write_csv(folder / "table.csv", table)
    write_text(folder / "table.tex", latex(table))
