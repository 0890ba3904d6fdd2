"""Step: views far from the paper's, turned, near, noisy and incomplete, against the lower bound.

Every condition is a column of the table. Learning methods are trained for each, on the same faces.
"""

import numpy as np
import pandas as pd

from deepmds_keras.geometry.units import centre_and_scale
from experiments.figures.errors import Panel, error_lines
from experiments.lifting.contenders import aligned_mse, lower_bound, simple_methods
from experiments.lifting.train import DEEP_MDS, LIFTING, SEEDED, hard_file, hard_seeds, load_network
from experiments.lifting.views import CONDITIONS, MOST_MISSING, Condition, hard_views
from experiments.methods import title
from experiments.progress import counted
from experiments.run import Run
from experiments.streams import Stream
from experiments.studies.study_results import grid, write_results
from experiments.tasks import unordered

METRICS = ["mse", "times_lower_bound", "within_1_sd", "within_2_sd"]
_UNIT = 1e-6
_YAW_STEP = 10.0  # degrees
_ABOUT = (
    "MSE: mean square over coordinates in 10⁻⁶ of the squared min-max unit, after Procrustes "
    "alignment with scale and reflection, ± its standard error over the test faces. Of several "
    "seeds it is the mean."
)
_FILLED = "missing coordinates are put where a regression on those that are seen expects them"
NOTES = {
    **dict.fromkeys(("ridge", "ridge_roll_aligned", "mlp"), f"trained for each column; {_FILLED}"),
    "aldrian": "given the noise together with what its camera cannot express of the perspective; "
    f"{_FILLED}",
    "map": "given the noise, the face model and the prior of the perspective",
    DEEP_MDS: "trained for each column; it has no way to leave a landmark out",
    LIFTING: "trained for each column, for all with missing landmarks once, on views that miss "
    f"up to {MOST_MISSING:.0%}; told the noise, which in a column is the same for all",
    "lower_bound": "what a single view leaves open to a method that knows the face model and the "
    "camera",
}
METHODS = ["mean_shape", *NOTES]


def measure(run: Run, condition: Condition) -> pd.DataFrame:
    """Errors of every method on the test faces of a condition.

    Returns:
        One row per face: `condition`, `method`, `seed`, `yaw` to either side in degrees, and
        `METRICS`, of which the last two are NaN except for lifting.
    """
    parts, faces = [], hard_views(run, condition)
    best = lower_bound(run, faces, np.random.default_rng([run.seed, Stream.HARD_BOUND]))

    def add(method: str, seed: int, errors: np.ndarray, **metrics: np.ndarray) -> None:
        ratio = errors.mean() / best.mean()
        # Linearised ratio of means, so that the standard error of its mean is that of the ratio.
        ratios = ratio + (errors - ratio * best) / best.mean()
        rows = pd.DataFrame({"mse": errors, "times_lower_bound": ratios} | metrics)
        yaw = np.abs(faces.cameras.yaw)
        parts.append(rows.assign(condition=condition.id, method=method, seed=seed, yaw=yaw))

    for method, shapes in simple_methods(run, condition, faces).items():
        add(method, run.seed, aligned_mse(shapes, faces.shapes))
    if not condition.missing:
        net = load_network(hard_file(run, DEEP_MDS, condition, run.seed))
        add(DEEP_MDS, run.seed, aligned_mse(net.predict(faces.views), faces.shapes))
    for seed in hard_seeds(run, condition):
        lifter = load_network(hard_file(run, LIFTING, condition, seed))
        shapes, sd = lifter.predict(faces.views, landmark_sd=faces.sd_mm, return_std=True)
        within = coverage(shapes, sd, centre_and_scale(faces.shapes))
        add(LIFTING, seed, aligned_mse(shapes, faces.shapes), **within)
    add("lower_bound", run.seed, best)
    return pd.concat(parts)


def coverage(shapes: np.ndarray, sd: np.ndarray, truth: np.ndarray) -> dict[str, np.ndarray]:
    """Share of the coordinates of each face that are within one and two of their s.d. `(n,)`."""
    off = np.abs(shapes - truth) / sd
    return {f"within_{n}_sd": (off <= n).mean((1, 2)) for n in (1, 2)}


def summarise(errors: pd.DataFrame) -> pd.DataFrame:
    """Mean of every method in every condition; empty if it cannot be used.

    `standard_error` is over the faces and, like `mean`, averaged over seeds; `std` is over seeds.
    """
    cell = ["method", "condition", "metric"]
    values = errors.melt(["method", "condition", "seed"], METRICS, "metric").dropna()
    seeds = values.groupby([*cell, "seed"])["value"].agg(["mean", "sem", "count"])
    table = seeds.groupby(level=cell).agg(
        mean=("mean", "mean"),
        standard_error=("sem", "mean"),
        std=("mean", "std"),
        n_seeds=("mean", "count"),
        n_faces=("count", "first"),
    )
    methods = [method for method in METHODS if (errors["method"] == method).any()]
    conditions = sorted(condition.id for condition in CONDITIONS)
    rows = pd.MultiIndex.from_product([methods, conditions, METRICS], names=cell)
    table = table.astype({"n_seeds": "Int64", "n_faces": "Int64"}).reindex(rows).reset_index()
    table = table[table["mean"].notna() | (table["metric"] == "mse")]
    return table.assign(note=table["method"].map(NOTES))


def by_yaw(errors: pd.DataFrame) -> pd.DataFrame:
    """Errors in hard conditions by yaw (the middle of a bin), of the first seed of each method."""
    first = errors["seed"] == errors["seed"].min()
    rows = errors[first & errors["condition"].str.startswith("hard")]
    rows = rows.assign(
        yaw=(rows["yaw"] // _YAW_STEP + 0.5) * _YAW_STEP,
        condition=pd.Categorical(rows["condition"], [condition.id for condition in CONDITIONS]),
        method=pd.Categorical(rows["method"], METHODS),
    )
    bins = rows.groupby(["condition", "method", "yaw"], observed=True)["mse"]
    table = bins.agg(mean="mean", standard_error="sem", n_faces="count").reset_index()
    columns = ["method", "condition", "yaw", "mean", "standard_error", "n_faces"]
    return table.loc[table["n_faces"] > 1, columns]


def cells(table: pd.DataFrame) -> pd.DataFrame:
    """Errors ± standard errors of a table from `summarise`, methods by conditions."""
    rows = table[table["metric"] == "mse"].rename(columns={"mean": "mse", "standard_error": "sem"})
    texts = grid(rows, "method", "condition", _UNIT)[[c.id for c in CONDITIONS]]
    texts.columns = [c.title for c in CONDITIONS]
    return texts.rename(index=title).rename_axis("Method")


def main(run: Run) -> dict:
    tasks = [(run, condition) for condition in CONDITIONS]
    parts = counted("condition", unordered(run.jobs, measure, tasks), len(tasks))
    errors = pd.concat(parts)
    table, curves = summarise(errors), by_yaw(errors)
    rows = curves[curves["condition"] == SEEDED].rename(columns={"standard_error": "sem"})
    figure = error_lines([Panel(rows, "yaw", "Yaw to either side (degrees)")], unit=_UNIT)
    tables, figures = {"table": table, "by_yaw": curves}, {"errors_by_yaw": figure}
    notes = [_ABOUT, *(f"{title(method)}: {note}." for method, note in NOTES.items())]
    return write_results(run, "lifting/hard", tables, cells(table), notes, figures)
