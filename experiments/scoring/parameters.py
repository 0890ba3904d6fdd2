"""The paper's table of trainable parameters and time complexity, with ours beside it."""

from __future__ import annotations

import pandas as pd

from experiments.inputs import load_landmark_model
from experiments.methods import METHODS, title
from experiments.metrics import METRICS
from experiments.published import printed
from experiments.records import write_text
from experiments.run import Run
from experiments.scoring.latex import tabular
from experiments.scoring.numbers import NOTHING
from experiments.scoring.tables import write_csv

_LEGEND = (
    "Paper: quoted from Kamyab and Azimifar. Total: with the moving "
    "statistics of batch normalisation. n: landmarks, t: iterations, k: components of the face "
    f"model. {NOTHING}: not measured here, or not in the paper."
)

HEADS = {
    "method": "Method",
    "trainable": "Trainable",
    "total": "Total",
    "paper": "Trainable (paper)",
    "complexity_paper": "Complexity (paper)",
    "complexity": "Complexity",
    **{name: METRICS[name].head
       for name in ("ms_per_face", "ms_per_face_lowest", "ms_per_face_highest")},
}  # fmt: skip


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

    counts = _values(metrics, "n_parameters")
    times = {name: _values(metrics, name) for name in HEADS if name.startswith("ms_per_face")}
    quoted = printed("parameters", "n_parameters")
    quoted_times = printed("parameters", "time_complexity")
    rows = []
    for method in METHODS.values():
        if method.complexity is None:
            continue
        trainable = total = counts.get(method.id)
        if method.networks:
            nets = method.networks(n_landmarks, n_coefficients)
            total = sum(net.count_params() for net in nets)
            trainable = count_trainable(*nets)
        rows.append(
            {
                "method": method.id,
                "trainable": "" if trainable is None else f"{trainable:.0f}",
                "total": "" if total is None else f"{total:.0f}",
                "paper": quoted.get(method.paper, ""),
                "complexity_paper": quoted_times.get(method.paper, ""),
                "complexity": method.complexity,
                **{
                    name: f"{own[method.id]:.3g}" if method.id in own else ""
                    for name, own in times.items()
                },
            }
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


def _values(metrics: pd.DataFrame, metric: str) -> dict[str, float]:
    rows = metrics[metrics["metric"] == metric]
    return dict(zip(rows["method"], rows["value"], strict=True))
