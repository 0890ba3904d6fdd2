"""The tables of README and docs, and the main numbers of their text, are the committed results."""

import itertools
from functools import partial

import pandas as pd
import pytest
from documents import errors_of, results, table_of, text_of
from places import ROOT

from experiments.face_models import TITLES
from experiments.lifting.anatomy import STEPS
from experiments.lifting.views import CONDITIONS
from experiments.methods import METHODS, title

MODELS = ("openhead", "ict")
PAIRS = [*itertools.product(MODELS, repeat=2)]
SURREY = [(faces, "surrey") for faces in (*MODELS, "both")]
RESULTS, LIFTING = "docs/results.md", "docs/lifting.md"
# Conditions of hard views that the documents show.
SHOWN = [condition.id for condition in CONDITIONS]


def two(value):
    """Two significant digits."""
    return f"{float(f'{value:.2g}'):,g}"


def cells_of(values, form="{:.3g}"):
    """A row of a table; – where there is no number."""
    return ["–" if pd.isna(value) else form.format(value) for value in values]


# Tables


@pytest.mark.parametrize(
    ("head", "unit", "folders"),
    [
        ("MSE, in 10⁻⁴", 1e-4, ["ict/bfm", "openhead/bfm"]),
        ("MSE, in 10⁻³", 1e-3, [f"{m}/flame{s}" for m in MODELS for s in ("", "-true-landmarks")]),
        ("MSE, in 10⁻⁵", 1e-5, [f"{m}/celeba{s}" for m in MODELS for s in ("", "-true-landmarks")]),
    ],
)
def test_tables_of_errors(head, unit, folders):
    rows = table_of(RESULTS, head)
    ids = {method.title: method.id for method in METHODS.values()}
    assert {"Deep-MDS", "Deep-MDS, cosine schedule", "Mean shape", "Linear"} <= {*rows} <= {*ids}
    for column, folder in enumerate(folders, start=1):
        errors = errors_of(folder)
        for name, cells in rows.items():
            if ids[name] not in errors.index:
                assert cells[column] == "–", (name, folder)
                continue
            own = errors.loc[ids[name]]
            (shown,) = cells_of([own["mean"] / unit], "{:.2g}")
            if own.get("n_seeds", 0) > 1:
                shown = "{:.2g} ({:.2g} to {:.2g})".format(
                    *own[["median", "lowest", "highest"]] / unit
                )
            assert cells[column] == shown, (name, folder)
            assert cells[0] == cells_of([own["paper_mean"] / unit], "{:g}")[0], name


def test_the_readme_and_the_results_have_one_main_table():
    head = "MSE, in 10⁻⁴"
    assert table_of("README.md", head) == table_of(RESULTS, head)


@pytest.mark.parametrize(("model", "head"), [("openhead", "open head"), ("ict", "ICT")])
def test_table_of_hard_views(model, head):
    rows = table_of(LIFTING, head)
    mse = 1e6 * errors_of(f"{model}/lifting/hard").set_index("condition", append=True)["mean"]
    table = mse.unstack()[SHOWN].rename(index=title)
    assert {*rows} == {*table.index}
    for method, errors in table.iterrows():
        assert rows[method] == cells_of(errors), method


def test_tables_of_the_anatomy_and_of_transfer():
    head = "MSE in 10⁻⁶, non-metric MDS"
    paths = [ROOT / "results" / model / "lifting/anatomy/table.csv" for model in MODELS]
    anatomy = [pd.read_csv(path) for path in paths if path.exists()]
    assert (head in text_of(LIFTING)) == bool(anatomy)
    rows = table_of(LIFTING, head) if anatomy else {}
    assert {*rows} == ({*STEPS.values()} if anatomy else set())
    for step, name in STEPS.items() if anatomy else ():
        parts = [t[(t["step"] == step) & (t["embedding"] != "metric")] for t in anatomy]
        values = [1e6 * part["mse"].item() for part in parts]
        assert rows[name] == ["0" if value < 1e-6 else f"{value:.3g}" for value in values], step
    for head, pairs in (
        ("MSE in 10⁻⁵, errors of 1 mm", PAIRS),
        ("Surrey faces, MSE in 10⁻⁵, errors of 1 mm", SURREY),
    ):
        rows, errors = table_of(LIFTING, head), transfer(pairs).dropna()
        assert {*rows} == {*map(title, errors.index)}
        for method, cells in errors.iterrows():
            assert rows[title(method)] == cells_of(1e5 * cells), method


def transfer(pairs=None):
    """Errors with noise of 1 mm: methods by model of training and of test."""
    table = pd.concat(results(f"{m}/lifting/transfer/table.csv") for m in MODELS)
    rows = table[table["noise_mm"] == 1]
    return rows.pivot(index="method", columns=["trained", "tested"], values="mse")[pairs or PAIRS]


def test_table_of_the_shipped_weights():
    mse = pretrained()["mse"].loc["ibug51"].unstack("method") / 1e-5
    rows = table_of("docs/photos.md", "51 landmarks, MSE in 10⁻⁵")
    assert {*rows} == {*map(title, mse)}
    views = [*itertools.product(MODELS, ("exact", "dlib", "mediapipe"))]
    for method, errors in mse.items():
        assert rows[title(method)] == cells_of(errors[views]), method


def pretrained():
    table = results("openhead/pretrained/table.csv")
    return table.set_index(["scheme", "faces", "views", "method"])


def test_table_of_meshes():
    table = results("openhead/surface/table.csv").set_index(["faces", "landmarks"])
    lines = [[TITLES[f], k, *map("{:.2f}".format, row)] for (f, k), row in table.iterrows()]
    page = text_of("docs/mesh.md")
    assert len(lines) == 8 and all(f"| {' | '.join(line)} |" in page for line in lines)


def test_tables_of_times_and_of_an_installation():
    parts = bench("parts").pivot(index="part", columns="way", values="ms_per_face")
    rows = table_of(RESULTS, "ms per face, on one core")
    assert {*rows} == {part.capitalize() for part in parts.index}
    for part, ms in parts.iterrows():
        sklearn, batched = ms[["sklearn", "batched"]].fillna(ms["ours"])
        ratio = f"{two(ms['released'] / batched)} times"
        assert rows[part.capitalize()] == [*map(two, (ms["released"], sklearn, batched)), ratio]
    rows = table_of("docs/photos.md", "installed with | `[dlib]` | `[mediapipe]`")
    for measure, taken in results("bench/footprint.csv").groupby("measure"):
        taken = taken.set_index("extra")
        shown = [f"{two(taken.value[x])} {taken.unit[x]}" for x in ("dlib", "mediapipe")]
        assert rows.pop(measure) == shown, measure
    assert not rows


def bench(comparison):
    table = results("bench/bench.csv")
    return table[table["comparison"] == comparison]


# Numbers of the text


def spread(model):
    """Errors of Deep-MDS over ten seeds, in 10⁻⁴: median, lowest, highest."""
    rows = results(f"{model}/seeds/metrics.csv").query("metric == 'mse' and method == 'ours'")
    errors = rows["value"] / 1e-4
    assert len(errors) == 10
    return errors.median(), errors.min(), errors.max()


def constant(model):
    """Errors in 10⁻⁴ of the mean shape, the median over seeds, and of ridge regression."""
    mse = errors_of(f"{model}/bfm")[["median", "mean"]] / 1e-4
    return mse.loc["mean_shape", "median"], mse.loc["linear", "mean"]


def of_deep_mds(model):
    """The same in that of Deep-MDS."""
    return [error / spread(model)[0] for error in constant(model)]


def audited(*names):
    """Numbers of the audit on the open head and ICT faces, each with its interval."""
    tables = [results(f"{model}/audit/numbers.csv").set_index("number") for model in MODELS]
    return [x for n in names for t in tables for x in t.loc[n, ["value", "low", "high"]]]


def seeds_below(number):
    """How many of ten seeds a share of the audit is, in words, on ICT faces and the open head."""
    words = ["none", "one", "two", "three", "four", "five", "six", "seven", "eight", "nine", "ten"]
    share, _, _, share_ict, *_ = audited(number)
    return [words[round(10 * x)] for x in (share_ict, share)]


def lifting_times():
    """µs and ms for a face, and how many times as long Deep-MDS takes."""
    batch, alone = (bench(c).query("way == 'lifting'").iloc[0] for c in ("parts", "one face"))
    slower = [row[f"times_{s}"] for s in ("batched", "sklearn") for row in (batch, alone)]
    return [two(value) for value in (1e3 * batch.ms_per_face, alone.ms_per_face, *slower)]


def at_the_limit(model):
    rows = results(f"{model}/lifting/hard/table.csv").set_index(["method", "metric", "condition"])
    return [rows.loc[("lifting", "times_limit", "hard_1"), "mean"]]


def shares_of_mean_shape():
    """Errors of lifting and ridge regression, on the model of training and on the other."""
    shares = transfer() / transfer().loc["mean_shape"]
    return shares.loc[["lifting", "linear"], [PAIRS[k] for k in (0, 3, 1, 2)]].to_numpy().ravel()


def streamed():
    table = results("openhead/stream/table.csv").set_index(["method", "metric"])
    assert (table["n_faces"] == 1_000_000).all()
    return table.loc[("ours", "mse"), ["mean", "standard_error"]] / 1e-4


MINI_BATCHES = [f"same_face_over_shuffled_{name}" for name in ("mse", "loss_inference")]
# Page, what it says, and the numbers.
TEXTS = [
    ("README.md", "a median of {:.2f} × 10⁻⁴ ({:.2f} to {:.2f})", lambda: spread("openhead")),
    ("README.md", "an Intel processor, have a median of {:.2f} ({:.2f} to {:.2f})",
     lambda: spread("intel/openhead")),
    ("README.md", "whatever the view, has {:.2f}. Ridge regression has {:.2f}.",
     lambda: constant("openhead")),
    ("README.md", "On ICT faces these are {:.2f} ({:.2f} to {:.2f}), {:.2f} and {:.2f}.",
     lambda: [*spread("ict"), *constant("ict")]),
    *(("README.md", "{:.2f} times the (approximate) lower bound", partial(at_the_limit, model))
      for model in MODELS),
    ("README.md", "{} µs per face in a batch of 1,000 and {} ms for one alone. Deep-MDS takes {} "
     "and {} times as long with the batched solver, {} and {} times", lifting_times),
    (RESULTS, "only {:.2f} of that error on ICT faces and {:.2f} on the open head.",
     lambda: [of_deep_mds(model)[0] for model in ("ict", "openhead")]),
    (RESULTS, "Ridge regression has {:.2f} and {:.2f}.",
     lambda: [of_deep_mds(model)[1] for model in ("ict", "openhead")]),
    (RESULTS, "{} of the ten on ICT faces, and {} on the open head, have less error than the",
     lambda: seeds_below("seeds_below_aldrian_authors")),
    (RESULTS, "{}, and {}, have less than the shape that Deep-MDS makes",
     lambda: seeds_below("seeds_below_own_constant")),
    (RESULTS, "Lifting recovers {:.2f} of it, on ICT faces {:.2f}.",
     lambda: audited("recovered_lifting")[::3]),
    (RESULTS, "have {:.2f} [{:.2f}, {:.2f}] times the error of shuffled ones, on ICT faces {:.2f} "
     "[{:.2f}, {:.2f}]. The loss in use is {:.2f} [{:.2f}, {:.2f}] and {:.2f} [{:.2f}, {:.2f}]",
     lambda: audited(*MINI_BATCHES)),
    (RESULTS, "it has {:.1f} times the error of the mean shape, on ICT faces {:.1f} times",
     lambda: audited("noisy_ours_over_mean_shape")[::3]),
    (RESULTS, "{:.3f} ± {:.1g} × 10⁻⁴; that is the standard error", streamed),
    (LIFTING, "lifting has {:.2f} (open head) and {:.2f} (ICT) of the error of the mean shape, on "
     "those of the other {:.2f} and {:.2f}. Ridge regression has {:.2f} and {:.2f}, and {:.2f} "
     "and {:.2f}.", shares_of_mean_shape),
]  # fmt: skip


@pytest.mark.parametrize(("page", "said", "numbers"), TEXTS, ids=[said for _, said, _ in TEXTS])
def test_numbers_of_the_text(page, said, numbers):
    assert said.format(*numbers()).lower() in text_of(page).lower()


def test_one_claim_of_17_is_supported():
    claims = results("audit/claims.csv").drop_duplicates(["id", "model"])
    supported = claims[claims["verdict"] == "supported"]
    assert {*supported["id"]} == {"autoencoder-needed"} and {*supported["model"]} == {*MODELS}
    assert claims["id"].nunique() == 17 and "Of 17 claims of the paper one" in text_of("README.md")
