"""Write README.md, pages of docs/ and the article from templates and the results: `make docs`.

A template is the page, with `{{ … }}` where a number or table of the results belongs, `<< … >>` in
the article: `docs/templates/docs/results.md.j2` becomes `docs/results.md`. Errors are in 10⁻⁴ where
no unit is named. `{{ check(a < b) }}` stands in a sentence that says which of two errors is
smaller: pages are not written once it is no longer so.
"""

import sys
import traceback
from collections.abc import Iterable, Mapping
from functools import cache
from pathlib import Path

import numpy as np
import pandas as pd
from jinja2 import Environment, FileSystemLoader, StrictUndefined

from data_gen.models.registry import TITLES
from deepmds_keras import __version__
from deepmds_keras.errors import InputError
from deepmds_keras.files import sha256_of, write_bytes
from deepmds_keras.landmarks import DETECTOR_ERRORS
from docs.latex import Grid, in_latex
from experiments.lifting.variants import STEPS
from experiments.methods import METHODS, title
from experiments.presets import FULL
from experiments.records import read_manifest, steps_of
from experiments.scoring.numbers import NOTHING, power
from experiments.scoring.verdict import Order, orders

ROOT = Path(__file__).parents[1]
_OF_SEEDS = ("bfm68", "openhead", "ict")  # face models whose `bfm` and `seeds` have ten
_DIGITS = ("none", "one", "two", "three", "four", "five", "six", "seven", "eight", "nine", "ten")


class UntrueError(ValueError):
    """A sentence of a page is not true of the results."""


class Results:
    """Numbers of a folder of results, as the pages have them.

    Attributes:
        of_one_seed: Folders whose table has no seeds, where a page has the median of ten.
    """

    def __init__(self, folder: Path):
        self._folder = folder
        self._read = cache(lambda name: pd.read_csv(folder / name))
        self.of_one_seed: set[str] = set()

    def csv(self, *names: str) -> pd.DataFrame:
        """Tables of results, one below the other; `model` is the first folder of each."""
        read = [(name, self._read(name)) for name in names]
        return pd.concat(t if "model" in t else t.assign(model=n.split("/")[0]) for n, t in read)

    def files_read(self, *folders: str) -> pd.DataFrame:
        """External files of the manifests in folders: `name` and `sha256`, a row per content."""
        files = [
            file
            for folder in folders
            for path in (self._folder / folder).rglob("manifest.json")
            for step in steps_of(read_manifest(path.parent))
            for file in step["inputs"].items()
        ]
        return pd.DataFrame(sorted({*files}), columns=["name", "sha256"])

    def made_by(self, folder: str) -> list[dict]:
        """Records of the steps behind a folder, with the preset, processor and inputs of each."""
        return steps_of(read_manifest(self._folder / folder))

    def rows(self, folder: str) -> pd.DataFrame:
        """Mean squared errors of a folder's table, by method."""
        rows = self.csv(f"{folder}/table.csv").query("metric == 'mse'").set_index("method")
        if folder.removesuffix("/bfm") in _OF_SEEDS and "median" not in rows:
            self.of_one_seed.add(folder)
        return rows

    def error(self, folder: str, method: str) -> float:
        """The error of a method: the median over seeds, or that of its only training."""
        row = self.rows(folder).loc[method]
        return row["mean"] if pd.isna(row.get("median")) else row["median"]

    def mse(self, folder: str, method: str, form: str = ".2f") -> str:
        """`error`, as text."""
        return f"{self.error(folder, method) / 1e-4:{form}}"

    def by_seed(self, model: str) -> pd.DataFrame:
        """Deep-MDS of every seed: a row a seed, a column a metric."""
        rows = self.csv(f"{model}/seeds/metrics.csv").query("method == 'deep_mds'")
        return rows.pivot_table("value", "seed", "metric")

    def seeds_before_aldrian(self) -> dict[str, float]:
        """Share of the seeds of Deep-MDS that beat the authors' fit of Aldrian & Smith."""
        bound = {model: self.error(f"{model}/bfm", "aldrian_authors") for model in _OF_SEEDS}
        return {model: (self.by_seed(model)["mse"] < bound[model]).mean() for model in _OF_SEEDS}

    def autoencoder_corr(self, model: str) -> float:
        """Correlation over seeds of the autoencoder's error and that of the shapes."""
        seeds = self.by_seed(model)
        return seeds["mse"].corr(seeds["autoencoder_mse_inference"])

    def audit(
        self, model: str, name: str, form: str = ".2f", *, unit: float = 1.0, interval: bool = False
    ) -> str:
        """A number of the audit, with its 95 % interval if wanted."""
        row = self.csv(f"{model}/audit/numbers.csv").set_index("number").loc[name]
        value, low, high = (f"{row[key] / unit:{form}}" for key in ("value", "low", "high"))
        return f"{value} [{low}, {high}]" if interval else value

    def orders(self, columns: Mapping[str, str]) -> Grid:
        """Whether the paper's order of methods is found in folders, by their heads."""
        found = {head: orders(self.rows(folder)) for head, folder in columns.items()}
        protocols = [order.protocol for order in next(iter(found.values()))]
        rows = [["The paper's order", *protocols]]
        return grid(rows + [[head, *(o.verdict for o in of)] for head, of in found.items()])

    def pairs(self, *folders: str, **instead: str) -> str:
        """How many pairs stand in the paper's order by its authors' protocol, in folders.

        Args:
            folders: Of tables of one training.
            instead: Ids of methods by the id of the method whose place they take.
        """
        found = []
        for folder in folders:
            rows = self.rows(folder).copy()
            for method, other in instead.items():
                rows.loc[method, "mean"] = rows.loc[other, "mean"]
            found.append(orders(rows)[0])
        return _pairs(found)

    def answers(self, columns: Mapping[str, str], tables: Mapping[str, str]) -> Grid:
        """Whether the paper's tables are found again: Deep-MDS, and in brackets the mean shape.

        Args:
            columns: Face models by their heads.
            tables: Folders of a face model's results by names of tables; not each model has each.
        """
        rows, heads = [], []
        for name, table in tables.items():
            folders = [f"{model}/{table}" for model in columns.values()]
            known = [f for f in folders if (self._folder / f / "table.csv").exists()]
            cells = [self._beside_mean_shape(f) if f in known else NOTHING for f in folders]
            paper = self.rows(known[0]).loc["deep_mds"]["paper_mean"] / 1e-4
            found = [*zip(*(orders(self.rows(folder)) for folder in known), strict=True)]
            heads = [f"order {of[0].protocol}" for of in found]
            rows.append([name, f"{paper:g}", *cells, *map(_pairs, found)])
        return grid([["MSE, in 10⁻⁴", "paper", *columns, *heads], *rows])

    def _beside_mean_shape(self, folder: str) -> str:
        ours, mean = (self.error(folder, method) / 1e-4 for method in ("deep_mds", "mean_shape"))
        return f"{_significant(ours)} ({_significant(mean)})"

    def verdicts(self, verdict: str, protocol: str = "faithful") -> list[str]:
        """Ids of the claims that have a verdict on all face models, in order."""
        claims = self.csv("audit/claims.csv")
        found = claims[claims["protocol"] == protocol].groupby("id")["verdict"].unique()
        return sorted(found.index[[[*each] == [verdict] for each in found]])

    def errors(
        self, unit: float, paper: str, columns: Mapping[str, str], methods: Iterable[str]
    ) -> Grid:
        """The paper's errors next to ours, a row a method, a column a folder (by its head)."""
        tables = [self.rows(folder).reindex(methods) for folder in columns.values()]
        rows = [[f"MSE, in {power(unit)}", paper, *columns]]
        for method in methods:
            known = [table.loc[method] for table in tables]
            if any(pd.notna(row["mean"]) for row in known):
                quoted = f"{known[0]['paper_mean'] / unit:g}".replace("nan", NOTHING)
                rows.append([title(method), quoted, *(_error(row, unit) for row in known)])
        return grid(rows)


def pivot(
    table: pd.DataFrame, corner: str, columns: Mapping, by: list[str], *,
    value: str = "mse", row: str = "method", unit: float = 1.0, names: Mapping | None = None,
) -> Grid:  # fmt: skip
    """Numbers (`value`) of a table of results by its columns `row` and `by`, in a unit.

    Args:
        corner, columns: Head of the first column, and of the others by the values of `by`.
        names: Of the rows, in order; None are the titles of methods.
    """
    numbers = table.pivot_table(value, row, by)[[*columns]].dropna(how="all") / unit
    texts = numbers.map(_significant, digits=3)
    names = names or {method: title(method) for method in METHODS}
    rows = [[names[key], *texts.loc[key]] for key in names if key in texts.index]
    return grid([[corner, *columns.values()], *rows])


def grid(rows: Iterable[Iterable[object]]) -> Grid:
    """A table in Markdown, the first row its head."""
    head, *below = rows = [[str(cell) for cell in row] for row in rows]
    lines = (head, ["---"] * len(head), *below)
    table = Grid("\n".join(f"| {' | '.join(line)} |" for line in lines))
    table.rows = rows
    return table


def check(holds: bool) -> str:
    """Nothing.

    Raises:
        UntrueError: What a sentence says does not hold.
    """
    if not holds:
        raise UntrueError
    return ""


def words(share: str | float) -> str:
    """How many of ten a share is."""
    return _DIGITS[round(10 * float(share))]


def two(value: float) -> str:
    """Two significant digits."""
    return f"{float(f'{value:.2g}'):,g}"


def span(values: pd.Series) -> str:
    """The range of numbers, or the one that they all are."""
    return " to ".join(dict.fromkeys(f"{value:.2f}" for value in (values.min(), values.max())))


def _significant(value: float, digits: int = 2) -> str:
    """So many significant digits, zeros included."""
    if pd.isna(value):
        return NOTHING
    if value < 1e-6 or value >= 10**digits - 0.5:
        return f"{value:,.0f}"
    if value < 1e-3:
        return np.format_float_positional(value, precision=1, unique=False, fractional=False)
    return f"{value:#.{digits}g}".rstrip(".")


def _pairs(orders: Iterable[Order]) -> str:
    """How many pairs of methods stand in the paper's order, on each face model."""
    return ", ".join(f"{order.same}/{order.pairs}" for order in orders)


def _error(row: pd.Series, unit: float) -> str:
    """An error; of several seeds their median and range."""
    if row.get("n_seeds", 0) > 1:
        ends = row[["median", "lowest", "highest"]] / unit
        return "{} ({} to {})".format(*map(_significant, ends))
    return _significant(row["mean"] / unit)


def pages(results: Results) -> dict[str, str]:
    """Text of every page that has a template, by its path.

    Raises:
        UntrueError: A sentence does not hold.
    """
    environment = Environment(
        loader=FileSystemLoader(ROOT / "docs" / "templates"), undefined=StrictUndefined,
        keep_trailing_newline=True, trim_blocks=True,
    )  # fmt: skip
    public = [name for name in dir(results) if not name.startswith("_")]
    environment.globals |= {name: getattr(results, name) for name in public}
    functions = check, pivot, span, two, words
    environment.globals |= {function.__name__: function for function in functions}
    environment.globals |= {
        "title": title,
        "models": TITLES,
        "steps": STEPS,
        "preset": FULL,
        "version": __version__,
        "detectors_sha256": sha256_of([DETECTOR_ERRORS]),
    }
    article = in_latex(environment)
    texts = {}
    for name in environment.list_templates():
        kind = article if name.endswith(".tex.j2") else environment
        texts[name.removesuffix(".j2")] = kind.get_template(name).render()
    return texts


def main() -> None:
    results = Results(ROOT / "results")
    try:
        written = pages(results)
    except UntrueError as error:
        frames = traceback.extract_tb(error.__traceback__)
        place = next(frame for frame in frames if frame.filename.endswith(".j2"))
        sys.exit(
            f"error: {place.filename}:{place.lineno} must be true of results/. It is not: "
            f"{place.line}"
        )
    except (KeyError, FileNotFoundError, InputError) as error:
        missing = str(error).removesuffix(".")
        sys.exit(f"error: results/ must be those of make all-results. Missing: {missing}.")
    for place, text in written.items():
        write_bytes(ROOT / place, text.encode())
        print(place)
    for folder in sorted(results.of_one_seed):
        print(
            f"note: results/{folder} has one seed. The pages now have its error instead of "
            "the median over ten seeds (make reproduce-bfm SEEDS=10)."
        )


if __name__ == "__main__":
    main()
