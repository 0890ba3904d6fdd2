"""Step: errors of the methods against the scale of the Basel model's s.d., table and figure."""

import pandas as pd
from matplotlib.figure import Figure

from experiments.figures.errors import Panel, error_lines, level
from experiments.figures.style import INK, Look
from experiments.methods import title
from experiments.run import Run
from experiments.scoring.numbers import between
from experiments.scoring.published import published_mse
from experiments.studies.scale import scores_file, trainings
from experiments.studies.study_results import write_results

_UNIT = 1e-4
_PRINTED = "printed"
_NOT_DRAWN = "map"  # far below the others, which it would press together
_NOTES = (
    "MSE in 10⁻⁴ squared normalised units, and share of a face's offset from the mean shape that "
    "is recovered (slope): median [lowest, highest] over seeds.",
    "Scales are of the s.d. of 3DDFA's fits, which underestimate the Basel model's.",
    "Aldrian & Smith and MAP are given the face model.",
)


def main(run: Run) -> dict:
    files = [scores_file(run, scale, seed) for scale, seed in trainings(run)]
    scores = pd.concat(map(pd.read_csv, files), ignore_index=True)
    table = summarise(scores)
    tables = {"table": table, "metrics": scores}
    return write_results(run, "scales", tables, cells(table), _NOTES, {"errors": draw(table)})


def summarise(scores: pd.DataFrame) -> pd.DataFrame:
    """Median and range over seeds of `mse`, `slope` and `over_mean_shape`, by scale and method.

    The last is the error in that of the mean shape on the same faces.
    """
    by_faces = scores[scores["method"] == "mean_shape"].set_index(["scale", "seed"])["mse"]
    faces = pd.MultiIndex.from_frame(scores[["scale", "seed"]])
    scores = scores.assign(over_mean_shape=scores["mse"].to_numpy() / by_faces[faces].to_numpy())
    groups = scores.groupby(["scale", "method"], sort=False)
    parts = [groups["seed"].agg(n_seeds="count")]
    for column in ("mse", "slope", "over_mean_shape"):
        ends = {f"{column}_lowest": "min", f"{column}_highest": "max"}
        parts.append(groups[column].agg(**{column: "median"} | ends))
    return pd.concat(parts, axis=1).reset_index()


def cells(table: pd.DataFrame) -> pd.DataFrame:
    """For readers: a row per method, a column per scale with its error and slope."""
    texts = [f"{_text(row, 'mse', _UNIT)}; {_text(row, 'slope')}" for _, row in table.iterrows()]
    shown = table.assign(
        text=texts, method=table["method"].map(title), scale=table["scale"].map("{:g}".format)
    )
    return shown.pivot_table("text", "method", "scale", "first", sort=False).rename_axis(
        index="Method", columns=None
    )


def _text(row: pd.Series, column: str, unit: float = 1.0) -> str:
    return between(row[column], row[f"{column}_lowest"], row[f"{column}_highest"], unit)


def draw(table: pd.DataFrame) -> Figure:
    """Errors against the scale, with the error that the paper prints for Deep-MDS as a line."""
    names = {"mse": "mean", "mse_lowest": "low", "mse_highest": "high"}
    rows = table[table["method"] != _NOT_DRAWN].rename(columns=names)
    mse = published_mse("deep_mds")
    line = level(rows["scale"], _PRINTED, mse)
    label = "Scale of the s.d. of 3DDFA's fits"
    looks = {_PRINTED: Look(f"published: Deep-MDS, {mse / _UNIT:.1f}", INK, "", (0, (4, 2)))}
    panel = Panel(pd.concat([rows, line]), "scale", label)
    return error_lines([panel], looks=looks, interval="range over seeds")
