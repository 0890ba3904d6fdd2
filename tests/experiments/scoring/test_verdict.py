"""The last lines of `make reproduce-bfm`, and `make check`."""

import subprocess
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from deepmds_keras.errors import InputError
from experiments.methods import constant_answers
from experiments.presets import FULL, SMOKE
from experiments.run import Run
from experiments.scoring.intervals import holm_adjusted
from experiments.scoring.tables import summarise, wilcoxon_tests
from experiments.scoring.typesetting import paper_layout, remarks
from experiments.scoring.verdict import check, order_lines, verdict

ERRORS = {
    "mean_shape": 0.5e-4,
    "deep_mds_constant": 1e-4,
    "deep_mds": 0.9e-4,
    "landmark_lifter": 0.05e-4,
}


def metrics_of(errors):
    rows = [(m, "mse", k, mse * (1 + k / 100)) for m, mse in errors.items() for k in (0, 1)]
    rows += [(m, "depth_corr", k, 71.9) for m in errors for k in (0, 1)]
    return pd.DataFrame(rows, columns=["method", "metric", "subset", "value"])


def seeds_of(errors, n=10):
    rows = [(m, "mse", k, mse * (1 + k / 10)) for m, mse in errors.items() for k in range(n)]
    return pd.DataFrame(rows, columns=["method", "metric", "seed", "value"])


def table_of(errors, seeds=None):
    return summarise(metrics_of(errors), "bfm", {}, subset_size=2, n_landmarks=72, seeds=seeds)


@pytest.fixture
def run(tmp_path):
    """A run whose table is committed, over ten seeds of all but lifting."""
    run = Run("openhead", FULL, results=tmp_path / "results")
    path = run.experiment_results("bfm") / "table.csv"
    path.parent.mkdir(parents=True)
    seeds = seeds_of({m: mse for m, mse in ERRORS.items() if m != "landmark_lifter"})
    table_of(ERRORS, seeds).to_csv(path, index=False)
    who = ("-c", "user.name=a", "-c", "user.email=a@b.c")
    for words in (("init", "-q"), ("add", "."), (*who, "commit", "-qm", "a run")):
        subprocess.run(["git", *words], cwd=tmp_path, check=True)
    return run


def write(run, errors):
    path = run.experiment_results("bfm") / "table.csv"
    path.parent.mkdir(parents=True, exist_ok=True)
    table_of(errors).to_csv(path, index=False)


def test_a_run_ends_with_its_verdict(run):
    text, compared = verdict(run)
    assert text == (
        "MSE in 10⁻⁴: Deep-MDS 1.30 [0.90, 1.71] (paper 1.4 ± 0.005); one output of its own for "
        "all views 1.45 [1.00, 1.90]; the mean shape 0.72 [0.50, 0.95]."
    )
    assert compared == "This run agrees with the committed one."
    write(run, ERRORS | {"deep_mds": 3e-4})
    assert verdict(run)[2].endswith("see make check: deep_mds.")
    assert verdict(run)[1] == (
        "These numbers are of seed 0 alone. The committed table, and the pages, have the median "
        "over 10 seeds: Deep-MDS 1.30 [0.90, 1.71] (make reproduce-bfm SEEDS=10)."
    )
    write(run, {method: mse for method, mse in ERRORS.items() if method != "landmark_lifter"})
    assert verdict(run)[2].endswith("agrees with the committed one; not run here: landmark_lifter.")
    small = replace(run, preset=SMOKE)
    write(small, ERRORS)
    assert "Not compared" in verdict(small)[1]


@pytest.mark.parametrize(
    ("changes", "off"),
    [
        ({}, []),
        ({"deep_mds": 1.7e-4}, []),  # as one of the seeds
        ({"landmark_lifter": 0.057e-4}, []),
        ({"landmark_lifter": 0.058e-4}, ["landmark_lifter"]),
        ({"deep_mds": 0.5e-4, "mean_shape": 2e-4}, ["mean_shape", "deep_mds"]),
    ],
)
def test_check_allows_what_seeds_do(run, capsys, changes, off):
    write(run, ERRORS | changes)
    if not off:
        check(run)
        assert "agrees" in capsys.readouterr().out
        return
    with pytest.raises(SystemExit) as end:
        check(run)
    assert end.value.code == 1
    rows = capsys.readouterr().out.splitlines()[2:]
    assert [row.split()[0] for row in rows] == off


def test_check_needs_a_committed_table_and_a_fresh_one(run, tmp_path):
    with pytest.raises(InputError, match="Received the committed one: run make reproduce-bfm"):
        check(run)
    run = replace(run, results=tmp_path / "ignored")
    with pytest.raises(InputError, match=r"table.csv not found: run make reproduce-bfm first"):
        check(run)
    write(run, ERRORS)
    with pytest.raises(InputError, match=r"not found in git's last commit"):
        check(run)


def test_notes_name_methods_whose_titles_have_commas_apart():
    notes = dict.fromkeys(("zhao_authors", "mean_shape"), "left out")
    table = summarise(metrics_of(ERRORS), "bfm", notes, subset_size=2, n_landmarks=72)
    assert "Mean shape; Zhao et al., authors' training: left out." in remarks(table, "bfm", "latex")


def test_tests_over_seeds_are_paired_and_corrected():
    seeds = seeds_of(ERRORS)
    tests = wilcoxon_tests(metrics_of(ERRORS), {}, seeds).query("over == 'seeds'")
    assert (tests["n"] == 10).all() and len(tests) == 6
    assert np.allclose(tests["p_value"], 2 / 2**10) and np.allclose(tests["p_holm"], 6 * 2 / 2**10)
    assert np.allclose(holm_adjusted(np.array([0.03, 0.01, 0.04, 0.9])), [0.09, 0.04, 0.09, 0.9])


def test_the_papers_table_in_its_layout():
    tex = paper_layout(table_of(ERRORS), "bfm", "the open head")
    lines = tex.splitlines()
    assert lines[0] == r"\begin{table}" and lines[-1] == r"\end{table}"
    head = next(line for line in lines if line.startswith("Paper / here"))
    assert head.split(" & ") == ["Paper / here", "Zhao's", "Aldrian's", "MobileFace", r"Ours \\"]
    mse = next(line for line in lines if line.startswith("avgMSE"))
    assert r"22 $\pm$ 0.25 / --" in mse and r"1.4 $\pm$ 0.005 / 0.904 $\pm$ 0.006" in mse
    assert r"\label{tab:cmp_bfm}" in tex and r"\caption{" in tex


def test_constant_answers_have_the_mean_error_of_one_answer_to_all():
    rng = np.random.default_rng(0)
    shapes, truth = rng.normal(size=(2, 400, 5, 3))
    answers = constant_answers(shapes)
    assert not (answers == shapes).all((1, 2)).any() and np.isin(answers, shapes).all()
    mean = np.mean([((shape - truth) ** 2).mean() for shape in shapes])
    assert ((answers - truth) ** 2).mean() == pytest.approx(mean, rel=0.02)


@pytest.mark.parametrize(
    ("errors", "expected"),
    [
        # The paper: MobileFace 0.6, Deep-MDS 1.4, Aldrian & Smith 2.5, Zhao et al. 22.
        ([1, 2, 3, 4, 3, 4], ["reproduced (6 of 6 pairs): MobileFace < Deep-MDS", "reproduced"]),
        ([1, 2, 3, 4, 0.5, 1.5], ["reproduced (6", "partly reproduced (3 of 6 pairs): Aldrian"]),
        ([4, 3, 2, 1, 2, 1], ["not reproduced (0 of 6", "not reproduced (0 of 6"]),
    ],
)
def test_the_order_of_the_paper_is_looked_for_by_either_protocol(errors, expected):
    methods = "mobileface", "deep_mds", "aldrian_authors", "zhao_evaluator", "aldrian", "zhao"
    paper = [0.6, 1.4, 2.5, 22, np.nan, np.nan]
    rows = pd.DataFrame({"mean": errors, "paper_mean": paper}, index=methods)
    lines = order_lines(rows)
    protocols = "by the authors' protocol", "with faithful baselines"
    assert all(protocol in line for protocol, line in zip(protocols, lines, strict=True))
    for line, text in zip(lines, expected, strict=True):
        assert f": {text}" in line
    assert lines[1].endswith(" One training of each: indicative.")
    of_seeds = order_lines(rows.assign(median=errors, mean=errors[::-1]))
    assert of_seeds == [lines[0], lines[1].removesuffix(" One training of each: indicative.")]
