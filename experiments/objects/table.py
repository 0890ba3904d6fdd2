"""Step: the table and the figure of all objects."""

import pandas as pd

from experiments.figures.errors import Panel, error_lines
from experiments.methods import title
from experiments.objects.shapes import METHODS, NOISES, OBJECTS, scores_file
from experiments.run import Run
from experiments.scoring.numbers import between
from experiments.studies.study_results import write_results

_UNIT = 1e-3
_NOTES = (
    "Mean squared distance of a landmark in 10⁻³ of the squared r.m.s. radius, after alignment "
    "with scale and reflection: median [lowest, highest] over seeds.",
    "Shapes are first rotated onto the mean training shape, since views are from all sides.",
    "Views are orthographic; noise is the s.d. of a coordinate in r.m.s. radii.",
    "Chairs: 220 of 920 are held out. Sequences: the last third of one motion is.",
    "MAP knows the noise and, in place of a face model, the principal components of the training "
    "shapes. LandmarkLifter is told the noise; the others are trained with it.",
)


def summarise(scores: pd.DataFrame) -> pd.DataFrame:
    """Median, lowest and highest error over seeds by `object`, `noise` and `method`."""
    cells = scores.groupby(["object", "noise", "method"], sort=False)
    table = cells.agg(
        median=("error", "median"),
        lowest=("error", "min"),
        highest=("error", "max"),
        frontal_share=("frontal_share", "median"),
        n_seeds=("seed", "count"),
        n_views=("n_views", "first"),
        n_landmarks=("n_landmarks", "first"),
    )
    return table.reset_index()


def main(run: Run) -> dict:
    files = [scores_file(run, name, seed) for name in OBJECTS for seed in run.few_seeds]
    scores = pd.concat(map(pd.read_csv, files), ignore_index=True)
    table = summarise(scores)
    texts = table.assign(
        text=[between(*ends, _UNIT) for ends in table[["median", "lowest", "highest"]].to_numpy()],
        of=table["object"] + table["noise"].map(", {:.0%}".format),
    )
    cells = texts.pivot_table("text", "of", "method", "first", sort=False)[[*METHODS]]
    cells = cells.rename(columns=title).rename_axis(index="Object, noise", columns=None)
    rows = table.rename(columns={"median": "mean", "lowest": "low", "highest": "high"})
    panels = [
        Panel(
            rows[rows["noise"] == n], "object", title=f"Noise of {100 * n:g} % of the r.m.s. radius"
        )
        for n in NOISES
    ]
    options = {"interval": "range over seeds", "n_columns": 1}
    figure = error_lines(panels, "MSE of an object", _UNIT, "squared r.m.s. radii", **options)
    figures = {"errors": figure}
    folder = run.shared_results / "objects"
    return write_results(run, folder, {"table": table, "metrics": scores}, cells, _NOTES, figures)
