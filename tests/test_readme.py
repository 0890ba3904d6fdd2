"""The tables of README and docs are the committed results."""

import itertools
import json
import re

import pandas as pd
import pytest
from documents import text_of
from places import ROOT
from scipy.stats import mannwhitneyu

from experiments.methods import METHODS


def errors_of(folder):
    """Rows of a table of results with mean squared errors, by method."""
    table = pd.read_csv(ROOT / "results" / folder / "table.csv")
    return table[table["metric"] == "mse"].set_index("method")


def bench():
    """All times of the bench."""
    return pd.read_csv(ROOT / "results" / "bench" / "bench.csv")


def table_of(head, page="docs/results.md"):
    """Cells of a page's table with that head, by the first of each row."""
    text = (ROOT / page).read_text(encoding="utf-8")
    start = text.index(f"\n| {head} |")
    lines = text[start + 1 :].split("\n\n")[0].splitlines()[2:]
    rows = [[cell.strip() for cell in line.strip("|").split("|")] for line in lines]
    return {row[0]: row[1:] for row in rows}


@pytest.mark.parametrize(
    ("head", "unit", "folder", "column"),
    [
        ("MSE, in 10⁻⁴", 1e-4, "ict/bfm", 1),
        ("MSE, in 10⁻⁴", 1e-4, "openhead/bfm", 2),
        ("MSE, in 10⁻³", 1e-3, "openhead/flame", 1),
        ("MSE, in 10⁻³", 1e-3, "openhead/flame-true-landmarks", 2),
        ("MSE, in 10⁻³", 1e-3, "ict/flame", 3),
        ("MSE, in 10⁻³", 1e-3, "ict/flame-true-landmarks", 4),
        ("MSE, in 10⁻⁵", 1e-5, "openhead/celeba", 1),
        ("MSE, in 10⁻⁵", 1e-5, "openhead/celeba-true-landmarks", 2),
        ("MSE, in 10⁻⁵", 1e-5, "ict/celeba", 3),
        ("MSE, in 10⁻⁵", 1e-5, "ict/celeba-true-landmarks", 4),
    ],
)
def test_numbers_are_those_of_the_results(head, unit, folder, column):
    mse = errors_of(folder)
    rows = table_of(head)
    shown = [
        method for method in METHODS.values() if method.title in rows and method.id in mse.index
    ]
    assert {"ours", "ours_stable", "mean_shape", "linear"} <= {method.id for method in shown}
    assert {*rows} <= {method.title for method in METHODS.values()}
    for method in shown:
        cells, own = rows[method.title], mse.loc[method.id]
        measured, quoted = own[["mean", "paper_mean"]] / unit
        said = "–" if pd.isna(measured) else f"{measured:.2g}"
        if own.get("n_seeds", 0) > 1:
            median, *span = (f"{own[key] / unit:.2g}" for key in ("median", "lowest", "highest"))
            said = f"{median} ({' to '.join(span)})"
        assert cells[column] == said, method.id
        assert cells[0] == ("–" if pd.isna(quoted) else f"{quoted:g}"), method.id


def test_the_readme_and_the_results_have_one_main_table():
    head = "MSE, in 10⁻⁴"
    assert table_of(head, "README.md") == table_of(head)


def test_what_is_said_of_luck_is_what_was_measured():
    readme = text_of("README.md")
    median, span, mean_shape, linear = headline("openhead")
    assert f"a median of {median} × 10⁻⁴ ({span})" in readme
    assert f"whatever the view, has {mean_shape}. Ridge regression has {linear}." in readme
    median, span, mean_shape, linear = headline("ict")
    assert f"On ICT faces these are {median} ({span}), {mean_shape} and {linear}." in readme


def headline(model):
    """Deep-MDS over the seeds (median and range), the mean shape and ridge regression, in 10⁻⁴."""
    mse = errors_of(f"{model}/bfm")
    ours = mse.loc["ours", ["median", "lowest", "highest"]]
    others = mse.loc["mean_shape", "median"], mse.loc["linear", "mean"]
    median, low, high, *others = (f"{error / 1e-4:.2f}" for error in (*ours, *others))
    return median, f"{low} to {high}", *others


def test_what_the_method_page_says_of_mobileface_is_what_was_measured():
    errors = [errors_of(f"{m}/bfm").loc["mobileface", "mean"] / 1e-5 for m in ("openhead", "ict")]
    said = "an MSE of {:.2f} × 10⁻⁵ on the open head and {:.2f} on ICT faces".format(*errors)
    assert said in text_of("docs/method.md")


def test_shares_of_deep_mds_error_are_what_was_measured():
    shares = {}
    for model in ("ict", "openhead"):
        mse = errors_of(f"{model}/bfm")
        others = mse.loc["mean_shape", "median"], mse.loc["linear", "mean"]
        shares[model] = [f"{error / mse.loc['ours', 'median']:.2f}" for error in others]
    said = (
        "has only {} of that error on ICT faces and {} on the open head. "
        "Ridge regression has {} and {}."
    )
    pairs = zip(shares["ict"], shares["openhead"], strict=True)
    assert said.format(*itertools.chain(*pairs)) in text_of("docs/results.md")


def test_what_is_said_of_single_seeds_is_what_was_measured():
    page = text_of("docs/results.md")
    ours, stable = seeds_of("openhead")
    assert (
        f"nine of ten seeds of the paper's recipe lie between {ours[0]} and {ours[8]} × 10⁻⁴, and "
        f"one has {ours[9]}. With the cosine schedule all ten lie between {stable[0]} and "
        f"{stable[-1]} ("
    ) in page
    ours, stable = seeds_of("ict")
    assert (
        f"eight of ten lie between {ours[0]} and {ours[7]}, and two at {ours[8]} and {ours[9]}; "
        f"with the cosine schedule all between {stable[0]} and {stable[-1]} ("
    ) in page


def test_how_many_seeds_agree_with_verdicts_of_one_is_what_was_measured():
    claims = pd.read_csv(ROOT / "results/audit/claims.csv").set_index(["id", "model"])["evidence"]
    better = {}
    for model in ("ict", "openhead"):
        ours, _ = seeds_of(model)
        evidence = claims["trivial-case", model]
        constant = float(re.search(r"what Deep-MDS makes of one view ([\d.]+)", evidence)[1])
        authors = errors_of(f"{model}/bfm").loc["aldrian_authors", "mean"] / 1e-4
        better[model] = [sum(float(x) < bound for x in ours) for bound in (authors, constant)]
    assert better == {"ict": [6, 4], "openhead": [9, 7]}
    page = text_of("docs/results.md")
    assert "Aldrian & Smith: six of the ten seeds do, on the open head nine." in page
    assert "taken as a constant: four do, and seven." in page


def rounding_of(folder):
    """Errors of seed 0 by how its sums were rounded, in 10⁻⁴."""
    table = pd.read_csv(ROOT / "results" / folder / "rounding" / "table.csv")
    return table.set_index("rounding")["mse"] / 1e-4


def test_what_rounding_alone_changes_is_what_was_measured():
    for model in ("ict", "openhead"):
        errors = rounding_of(model)
        assert errors.max() / errors.min() < 1.01
    assert "moves one seed by less than a hundredth" in text_of("docs/results.md")


def test_what_the_processor_changes_is_what_was_measured():
    said = []
    for model in ("openhead", "ict"):
        for folder, processor in ((model, "AMD"), (f"intel/{model}", "Intel")):
            errors = rounding_of(folder)
            assert (abs(errors / errors["as trained"] - 1) < 0.01).all()
            manifest = ROOT / "results" / folder / "rounding" / "manifest.json"
            assert processor in json.loads(manifest.read_text())["processor"]
            said.append(f"{errors['as trained']:.2f}")
    text = "Seed 0 has {} on AMD and {} on Intel; on ICT faces {} and {}."
    assert text.format(*said) in text_of("docs/results.md")


def test_that_processors_differ_as_seeds_do_is_what_was_measured():
    amd, intel = (errors_by_seed(folder) for folder in ("openhead", "intel/openhead"))
    page = text_of("docs/results.md")
    for errors, text, said in (
        (intel, page, "a median of {:.2f} × 10⁻⁴ ({:.2f} to {:.2f})"),
        (amd, page, "of the tables {:.2f} ({:.2f} to {:.2f}; "),
        (
            intel,
            text_of("README.md"),
            "Another ten, on an Intel processor, have a median of {:.2f} ({:.2f} to {:.2f}).",
        ),
    ):
        ours = errors["ours"]
        assert said.format(ours.median(), ours.min(), ours.max()) in text
    p = mannwhitneyu(amd["ours"], intel["ours"]).pvalue
    assert f"has p = {p:.2f}: no more than luck is seen" in page
    medians = [errors[m].median() for m in ("ours_stable", "mean_shape") for errors in (amd, intel)]
    said = "The cosine schedule has {:.2f} and {:.2f}, the mean shape {:.2f} and {:.2f}."
    assert said.format(*medians) in page
    assert (pd.concat([amd["ours"], intel["ours"]]) > 1.7).sum() == 4
    assert "of the twenty runs four have more than 1.7" in page


def errors_by_seed(folder):
    """Errors in 10⁻⁴: a row for each of ten seeds, a column for each method."""
    rows = pd.read_csv(ROOT / "results" / folder / "seeds" / "metrics.csv").query("metric == 'mse'")
    errors = rows.pivot(index="seed", columns="method", values="value") / 1e-4
    assert len(errors) == 10
    return errors


def seeds_of(model):
    """Errors of every seed, sorted: the paper's recipe and the cosine schedule."""
    errors = errors_by_seed(model)
    return [[f"{x:.2f}" for x in sorted(errors[method])] for method in ("ours", "ours_stable")]


def test_how_little_lifting_is_biased_is_what_was_measured():
    claims = pd.read_csv(ROOT / "results/audit/claims.csv").set_index(["id", "model"])["evidence"]
    found = [
        float(re.search(r"it is ([\d.]+) ± \S+ for Lifting", claims["lifting-unbiased", model])[1])
        for model in ("openhead", "ict")
    ]
    said = "It finds {:.2f} of what sets a face apart, on ICT faces {:.2f}.".format(*found)
    assert said in text_of("docs/results.md")


def test_what_is_said_of_turned_perspective_views_is_what_was_measured():
    mse = {}
    for model, folder in itertools.product(("openhead", "ict"), ("bfm", "bfm-posed")):
        mse[model, folder] = own = errors_of(f"{model}/{folder}")["mean"] / 1e-4
        assert own["lifting"] == own.min() and own["mean_shape"] < own["ours"]
    page = text_of("docs/results.md")
    methods = ["ours", "ours_stable", "aldrian", "lifting"]
    posed = [[f"{x:.2f}" for x in mse[m, "bfm-posed"][methods]] for m in ("openhead", "ict")]
    said = "{} × 10⁻⁴ then, with the cosine schedule {}, Aldrian & Smith {} and lifting {}."
    assert said.format(*posed[0]) in page
    assert "On ICT faces these are {}, {}, {} and {}".format(*posed[1]) in page
    zhao = [
        f"{mse[model, folder]['zhao']:.2f}"
        for folder, model in itertools.product(("bfm-posed", "bfm"), ("openhead", "ict"))
    ]
    assert "Zhao's net has {} and {} instead of {} and {}.".format(*zhao) in page


def test_how_many_faces_are_said_to_be_scored_is_how_many_were():
    used = {}
    for model, (table, kind) in itertools.product(
        ("openhead", "ict"), (("flame", "scans"), ("celeba", "photos"))
    ):
        made = json.loads((ROOT / "results" / model / table / "manifest.json").read_text())
        (faces,) = (stage[kind] for stage in made["stages"] if stage["stage"] == kind)
        used[model, kind] = f"{faces['used']:,}"
    page = text_of("docs/results.md")
    scans, photos = ((used["openhead", kind], used["ict", kind]) for kind in ("scans", "photos"))
    assert "Of the open head's {} and of ICT's {} are scored".format(*scans) in page
    assert "dlib finds {} of the faces of the open head and {} of ICT's".format(*photos) in page


def test_what_is_said_of_lifting_at_the_limit_is_what_was_measured():
    for model in ("openhead", "ict"):
        table = pd.read_csv(ROOT / "results" / model / "lifting" / "hard" / "table.csv")
        row = table[table["metric"] == "times_limit"].set_index(["method", "condition"])["mean"]
        assert f"{row['lifting', 'hard_1']:.2f} times" in text_of("README.md")


def test_what_is_said_of_the_shipped_weights_is_what_was_measured():
    table = pd.read_csv(ROOT / "results" / "openhead" / "pretrained" / "table.csv")
    own = table[table["scheme"] == "ibug51"].set_index(["method", "faces", "views"])["mse"]
    rows = table_of("51 landmarks, MSE in 10⁻⁵", "docs/photos.md")
    titles = {METHODS[method].title: method for method in own.index.get_level_values(0)}
    assert {*rows} == {*titles}
    columns = [*itertools.product(("openhead", "ict"), ("exact", "dlib", "mediapipe"))]
    for row, cells in rows.items():
        for (faces, views), cell in zip(columns, cells, strict=True):
            measured = own.get((titles[row], faces, views))
            assert cell == ("–" if measured is None else f"{measured / 1e-5:.3g}"), row


def test_what_is_said_of_photos_is_what_was_measured():
    table = pd.read_csv(ROOT / "results" / "openhead" / "pretrained" / "table.csv")
    rows = table.set_index(["scheme", "faces", "views", "method"]).unstack()
    mse, found = rows["mse"], rows["found_again"]["lifting"]
    assert (mse.idxmin(axis=1) == "lifting").all()
    below = 100 - 100 * mse["lifting"] / mse["mean_shape"]
    exact, jaw = found.loc[:, :, "exact"], below.loc["ibug68", :, "dlib"]
    lower, again = (column.loc["ibug51", :, ["dlib", "mediapipe"]] for column in (below, found))
    page = text_of("docs/photos.md")
    assert f"On exact landmarks it finds {exact.min():.2f} to {exact.max():.2f} of what" in page
    assert (
        f"lifting is {lower.min():.0f} to {lower.max():.0f} % below the mean shape, and finds "
        f"{again.min():.2f} to {again.max():.2f} again. With the jaw, as dlib finds it, it is "
        f"{jaw['openhead']:.0f} % below on the open head and {jaw['ict']:.0f} % on ICT."
    ) in page


def test_what_is_said_of_detectors_is_what_was_measured():
    table = pd.read_csv(ROOT / "results" / "openhead" / "pretrained" / "detection.csv")
    table = table.assign(turned=table["yaw"].abs(), hits=table["found"] * table["n_photos"])
    photos = table.groupby(["detector", "turned", "faces"])[["hits", "n_photos"]].sum()
    found = 100 * photos["hits"] / photos["n_photos"]
    assert found["mediapipe"].drop(60).min() > 99
    spans = [
        f"{found[of].min():.0f} to {found[of].max():.0f} %"
        for of in (("mediapipe", 60), ("dlib", 0), ("dlib", 40))
    ]
    assert (
        "MediaPipe finds {} of the faces turned by 60° and over 99 % of the others. Of the faces "
        "seen from the front dlib finds {}, of those turned by 40° {}."
    ).format(*spans) in text_of("docs/photos.md")


def test_times_are_those_of_the_bench():
    table = bench()
    parts = table[table["comparison"] == "parts"].set_index(["part", "way"])["ms_per_face"]
    rows = table_of("ms per face, on one core")
    assert [*rows] == [part.capitalize() for part in dict.fromkeys(parts.index.get_level_values(0))]
    for part in dict.fromkeys(parts.index.get_level_values(0)):
        released, *ours = rows[part.capitalize()]
        measured = [parts.get((part, way)) for way in ("sklearn", "batched")]
        if part not in ("embedding", "end to end"):
            measured = [parts[part, "ours"]] * 2
        assert [*map(rounded, (parts[part, "released"], *measured))] == [released, *ours[:2]]
        assert ours[2] == f"{rounded(parts[part, 'released'] / measured[1])} times", part


def rounded(value):
    return f"{float(f'{value:.2g}'):,g}"


def test_what_is_said_of_a_million_faces_is_what_was_measured():
    folder = ROOT / "results" / "openhead" / "stream"
    table = pd.read_csv(folder / "table.csv").set_index(["method", "metric"])
    made = json.loads((folder / "manifest.json").read_text(encoding="utf-8"))
    memory = max(made["stages"][-1]["processes_mb"])
    (bound,) = re.findall(r"No process held more than ([\d.]+) GB", text_of("docs/large.md"))
    assert memory / 1000 <= float(bound) < memory / 1000 + 0.1
    assert (table["n_faces"] == 1_000_000).all()
    errors = table.xs("mse", level="metric") / 1e-4
    said = f"{errors.loc['ours', 'mean']:.3f} ± {errors.loc['ours', 'standard_error']:.1g}"
    assert said in text_of("docs/results.md")


def test_what_is_said_of_the_speed_of_lifting_is_what_was_measured():
    table = bench()
    rows = table[table["way"] == "lifting"].set_index("comparison")
    batch, alone = rows.loc["parts"], rows.loc["one face"]
    slower = [
        f"{rounded(batch[column])} and {rounded(alone[column])} times"
        for column in ("times_batched", "times_sklearn")
    ]
    said = (
        f"{rounded(1e3 * batch.ms_per_face)} µs per face in a batch of {batch.n_faces:,} and "
        f"{rounded(alone.ms_per_face)} ms for one alone. Deep-MDS takes {slower[0]} as long with "
        f"the batched solver, {slower[1]} with scikit-learn's"
    )
    assert said in text_of("README.md")


def test_what_is_said_of_training_steps_is_what_was_measured():
    table = bench().set_index(["part", "way"])
    of_released = 1 / table.xs("ours", level="way")["times_released"]
    shares = [
        f"{of_released[f'training step, {net}']:.2f}"
        for net in ("autoencoder", "dissimilarity net")
    ]
    page = text_of("docs/large.md")
    assert (
        f"Ours took {shares[0]} of the released way's time for the autoencoder and {shares[1]} of "
        "it for the dissimilarity net."
    ) in page
    steps = table.loc["training step, MobileFace", "ms_per_face"]
    slower = {way: rounded(own / steps["ours"]) for way, own in steps.items()}
    said = (
        f"A step takes {slower['without oneDNN']} times as long without oneDNN, "
        f"{slower['compiled by XLA']} times when XLA compiles it, "
        f"{slower['one thread']} times with one thread "
        f"and {slower['two threads within a layer']} times with two that share each layer. "
        f"It takes {slower['images as float32']} times as long with images as float32, which fill "
        f"four times the memory, and {slower['mini-batches not ahead']} times when no mini-batches "
        "are put together ahead."
    )
    assert said in page
    together = slower["two networks, a process and a thread each"]
    said = f"Two networks in a process and with a thread each take {together} of the time"
    assert said in page


def test_what_an_installation_takes_is_what_was_measured():
    table = pd.read_csv(ROOT / "results" / "bench" / "footprint.csv")
    rows = table_of("installed with | `[dlib]` | `[mediapipe]`", "docs/photos.md")
    measured = table.set_index(["measure", "extra"])
    assert {*rows} == {*table["measure"]}
    for measure, cells in rows.items():
        for extra, cell in zip(dict.fromkeys(table["extra"]), cells, strict=True):
            own = measured.loc[(measure, extra)] if (measure, extra) in measured.index else None
            assert cell == ("–" if own is None else f"{rounded(own.value)} {own.unit}"), measure
