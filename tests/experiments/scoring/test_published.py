"""The transcription of the paper: complete, as printed, and read in plain units."""

import re
from decimal import Decimal

import pandas as pd
import pytest

from experiments.methods import METHODS
from experiments.records import PUBLISHED
from experiments.scoring.metrics import METRICS
from experiments.scoring.numbers import as_quoted
from experiments.scoring.published import printed, published


@pytest.fixture(scope="module")
def rows():
    return pd.read_csv(PUBLISHED / "published.csv", dtype=str, keep_default_na=False)


def test_every_cell_of_the_four_tables_is_there(rows):
    counts = rows["table"].value_counts()
    two_criteria_four_methods, two_columns_six_methods = 8, 12
    for table in ("tab:cmp_bfm", "tab:cmp_celebA_bfm", "tab:cmp_casia"):
        assert counts[table] == two_criteria_four_methods
    assert counts["tab:cmp_param"] == two_columns_six_methods
    assert not rows.duplicated(["table", "method", "metric"]).any()
    assert {*rows["method"]} - {""} == {m.paper for m in METHODS.values() if m.paper}
    for experiment in ("bfm", "celeba", "flame"):
        in_paper = {metric.id for metric in METRICS.values() if metric.in_paper}
        assert {*published(experiment)["metric"]} == in_paper


def test_numbers_are_those_in_the_papers_tables(rows, paper):
    in_paper = [
        (label, " ± ".join(number))
        for body, label in re.findall(r"\\begin{tabular}(.*?)\\label{(.*?)}", paper, re.S)
        for number in re.findall(r"([\d.]+) *\\pm *([\d.]+)", body)
    ]
    here = rows[rows["uncertainty"] != ""]
    assert [*zip(here["table"], here["printed"], strict=True)] == in_paper


@pytest.mark.parametrize(
    ("experiment", "method", "metric", "expected"),
    [
        ("bfm", "deep_mds", "mse", (1.4e-4, 5e-7)),
        ("bfm", "deep_mds", "depth_corr", (71.95, 0.002)),
        ("bfm", "zhao", "mse", (22e-4, 0.25e-4)),
        ("celeba", "mobileface", "mse", (0.092e-5, 0.0016e-5)),
        ("celeba", "aldrian", "depth_corr", (71.91, 0.076)),
        ("flame", "ringnet", "mse", (1.34e-3, 0.95e-3)),
        ("flame", "mediapipe", "depth_corr", (68, 0.009)),
        ("bfm", "deep_mds_constant", "mse", (2.9e-4, float("nan"))),  # the trivial case
        ("parameters", "deep_mds", "n_parameters", (27505, float("nan"))),
    ],
)
def test_numbers_are_the_papers_in_plain_units(experiment, method, metric, expected):
    numbers = published(experiment).set_index(["method", "metric"])[["paper_mean", "paper_std"]]
    assert tuple(numbers.loc[(method, metric)]) == pytest.approx(expected, rel=0, nan_ok=True)


def test_what_is_no_number_is_printed_only_and_doubtful_ones_carry_a_note():
    notes = published("celeba").set_index(["method", "metric"])["paper_note"]
    assert "factor of ten" in notes["zhao", "mse"]
    assert "mediapipe" not in {*published("parameters")["method"]}
    assert printed("parameters", "n_parameters")["mediapipe"] == "Not found"
    assert printed("parameters", "time_complexity")["aldrian"] == "O(n^4)"


def test_numbers_are_shown_with_the_digits_that_are_printed(rows):
    for row in rows[rows["uncertainty"] != ""].itertuples():
        unit = Decimal(row.unit.strip("%") or 1)
        numbers = (float(Decimal(text) * unit) for text in (row.value, row.uncertainty))
        assert as_quoted(*numbers, float(unit)) == row.printed == f"{row.value} ± {row.uncertainty}"
    for row in rows[(rows["metric"] == "n_parameters") & (rows["value"] != "")].itertuples():
        assert re.sub(r"\D", "", row.printed) == row.value
