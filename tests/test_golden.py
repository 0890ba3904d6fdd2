"""Numbers of a tiny run, kept in `golden.csv`: a move of code changes none of them.

Those of trained networks depend on the processor, and are compared loosely. To record them again:
`PYTHONPATH=. python tests/test_golden.py FOLDER`, where FOLDER holds `build` and `results` of
`make reproduce-bfm PRESET=tiny`.
"""

import sys
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from data_gen.datasets.dataset import load_dataset
from data_gen.models.openhead import load_openhead
from deepmds_keras.embedding import embed
from deepmds_keras.geometry.classical_scaling import pairwise_distances

GOLDEN = Path(__file__).with_name("golden.csv")
EXACT = ("mean_shape", "ridge", "aldrian", "aldrian_authors")
METRICS = ("mse", "mse_mm2", "depth_corr", "depth_corr_across_faces", "reflection_rate")


def numbers(folder):
    """Table of `quantity, value, tolerance` (relative) of a tiny run."""
    metrics = pd.read_csv(folder / "results/tiny/openhead/bfm/metrics.csv")
    means = metrics[metrics["metric"].isin(METRICS)].groupby(["method", "metric"])["value"].mean()
    rows = [
        (f"{method} {metric}", value, 1e-6 if method in EXACT else 1.0)
        for (method, metric), value in means.items()
        if method in EXACT or metric in ("mse", "depth_corr")
    ]
    faces = load_dataset(folder / "build/openhead/bfm-tiny-paper-seed0/test.npz")
    for name in ("views", "landmarks", "identity"):
        rows.append((f"mean size of {name}", np.abs(getattr(faces, name)).mean(dtype=float), 1e-6))
    head = load_openhead()
    shape = head.mean[head.landmarks["bfm72"]][None]
    sizes = np.linalg.norm(embed(pairwise_distances(shape))[0], axis=1)
    rows.append(("distance of an embedded nose tip to the centre", sizes[33], 1e-6))
    return pd.DataFrame(rows, columns=["quantity", "value", "tolerance"])


def test_a_tiny_run_has_the_numbers_that_it_had(whole_bfm):
    kept = pd.read_csv(GOLDEN).set_index("quantity")
    now = numbers(whole_bfm).set_index("quantity")["value"]
    assert {*kept.index} == {*now.index}
    for quantity, (value, tolerance) in kept[["value", "tolerance"]].iterrows():
        assert now[quantity] == pytest.approx(value, rel=tolerance, abs=1e-12), quantity


if __name__ == "__main__":
    numbers(Path(sys.argv[1])).to_csv(GOLDEN, index=False, float_format="%.9g")
