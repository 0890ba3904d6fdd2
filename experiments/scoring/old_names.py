"""Ids in results that are committed, as this version calls them.

These were written when the paper's method was called `ours`. The module goes once all results are
made anew; its readers then call `pandas.read_csv`.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING, TextIO

if TYPE_CHECKING:
    import pandas as pd

_NEW = {
    "parameters-ours": "parameters-deep-mds",
    "ours_with_errors": "deep_mds_noise",
    "ours_stable": "deep_mds_cosine",
    "ours": "deep_mds",
    "authors_weights": "deep_mds_weights",
    "own_constant": "deep_mds_constant",
    "linear_upright": "ridge_roll_aligned",
    "linear": "ridge",
    "perceptron": "mlp",
    "times_limit": "times_lower_bound",
    "limit": "lower_bound",
    "stable": "cosine",
    "short_connection": "skip_connection",
    "seed_spread": "errors_by_seed",
    "spread": "sd_of",
    "anatomy": "component_ablation",
    "witness": "released_weights",
}
# Parts of longer ids too, such as `ours_over_own_constant`. The task is still called lifting, as in
# the step `lifting-hard-lifting-hard_1-seed0`.
_OLD = re.compile(rf"(?<![a-z])(?:{'|'.join(_NEW)})(?![a-z])")
_LIFTING = re.compile(r"(?<=[-_])lifting(?![a-z/])|^lifting$")
_ID = re.compile(r"[\w-]+")  # what has other characters is words for readers


def new_name(name: str) -> str:
    """An id of a method, variant, number, claim or step; others, and new ones, are as they were."""
    return _LIFTING.sub("landmark_lifter", _OLD.sub(lambda old: _NEW[old[0]], name))


def read_table(file: Path | TextIO) -> pd.DataFrame:
    """Read a table of results, with today's columns and ids."""
    import pandas as pd

    table = pd.read_csv(file).rename(columns=new_name)
    for column in table.select_dtypes(exclude="number"):
        conditions = column == "supported_if"
        table[column] = [
            new_name(cell)
            if isinstance(cell, str) and (conditions or _ID.fullmatch(cell))
            else cell
            for cell in table[column]
        ]
    return table
