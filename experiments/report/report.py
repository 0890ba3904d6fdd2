"""Writes the report of a face model, `results/<model>/report/report.md`, from its results alone."""

import re
from collections.abc import Iterator
from dataclasses import dataclass
from numbers import Real
from pathlib import Path

import numpy as np
import pandas as pd
from jinja2 import Environment, FileSystemLoader, StrictUndefined

from data_gen.models.registry import TITLES
from deepmds_keras.errors import InputError
from experiments.methods import METHODS, title
from experiments.progress import duration
from experiments.records import commits_of, manifests, read_manifest, steps_of, write_text
from experiments.run import SCHEMES, Run
from experiments.scoring.metrics import METRICS
from experiments.scoring.numbers import NOTHING, minus, plus_minus, power, scientific
from experiments.scoring.typesetting import cells, head_of, n_landmarks, remarks

# Folder of results → title, in the report's order. Texts about folders and figures are in the
# template.
RESULTS = {
    "bfm": "The paper's BFM table",
    "bfm-evaluator-released": "BFM, authors' evaluator",
    "flame": "The paper's CASIA-3D table",
    "flame-true-landmarks": "CASIA-3D, against the true landmarks",
    "celeba": "The paper's CelebA table",
    "celeba-true-landmarks": "CelebA, against the true landmarks",
    "celeba-flame": "The paper's CelebA faces with 51 landmarks",
    "celeba-flame-substitute": "Rendered photos with 51 landmarks",
    "audit": "Claims of the paper",
    "parameters": "Parameters and time",
    "ablation": "Ablation",
    "seeds": "Seed variance",
    "scales": "Scales of the standard deviation",
    "stream": "Many faces: the tails of the errors",
    "pretrained": "The weights that ship with the package",
    "real": "Real faces by two detectors",
    "surface": "The head of `deepmds predict --mesh`",
    "lifting/hard": "Hard views, against the lower bound",
    "lifting/component-ablation": "Component ablation of Deep-MDS",
    "lifting/transfer": "Transfer between face models",
}
_MACHINE = ("platform", "processor", "python")
_LONG = 40  # rows; a longer table gets a column per metric instead of a row
# `code`, **strong** words and links are kept; other characters are escaped.
_MARKUP = re.compile(r"`[^`]+`|\*\*|\]\([^)]+\)|([\\`*_{}<>|#~]|&(?=#?\w+;))")
_NUMBER = r"[-−+<>×]? ?[\d(].*|–"


def main(run: Run) -> None:
    path = run.model_results / "report" / "report.md"
    write_text(path, report(run, load_results(run.model_results)))
    print(f"Report: {path}")


@dataclass(frozen=True, eq=False)
class Result:
    """A folder of `results/<model>` and its manifest."""

    name: str
    folder: Path
    manifest: dict

    @property
    def base(self) -> str:
        """The longest name in `RESULTS` that begins its own; a seed or the like may follow."""
        bases = [base for base in RESULTS if f"{self.name}-".startswith(f"{base}-")]
        return max(bases, key=len, default=self.name)

    @property
    def title(self) -> str:
        """Title, with settings other than the default in brackets."""
        variant = self.name[len(self.base) :].strip("-").replace("-", " ")
        name = RESULTS.get(self.base, self.name)
        return f"{name} ({variant})" if variant else name

    @property
    def steps(self) -> list[dict]:
        """Records of the steps behind it."""
        return steps_of(self.manifest)

    @property
    def track(self) -> str | None:
        """The paper's table that it is compared with, if any."""
        track = self.base.split("-")[0]
        return track if track in SCHEMES and "table.csv" in self.manifest["files"] else None


def load_results(folder: Path) -> list[Result]:
    """Results in `results/<model>` that have a manifest, in the order of `RESULTS`.

    Raises:
        InputError: There are none, or a manifest is damaged.
    """
    folders = [path.parent for path in manifests(folder)]
    if not folders:
        raise InputError(
            f"{folder} must hold results of experiments. Received none; run make reproduce-bfm "
            f"MODEL={folder.name}."
        )
    results = [Result(f.relative_to(folder).as_posix(), f, read_manifest(f)) for f in folders]
    order = {base: place for place, base in enumerate(RESULTS)}
    return sorted(results, key=lambda result: order.get(result.base, len(order)))


def report(run: Run, results: list[Result]) -> str:
    """The report of a face model's results at a preset, in GitHub's Markdown."""
    environment = Environment(
        loader=FileSystemLoader(Path(__file__).parent),
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters |= {"md": escaped, "table": markdown_table, "duration": duration}
    environment.filters |= {"commits": commits_of}
    steps = [step for result in results for step in result.steps]
    given = f"MODEL={run.model}" + f" PRESET={run.preset.name}" * (run.preset.name != "full")
    text = environment.get_template("report.md.j2").render(
        given=given,
        title=TITLES[run.model],
        results=results,
        tables=_tables,
        glance=pd.DataFrame(_glance(result) for result in results if result.track),
        steps_of=_steps,
        preset=_facts([step["preset"] for step in steps]),
        versions=_facts([{key: s[key] for key in _MACHINE} | s["packages"] for s in steps]),
    )
    return re.sub(r"\n{3,}", "\n\n", text).strip() + "\n"


def _tables(result: Result) -> Iterator[tuple[str, pd.DataFrame, list[str]]]:
    """Title, cells and remarks of the tables of a result; the first needs no title."""
    if result.track:
        table = pd.read_csv(result.folder / "table.csv")
        of = table, result.track, "terminal"
        yield "", cells(*of), remarks(*of)
        tests = pd.read_csv(result.folder / "wilcoxon.csv").query("metric == 'mse'")
        tests = tests[(tests[["method_a", "method_b"]] == "deep_mds").any(axis=1)]
        columns = ["over", "method_a", "method_b", "n", "median_difference", "p_value"]
        yield "Wilcoxon's signed-rank tests of Deep-MDS", readable(tests[columns]), []
    elif result.base == "audit":
        # That of all models first: it has both protocols, as claims.md has, of the default run.
        of_all_models = [result.folder.parents[1] / "audit"] if result.name == "audit" else []
        paths = (folder / "claims.csv" for folder in (*of_all_models, result.folder))
        if path := next(filter(Path.is_file, paths), None):
            claims = pd.read_csv(path)
            claims = claims[claims["model"] == result.folder.parent.name]
            yield "", readable(claims.drop(columns=["id", "model"])), []
    elif "table.csv" in result.manifest["files"]:
        yield "", readable(pd.read_csv(result.folder / "table.csv")), []


def _glance(result: Result) -> dict[str, str]:
    """Error of the paper's method, and of two simpler ones, in an experiment."""
    table = pd.read_csv(result.folder / "table.csv")
    head = head_of(METRICS["mse"], result.track, n_landmarks(table))
    errors = cells(table, result.track, "terminal")[head].T.to_dict()
    row = {"Experiment": f"[{result.title}](#{result.name})", "Error": head}
    for method, column in (("deep_mds", "paper"), ("deep_mds", "here"), ("deep_mds", "seeds"),
                           ("mean_shape", "here"), ("ridge", "here")):  # fmt: skip
        row[f"{title(method)}: {column}"] = errors.get(title(method), {}).get(column, NOTHING)
    return row


def _steps(result: Result) -> pd.DataFrame:
    """Time, memory and commit of the steps behind a result, and counts of scans and photos."""
    return pd.DataFrame(
        {
            "Step": step["step"],
            "Took": duration(step["seconds"]),
            "Memory of a process (MB)": _text(step["peak_memory_mb"]),
            "Commit": step["commit"] or "unknown",
            "Scans or photos": "; ".join(
                f"{status}: {n:,}"
                for kind in ("scans", "photos")
                for status, n in step.get(kind, {}).items()
            ),
        }
        for step in result.steps
    )


def _facts(records: list[dict]) -> pd.DataFrame:
    """Names and values of records; several values where they differ."""
    names = dict.fromkeys(name for record in records for name in record)
    values = {n: dict.fromkeys(_text(r[n]) for r in records if r.get(n, "") != "") for n in names}
    rows = [(_head(name), "; ".join(texts)) for name, texts in values.items() if texts]
    return pd.DataFrame(rows, columns=["Name", "Value"])


def readable(table: pd.DataFrame) -> pd.DataFrame:
    """Cells of a table of names and numbers; a long one gets a column per metric."""
    if len(table) > _LONG and {"metric", "mean"} <= {*table}:
        table = _by_metric(table)
    return table.convert_dtypes().map(_text).rename(columns=_head)


def _by_metric(table: pd.DataFrame) -> pd.DataFrame:
    """Mean ± s.d. or standard error of each metric; the columns to the left of it name a row."""
    keys = [*table.columns[: table.columns.get_loc("metric")]]
    sd = table["standard_error" if "standard_error" in table else "std"]
    typical = table["mean"].abs().groupby(table["metric"]).transform("median")
    small = (typical > 0) & (typical < 0.01)
    units = 10.0 ** np.floor(np.log10(typical.where(small, 1.0)))
    heads = map(_head, table["metric"])
    table = table[keys].assign(
        head=[f"{h} ({power(u)})" if u < 1 else h for h, u in zip(heads, units, strict=True)],
        text=[*map(plus_minus, table["mean"], sd, units)],
    )
    rows, columns = table[keys].drop_duplicates(), table["head"].unique()
    wide = table.pivot(index=keys, columns="head", values="text")[columns].rename_axis(columns=None)
    return rows.merge(wide, left_on=keys, right_index=True)


def _head(name: str) -> str:
    """Name of a column, metric or entry for readers."""
    return METRICS[name].head if name in METRICS else name.replace("_", " ")


def _text(value: object) -> str:
    """Text of a cell: methods and metrics by their titles, numbers to four digits."""
    if isinstance(value, list):
        return ", ".join(map(_text, value))
    if pd.isna(value) or value == "":
        return NOTHING
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, Real):
        return minus(f"{value:,.0f}") if float(value).is_integer() else scientific(value)
    if value in METHODS:
        return title(value)
    return _head(value) if value.isidentifier() else value


def escaped(text: object) -> str:
    """Text that Markdown shows unchanged, except for the markup in `_MARKUP`."""
    return _MARKUP.sub(lambda mark: f"\\{mark[1]}" if mark[1] else mark[0], str(text))


def markdown_table(texts: pd.DataFrame) -> str:
    """A table in GitHub's Markdown; lower heads appear only below an upper head with several.

    A named index becomes the first column.
    """
    if texts.columns.nlevels > 1:
        groups = texts.columns.get_level_values(0).value_counts()
        texts = texts.set_axis(
            [f"{head}: {of}" if groups[head] > 1 else head for head, of in texts], axis=1
        )
    texts = texts.reset_index(drop=texts.index.name is None)
    numbers = [texts[name].str.fullmatch(_NUMBER).all() for name in texts]
    rules = ["--:" if k and number else ":--" for k, number in enumerate(numbers)]
    rows = [[*texts], rules, *texts.to_numpy().tolist()]
    # A bar would end a cell, even in code.
    lines = (" | ".join(re.sub(r"(?<!\\)\|", r"\|", escaped(c)) for c in row) for row in rows)
    return "\n".join(f"| {line} |" for line in lines)
