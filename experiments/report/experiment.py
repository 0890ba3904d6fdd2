"""An experiment's folder of results, as its manifest describes it."""

from __future__ import annotations

import json
import re
from dataclasses import dataclass
from pathlib import Path

import pandas as pd

from experiments.figures.examples import EXAMPLES
from experiments.manifest import read_manifest
from experiments.published import unit_of
from experiments.stages import RESULTS

REPORT = "report"
# Experiments in the order of the report, and the target that makes each.
COMMANDS = {result.folder: result.command for result in RESULTS}
_SHARED = {base.split("/")[0] for base in COMMANDS if "/" in base}  # by the results of a target
_OF_BFM = ("audit", "ablation", "seeds", "stream")  # on its faces


@dataclass(frozen=True, eq=False)
class Experiment:
    """One folder of `results/<model>` and its manifest."""

    folder: Path
    manifest: dict

    @property
    def name(self) -> str:
        """Of the folder, in `results/<model>`."""
        return name_of(self.folder)

    @property
    def base(self) -> str:
        """Name among `COMMANDS`; the folder's name goes on with what is not the default."""
        return base_of(self.name)

    @property
    def variant(self) -> str:
        """Rest of its folder's name after `base`: the protocol, the seed, data sets."""
        return self.name[len(self.base) :].strip("-")

    @property
    def track(self) -> str:
        """Table of the paper that it stands beside: one of `published.SOURCES`, or another."""
        return "bfm" if self.base in _OF_BFM else self.base.split("-")[0]

    def table(self, name: str = "table.csv") -> pd.DataFrame:
        return pd.read_csv(self.folder / name)

    def has(self, name: str) -> bool:
        """Whether the run wrote the file; what merely lies in the folder does not count."""
        return name in self.manifest["files"]

    @property
    def compared(self) -> bool:
        """Whether its table has the paper's numbers beside ours."""
        return self.has("metrics.csv") and self.has("table.csv") and "paper_mean" in self.table()

    @property
    def figures(self) -> list[str]:
        """Names of its pictures, in order of the alphabet."""
        return sorted(re.findall(r"(?m)^figures/(.+)\.png$", "\n".join(self.manifest["files"])))

    @property
    def examples(self) -> dict | None:
        """Faces as `examples.write_examples` wrote them, if it did."""
        if not self.has(EXAMPLES):
            return None
        return json.loads((self.folder / EXAMPLES).read_text(encoding="utf-8"))

    @property
    def mse_unit(self) -> float:
        """In which the paper prints the errors of the table that this one stands beside."""
        return unit_of(self.track, "mse")


def name_of(folder: Path) -> str:
    """Name of an experiment's folder in `results/<model>`, which may be in a folder of several."""
    shared = folder.parent.name in _SHARED
    return f"{folder.parent.name}/{folder.name}" if shared else folder.name


def base_of(name: str) -> str:
    """Name among `COMMANDS` that a folder's name begins with; of several, the longest."""
    fitting = [base for base in COMMANDS if f"{name}-".startswith(f"{base}-")]
    return max(fitting, key=len, default=name)


def result_folders(folder: Path) -> list[Path]:
    """Folders of `results/<model>` that hold experiments, in the order of the report."""
    found = [
        path
        for own in folder.glob("*")
        for path in (own.glob("*") if own.name in _SHARED else [own])
        if path.is_dir() and path.name != REPORT and any(path.iterdir())
    ]
    order = [*COMMANDS]

    def place(path: Path) -> tuple[int, str]:
        base = base_of(name_of(path))
        return (order.index(base) if base in order else len(order), path.name)

    return sorted(found, key=place)


def load_experiments(folder: Path) -> list[Experiment]:
    """Every experiment of `results/<model>`, in the order of the report.

    Raises:
        InputError: A manifest is missing or damaged.
    """
    return [Experiment(path, read_manifest(path)) for path in result_folders(folder)]
