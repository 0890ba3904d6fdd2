"""The paper's table of trainable parameters and time complexity, next to ours."""

import re
from pathlib import Path

import pandas as pd

from experiments.inputs import load_landmark_model
from experiments.methods import METHODS, title
from experiments.records import write_csv, write_text
from experiments.run import Run
from experiments.scoring.latex import tabular
from experiments.scoring.metrics import METRICS
from experiments.scoring.numbers import NOTHING
from experiments.scoring.published import printed

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
        n_landmarks, n_coefficients: Of the face model, for counting networks. The paper has 72
            landmarks and the Basel model's 199 coefficients.

    Returns:
        Columns as in `HEADS`; `paper` and `complexity_paper` as the paper prints them. `total`
        adds the running statistics of batch normalisation, which nothing trains.
    """
    from deepmds_keras.networks import count_trainable  # printing a table needs no Keras

    measured = metrics[metrics["subset"].isna()].set_index(["method", "metric"])["value"]
    measured = measured.unstack().reindex(columns=["n_parameters", *_TIMES])
    methods = [method for method in METHODS.values() if method.complexity]
    table = measured.reindex([method.id for method in methods])
    table["trainable"] = table["total"] = table.pop("n_parameters")
    for method in methods:
        if method.networks:
            networks = method.networks(n_landmarks, n_coefficients)
            table.loc[method.id, "trainable"] = count_trainable(*networks)
            table.loc[method.id, "total"] = sum(network.count_params() for network in networks)
    for column, metric in (("paper", "n_parameters"), ("complexity_paper", "time_complexity")):
        quoted = printed("parameters", metric)
        table[column] = [quoted.get(method.paper, "") for method in methods]
    table["complexity"] = [method.complexity for method in methods]
    formats = dict.fromkeys(("trainable", "total"), "{:.0f}") | dict.fromkeys(_TIMES, "{:.3g}")
    for column, form in formats.items():
        table[column] = ["" if pd.isna(n) else form.format(n) for n in table[column]]
    return table.reset_index()[[*HEADS]]


def latex(table: pd.DataFrame) -> str:
    r"""The table as a booktabs `tabular` to `\input`."""
    counts = {
        column: [re.sub(r"\d{4,}", lambda n: f"{int(n[0]):,}", text) for text in table[column]]
        for column in ("trainable", "total", "paper")
    }
    cells = table.assign(method=table["method"].map(title), **counts).replace("", NOTHING)
    return tabular(cells.rename(columns=HEADS), "lrrrll" + 3 * "r", [_LEGEND])


def write_parameter_table(folder: Path, run: Run, metrics: pd.DataFrame) -> None:
    """Write `table.csv` and `table.tex` into a folder."""
    mean, basis = load_landmark_model(run)
    table = parameter_table(metrics, len(mean), len(basis))
    write_csv(folder / "table.csv", table)
    write_text(folder / "table.tex", latex(table))
