"""Step: ablation of the method's parts, from the trainings of `studies.variant` over seeds.

The paper compares mini-batches of one face with shuffled ones. Further variants are the net without
its skip connection and of other depths, the method without its autoencoder, and both networks
trained on fewer faces.
"""

import json

import pandas as pd
from matplotlib.figure import Figure
from scipy.stats import sem

from deepmds_keras.baselines.closed_form import MeanShape, RidgeRegression
from experiments.figures.curves import FIRST_EPOCH, epochs_from
from experiments.figures.errors import Panel, error_lines
from experiments.figures.style import Look
from experiments.inputs import load_faces
from experiments.run import Run
from experiments.scoring.scores import score, subsets
from experiments.studies.seeds import seed_statistics
from experiments.studies.study_results import grid, write_results
from experiments.studies.variant import VARIANTS, ablation_trainings, scores_file

_HEADS = {
    "loss_train": "Loss in training (1e-4)",
    "loss_inference": "Inference-mode loss (1e-4)",
    "mse": "MSE (1e-4)",
}
_SCHEDULES = {"": "Constant learning rate", "_cosine": "Cosine schedule"}
_NOTE = "± is the standard deviation over seeds of the dissimilarity net, on one autoencoder."
_MODES = {"train": "training mode", "inference": "inference mode"}


def main(run: Run) -> dict:
    metrics, losses = collect(run)
    table = seed_statistics(metrics, ["variant", "faces", "metric"])
    curve = training_curve(run, metrics)
    tables = {"metrics": metrics, "losses": losses, "table": table, "curves": curve}
    panel = Panel(curve.rename(columns={"mse": "mean"}), "value", "Training faces", log_x=True)
    figures = {"mini_batches": mini_batches(losses), "training_faces": error_lines([panel])}
    return write_results(run, "ablation", tables, cells(table), [_NOTE], figures)


def collect(run: Run) -> tuple[pd.DataFrame, pd.DataFrame]:
    """All trainings: `variant, faces, seed, metric, value`, and the losses by epoch."""
    metrics, losses = [], []
    for item, seed in ablation_trainings(run):
        name, _, size = item.partition("-")
        training = json.loads(scores_file(run, item, seed).read_text(encoding="utf-8"))
        of = {"variant": name, "faces": int(size or run.preset.train_faces), "seed": seed}
        metrics += [of | {"metric": m, "value": value} for m, value in training["values"].items()]
        history = pd.DataFrame(training["history"], columns=[*_MODES])
        losses.append(pd.DataFrame({**of, "epoch": history.index + 1}).join(history))
    return pd.DataFrame(metrics), pd.concat(losses, ignore_index=True)


def training_curve(run: Run, metrics: pd.DataFrame) -> pd.DataFrame:
    """Test error by number of training faces: ours from one seed, and two methods without seed.

    Returns:
        `sweep, value, method, mse, sem`; the last value stands for all faces.
    """
    train, test = load_faces(run, "train"), load_faces(run, "test")
    test = test[subsets(run, len(test.views))[0]]
    first = metrics[metrics["seed"] == run.seed]
    errors = first.set_index(["variant", "faces", "metric"])["value"].unstack()
    rows = []
    for n in (*run.preset.training_sizes, run.preset.train_faces):
        for method, model in (("mean_shape", MeanShape()), ("ridge", RidgeRegression())):
            model.fit(train.views[:n], train.shapes[:n])
            mse = score(model.predict(test.views), test).mse
            rows.append((n, method, mse.mean(), sem(mse)))
        for schedule in _SCHEDULES:
            name = "same_face" if n == run.preset.train_faces else "fewer_faces"
            mse = errors.loc[(f"{name}{schedule}", n), ["mse", "mse_sem"]]
            rows.append((n, f"deep_mds{schedule}", *mse))
    curve = pd.DataFrame(rows, columns=["value", "method", "mse", "sem"])
    curve.insert(0, "sweep", "training_faces")
    return curve.sort_values(["method", "value"], ignore_index=True)


def cells(table: pd.DataFrame) -> pd.DataFrame:
    """Mean ± s.d. over the seeds of each `Variant`, as text, from `table.csv`."""
    rows = table.rename(columns={"mean": "mse", "std": "sem", "count": "seeds"})
    rows["variant"] = [VARIANTS[variant].title for variant in rows["variant"]]
    rows["faces"], rows["seeds"] = rows["faces"].map("{:,}".format), rows["seeds"].astype(str)
    texts = grid(rows, ["variant", "faces", "seeds"], "metric", 1e-4)[[*_HEADS]]
    texts = texts.rename(columns=_HEADS).rename_axis(["Variant", "Faces", "Seeds"])
    return texts.reset_index(["Faces", "Seeds"])


def mini_batches(losses: pd.DataFrame) -> Figure:
    """Loss of the dissimilarity net by epoch and by kind of mini-batches: mean and range.

    Args:
        losses: `variant, seed, epoch`, and mean squared errors: `train` as the optimiser sees them,
            `inference` of the net after the epoch.
    """
    looks = {
        "same_face": Look("pairs of one face", "#D55E00", "o"),
        "shuffled": Look("pairs of different faces", "#0072B2", "s"),
    }
    first = min(FIRST_EPOCH, losses["epoch"].max())
    losses = losses[losses["epoch"] >= first]
    panels = []
    for suffix, schedule in _SCHEDULES.items():
        ids = {f"{name}{suffix}": name for name in looks}
        shown = losses.assign(method=losses["variant"].map(ids)).dropna()
        for column, mode in _MODES.items():
            over_seeds = shown.groupby(["method", "epoch"])[column]
            rows = over_seeds.agg(mean="mean", low="min", high="max").reset_index()
            panels.append(Panel(rows, "epoch", epochs_from(first), f"{schedule}, {mode}"))
    options = {"looks": looks, "interval": "range over seeds", "n_columns": 2}
    return error_lines(panels, "Mean squared error", **options)
