"""Step: collect what the audit measured, decide every claim, and compare the face models."""

from dataclasses import asdict, fields
from pathlib import Path

import numpy as np
import pandas as pd
from jinja2 import StrictUndefined, Template
from matplotlib.figure import Figure

from data_gen.models.registry import TITLES
from experiments.audit.claims import INDICATIVE, NOT_TESTABLE, decide, numbers_of
from experiments.audit.poses import TRAINED
from experiments.audit.tables import Tables
from experiments.figures.errors import Panel, error_lines
from experiments.figures.style import save
from experiments.records import PUBLISHED, new_results, write_csv, write_text
from experiments.run import Run
from experiments.scoring.intervals import ONE_TRAINING, Estimate
from experiments.scoring.numbers import power, scientific
from experiments.scoring.verdict import PROTOCOLS

CLAIMS = PUBLISHED / "claims.csv"
_DRAWN = ("mean_shape", "zhao", "aldrian", "deep_mds", "landmark_lifter")
_PAGE = Path(__file__).with_name("claims.md.j2")


def main(run: Run, *topics: str) -> dict:
    """Collect the topics, which were measured, and decide the claims."""
    tables = {topic: pd.read_csv(run.work / "audit" / f"{topic}.csv") for topic in topics}
    curves = pd.concat([tables.pop("poses"), tables.pop("noise")], ignore_index=True)
    folder = run.experiment_results("audit")
    new = new_results(folder)
    for name, table in {"curves": curves, **tables}.items():
        write_csv(new / f"{name}.csv", table)
    for name, figure in figures(curves).items():
        save(figure, new / "figures", name, run.preset.caution)
    numbers = numbers_table(run, new)
    write_csv(new / "numbers.csv", numbers)
    if run.preset.caution:
        print(f"No verdicts: {run.preset.caution}. Numbers and figures: {folder}/")
        return {"results": [folder]}
    write_csv(new / "claims.csv", judge(numbers, run.model))
    print(f"Claims, numbers and figures: {folder}/")
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


def numbers_table(run: Run, folder: Path) -> pd.DataFrame:
    """The content of `numbers.csv`: what is known of a face model, from its tables of results.

    Those of the audit itself are in `folder`.
    """
    return pd.DataFrame(
        {"claim": claim, "number": name, "model": run.model, **asdict(estimate)}
        for claim, estimates in numbers_of(Tables(run, folder)).items()
        for name, estimate in estimates.items()
    ).dropna(subset="value")


def judge(numbers: pd.DataFrame, model: str) -> pd.DataFrame:
    """The content of `claims.csv`: verdicts by each of `PROTOCOLS`, and the numbers that decide."""
    claims = pd.read_csv(CLAIMS, dtype=str)
    as_authors = claims.pop("supported_if_authors").fillna(claims["supported_if"])
    conditions = dict(zip(PROTOCOLS, (as_authors, claims["supported_if"]), strict=True))
    claims = pd.concat(
        claims.assign(model=model, protocol=protocol, supported_if=of_protocol)
        for protocol, of_protocol in conditions.items()
    )
    columns = ["number", *(field.name for field in fields(Estimate))]
    known = {name: Estimate(*row) for name, *row in numbers[columns].itertuples(index=False)}
    claims[["verdict", "number"]] = [decide(text, known) for text in claims["supported_if"]]
    return claims.merge(numbers[columns], on="number", how="left")


def combine(root: Path) -> Path:
    """Write the claims of all face models in `results`, the root: `claims.csv` and `claims.md`.

    Returns:
        The folder, `results/audit`.
    """
    files = {model: root / model / "audit" / "numbers.csv" for model in TITLES}
    of_models = {model: pd.read_csv(file) for model, file in files.items() if file.exists()}
    claims = pd.concat(judge(table, model) for model, table in of_models.items())
    numbers = pd.concat(of_models.values())
    numbers["text"] = numbers.apply(text_of, axis=1)
    claims["shown"] = claims["verdict"] + np.where(
        claims["of"].isin(ONE_TRAINING) & (claims["verdict"] != NOT_TESTABLE),
        f" ({INDICATIVE})",
        "",
    )
    page = Template(_PAGE.read_text(), trim_blocks=True, undefined=StrictUndefined).render(
        titles={model: title for model, title in TITLES.items() if model in {*claims["model"]}},
        protocols=PROTOCOLS,
        claims=claims.drop_duplicates("id").to_dict("records"),
        conditions=claims.set_index(["id", "protocol"])["supported_if"].to_dict(),
        verdicts=claims.set_index(["id", "model", "protocol"])["shown"].to_dict(),
        numbers=numbers.astype({"n": "Int64"}).astype(object).fillna("").to_dict("records"),
        texts=numbers.set_index(["model", "number"])["text"].to_dict(),
    )
    write_csv(root / "audit" / "claims.csv", claims.drop(columns="shown"))
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
