"""The writers, to the letter: CSV lines, LaTeX rows, marks and reasons of empty cells."""

import numpy as np
import pandas as pd
import pytest

from deepmds_keras.errors import InputError
from experiments.presets import SMOKE
from experiments.progress import duration
from experiments.records import write_csv, write_json
from experiments.run import Run
from experiments.scoring import parameters, tables
from experiments.scoring.latex import plain_tabular, tex
from experiments.scoring.metrics import metrics_of
from experiments.scoring.numbers import as_quoted, plus_minus, scientific
from experiments.scoring.tables import print_tables, summarise, write_tables
from experiments.scoring.typesetting import latex, text

SIZES = {"subset_size": 500, "n_landmarks": 72}
NOTES = {"mobileface": "needs images: not part of this experiment yet"}


@pytest.fixture
def metrics():
    rows = [
        ("deep_mds", "mse", 0, 1e-4), ("deep_mds", "mse", 1, 3e-4),
        ("deep_mds", "mse_mm2", 0, 4.0), ("deep_mds", "mse_mm2", 1, 9.0),
        ("deep_mds", "depth_corr", 0, 71.9), ("deep_mds", "depth_corr", 1, 71.92),
        ("deep_mds", "n_parameters", np.nan, 27323),
        ("ridge", "mse", 0, 2e-6), ("ridge", "mse", 1, 2e-6),
    ]  # fmt: skip
    return pd.DataFrame(rows, columns=["method", "metric", "subset", "value"])


@pytest.fixture
def table(metrics):
    return summarise(metrics, "bfm", NOTES, **SIZES)


def line(string, start):
    return next(part for part in string.splitlines() if part.startswith(start))


def test_csv_to_the_letter(metrics, tmp_path):
    faces = np.arange(1.0, 21)
    per_face = {"mse": {"ridge": faces, "deep_mds": 2 * faces}}
    write_tables(tmp_path, metrics, experiment="bfm", notes=NOTES, per_face=per_face, **SIZES)
    lines = (tmp_path / "table.csv").read_text().splitlines()
    head = "method,metric,mean,std,paper_mean,paper_std,n_subsets,subset_size,n_landmarks,note"
    assert lines[0] == head
    assert "deep_mds,mse,0.0002,0.00014142136,0.00014,5e-07,2,500,72," in lines
    assert "deep_mds,n_parameters,27323,,,,,,72," in lines
    assert "deep_mds,ms_per_face,,,,,,,72,ms_per_face not measured" in lines
    assert f"mobileface,mse,,,6e-05,4e-07,,,72,{NOTES['mobileface']}" in lines
    tests = pd.read_csv(tmp_path / "wilcoxon.csv").iloc[:, :5]
    assert [*tests] == ["over", "metric", "method_a", "method_b", "n"]
    assert tests.to_numpy().tolist() == [
        ["subsets", "mse", "ridge", "deep_mds", 2],
        ["faces", "mse", "ridge", "deep_mds", 20],
    ]


def test_every_method_has_every_metric_and_every_empty_cell_a_reason(table):
    methods = ["deep_mds_constant", "ridge", "zhao", "aldrian_authors", "mobileface", "deep_mds"]
    cells = [*zip(table["method"], table["metric"], strict=True)]
    columns = [metric.id for metric in metrics_of("bfm")]
    assert columns[:2] == ["depth_corr", "mse"], "the paper's first, in its order"
    assert cells == [(method, metric) for method in methods for metric in columns]
    assert (table.loc[table["mean"].isna(), "note"] != "").all()
    reasons = table[table["mean"].isna()].groupby("method")["note"].first()
    assert reasons["aldrian_authors"].startswith("not part of this experiment")
    root_of_each_subset = table.set_index(["method", "metric"]).loc[("deep_mds", "rmse_mm")]
    assert (root_of_each_subset["mean"], root_of_each_subset["n_subsets"]) == (2.5, 2)


def test_latex_to_the_letter(table):
    lines = latex(table, "bfm").splitlines()
    heads, rules, subheads, _, *rows = lines[3:14]
    assert lines[1:3] == [r"\begin{tabular}{@{}lrrrrrr@{}}", r"\toprule"]
    assert heads.startswith(
        r" & \multicolumn{2}{c}{Depth correlation (of 72)} & \multicolumn{2}{c}"
    )
    assert rules == "".join(rf"\cmidrule(lr){{{k}}}" for k in ("2-3", "4-5", "6-6", "7-7"))
    assert subheads == r"Method & paper & here & paper & here & here & here \\"
    assert rows[1] == r"Ridge regression & -- & -- & -- & 0.02 & -- & -- \\"
    assert rows[4:7] == [
        r"MobileFace & 71.97 $\pm$ 0.002 & -- & 0.6 $\pm$ 0.004 & -- & -- & -- \\",
        r"Deep-MDS & 71.95 $\pm$ 0.002 & 71.910 $\pm$ 0.014 & 1.4 $\pm$ 0.005 & 2.0 $\pm$ 1.4"
        r" & 2.50 & -- \\",
        r"\bottomrule",
    ]
    assert lines[14] == r"\end{tabular}"  # notes among the rows would stretch the last column
    below = "\n".join(lines[15:])
    assert "MobileFace: needs images: not part of this experiment yet." in below
    assert "2 random subsets of 500 test faces" in below
    assert "".join(lines).count("{") == "".join(lines).count("}")
    assert tex("(x10^-4)") == "(x10$^{-4}$)"
    assert tex("50 % of a_b ± n^2 > −10⁻³") == (
        r"50 \% of a\_b $\pm$ n$^{2}$ \textgreater{} $-$10$^{-3}$"
    )


def test_a_plain_table_keeps_names_counts_and_what_is_missing():
    plain = pd.DataFrame({"method": ["a_b", "c"], "n_faces": [5, 12_000], "mse": [1.5e-5, np.nan]})
    lines = plain_tabular(plain).splitlines()
    assert lines[1] == r"\begin{tabular}{@{}lrr@{}}"
    assert lines[3] == r"method & n faces & mse \\"
    assert lines[5:7] == [r"a\_b & 5 & 1.5 $\times$ 10$^{-5}$ \\", r"c & 12000 &  \\"]


@pytest.mark.parametrize(
    ("experiment", "head", "ours", "paper"),
    # As floats, as which `table.csv` holds them, 0.30 and 1.50 have lost their last digit.
    [("bfm", "MSE (10⁻⁴)", "2.0", "22 ± 0.25"), ("celeba", "MSE (10⁻⁵)", "20", "21 ± 0.19"),
     ("flame", "MSE (10⁻³)", "0.20", "2.6 ± 0.30")],
)  # fmt: skip
def test_errors_have_the_unit_and_the_digits_of_the_papers_table(
    metrics, experiment, head, ours, paper
):
    table = summarise(metrics, experiment, {}, **SIZES)
    for output, escaped in ((text(table, experiment), str), (latex(table, experiment), tex)):
        assert escaped(head) in output
        assert escaped(f" {ours} ± ") in line(output, "Deep-MDS ")
        assert f" {escaped(paper)} " in line(output, "Zhao et al. ")


def test_several_seeds_have_columns_and_a_range(metrics):
    rows = [("deep_mds", seed, "mse", value) for seed, value in enumerate((1e-4, 1.3e-4, 0.9e-4))]
    seeds = pd.DataFrame(rows, columns=["method", "seed", "metric", "value"])
    table = summarise(metrics, "bfm", NOTES, **SIZES, seeds=seeds)
    cells = table.set_index(["method", "metric"])[["n_seeds", "median", "lowest", "highest"]]
    assert cells.loc["deep_mds", "mse"].tolist() == [3, 1e-4, 0.9e-4, 1.3e-4]
    assert cells.loc["ridge", "mse"].isna().all()
    assert "1.00 [0.90, 1.30]" in line(text(table, "bfm"), "Deep-MDS ")
    assert "of 3 trainings" in text(table, "bfm")


def test_tables_of_a_run_are_printed_with_their_folders(table, tmp_path, capsys):
    run = Run("openhead", SMOKE, "celeba", results=tmp_path)
    with pytest.raises(InputError, match=r"table\.csv not found"):
        print_tables(run)
    names = ("celeba", "celeba-true-landmarks")
    for name in names:
        write_csv(run.experiment_results(name) / "table.csv", table)
    print_tables(run)
    shown = capsys.readouterr().out
    assert shown.count("\nDeep-MDS ") == 4, "two blocks of each"
    assert shown.index("the model fitted to the photos") < shown.index("against the true landmarks")
    assert shown.splitlines()[-2].startswith("MSE in 10⁻⁵: Deep-MDS ")
    assert shown.splitlines()[-4:-2] == [
        f"Tables, figures and manifest: {run.experiment_results(name)}/" for name in names
    ]


@pytest.mark.parametrize(("made", "said"), [("abc", True), ("def", False)])
def test_a_table_of_another_commit_is_printed_with_both(
    table, tmp_path, capsys, monkeypatch, made, said
):
    run = Run("openhead", SMOKE, results=tmp_path)
    write_csv(run.experiment_results("bfm") / "table.csv", table)
    write_json(run.experiment_results("bfm") / "manifest.json", {"commit": made, "steps": [{}]})
    monkeypatch.setattr(tables, "environment", lambda: {"commit": "def"})
    print_tables(run)
    assert ("They were made at commit abc; HEAD is def." in capsys.readouterr().out) == said


@pytest.mark.parametrize(
    ("shown", "expected"),
    [
        (plus_minus(0.000095569548, 1.1224717e-06, 1e-4), "0.956 ± 0.011"),
        (plus_minus(71.988743, 0.00016390089), "71.98874 ± 0.00016"),
        (plus_minus(2000.0, 96.0), "2,000 ± 96"),
        (plus_minus(27323.0), "27,323"),
        (plus_minus(float("nan")), "–"),
        (plus_minus(999.4), "999"),
        (plus_minus(999.7), "1,000"),
        (as_quoted(0.00125, unit=1e-3), "1.25"),  # not one of the paper's
        (scientific(-0.0000123456), "−1.235 × 10⁻⁵"),
        (duration(5287.5), "1 h 28 min"),
    ],
)
def test_numbers_are_rounded_where_their_spread_begins(shown, expected):
    assert shown == expected


def test_unknown_methods_are_refused(metrics):
    with pytest.raises(InputError, match=r"method must be one of .* Received 'mystery'"):
        summarise(metrics.replace("ridge", "mystery"), "bfm", {}, **SIZES)


def test_parameters_are_counted_from_the_networks(metrics):
    table = parameters.parameter_table(metrics).set_index("method")
    counts = table[["trainable", "total", "paper"]].T.to_dict("list")
    assert counts["mobileface"] == ["900979", "907819", "900,979"]
    assert counts["deep_mds"] == ["27323", "28229", "27505"]
    assert counts["deep_mds_released"][:2] == ["27303", "28209"]
    # ResNet-50 without its head has 23,534,592 trainable parameters.
    assert int(counts["ringnet"][0]) > 23_534_592 and counts["ringnet"][2] == "> 23000000"
    fewer = parameters.parameter_table(metrics, n_landmarks=68).set_index("method")
    assert fewer.loc["deep_mds", ["trainable", "total"]].tolist() == ["26275", "27165"]
    row = line(parameters.latex(table.reset_index()), "MediaPipe")
    assert row == r"MediaPipe & -- & -- & Not found & O(1) & O(1) & -- & -- & -- \\"
    # Counts of both sources are grouped, whichever way the paper prints them.
    row = line(parameters.latex(table.reset_index()), "Deep-MDS")
    assert row.startswith("Deep-MDS & 27,323 & 28,229 & 27,505 & ")
