"""The report: numbers from the results, stale results refused, the page in a real browser."""

import dataclasses
import json
import re
import shutil

import numpy as np
import pandas as pd
import pytest
from matplotlib.figure import Figure
from pages import drawn
from places import ROOT

from deepmds_keras.landmarks import load_scheme
from experiments import published
from experiments.figures.examples import write_examples
from experiments.figures.style import save
from experiments.inputs import Faces
from experiments.manifest import clear_results, files_of, read_manifest, write_manifest
from experiments.presets import SMOKE
from experiments.records import write_text
from experiments.report.experiment import load_experiments, name_of, result_folders
from experiments.report.overview import reports_elsewhere
from experiments.report.page import page as html_page
from experiments.report.report import main
from experiments.report.sections import colour_of, faces, report
from experiments.report.staleness import stale
from experiments.report.summaries import error, measured
from experiments.run import Run
from experiments.scoring.numbers import as_quoted, difference, duration, factor, plus_minus
from experiments.scoring.scores import Scores
from experiments.scoring.tables import write_csv, write_tables
from experiments.studies.seeds import spread

PHONE = {"viewport": {"width": 390, "height": 844}, "is_mobile": True, "has_touch": True}
DESKTOP = {"viewport": {"width": 1280, "height": 900}, "reduced_motion": "reduce"}
# Mean MSE of each method, in units of the paper's table.
MSE = {"mean_shape": 0.5, "linear": 0.125, "zhao": 3.0, "ours": 2.0, "ours_stable": 1.0}


def stage(name, minute, track="bfm", **more):
    return {
        "model_sha256": "0" * 64, "build": f"{track}-smoke-paper-seed0", "stage": name,
        "command": f"python -m experiments {name}",
        "started": f"2026-01-02T03:{minute:02d}:00+00:00", "seconds": 75.0, "peak_memory_mb": 300,
        **more,
    }  # fmt: skip


def metrics_of(mse, unit):
    rows = [
        (method, metric, subset, value * factor)
        for method, mean in mse.items()
        for metric, value in (("mse", mean * unit), ("mse_mm2", mean), ("depth_corr", 71.9))
        for subset, factor in enumerate((0.75, 1.25) if metric != "depth_corr" else (1, 1))
    ]
    rows += [(method, "n_parameters", np.nan, 1000.0) for method in mse]
    return pd.DataFrame(rows, columns=["method", "metric", "subset", "value"])


def write_experiment(run, name, mse, stages, notes, unit=1e-4, target="reproduce-bfm"):
    """An experiment's folder by the writers that experiments use."""
    folder = run.experiment_results(name)
    clear_results(folder)
    metrics = metrics_of(mse, unit)
    write_csv(folder / "metrics.csv", metrics)
    track, rng = name.split("-")[0], np.random.default_rng(0)
    per_face = {"mse": {method: mean * rng.random(20) for method, mean in mse.items()}}
    write_tables(folder, metrics, experiment=track, subset_size=10, notes=notes, per_face=per_face)
    figure = Figure(figsize=(7.2, 2))
    figure.subplots().plot([1, 2])
    save(figure, folder / "figures", "learning_curves")
    if "-" not in name:
        examples(folder, mse, "bfm72" if track == "bfm" else "ibug51")
    write_manifest(run, target, stages, folder)
    return folder


def examples(folder, methods, scheme, faces=2):
    scheme, rng = load_scheme(scheme), np.random.default_rng(1)
    truth = rng.random((faces, len(scheme), 3)).astype(np.float32)
    test = Faces(truth[..., :2], truth, np.full(faces, 200.0), truth, None)
    scores = {}
    for number, method in enumerate(methods, 1):
        aligned = truth + 0.01 * np.sqrt(number) * rng.choice([-1, 1], truth.shape)
        if method == "zhao":  # finds only the first face
            aligned[1:] = np.nan
        scores[method] = Scores(aligned, truth, test.unit_mm, np.zeros(faces))
    titles = [f"orthographic\nyaw {k}°" for k in range(faces)]
    write_examples(folder, scheme, test, scores, range(faces), titles)


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """Small results of every kind of experiment."""
    results = tmp_path_factory.mktemp("results")
    run = Run("openhead", SMOKE, results=results)
    of_bfm = [stage("faces", 1), stage("networks", 2), stage("predictions", 3)]
    notes = {
        "mobileface": "left out (MOBILEFACE=no), or still to come",
        "authors_weights": "<script>window.ran=1</script> | not given",
    }
    write_experiment(run, "bfm", MSE, of_bfm, notes)
    released = MSE | {"zhao_true_depth": 22.0}
    write_experiment(run, "bfm-evaluator-released", released, of_bfm, notes)
    of_flame = [stage("frames", 1, "flame", frames="stand-in"), stage("networks", 5, "flame")]
    flame = dataclasses.replace(run, track="flame")
    truths = MSE | {"true_landmarks": 0.6}
    write_experiment(flame, "flame", truths, of_flame, {}, 1e-3, "reproduce-flame")
    folder = run.model_results / "parameters"
    parameters = [
        ("ours", "27323", "28229", "27505", "O(n^3)", "O(n^3 + t n^2 log n)", "7.7"),
        ("zhao", "114840", "114840", "114,840", "O(1)", "O(n^2)", "0.02"),
        ("mediapipe", "", "", "Not found", "O(1)", "O(1)", ""),
    ]
    heads = ["method", "trainable", "total", "paper", "complexity_paper", "complexity",
             "ms_per_face"]  # fmt: skip
    write_csv(folder / "table.csv", pd.DataFrame(parameters, columns=heads))
    write_manifest(run, "reproduce-bfm", of_bfm, folder)
    rows = [
        (method, seed, metric, 1e-4 * (seed + 1))
        for method in ("ours", "ours_stable")
        for seed in range(2)
        for metric in ("mse", "autoencoder_mse_inference", "autoencoder_mse_reestimated")
    ]
    table = spread(pd.DataFrame(rows, columns=["method", "seed", "metric", "value"]))
    folder = run.experiment_results("seeds")
    write_csv(folder / "table.csv", table)
    write_manifest(run, "seeds", [stage("seeds", 9)], folder)
    return results


@pytest.fixture
def results(made, tmp_path):
    shutil.copytree(made, tmp_path / "results")
    return tmp_path / "results"


@pytest.fixture(scope="module")
def written(made, tmp_path_factory):
    results = tmp_path_factory.mktemp("written") / "results"
    shutil.copytree(made, results)
    main(["--preset", "smoke", "--results", str(results)])
    return folder_of(results, "report")


def folder_of(results, name=""):
    return results / "smoke" / "openhead" / name


OTHER_COMMIT = "0123456789ab"


def change(folder, **values):
    manifest = read_manifest(folder)
    write_text(folder / "manifest.json", json.dumps(manifest | values))


def row_of(text, method, head):
    """A method's row of the Markdown table below a heading."""
    return next(
        line
        for line in text.partition(f"\n## {head}\n")[2].splitlines()
        if f"| {method} |" in line or line.startswith(f"| {method}<sup>")
    )


# What it says.


def test_the_paper_stands_beside_ours_with_difference_and_ratio(written):
    text = (written / "report.md").read_text()
    row = row_of(text, "Deep-MDS", "The paper's BFM table")
    assert row.startswith("| Deep-MDS | 2.0 ± 0.7 | 1.4 ± 0.005 | +0.6 (×1.43) | 71.9 |")
    assert "71.95 ± 0.002" in row
    flame = row_of(text, "Deep-MDS", "The paper's CASIA-3D table")
    assert flame.startswith("| Deep-MDS | 2.0 ± 0.7 | 1.50 ± 0.18 | +0.5 (×1.33) |")


def test_a_summary_follows_the_numbers(written, results):
    text = (written / "report.md").read_text()
    assert (
        "Deep-MDS has an MSE of (2.0 ± 0.7) × 10⁻⁴, 1.43 times the (1.4 ± 0.005) × 10⁻⁴ that the "
        "paper prints. 2 of the 3 other methods on the same faces have a smaller error: Linear "
        "0.062 and Mean shape 0.25 times it."
    ) in text
    assert 'The row "True landmarks" is no method' in text
    assert "has 0.30 times the error of Deep-MDS; Mean shape and Linear no more." in text
    assert "the true depth itself has an MSE of (22 ± 8) × 10⁻⁴. That is 1.0000 times" in text
    assert "MSE is 1 to 2 × 10⁻⁴ (2.00 times) for Deep-MDS" in text
    run = Run("openhead", SMOKE, results=results)
    best = MSE | {"ours": 0.1, "mean_shape": 0.2}
    write_experiment(run, "bfm", best, [stage("faces", 1)], {})
    main(["--preset", "smoke", "--results", str(results)])
    text = (folder_of(results, "report") / "report.md").read_text()
    assert (
        "None of the 3 other methods on the same faces have a smaller error. One constant" in text
    )
    assert "has 2.00 times it." in text


def test_a_fit_that_is_the_truth_elsewhere_is_no_method(results):
    run = Run("openhead", SMOKE, results=results)
    notes = {"model_fit": "no method here: what the paper takes for the truth"}
    fits = MSE | {"model_fit": 0.6}
    write_experiment(run, "celeba-true-landmarks", fits, [stage("photos", 1)], notes, 1e-5)
    main(["--preset", "smoke", "--results", str(results)])
    text = (folder_of(results, "report") / "report.md").read_text()
    section = text.partition("## CelebA, against the true landmarks")[2].partition("\n## ")[0]
    assert "2 of the 3 other methods" in section
    assert 'The row "Model fit" is no method' in section


def test_what_was_not_run_has_a_reason(written):
    text = (written / "report.md").read_text()
    missing = text.partition("## What was not run, and why")[2].partition("\n## ")[0]
    for item in ("celeba", "flame-true-landmarks", "Basel Face Model 2009", "MODEL=openhead",
                 "licence must be asked for", "CoMA", "left out (MOBILEFACE=no)"):  # fmt: skip
        assert item in missing
    assert "`bfm`" not in missing.partition("### Empty cells")[0]


def test_both_files_hold_the_same_numbers(written):
    cells = re.findall(r"<td[^>]*>(.*?)</td>", (written / "index.html").read_text())
    on_page = [re.sub(r"<[^>]+>", "", cell) for cell in cells]
    rows = (written / "report.md").read_text().splitlines()
    rows = [row[2:-2].split(" | ")[1:] for row in rows if row.startswith("| ")]
    in_text = [re.sub(r"<[^>]+>|[`\\\\]", "", cell) for row in rows for cell in row]
    numbers = re.compile(r".*\d( ±|\)$).*")
    assert len([*filter(numbers.match, on_page)]) > 60
    assert [*filter(numbers.match, on_page)] == [*filter(numbers.match, in_text)]


def test_pictures_and_files_of_the_markdown_are_there(written):
    links = re.findall(r"\]\(([^)#]+)\)", (written / "report.md").read_text())
    assert len(links) > 10
    for link in links:
        assert (written / link).exists(), link


def test_what_a_file_says_cannot_become_markup(written):
    page = (written / "index.html").read_text()
    assert "&lt;script&gt;window.ran=1&lt;/script&gt; | not given" in page
    assert "<script>window.ran" not in page
    text = (written / "report.md").read_text()
    assert r"\<script\>window.ran=1\</script\> \| not given" in text


def test_only_what_the_run_wrote_is_shown(results):
    figures = folder_of(results, "bfm/figures")
    shutil.copy(figures / "learning_curves.png", figures / "of_another_run.png")
    main(["--preset", "smoke", "--results", str(results)])
    text = (folder_of(results, "report") / "report.md").read_text()
    assert "learning_curves" in text
    assert "another" not in text


def test_the_same_results_give_the_same_report(written, results):
    main(["--preset", "smoke", "--results", str(results)])
    for name in ("report.md", "index.html"):
        assert (folder_of(results, "report") / name).read_bytes() == (written / name).read_bytes()


def test_the_committed_report_is_that_of_the_committed_results():
    folder = ROOT / "results" / "openhead"
    assert stale(folder) == []
    experiments = load_experiments(folder)
    made = report("openhead", experiments, reports_elsewhere(ROOT / "results"))
    committed = (folder / "report" / "report.md").read_text(encoding="utf-8")
    assert committed == made
    whole = html_page(made, folder / "report", faces(experiments), colour_of)
    assert len(whole.encode()) < 2.5e6


@pytest.mark.parametrize(
    ("shown", "expected"),
    [
        (plus_minus(0.000095569548, 1.1224717e-06, 1e-4), "0.956 ± 0.011"),
        (plus_minus(71.988743, 0.00016390089), "71.98874 ± 0.00016"),
        (plus_minus(93.2, 0.84), "93.2 ± 0.8"),
        (plus_minus(2000.0, 96.0), "2,000 ± 96"),
        (plus_minus(27323.0), "27,323"),
        (plus_minus(0.0, 0.0), "0"),
        (plus_minus(float("nan")), "–"),
        (as_quoted(0.0022, 2.5e-05, 1e-4), "22 ± 0.25"),
        (as_quoted(float("nan")), "–"),
        (difference(0.9, 1.4), "−0.5 (×0.64)"),
        (difference(1.0, float("nan")), "–"),
        (factor(1.0005), "1.0005"),
        (factor(145.7), "146"),
        (duration(5287.5), "1 h 28 min"),
        (duration(65.4), "1 min 5 s"),
    ],
)
def test_numbers_are_rounded_where_their_spread_begins(shown, expected):
    assert shown == expected


def test_where_there_are_seeds_their_median_and_range_are_the_headline():
    (bfm,) = (own for own in load_experiments(ROOT / "results" / "openhead") if own.name == "bfm")
    table = bfm.table().query("metric == 'mse'").set_index("method")
    ours, alone = measured(bfm).loc["ours"], measured(bfm).loc["linear"]
    assert ours["mean"] == table.loc["ours", "median"] != table.loc["ours", "mean"]
    assert alone["mean"] == table.loc["linear", "mean"]
    assert re.fullmatch(r"\([\d.]+ \[[\d.]+, [\d.]+\]\) × 10⁻⁴ over 10 seeds", error(ours, 1e-4))
    assert re.fullmatch(r"\([\d.]+ ± [\d.]+\) × 10⁻⁴", error(alone, 1e-4))


# What it refuses.


def test_whole_results_are_not_stale(results):
    assert stale(folder_of(results)) == []


def edited(folder):
    path = folder / "bfm" / "table.csv"
    path.write_text(path.read_text().replace("2", "3", 1))


def removed(folder):
    (folder / "flame" / "examples.json").unlink()


def of_an_earlier_version(folder):
    manifest = read_manifest(folder / "bfm")
    manifest.pop("files")
    write_text(folder / "bfm" / "manifest.json", json.dumps(manifest))


def stopped(folder):
    (folder / "parameters" / "manifest.json").unlink()


def damaged(folder):
    path = folder / "flame" / "manifest.json"
    path.write_text(path.read_text()[:100])


def trained_anew(folder):
    stages = read_manifest(folder / "bfm")["stages"]
    stages[1]["started"] = "2026-02-02T03:02:00+00:00"
    for name in ("bfm", "parameters"):
        change(folder / name, stages=stages, commit=OTHER_COMMIT)


def predicted_anew(folder):
    stages = read_manifest(folder / "bfm")["stages"]
    stages[2]["started"] = "2026-02-02T03:02:00+00:00"
    for name in ("bfm-evaluator-released", "parameters"):
        change(folder / name, stages=stages, commit=OTHER_COMMIT)


@pytest.mark.parametrize(
    ("spoil", "where", "reason"),
    [
        (edited, "bfm", "table.csv changed since the run"),
        (removed, "flame", "examples.json missing"),
        (of_an_earlier_version, "bfm", "was written by an earlier version"),
        (stopped, "parameters", "no readable manifest.json"),
        (damaged, "flame", "no readable manifest.json"),
        (
            trained_anew,
            "bfm-evaluator-released",
            "was made from stage networks of 2026-01-02 03:02",
        ),
        (predicted_anew, "bfm", "was made from stage predictions of 2026-01-02 03:03"),
    ],
)
def test_stale_results_are_refused_with_one_line(results, capsys, spoil, where, reason):
    folder = folder_of(results)
    spoil(folder)
    with pytest.raises(SystemExit) as ended:
        main(["--preset", "smoke", "--results", str(results)])
    assert ended.value.code == 2
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 1
    assert lines[0].startswith(f"error: {folder / where}")
    assert reason in lines[0]
    assert "&& make reproduce-" in lines[0]
    assert not (folder / "report").exists()


def test_all_that_is_stale_is_listed_at_once(results, tmp_path):
    folder = folder_of(results)
    edited(folder)
    removed(folder)
    (folder / "bfm" / "figures" / "learning_curves.png").unlink()
    problems = stale(folder)
    assert len(problems) == 2
    assert "figures/learning_curves.png missing; table.csv changed since the run" in problems[0]
    assert (
        "rm -f build/openhead/bfm-smoke-paper-seed0*/bfm*.json && make reproduce-bfm" in problems[0]
    )
    assert "MODEL=openhead PRESET=smoke SEED=0" in problems[0]


def test_other_numbers_of_the_paper_make_all_results_stale(results, tmp_path):
    changed = tmp_path / "published.csv"
    changed.write_text(published.PUBLISHED.read_text() + "\n")
    problems = stale(folder_of(results), changed)
    assert len(problems) == 5
    assert all("published.csv changed since" in problem for problem in problems)


@pytest.mark.parametrize(
    ("commit", "inputs", "n_stale"),
    [(OTHER_COMMIT, {}, 0), (OTHER_COMMIT, {"MODEL": "1" * 64}, 1), (f"{OTHER_COMMIT}+", {}, 1)],
)
def test_one_commit_makes_the_same_of_the_same_inputs_whenever(results, commit, inputs, n_stale):
    folder = folder_of(results)
    for name in ("bfm", "bfm-evaluator-released", "parameters"):
        change(folder / name, commit=commit)
    stages = read_manifest(folder / "bfm-evaluator-released")["stages"]
    stages[1] |= {"started": "2026-01-01T03:02:00+00:00", "inputs": inputs}
    change(folder / "bfm-evaluator-released", stages=stages)
    assert len(stale(folder)) == n_stale


def test_photos_are_tested_with_the_networks_of_the_other_table(results):
    run = Run("openhead", SMOKE, track="celeba", results=results)
    same = [stage("photos", 30, "celeba"), stage("networks", 2), stage("predictions", 40, "celeba")]
    write_experiment(run, "celeba", MSE, same, {}, 1e-5, "reproduce-celeba")
    assert stale(folder_of(results)) == []
    anew = [stage("networks", 59)]
    change(write_experiment(run, "celeba", MSE, anew, {}, 1e-5, "reproduce-celeba"),
           commit=OTHER_COMMIT)  # fmt: skip
    problems = stale(folder_of(results))
    assert len(problems) == 3  # the two tables on random faces, and their parameters
    assert all("celeba from that of 2026-01-02 03:59" in problem for problem in problems)


def test_real_photos_and_their_stand_in_are_no_runs_of_the_same_stage(results):
    run = Run("openhead", SMOKE, track="celeba", results=results)
    given = dataclasses.replace(run, celeba="data/celeba")
    networks = stage("networks", 2)
    for own, minute in ((run, 30), (given, 40)):
        stages = [stage("photos", minute, "celeba") | {"build": own.work.name}, networks]
        folder = write_experiment(own, "celeba", MSE, stages, {}, 1e-5, "reproduce-celeba")
    assert folder.name == "celeba-real"
    assert stale(folder_of(results)) == []
    # The networks are one and the same.
    stages[-1] = stage("networks", 1)
    change(write_experiment(given, "celeba", MSE, stages, {}, 1e-5, "reproduce-celeba"),
           commit=OTHER_COMMIT)  # fmt: skip
    (problem,) = stale(folder_of(results))
    assert "celeba-real was made from stage networks of 2026-01-02 03:01" in problem


def test_photos_with_51_landmarks_are_of_the_networks_of_the_expressive_faces(results):
    run = Run("openhead", SMOKE, track="flame", results=results)
    folder = run.experiment_results("celeba-flame")
    for minute, problems in ((5, 0), (55, 1)):
        stages = [stage("networks", minute, "flame"), stage("celeba-flame", 56, "flame")]
        write_manifest(run, "reproduce-celeba", stages, folder)
        change(folder, commit=OTHER_COMMIT)
        assert len(stale(folder_of(results))) == problems


def test_runs_with_other_seeds_have_other_networks(results):
    run = dataclasses.replace(Run("openhead", SMOKE, results=results), seed=1)
    networks = stage("networks", 50) | {"build": run.work.name}
    folder = write_experiment(run, "bfm", MSE, [networks], {})
    assert folder.name == "bfm-seed1"
    assert stale(folder_of(results)) == []
    main(["--preset", "smoke", "--results", str(results)])
    text = (folder_of(results, "report") / "report.md").read_text()
    assert "## The paper's BFM table (seed1)" in text


def test_a_folder_of_several_results_is_none_itself(tmp_path):
    for name in ("bfm", "lifting/hard", "lifting/hard-seed1"):
        (tmp_path / "openhead" / name).mkdir(parents=True)
        write_text(tmp_path / "openhead" / name / "table.csv", "a,b\n")
    found = result_folders(tmp_path / "openhead")
    assert [name_of(path) for path in found] == ["bfm", "lifting/hard", "lifting/hard-seed1"]
    listed = "\n".join(stale(tmp_path / "openhead"))
    assert "lifting/hard-seed1 has no readable manifest.json" in listed
    assert "run: rm -f build/openhead/*/hard*.json && make lifting MODEL=openhead" in listed


def test_without_results_there_is_no_report(tmp_path, capsys):
    with pytest.raises(SystemExit):
        main(["--results", str(tmp_path)])
    assert "must hold results of experiments. Received none" in capsys.readouterr().err


# What it is made from.


def test_a_new_run_takes_the_place_of_the_old_one(results):
    folder = folder_of(results, "bfm")
    (folder / "mine.txt").write_text("kept")
    assert {"table.csv", "figures/learning_curves.pdf"} <= files_of(folder).keys()
    clear_results(folder)
    assert [path.name for path in folder.rglob("*") if path.is_file()] == ["mine.txt"]


def test_a_manifest_cannot_have_files_deleted_elsewhere(results):
    folder = folder_of(results, "bfm")
    change(folder, files={"../flame/table.csv": "0" * 64, "table.csv": "0" * 64})
    clear_results(folder)
    assert (folder_of(results, "flame") / "table.csv").exists()
    assert not (folder / "table.csv").exists()


def test_examples_are_small_and_say_what_was_not_found(tmp_path):
    methods = ["zhao", *(f"method{k}" for k in range(9))]
    examples(tmp_path, methods, "bfm72", faces=5)
    path = tmp_path / "examples.json"
    assert path.stat().st_size < 150_000
    made = json.loads(path.read_text())
    assert made["faces"][1]["shapes"]["zhao"] is made["faces"][1]["mse"]["zhao"] is None
    face = made["faces"][0]
    assert np.shape(face["shapes"]["zhao"]) == np.shape(face["truth"]) == (72, 3)
    assert max(len(str(value)) for point in face["truth"] for value in point) <= 6
    assert face["title"] == "orthographic, yaw 0°"


# In a browser.


@pytest.fixture
def page(visit, written):
    shown = visit(written / "index.html", **DESKTOP)
    shown.evaluate("for (const fold of document.querySelectorAll('details')) fold.open = true")
    return shown


@pytest.mark.parametrize("model", ["openhead", "ict"])
def test_the_committed_report_opens_at_the_findings(visit, model, tmp_path):
    experiments = load_experiments(ROOT / "results" / model)
    folder = ROOT / "results" / model / "report"
    text = (folder / "report.md").read_text(encoding="utf-8")
    path = tmp_path / "index.html"
    path.write_text(html_page(text, folder, faces(experiments), colour_of), encoding="utf-8")
    shown = visit(path, **DESKTOP)
    assert shown.evaluate("document.documentElement.scrollHeight") < 6000
    first = shown.locator("h2").first
    assert first.text_content() == "At a glance"
    assert first.bounding_box()["y"] < 900


def column(page, table, number):
    """Texts of a column of a table."""
    return (
        page.locator("table")
        .nth(table)
        .locator("tbody tr")
        .evaluate_all("(rows, k) => rows.map((row) => row.cells[k].textContent)", number)
    )


def criteria(page):
    """Number of the first table with groups of columns after the one at a glance."""
    captions = page.locator("table caption").all_text_contents()
    return next(k for k, text in enumerate(captions) if text.startswith("The paper's criteria"))


def test_every_picture_is_there(page):
    sizes = page.locator("img").evaluate_all(
        "async (all) => { await Promise.all(all.map((i) => i.decode()));"
        " return all.map((i) => [i.naturalWidth, i.naturalHeight, i.width / i.height]); }"
    )
    assert len(sizes) == 3
    for width, height, ratio in sizes:
        assert width > 600
        assert ratio == pytest.approx(width / height, rel=0.02)


def test_tables_sort_by_click_both_ways_and_keep_empty_cells_last(page):
    table = criteria(page)
    heading = page.locator("table").nth(table).locator("th[aria-sort]").nth(1)
    assert heading.text_content() == "here"
    heading.locator("button").click()
    assert heading.get_attribute("aria-sort") == "ascending"
    rising = column(page, table, 1)
    assert rising[:5] == ["0.12 ± 0.04", "0.50 ± 0.18", "1.0 ± 0.4", "2.0 ± 0.7", "3.0 ± 1.1"]
    assert {*rising[5:]} == {"–"}
    heading.locator("button").click()
    assert heading.get_attribute("aria-sort") == "descending"
    falling = column(page, table, 1)
    assert falling[:5] == rising[4::-1]
    assert {*falling[5:]} == {"–"}


def test_tables_sort_by_the_number_that_a_cell_shows(page):
    numbers = {
        "(6.34 ± 0.11) × 10⁻⁵": 6.34e-5,
        "−2.37 (×0.18)": -2.37,
        "×45.27": 45.27,
        "> 23,000,000": 23e6,
        "5 of 6": 5,
        "8e−185": 8e-185,
        "1 h 28 min": 5280,
        "27 min 18 s": 1638,
        "0.7 s": 0.7,
    }
    found = page.evaluate("(texts) => texts.map(numberIn)", [*numbers, "< 10⁻³⁰⁰", "–", "N/A"])
    assert found[:-3] == [pytest.approx(number, rel=1e-9) for number in numbers.values()]
    assert found[-3] < 8e-185 and found[-2:] == [None, None]


def test_tables_sort_by_time_of_day(page):
    first, later = (page.evaluate("numberIn", f"2026-01-0{d} 03:04") for d in (2, 3))
    assert later - first == 24 * 3600 * 1000


def test_colours_of_methods_are_those_of_the_figures(page):
    row = page.locator("table").nth(criteria(page)).locator("tbody tr", has_text="Deep-MDS").first
    colour = row.locator(".patch").evaluate("(patch) => getComputedStyle(patch).backgroundColor")
    assert colour == "rgb(213, 94, 0)"


def test_no_comma_strays_from_the_name_before_it(page):
    names = page.locator("td", has=page.locator("code + code")).first
    widths = names.evaluate(
        """(cell) => [...cell.childNodes].slice(0, 2).map((node) => {
          const range = document.createRange();
          range.selectNodeContents(node);
          const text = range.getBoundingClientRect();
          return [text.left, text.right, node.textContent];
        })"""
    )
    (_, end, name), (start, _, comma) = widths
    assert name.startswith("flame") or name.startswith("bfm")
    assert comma.startswith(",")
    assert start == pytest.approx(end, abs=2)


def test_tables_sort_by_keyboard(page):
    table = criteria(page)
    headings = page.locator("table").nth(table).locator("th[aria-sort]")
    headings.nth(0).locator("button").focus()
    page.keyboard.press("Enter")
    names = column(page, table, 0)
    assert names == sorted(names) and headings.nth(0).get_attribute("aria-sort") == "ascending"
    # The next one is a column of the second row of headings: of the paper's numbers.
    for _ in range(2):
        page.keyboard.press("Tab")
    page.keyboard.press("Space")
    assert headings.nth(0).get_attribute("aria-sort") == "none"
    assert headings.nth(2).get_attribute("aria-sort") == "ascending"
    assert column(page, table, 2)[0].startswith("0.6 ± 0.004")


def of_colour(image, colour):
    near = (np.abs(image[..., :3].astype(int) - colour) < 40).all(-1)
    return int((near & (image[..., 3] > 150)).sum())


def test_faces_turn_by_pointer_and_by_key(page):
    before = drawn(page)
    box = page.locator("canvas").first.bounding_box()
    page.mouse.move(box["x"] + 200, box["y"] + 200)
    page.mouse.down()
    page.mouse.move(box["x"] + 300, box["y"] + 200, steps=4)
    page.mouse.up()
    dragged = drawn(page)
    assert (dragged != before).any(-1).mean() > 0.01
    page.locator("canvas").first.focus()
    page.keyboard.press("ArrowLeft")
    assert (drawn(page) != dragged).any(-1).mean() > 0.01


def test_methods_and_faces_are_chosen(page):
    linear, ours = (0x22, 0x22, 0x22), (0xD5, 0x5E, 0x00)
    faces = page.locator(".faces").first
    first = drawn(page)
    assert of_colour(first, ours) > 300
    faces.get_by_label("Deep-MDS", exact=True).uncheck()
    assert of_colour(drawn(page), ours) == 0
    faces.get_by_label("Linear").check()
    assert of_colour(drawn(page), linear) > of_colour(first, linear) + 300
    assert faces.get_by_label("Zhao et al.").is_enabled()
    faces.locator("select").select_option("1")
    assert faces.get_by_label("Zhao et al.").is_disabled()
    assert (drawn(page) != first).any(-1).mean() > 0.01
    assert faces.locator("svg circle").count() == 72


def test_a_phone_scrolls_tables_in_their_box_and_nothing_else_sideways(visit, written):
    page = visit(written / "index.html", **PHONE)
    width = page.evaluate("document.documentElement.scrollWidth")
    assert width <= 390
    page.evaluate("for (const fold of document.querySelectorAll('details')) fold.open = true")
    assert page.evaluate("document.documentElement.scrollWidth") <= 390
    table = page.locator(".scroll").nth(criteria(page))
    inside, outside = table.evaluate("(box) => [box.scrollWidth, box.clientWidth]")
    assert inside > outside
    table.evaluate("(box) => box.scrollTo(200, 0)")
    # The method's name stays in sight.
    first = table.locator("tbody th").first
    assert first.bounding_box()["x"] == pytest.approx(table.bounding_box()["x"], abs=1)


def test_on_paper_every_fold_is_open(visit, written):
    page = visit(written / "index.html", **DESKTOP)
    assert page.locator("details[open]").count() == 0
    page.pdf()
    assert page.locator("details").count() == page.locator("details[open]").count() > 3


def test_links_within_the_page_lead_somewhere(page):
    missing = page.evaluate(
        """[...document.querySelectorAll('a[href^="#"]')]
          .map((link) => link.getAttribute("href").slice(1))
          .filter((name) => !document.getElementById(name))"""
    )
    assert missing == []
