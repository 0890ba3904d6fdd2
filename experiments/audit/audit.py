"""Step: collect what the audit measured, decide every claim, and compare the face models."""

from __future__ import annotations

from collections import ChainMap
from dataclasses import asdict
from pathlib import Path

import pandas as pd
from jinja2 import StrictUndefined, Template
from matplotlib.figure import Figure

from data_gen.models.registry import TITLES
from deepmds_keras.errors import InputError
from experiments.audit.claims import decide, numbers_of
from experiments.audit.poses import TRAINED
from experiments.audit.tables import Tables
from experiments.figures.errors import Panel, error_lines
from experiments.figures.style import save
from experiments.records import clear_results, write_csv, write_text
from experiments.run import Run
from experiments.scoring.numbers import power, scientific
from experiments.scoring.old_names import read_table

CLAIMS = Path(__file__).parents[2] / "results" / "published" / "claims.csv"
_DRAWN = ("mean_shape", "zhao", "aldrian", "deep_mds", "landmark_lifter")
_PAGE = Path(__file__).with_name("claims.md.j2")


def main(run: Run, *topics: str) -> dict:
    """Collect the topics, which were measured, and decide the claims."""
    files = {topic: run.work / "audit" / f"{topic}.csv" for topic in topics}
    for topic, file in files.items():
        if not file.exists():
            raise InputError(f"{file} must be there: python -m experiments audit.measure {topic}.")
    tables = {topic: pd.read_csv(file) for topic, file in files.items()}
    curves = pd.concat([tables.pop("poses"), tables.pop("noise")], ignore_index=True)
    folder = run.experiment_results("audit")
    clear_results(folder)
    for name, table in {"curves": curves, **tables}.items():
        write_csv(folder / f"{name}.csv", table)
    for name, figure in figures(curves).items():
        save(figure, folder / "figures", name, run.preset.caution)
    counts = judge(run)["verdict"].value_counts()
    print(f"\n{run.model}: {', '.join(f'{n} {verdict}' for verdict, n in counts.items())}")
    print(f"{folder}/ and, of all face models, {combine(run.shared_results)}/")
    return {"results": [folder]}


def figures(curves: pd.DataFrame) -> dict[str, Figure]:
    """Errors by pose and projection, and by noise, of `curves.csv`."""
    rows = curves[curves["method"].isin(_DRAWN)].rename(columns={"mse": "mean"}).groupby("sweep")
    poses = []
    for sweep, trained in TRAINED.items():
        label = f"{sweep.replace('_', ' ').capitalize()} (°)"
        poses.append(Panel(rows.get_group(sweep), "value", label, shaded=trained))
    noise = Panel(rows.get_group("noise_percent"), "value", "Noise (% of interocular distance)")
    return {"poses": error_lines(poses, n_columns=2), "noise": error_lines([noise])}


def judge(run: Run) -> pd.DataFrame:
    """Write `numbers.csv` and `claims.csv` of a face model, from its tables of results.

    Returns:
        The content of `claims.csv`: the verdict on each claim, and the number that decides it.
    """
    claims, by_claim = pd.read_csv(CLAIMS, dtype=str), numbers_of(Tables(run))
    known = ChainMap(*by_claim.values())
    numbers = pd.DataFrame(
        {"claim": claim, "number": name, "model": run.model, **asdict(estimate)}
        for claim, estimates in by_claim.items()
        for name, estimate in estimates.items()
    ).dropna(subset="value")
    decided = [decide(conditions, known) for conditions in claims["supported_if"]]
    claims[["model", "verdict", "number"]] = [(run.model, *decision) for decision in decided]
    claims = claims.merge(numbers.drop(columns=["claim", "model"]), on="number", how="left")
    for name, table in {"numbers": numbers, "claims": claims}.items():
        write_csv(run.experiment_results("audit") / f"{name}.csv", table)
    return claims


def combine(root: Path) -> Path:
    """Write the claims of all face models in `results`, the root: `claims.csv` and `claims.md`.

    Returns:
        The folder, `results/audit`.
    """
    claims, numbers = (
        pd.concat(read_table(f) for m in TITLES if (f := root / m / "audit" / name).exists())
        for name in ("claims.csv", "numbers.csv")
    )
    numbers["text"] = numbers.apply(text_of, axis=1)
    page = Template(_PAGE.read_text(), trim_blocks=True, undefined=StrictUndefined).render(
        titles={model: title for model, title in TITLES.items() if model in {*claims["model"]}},
        claims=claims.drop_duplicates("id").to_dict("records"),
        verdicts=claims.set_index(["id", "model"])["verdict"].to_dict(),
        numbers=numbers.astype({"n": "Int64"}).astype(object).fillna("").to_dict("records"),
        texts=numbers.set_index(["model", "number"])["text"].to_dict(),
    )
    write_csv(root / "audit" / "claims.csv", claims)
    write_text(root / "audit" / "claims.md", page)
    return root / "audit"


def text_of(row: pd.Series) -> str:
    """An estimate, row of `numbers.csv`; errors in 10⁻⁴ squared normalised units."""
    unit = 1e-4 if row["number"].endswith("_mse") and "_over_" not in row["number"] else 1.0
    ends = [row[end] / unit for end in ("value", "low", "high")]
    if row["value"] == round(row["value"]) >= 1000:
        text = f"{row['value']:,.0f}"
    elif row["high"] > row["low"]:
        text = "{} [{}, {}]".format(*(scientific(end, 3) for end in ends))
    else:
        text = scientific(ends[0])
    return text if unit == 1 else f"{text} × {power(unit)}"
