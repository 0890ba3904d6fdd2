"""Errors against the scale of the Basel model's s.d.: medians over seeds, the printed error."""

import pandas as pd
import pytest

from experiments.scoring.latex import tabular
from experiments.studies.scales import cells, draw, summarise


def scores():
    return pd.DataFrame(
        {"scale": scale, "seed": seed, "method": method, "mse": 1e-5 * mse, "slope": 0.1 * mse}
        for scale in (1.0, 2.0)
        for method, errors in {"mean_shape": (1, 2, 4), "deep_mds": (9, 3, 4)}.items()
        for seed, mse in enumerate(errors)
    )


def test_medians_and_ranges_are_over_seeds_and_each_ratio_is_within_its_own():
    table = summarise(scores()).set_index(["scale", "method"])
    row = table.loc[(2, "deep_mds")]
    assert (row["n_seeds"], row["mse"], row["mse_lowest"]) == (3, 4e-5, pytest.approx(3e-5))
    # Of 9 / 1, 3 / 2 and 4 / 4; the ratio of the medians would be 2.
    assert row["over_mean_shape"] == pytest.approx(1.5)
    shown = cells(table.reset_index())
    assert shown.loc["Deep-MDS", "2"] == "0.40 [0.30, 0.90]; 0.40 [0.30, 0.90]"
    assert "Method & 1 & 2 \\\\" in tabular(shown.reset_index(), "lrr", ())


def test_what_the_paper_prints_is_a_line_over_all_scales():
    figure = draw(summarise(scores()))
    texts = [text.get_text() for text in figure.legends[0].get_texts()]
    assert "published: Deep-MDS, 1.4" in texts
    lines = [line.get_xydata().tolist() for line in figure.axes[0].lines]
    assert [[1, pytest.approx(1.4)], [2, pytest.approx(1.4)]] in lines, "in 10⁻⁴"
