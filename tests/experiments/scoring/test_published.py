"""The transcription of the paper: complete, as printed, and read in plain units."""

import re
from decimal import Decimal

import pandas as pd
import pytest

from deepmds_keras.io.errors import InputError
from experiments.methods import METHODS, title
from experiments.metrics import METRICS
from experiments.published import PUBLISHED, printed, published
from experiments.scoring.numbers import as_quoted


@pytest.fixture(scope="module")
def rows():
    return pd.read_csv(PUBLISHED, dtype=str, keep_default_na=False)


def number(experiment, method, metric):
    table = published(experiment).set_index(["method", "metric"])
    return tuple(table.loc[(method, metric), ["paper_mean", "paper_std"]])


def test_every_cell_of_the_four_tables_is_there(rows):
    counts = rows["table"].value_counts()
    two_criteria_four_methods, two_columns_six_methods = 8, 12
    for table in ("tab:cmp_bfm", "tab:cmp_celebA_bfm", "tab:cmp_casia"):
        assert counts[table] == two_criteria_four_methods
    assert counts["tab:cmp_param"] == two_columns_six_methods
    assert not rows.duplicated(["table", "method", "metric"]).any()


@pytest.mark.parametrize(
    ("experiment", "method", "metric", "expected"),
    [
        ("bfm", "ours", "mse", (1.4e-4, 5e-7)),
        ("bfm", "ours", "depth_corr", (71.95, 0.002)),
        ("bfm", "zhao", "mse", (22e-4, 0.25e-4)),
        ("celeba", "mobileface", "mse", (0.092e-5, 0.0016e-5)),
        ("celeba", "aldrian", "depth_corr", (71.91, 0.076)),
        ("flame", "ringnet", "mse", (1.34e-3, 0.95e-3)),
        ("flame", "mediapipe", "depth_corr", (68, 0.009)),
    ],
)
def test_numbers_are_the_papers_in_plain_units(experiment, method, metric, expected):
    assert number(experiment, method, metric) == expected


def test_the_trivial_case_is_the_mean_shape_without_a_spread():
    mean, std = number("bfm", "mean_shape", "mse")
    assert mean == 2.9e-4
    assert std != std


def test_parameters_are_counts_and_what_is_no_number_is_left_out():
    table = published("parameters").set_index("method")["paper_mean"]
    assert dict(table) == {
        "zhao": 114840, "aldrian": 0, "mobileface": 900979, "ringnet": 23000000, "ours": 27505,
    }  # fmt: skip
    assert printed("parameters", "n_parameters")["mediapipe"] == "Not found"
    assert printed("parameters", "time_complexity")["aldrian"] == "O(n^4)"


def test_the_wilcoxon_p_value_is_there_for_both_topologies(rows):
    p_values = rows[rows["metric"] == "wilcoxon_p_value"]
    assert [*p_values["table"]] == ["text:bfm", "text:casia"]
    assert {*p_values["value"] + p_values["unit"]} == {"8.81e-5"}


def test_value_and_uncertainty_are_what_is_printed(rows):
    for row in rows[rows["uncertainty"] != ""].itertuples():
        assert row.printed == f"{row.value} ± {row.uncertainty}"
    for row in rows[(rows["metric"] == "n_parameters") & (rows["value"] != "")].itertuples():
        assert re.sub(r"\D", "", row.printed) == row.value


def test_a_number_is_found_again_as_it_is_printed(rows):
    for row in rows[rows["uncertainty"] != ""].itertuples():
        numbers = (float(Decimal(x) * Decimal(row.unit.strip("%") or 1))
                   for x in (row.value, row.uncertainty))  # fmt: skip
        unit = float(row.unit.strip("%") or 1)
        assert as_quoted(*numbers, unit) == row.printed
    assert as_quoted(0.00125, unit=1e-3) == "1.25", "also one that is not the paper's"


def test_metrics_are_the_papers_where_it_prints_them():
    for experiment in ("bfm", "celeba", "flame"):
        printed = {*published(experiment)["metric"]}
        assert printed == {m.id for m in METRICS.values() if m.in_paper}


def test_doubtful_numbers_carry_a_note():
    notes = published("celeba").set_index(["method", "metric"])["paper_note"]
    assert "factor of ten" in notes["zhao", "mse"]
    notes = published("flame").set_index(["method", "metric"])["paper_note"]
    assert all("exceeds 51" in notes[method, "depth_corr"] for method in ("zhao", "ours"))


def test_every_quoted_method_is_one_of_ours(rows):
    assert {*rows["method"]} - {""} == {m.paper for m in METHODS.values() if m.paper}


def test_unknown_names_are_refused():
    with pytest.raises(InputError, match=r"must be one of bfm, .* Received 'lfw'"):
        published("lfw")
    with pytest.raises(InputError, match=r"must be one of mean_shape, .* Received 'ouers'"):
        title("ouers")
    assert len(METHODS) == len({m.title for m in METHODS.values()})
