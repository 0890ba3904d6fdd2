"""Anatomy of Deep-MDS: its parts replaced one at a time by better ones, down to the limit.

On the first test faces of the paper's protocol. Each dissimilarity matrix goes through the
non-metric MDS of the method and through metric MDS.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pandas as pd
from scipy.stats import sem

from data_gen.datasets.dataset import load_dataset
from deepmds_keras.embedding import embed, metric_embed, pairwise_distances
from experiments.arguments import parse_run
from experiments.build_key import is_done, needs_of
from experiments.figures.staircase import staircase
from experiments.figures.style import save
from experiments.inputs import Faces, load_faces
from experiments.lifting.limit import limit
from experiments.lifting.study_tables import STEPS, anatomy_cells
from experiments.lifting.views import HardFaces, landmark_model
from experiments.manifest import clear_results, records_of, write_manifest
from experiments.methods import load
from experiments.progress import Bar, EpochBar
from experiments.records import load_record, write_text
from experiments.run import Run
from experiments.running import stage
from experiments.scoring.latex import tabular
from experiments.scoring.scores import score
from experiments.scoring.tables import write_csv
from experiments.streams import Stream
from experiments.trainings import side_by_side

_METHOD = "ours_stable"
_NAMED, _SEEING = "landmarks_known", "whole_view"


def net_file(run: Run, step: str) -> Path:
    """Checkpoint of a net that is trained here, on the frontal views of the networks as they are.

    Args:
        run: The run, whose networks are made.
        step: Of `STEPS`.
    """
    made_by = needs_of(run, "anatomy")["bfm/networks"]
    return run.work / "anatomy" / f"{step}-{made_by[:12]}.npz"


def train(run: Run) -> list[int]:
    """Train the two nets that are told more, a process each.

    Returns:
        Peak memory of each process, MB.
    """
    return side_by_side(run.jobs, _train, [(run, step) for step in (_NAMED, _SEEING)])[1]


def _train(run: Run, step: str) -> None:
    _net(run, step)


def _net(run: Run, step: str):
    """Train a net, or read it if its checkpoint is complete."""
    from deepmds_keras.training import Recipe
    from experiments.lifting.pair_nets import train_pair_net

    train, preset = load_faces(run, "train"), run.preset
    with EpochBar(step, preset.dissimilarity_epochs) as bar:
        return train_pair_net(
            load(run, _METHOD).frontalise(train.views),
            train.views,
            train.shapes,
            Recipe(preset.dissimilarity_epochs, preset.dissimilarity_steps, "cosine"),
            whole_view=step == _SEEING,
            seed=run.seed,
            checkpoint=net_file(run, step),
            progress=bar.losses,
        )


def dissimilarities(run: Run, test: Faces) -> Iterator[tuple[str, np.ndarray]]:
    """Yield each step and its matrices `(n, L, L)`."""
    from experiments.lifting.pair_nets import net_dissimilarities

    deep_mds = load(run, _METHOD)
    frontal, net = deep_mds.frontalise(test.views), deep_mds.dissimilarity_net_
    yield "deep_mds", net_dissimilarities(net, frontal, test.views)
    yield "true_frontal", net_dissimilarities(net, test.shapes[..., :2], test.views)
    for step in (_NAMED, _SEEING):
        yield step, net_dissimilarities(_net(run, step), frontal, test.views)
    yield "lifting", pairwise_distances(load(run, "lifting").predict(test.views))
    yield "true_distances", pairwise_distances(test.shapes)


def measure(run: Run) -> list[tuple]:
    """Measure every step on the first test faces.

    Returns:
        Rows of `step, embedding, mse, sem, n_faces`.
    """
    faces = slice(run.preset.audited_faces)
    test = load_faces(run, "test")[faces]
    mean_shapes = load(run, "mean_shape").predict(test.views)
    rows = [_row("mean_shape", "none", score(mean_shapes, test).mse)]
    with Bar(total=6 * len(test.views), desc="anatomy", unit="face") as bar:
        for step, matrices in dissimilarities(run, test):
            matrices = np.abs(matrices)  # as in `DeepMDS.predict`
            shapes = {
                "non_metric": embed(matrices, n_jobs=run.jobs, progress=bar.update),
                "metric": metric_embed(matrices),
            }
            rows += [_row(step, kind, score(own, test).mse) for kind, own in shapes.items()]
    dataset = load_dataset(run.work / "test.npz")
    seen = HardFaces(
        identity=dataset.identity[faces].astype(float),
        shapes=dataset.landmarks[faces].astype(float),
        views=dataset.views[faces],
        sd_mm=np.zeros(len(test.views)),
        cameras=dataset.cameras[faces],
    )
    rng = np.random.default_rng([run.seed, Stream.ANATOMY_LIMIT])
    return [*rows, _row("limit", "none", limit(landmark_model(run), seen, rng))]


def _row(step: str, embedding: str, mse: np.ndarray) -> tuple:
    return step, embedding, float(mse.mean()), float(sem(mse)), len(mse)


def main(arguments: list[str] | None = None) -> None:
    run = parse_run(__doc__, arguments)
    folder = run.experiment_results("lifting/anatomy")
    if not is_done(run, "anatomy"):
        with stage(run, "anatomy") as record:
            record["processes_mb"] = train(run)
            record["rows"] = measure(run)
    columns = ["step", "embedding", "mse", "sem", "n_faces"]
    table = pd.DataFrame(load_record(run, "anatomy")["rows"], columns=columns)
    clear_results(folder)
    write_csv(folder / "table.csv", table)
    write_text(folder / "table.tex", tabular(anatomy_cells(table), "lrrr"))
    save(staircase(table, STEPS), folder / "figures", "anatomy")
    write_manifest(run, "lifting", records_of(run, "anatomy"), folder)
    print(f"\n{run.model}, {table['n_faces'].max()} test faces, mean ± standard error\n")
    print(anatomy_cells(table).to_string(index=False))
    print(f"\nTables, figure and manifest: {folder}/")
