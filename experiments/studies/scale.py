"""Step: the methods on faces of the Basel model at one scale of its s.d., from one seed.

The scale is of the standard deviations of 3DDFA's fits, which are a low estimate of the model's own
(`data_gen.models.bfm68`). Beside the error of a method, the step measures what it recovers of the
differences between faces. The module is light to import, since every command reads the scales.
"""

from dataclasses import replace
from pathlib import Path

from experiments.run import Run

COMPARED = (
    "mean_shape", "ridge", "mlp", "aldrian", "map", "deep_mds", "deep_mds_cosine",
    "landmark_lifter",
)  # fmt: skip
SCALES = (0.75, 1.0, 1.5, 2.0)
_SHARE = 5  # of the test faces, one in so many: fits of one face take long


def scores_file(run: Run, scale: float, seed: int) -> Path:
    """File of the errors at a scale."""
    return run.work / "scales" / f"{scale:g}-seed{seed}.csv"


def trainings(run: Run) -> list[tuple[float, int]]:
    """Scale and seed of each training: as many seeds as the main table has at a scale of 1."""
    seeds = dict.fromkeys(SCALES, run.few_seeds) | {1.0: run.all_seeds}
    return [(scale, seed) for scale, of_scale in seeds.items() for seed in of_scale]


def main(run: Run, scale: str, seed: str) -> None:
    import pandas as pd

    from experiments.audit.shapes import bias_of
    from experiments.datasets import faces
    from experiments.inputs import load_faces
    from experiments.methods import CONSTANT, METHODS, constant_answers, load, predict
    from experiments.records import write_csv
    from experiments.scoring.scores import score
    from experiments.tasks import single_threaded
    from experiments.tracks import train

    scaled = replace(run, bfm_scale=float(scale), seed=int(seed))
    if float(scale) != 1:  # at 1 they are those of the main table
        faces.main(scaled)
    test = load_faces(scaled, "test")[::_SHARE]
    shapes = {}
    for method in COMPARED:
        print(f"scale {scale}, seed {seed}: {METHODS[method].title}", flush=True)
        if METHODS[method].trained:
            train.main(scaled, method)
        model = load(scaled, method)
        if METHODS[method].deep_mds:
            model.set_params(solver="numba", n_jobs=1)  # equal to scikit-learn's to rounding
        with single_threaded():
            shapes[method] = predict(model, test.views)
    shapes[CONSTANT] = constant_answers(shapes["deep_mds"])
    scores = {method: score(predicted, test) for method, predicted in shapes.items()}
    mean = scores["mean_shape"].aligned
    rows = [
        {"scale": float(scale), "seed": int(seed), "method": method, "mse": of.mse.mean()}
        | bias_of(of.aligned, mean, of.truth)
        for method, of in scores.items()
    ]
    write_csv(scores_file(run, float(scale), int(seed)), pd.DataFrame(rows))
