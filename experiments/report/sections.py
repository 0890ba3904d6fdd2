"""The report's sections, in order, as blocks."""

from __future__ import annotations

from deepmds_keras.landmarks import load_scheme
from experiments.face_models import TITLES
from experiments.figures.style import colour
from experiments.manifest import MANIFEST
from experiments.markup.blocks import (
    Block,
    Cell,
    Column,
    Faces,
    Fold,
    Heading,
    Listing,
    Paragraph,
    Picture,
    Table,
)
from experiments.markup.claim_blocks import claim_blocks
from experiments.methods import title
from experiments.report import wording
from experiments.report.experiment import REPORT, Experiment
from experiments.report.overview import (
    at_a_glance,
    environment,
    heading_of,
    not_run,
    what_was_run,
)
from experiments.report.report_tables import (
    ablation_table,
    criteria_table,
    method_cell,
    other_criteria_table,
    parameters_table,
    plain_table,
    time_cell,
    wilcoxon_table,
)
from experiments.report.summaries import summary
from experiments.scoring.numbers import duration, power, size
from experiments.verdicts import read_claims

# Of a stage's record: what tables have of their own, or nobody asks for.
_NOT_SHOWN = {"stage", "command", "started", "seconds", "peak_memory_mb", "model", "model_sha256",
              "methods", "processes_mb", "rows", "tables"}  # fmt: skip


def report(model: str, experiments: list[Experiment], elsewhere: dict[str, str]) -> list[Block]:
    """All of the report.

    Args:
        model: Face model.
        experiments: Of that model, in order.
        elsewhere: As from `overview.reports_elsewhere`.
    """
    name = TITLES[model]
    return [
        Heading(1, f"Deep-MDS in Keras: results on {name}", "top"),
        Paragraph(wording.ABOUT),
        Paragraph(
            "Every number is read from the files of the experiments, in the folders "
            f"beside `{REPORT}/`; the paper's are quoted from its tables."
        ),
        *at_a_glance(experiments),
        *what_was_run(experiments),
        *not_run(model, experiments, elsewhere),
        Heading(2, "How to read the tables", "reading"),
        Listing(wording.HOW_TO_READ),
        *(block for own in experiments for block in _section(own, experiments)),
        *environment(experiments),
    ]


def _section(experiment: Experiment, experiments: list[Experiment]) -> list[Block]:
    introduction = wording.EXPERIMENTS.get(experiment.base, ("", ""))[1]
    introduction = introduction.format_map(_grouped(experiment.manifest["preset"]))
    said = summary(experiment, experiments)
    said = f"**In short:** {said}" if said else ""
    blocks: list[Block] = [Heading(2, heading_of(experiment), experiment.name)]
    blocks += [Paragraph(text) for text in (introduction, said) if text]
    blocks += _tables(experiment)
    if examples := experiment.examples:
        blocks += _faces(experiment, examples)
    known = {name: place for place, name in enumerate(wording.FIGURES)}
    for name, path in sorted(
        experiment.figures.items(), key=lambda item: (known.get(item[0], len(known)), item[0])
    ):
        caption = wording.FIGURES.get(name, f"{name.replace('_', ' ').capitalize()}.")
        blocks.append(Picture(path, caption))
    blocks.append(Fold("Stages of this experiment", (_stages(experiment),)))
    files = [name for name in (*experiment.manifest["files"], MANIFEST) if "/" not in name]
    links = ", ".join(f"[{name}](../{experiment.name}/{name})" for name in files)
    blocks.append(Paragraph(f"Files: {links}."))
    return blocks


def _grouped(sizes: dict) -> dict[str, str]:
    """Sizes of a preset as they are read."""
    return {name: size(value) for name, value in sizes.items()}


def _tables(experiment: Experiment) -> list[Block]:
    if experiment.has("claims.csv"):
        return claim_blocks(read_claims(experiment.folder / "claims.csv"), TITLES)
    if not experiment.has("table.csv"):
        return []
    if experiment.base == "parameters":
        return [parameters_table(experiment)]
    if experiment.base == "ablation":
        return [ablation_table(experiment)]
    if not experiment.compared:
        caption = wording.TABLES.get(experiment.base, "As in `table.csv`.")
        return [plain_table(experiment, caption)]
    blocks = [criteria_table(experiment), other_criteria_table(experiment)]
    tests = wilcoxon_table(experiment)
    if tests is not None:
        blocks.append(Fold(f"Tests of {title('ours')} against the others", (tests,)))
    return blocks


def _faces(experiment: Experiment, examples: dict) -> list[Block]:
    scheme = load_scheme(examples["scheme"])
    methods = {
        method: {"title": title(method), "colour": colour(method)}
        for method in examples["faces"][0]["shapes"]
    }
    unit = experiment.mse_unit
    columns = [Column("Method", numeric=False)]
    columns += [Column(face["title"]) for face in examples["faces"]]
    rows = []
    for method in methods:
        errors = [face["mse"][method] for face in examples["faces"]]
        cells = (
            Cell("N/A") if error is None else Cell(f"{error / unit:#.3g}".rstrip("."), error)
            for error in errors
        )
        rows.append((method_cell(method), *cells))
    shown = examples | {"names": scheme.names, "numbers": scheme.numbers}
    return [
        Heading(3, "Faces to turn about", f"{experiment.name}-faces"),
        Faces(f"{experiment.name}-examples", heading_of(experiment), shown, methods),
        Table(f"MSE ({power(unit)}) of these faces. N/A: not found.", tuple(columns), tuple(rows)),
    ]


def _stages(experiment: Experiment) -> Table:
    columns = tuple(
        Column(head, numeric=numeric)
        for head, numeric in (
            ("Stage", False), ("Begun (UTC)", True), ("Took", True), ("Memory (MB)", True),
            ("Recorded", False), ("Command", False),
        )
    )  # fmt: skip
    rows = [
        (
            Cell(record["stage"]),
            time_cell(record["started"]),
            Cell(duration(record["seconds"]), record["seconds"]),
            Cell(f"{record['peak_memory_mb']:,}", record["peak_memory_mb"]),
            Cell("; ".join(_recorded(record))),
            Cell(f"`{record['command']}`"),
        )
        for record in experiment.manifest["stages"]
    ]
    return Table("Stages, in order.", columns, tuple(rows))


def _recorded(record: dict, prefix: str = "") -> list[str]:
    """What else a stage recorded, nested records flattened."""
    found = []
    for key, value in record.items():
        if not prefix and key in _NOT_SHOWN:
            continue
        name = f"{prefix}{key}".replace("_", " ")
        if isinstance(value, dict):
            found += _recorded(value, f"{name}, ")
        elif isinstance(value, list):
            found.append(f"{name}: {', '.join(map(str, value))}")
        else:
            found.append(f"{name}: {value:,}" if isinstance(value, int) else f"{name}: {value}")
    return found
