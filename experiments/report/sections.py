"""All that the report's template shows."""

from __future__ import annotations

from deepmds_keras.landmarks import load_scheme
from experiments.face_models import TITLES
from experiments.figures.style import colour
from experiments.manifest import MANIFEST
from experiments.markup.markdown import Table, markdown
from experiments.methods import METHODS, title
from experiments.metrics import METRICS
from experiments.report import method_tables, overview, report_tables, wording
from experiments.report.experiment import Experiment
from experiments.report.summaries import summary
from experiments.scoring.numbers import size
from experiments.verdicts import COLOURS, listed, read_claims, verdict_of


def report(model: str, experiments: list[Experiment], elsewhere: dict[str, str]) -> str:
    """Return the report as Markdown.

    Args:
        model: Face model.
        experiments: Of that model, in order.
        elsewhere: As from `overview.reports_elsewhere`.
    """
    return markdown(
        "report/report.md.j2",
        model=TITLES[model],
        glance=overview.at_a_glance(experiments),
        runs=overview.runs(experiments),
        sizes=overview.sizes(experiments),
        not_run=overview.not_run(model, experiments, elsewhere),
        empty_cells=overview.empty_cells(experiments),
        metrics=[metric for metric in METRICS.values() if "report" in metric.shown],
        sections=[_section(own, experiments) for own in experiments],
        environment=overview.environment(experiments),
    )


def faces(experiments: list[Experiment]) -> dict[str, dict]:
    """Return the faces that can be turned about, by the anchor of their heading."""
    found = {}
    for own in experiments:
        if examples := own.examples:
            scheme = load_scheme(examples["scheme"])
            methods = examples["faces"][0]["shapes"]
            found[f"{own.name}-faces"] = examples | {
                "title": overview.heading_of(own),
                "names": scheme.names,
                "numbers": scheme.numbers,
                "methods": {m: {"title": title(m), "colour": colour(m)} for m in methods},
            }
    return found


def colour_of(text: str) -> str | None:
    """Return the colour of a cell that names a method or a verdict, as CSS has it."""
    method = next((method.id for method in METHODS.values() if method.title == text), None)
    return colour(method) if method else COLOURS.get(verdict_of(text))


def _section(experiment: Experiment, experiments: list[Experiment]) -> dict:
    introduction = wording.EXPERIMENTS.get(experiment.base, ("", ""))[1]
    sizes = {name: size(value) for name, value in experiment.manifest["preset"].items()}
    claims = experiment.folder / "claims.csv" if experiment.has("claims.csv") else None
    compared = experiment.compared and not claims
    examples = experiment.examples
    order = [*wording.FIGURES, *experiment.figures]
    return {
        "name": experiment.name,
        "title": overview.heading_of(experiment),
        "introduction": introduction.format_map(sizes),
        "summary": summary(experiment, experiments),
        "claims": listed(read_claims(claims), TITLES) if claims else None,
        "tables": [] if claims else _tables(experiment),
        "tests": method_tables.wilcoxon_table(experiment) if compared else None,
        "n_faces": len(examples["faces"]) if examples else 0,
        "faces": method_tables.faces_table(experiment, examples) if examples else None,
        "figures": {
            name: wording.FIGURES.get(name, f"{name.replace('_', ' ').capitalize()}.")
            for name in sorted(experiment.figures, key=order.index)
        },
        "stages": report_tables.stages_table(experiment),
        "files": [name for name in (*experiment.manifest["files"], MANIFEST) if "/" not in name],
    }


def _tables(experiment: Experiment) -> list[Table]:
    if not experiment.has("table.csv"):
        return []
    if experiment.base == "parameters":
        return [report_tables.parameters_table(experiment)]
    if experiment.base == "ablation":
        return [report_tables.ablation_table(experiment)]
    if experiment.base == "lifting/hard":
        return report_tables.hard_tables(experiment)
    if experiment.base in ("lifting/anatomy", "lifting/transfer"):
        return [report_tables.study_table(experiment)]
    if not experiment.compared:
        return [report_tables.plain_table(experiment)]
    return [
        method_tables.criteria_table(experiment),
        method_tables.other_criteria_table(experiment),
    ]
