"""The writers, to the letter: CSV lines, LaTeX rows, marks and reasons of empty cells."""

import numpy as np
import pandas as pd
import pytest

from deepmds_keras.io.errors import InputError
from experiments.metrics import metrics_of
from experiments.scoring import parameters
from experiments.scoring.latex import plain_tabular, tabular, tex
from experiments.scoring.tables import summarise, write_csv, write_tables
from experiments.scoring.typesetting import latex, text

NOTES = {"mobileface": "needs images: not part of this experiment yet"}


@pytest.fixture
def metrics():
    rows = [
        ("ours", "mse", 0, 1e-4),
        ("ours", "mse", 1, 3e-4),
        ("ours", "mse_mm2", 0, 4.0),
        ("ours", "mse_mm2", 1, 9.0),
        ("ours", "depth_corr", 0, 71.9),
        ("ours", "depth_corr", 1, 71.92),
        ("ours", "n_parameters", np.nan, 27323),
        ("linear", "mse", 0, 2e-6),
        ("linear", "mse", 1, 2e-6),
    ]
    return pd.DataFrame(rows, columns=["method", "metric", "subset", "value"])


@pytest.fixture
def table(metrics):
    return summarise(metrics, "bfm", NOTES, subset_size=500)


def line(string, start):
    return next(part for part in string.splitlines() if part.startswith(start))


def test_csv_to_the_letter(table, tmp_path):
    write_csv(tmp_path / "table.csv", table)
    lines = (tmp_path / "table.csv").read_text().splitlines()
    assert lines[0] == "method,metric,mean,std,paper_mean,paper_std,n_subsets,subset_size,note"
    assert "ours,mse,0.0002,0.00014142136,0.00014,5e-07,2,500," in lines
    assert "ours,n_parameters,27323,,,,,," in lines
    assert "ours,ms_per_face,,,,,,,ms_per_face not measured" in lines
    assert f"mobileface,mse,,,6e-05,4e-07,,,{NOTES['mobileface']}" in lines


def test_the_root_is_taken_of_each_subset(table):
    cell = table.set_index(["method", "metric"]).loc[("ours", "rmse_mm")]
    assert (cell["mean"], cell["n_subsets"]) == (2.5, 2)


def test_every_method_has_every_metric_and_every_empty_cell_a_reason(table):
    methods = ["mean_shape", "linear", "zhao", "aldrian", "mobileface", "ours"]
    cells = [*zip(table["method"], table["metric"], strict=True)]
    columns = [metric.id for metric in metrics_of("bfm")]
    assert columns[:2] == ["depth_corr", "mse"], "the paper's first, in its order"
    assert cells == [(method, metric) for method in methods for metric in columns]
    assert (table.loc[table["mean"].isna(), "note"] != "").all()
    reasons = table[table["mean"].isna()].groupby("method")["note"].first()
    assert reasons["aldrian"].startswith("not part of this experiment")


def test_latex_to_the_letter(table):
    tabular = latex(table, "bfm")
    assert line(tabular, "Deep-MDS &") == (
        r"Deep-MDS & 71.95 $\pm$ 0.002 & 71.910 $\pm$ 0.014 & 1.4 $\pm$ 0.005 & 2.0 $\pm$ 1.4"
        r" & 2.50 & -- \\"
    )
    assert line(tabular, "Linear &") == r"Linear & -- & -- & -- & 0.02 & -- & -- \\"
    assert line(tabular, "MobileFace &") == (
        r"MobileFace & 71.97 $\pm$ 0.002 & -- & 0.6 $\pm$ 0.004 & -- & -- & -- \\"
    )
    assert line(tabular, "Method") == r"Method & paper & here & paper & here & here & here \\"
    assert "MobileFace: needs images: not part of this experiment yet." in tabular
    assert "2 random subsets of 500 test faces" in tabular
    assert "quoted from Kamyab and Azimifar" in tabular


def test_the_papers_numbers_have_the_digits_that_it_prints(metrics):
    """As floats, as which `table.csv` holds them, 0.30 and 1.50 have lost their last digit."""
    table = summarise(metrics, "flame", {}, subset_size=500)
    for row in (
        ("Zhao et al.", "2.6 ± 0.30"),
        ("MediaPipe", "1.30 ± 0.19"),
        ("Deep-MDS", "1.50 ± 0.18"),
    ):
        assert f" {row[1]} " in line(text(table, "flame"), row[0])
        assert f" {tex(row[1])} & " in line(latex(table, "flame"), row[0])


def test_several_seeds_have_columns_and_a_range(metrics):
    rows = [("ours", seed, "mse", value) for seed, value in enumerate((1e-4, 1.3e-4, 0.9e-4))]
    seeds = pd.DataFrame(rows, columns=["method", "seed", "metric", "value"])
    table = summarise(metrics, "bfm", NOTES, subset_size=500, seeds=seeds)
    cells = table.set_index(["method", "metric"])[["n_seeds", "median", "lowest", "highest"]]
    assert cells.loc["ours", "mse"].tolist() == [3, 1e-4, 0.9e-4, 1.3e-4]
    assert cells.loc["linear", "mse"].isna().all()
    assert "1.00 [0.90, 1.30]" in line(text(table, "bfm"), "Deep-MDS ")
    assert "of 3 trainings" in text(table, "bfm")


def test_a_plain_table_keeps_names_counts_and_what_is_missing():
    plain = pd.DataFrame({"method": ["a_b", "c"], "n_faces": [5, 12_000], "mse": [1.5e-5, np.nan]})
    first, second = plain_tabular(plain).splitlines()[5:7]
    assert first == r"a\_b & 5 & 1.5 $\times$ 10$^{-5}$ \\"
    assert second == r"c & 12000 &  \\"


def test_latex_is_balanced(table):
    tabular = latex(table, "bfm")
    assert tabular.count("{") == tabular.count("}")
    rows = [row for row in tabular.splitlines() if row.startswith(("Deep", "Zhao", "Mean", "Ald"))]
    assert {row.replace(r"\&", "").count("&") for row in rows} == {6}


@pytest.mark.parametrize(
    ("experiment", "head", "number"),
    [("bfm", "MSE (10⁻⁴)", "2.0"), ("celeba", "MSE (10⁻⁵)", "20")],
)
def test_errors_are_in_the_unit_of_the_papers_table(metrics, experiment, head, number):
    table = summarise(metrics, experiment, {}, subset_size=500)
    assert head in text(table, experiment)
    assert f" {number} ± " in line(text(table, experiment), "Deep-MDS ")
    assert tex(head) in latex(table, experiment)


def test_terminal_columns_are_aligned(table):
    lines = text(table, "bfm").splitlines()
    rule = next(i for i, row in enumerate(lines) if set(row) == {"-"})
    rows = lines[rule - 1 : rule] + lines[rule + 1 : lines.index("", rule)]
    assert len(rows) == 7
    assert len({len(row) for row in [*rows, lines[rule]]}) == 1


def test_special_characters_are_escaped():
    assert tex("50 % of a_b ± n^2 > −10⁻³") == (
        r"50 \% of a\_b $\pm$ n$^{2}$ \textgreater{} $-$10$^{-3}$"
    )


def test_a_table_over_pages_repeats_its_heads():
    long = tabular(pd.DataFrame({"Claim": ["a & b"], "Where": ["–"]}), "ll", over_pages=True)
    assert line(long, "a ") == r"a \& b & -- \\"
    assert long.count(r"Claim & Where \\") == 2
    assert long.count("{") == long.count("}")


def test_files(metrics, tmp_path):
    faces = np.arange(1.0, 21)
    per_face = {"mse": {"linear": faces, "ours": 2 * faces}}
    write_tables(
        tmp_path, metrics, experiment="bfm", subset_size=500, notes=NOTES, per_face=per_face
    )
    assert sorted(path.name for path in tmp_path.iterdir()) == [
        "table.csv", "table.tex", "wilcoxon.csv",
    ]  # fmt: skip
    tests = pd.read_csv(tmp_path / "wilcoxon.csv")
    assert [*tests.columns[:5]] == ["over", "metric", "method_a", "method_b", "n"]
    assert tests[["over", "method_a", "method_b", "n"]].to_numpy().tolist() == [
        ["subsets", "linear", "ours", 2],
        ["faces", "linear", "ours", 20],
    ]


def test_unusable_metrics_are_refused(metrics):
    with pytest.raises(InputError, match=r"one row for each .* Received ours, mse, 0.0 twice"):
        summarise(pd.concat([metrics, metrics]), "bfm", {}, subset_size=5)
    with pytest.raises(InputError, match=r"must have columns .* Received method, metric"):
        summarise(metrics.drop(columns="subset"), "bfm", {}, subset_size=5)
    with pytest.raises(InputError, match=r"method must be one of .* Received 'mystery'"):
        summarise(metrics.replace("linear", "mystery"), "bfm", {}, subset_size=5)
    with pytest.raises(InputError, match=r"metric must be one of mse, .* Received 'mystery'"):
        summarise(metrics.replace("mse", "mystery"), "bfm", {}, subset_size=5)
    with pytest.raises(InputError, match=r"experiment must be one of bfm, .* Received 'lfw'"):
        summarise(metrics, "lfw", {}, subset_size=5)


def test_parameters_are_counted_from_the_networks(metrics):
    table = parameters.parameter_table(metrics).set_index("method")
    assert [*table.loc["ours_released", ["trainable", "total"]]] == ["27303", "28209"]
    mobileface = table.loc["mobileface", ["trainable", "total", "paper"]]
    assert [*mobileface] == ["900979", "907819", "900,979"]
    assert [*table.loc["ours", ["trainable", "total", "paper"]]] == ["27323", "28229", "27505"]
    # ResNet-50 without its head has 23,534,592 trainable parameters.
    ringnet = table.loc["ringnet", ["trainable", "paper"]]
    assert int(ringnet["trainable"]) > 23_534_592 and ringnet["paper"] == "> 23000000"
    assert [*table.loc["mediapipe", ["trainable", "paper"]]] == ["", "Not found"]
    row = line(parameters.latex(table.reset_index()), "MediaPipe")
    assert row == r"MediaPipe & -- & -- & Not found & O(1) & O(1) & -- & -- & -- \\"
