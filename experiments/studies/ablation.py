"""Ablation of the method's parts: trainings with one of them changed, over seeds.

The paper compares mini-batches of one face with shuffled ones. Beside that stand the net without
its short connection and nets of other depths, the method without its autoencoder, and both networks
trained on fewer faces.
"""

from __future__ import annotations

import json

import pandas as pd
from scipy.stats import sem

from deepmds_keras.baselines.linear import Linear
from deepmds_keras.baselines.mean_shape import MeanShape
from experiments.arguments import parse_run
from experiments.build_key import is_done
from experiments.figures.audit_curves import error_curves, mini_batches
from experiments.figures.style import save
from experiments.inputs import load_faces
from experiments.manifest import MANIFEST, clear_results, records_of, write_manifest
from experiments.records import write_text
from experiments.run import Run
from experiments.running import stage
from experiments.scoring.latex import tabular
from experiments.scoring.numbers import plus_minus
from experiments.scoring.scores import score, subsets
from experiments.scoring.tables import write_csv
from experiments.studies.variants import DEPTHS, TITLES, VARIANTS, Variant, fewer_faces
from experiments.trainings import side_by_side

METRICS = (
    "loss_train", "loss_inference", "mse", "mse_sem", "mse_frontal", "mse_posed", "depth_corr",
)  # fmt: skip
HEADS = {
    "variant": "Variant",
    "faces": "Faces",
    "count": "Seeds",
    "loss_train": "Loss in training (1e-4)",
    "loss_inference": "Inference-mode loss (1e-4)",
    "mse": "MSE (1e-4)",
}
_UNIT = 1e-4
# Variants of `training_curve`, whose last point is the paper's method itself.
_BY_SIZE = {
    "same_face": "ours",
    "fewer_faces": "ours",
    "same_face_stable": "ours_stable",
    "fewer_faces_stable": "ours_stable",
}
_IN_BATCHES = ("same_face", "shuffled", "same_face_stable", "shuffled_stable")


def trainings(run: Run) -> list[tuple[Variant, int]]:
    """Every variant with every seed; those on fewer faces, of two networks each, with one."""
    seeds = range(run.seed, run.seed + run.preset.ablation_seeds)
    of_net = [(variant, seed) for variant in (*VARIANTS, *DEPTHS) for seed in seeds]
    return of_net + [(variant, run.seed) for variant in fewer_faces(run)]


def train(run: Run) -> list[int]:
    """Train what is not done yet, a process per core.

    Returns:
        Peak memory of each process, MB.
    """
    todo = [item for item in trainings(run) if not item[0].file(run, item[1]).exists()]
    return side_by_side(run.jobs, _train, [(run, *item) for item in todo])[1]


def _train(run: Run, variant: Variant, seed: int) -> None:
    from experiments.studies.variant_training import (
        train_and_score,  # only these processes load TensorFlow
    )

    train_and_score(run, variant, seed)


def collected(run: Run) -> tuple[pd.DataFrame, pd.DataFrame]:
    """All that was trained: `variant, faces, seed, metric, value`, and the losses by epoch."""
    values, losses = [], []
    for variant, seed in trainings(run):
        done = json.loads(variant.file(run, seed).read_text(encoding="utf-8"))
        faces = variant.faces or run.preset.train_faces
        for metric in METRICS:
            values.append((variant.id, faces, seed, metric, done["values"][metric]))
        for epoch, (in_training, in_use) in enumerate(
            zip(done["history"]["train"], done["history"]["inference"], strict=True), 1
        ):
            losses.append((variant.id, faces, seed, epoch, in_training, in_use))
    return (
        pd.DataFrame(values, columns=["variant", "faces", "seed", "metric", "value"]),
        pd.DataFrame(losses, columns=["variant", "faces", "seed", "epoch", "train", "inference"]),
    )


def spread(metrics: pd.DataFrame) -> pd.DataFrame:
    """Median, mean, s.d. (of a sample) and range over the seeds of each variant and metric."""
    groups = metrics.groupby(["variant", "faces", "metric"], sort=False)["value"]
    return groups.agg(["median", "mean", "std", "min", "max", "count"]).reset_index()


def training_curve(run: Run, table: pd.DataFrame) -> pd.DataFrame:
    """Test error by number of training faces: ours with one seed, and two that need no seed.

    Returns:
        `sweep, value, method, mse, sem`, as `error_curves` draws them.
    """
    train, test = load_faces(run, "train"), load_faces(run, "test")
    tested = test[subsets(run, len(test.views))[0]]
    rows = []
    for n in (*run.preset.training_sizes, run.preset.train_faces):
        for method, model in (("mean_shape", MeanShape()), ("linear", Linear())):
            model.fit(train.views[:n], train.shapes[:n])
            mse = score(model.predict(tested.views), tested).mse
            rows.append((n, method, mse.mean(), sem(mse)))
    found = table[table["seed"] == run.seed].pivot(
        index=["variant", "faces"], columns="metric", values="value"
    )
    for (variant, faces), values in found.iterrows():
        if variant in _BY_SIZE:
            rows.append((faces, _BY_SIZE[variant], values["mse"], values["mse_sem"]))
    curve = pd.DataFrame(rows, columns=["value", "method", "mse", "sem"])
    curve.insert(0, "sweep", "training_faces")
    return curve.sort_values(["method", "value"], ignore_index=True)


def latex(table: pd.DataFrame) -> str:
    r"""Mean and s.d. over seeds of every variant, as a booktabs `tabular` to `\input`."""
    return tabular(_cells(table), "l" + "r" * (len(HEADS) - 1))


def text(table: pd.DataFrame) -> str:
    """The same for the terminal."""
    return _cells(table).to_string(index=False)


def rows_of(table: pd.DataFrame) -> list[list[str]]:
    """Cells of every variant, under `HEADS`: mean and s.d. over its seeds."""
    rows = []
    for (variant, faces), own in table.groupby(["variant", "faces"], sort=False):
        cells = own.set_index("metric")
        row = [TITLES[variant], f"{faces:,}", f"{cells['count'].max():.0f}"]
        for metric in [*HEADS][3:]:
            row.append(plus_minus(*cells.loc[metric, ["mean", "std"]], _UNIT))
        rows.append(row)
    return rows


def _cells(table: pd.DataFrame) -> pd.DataFrame:
    return pd.DataFrame(rows_of(table), columns=[*HEADS.values()])


def write(run: Run) -> None:
    """Write the tables and figures of all that was trained."""
    metrics, losses = collected(run)
    folder = run.experiment_results("ablation")
    clear_results(folder)
    table, curve = spread(metrics), training_curve(run, metrics)
    for name, rows in (
        ("metrics", metrics),
        ("losses", losses),
        ("table", table),
        ("curves", curve),
    ):
        write_csv(folder / f"{name}.csv", rows)
    write_text(folder / "table.tex", latex(table))
    in_batches = losses[losses["variant"].isin(_IN_BATCHES)]
    save(mini_batches(in_batches), folder / "figures", "mini_batches")
    save(error_curves(curve, ["training_faces"], {}), folder / "figures", "training_faces")


def main(arguments: list[str] | None = None) -> None:
    run = parse_run(__doc__, arguments)
    folder = run.experiment_results("ablation")
    if not is_done(run, "ablation"):
        with stage(run, "ablation") as record:
            record["processes_mb"] = train(run)
            clear_results(folder)  # of an earlier training
    if not (folder / MANIFEST).exists():
        write(run)
        write_manifest(run, "ablation", records_of(run, "ablation"), folder)
    print(f"\n{run.model}, {run.preset.name} preset, seed {run.seed}: mean ± s.d. over seeds\n")
    print(text(pd.read_csv(folder / "table.csv")))
    print(f"\nTables, figures and manifest: {folder}/")
