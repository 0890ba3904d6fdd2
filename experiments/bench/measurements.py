"""Ways to do a part of the method, timed in turn, and the table of what was measured."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd

from experiments.bench.memory import NO_GAUGE, peak_memory_mb
from experiments.timing import seconds_in_turns

# The ways with which others are compared.
RELEASED, SKLEARN, BATCHED = BASELINES = "released", "sklearn", "batched"
RATIOS = tuple(f"times_{baseline}" for baseline in BASELINES)
COLUMNS = (
    "comparison", "part", "way", "n_landmarks", "n_faces", "jobs", "seconds", "ms_per_face",
    *RATIOS, "peak_memory_mb", "note",
)  # fmt: skip
SEVERAL_JOBS = "the released way has one process; memory of other processes is not counted"
NO_MEMORY = "in processes of its own, whose memory is not counted"
_LONG = 5.0  # seconds from which a way is timed once
_LONGEST = 300.0  # seconds beyond which, to judge by a smaller row, a way is not timed
_SAME = ["part", "n_landmarks", "jobs"]


@dataclass(frozen=True)
class Implementation:
    """A way to do a part of the method.

    Attributes:
        part: What is done.
        name: How, such as `RELEASED`.
        call: Does it for all the faces; None if it cannot be done, and `note` says why.
        n_landmarks, n_faces, jobs: Size of the task and number of processes.
        note: What a reader of the numbers must know.
    """

    part: str
    name: str
    call: Callable[[], object] | None
    n_landmarks: int
    n_faces: int
    jobs: int = 1
    note: str = ""


def measure(
    comparison: str, ways: Sequence[Implementation], passes: int, before: Iterable[dict] = ()
) -> list[dict]:
    """Time ways that are compared with each other: a row for each.

    All are run once, which warms up and tells the memory; then in turn, so that what else the
    machine does meets all of them. The time is the median of these later passes. A way that takes
    long is not run again.

    Args:
        comparison: Which rows are compared with each other.
        ways: In the order of the rows.
        passes: After the first; with none the time is the first one's.
        before: Rows that may show that a way would take too long.
    """
    estimates = [_estimate(way, before) for way in ways]
    timed = [
        way.call is not None and not estimate > _LONGEST
        for way, estimate in zip(ways, estimates, strict=True)
    ]
    first = [
        _first_pass(way.call) if run else (math.nan,) * 2
        for way, run in zip(ways, timed, strict=True)
    ]
    seconds = [own for own, _ in first]
    again = [k for k, (own, _) in enumerate(first) if passes and own < _LONG]
    if again:
        taken = seconds_in_turns([ways[k].call for k in again], passes)
        for k, median in zip(again, np.median(taken, axis=0), strict=True):
            seconds[k] = median
    rows = []
    for k, way in enumerate(ways):
        memory = first[k][1]
        notes = [way.note]
        if way.call is not None and not timed[k]:
            notes.append(f"not run: about {estimates[k] / 60:.0f} min, by the row of fewer faces")
        elif timed[k] and math.isnan(memory):
            notes.append(NO_GAUGE)
        elif way.jobs > 1:
            notes.append(SEVERAL_JOBS)
        rows.append(
            {
                "comparison": comparison,
                "part": way.part,
                "way": way.name,
                "n_landmarks": way.n_landmarks,
                "n_faces": way.n_faces,
                "jobs": way.jobs,
                "seconds": float(seconds[k]),
                "peak_memory_mb": memory,
                "note": "; ".join(filter(None, notes)),
            }
        )
    return rows


def table_of(rows: Iterable[dict]) -> pd.DataFrame:
    """The rows with times of a face and how many times as fast each way is as the compared ones.

    A row is compared with that of the other way of the same part, landmarks and processes: with one
    of the same comparison and the nearest number of faces, or else of another comparison.
    """
    table = pd.DataFrame(list(rows))
    table["ms_per_face"] = 1000 * table["seconds"] / table["n_faces"]
    for baseline, column in zip(BASELINES, RATIOS, strict=True):
        table[column] = [_times(table, row, baseline) for _, row in table.iterrows()]
    table["peak_memory_mb"] = table["peak_memory_mb"].round(1)
    return table[list(COLUMNS)]


def _times(table, row, baseline):
    other = table[(table["way"] == baseline) & table["seconds"].notna()]
    other = other[(other[_SAME] == row[_SAME]).all(axis=1)]
    if not len(other) or math.isnan(row["seconds"]):
        return math.nan
    elsewhere = (other["comparison"] != row["comparison"]).to_numpy()
    distance = np.abs(np.log(other["n_faces"] / row["n_faces"])).to_numpy()
    nearest = other.iloc[np.lexsort([distance, elsewhere])[0]]
    return nearest["ms_per_face"] / row["ms_per_face"]


def _estimate(way: Implementation, before: Iterable[dict]) -> float:
    own = (way.part, way.name, way.n_landmarks, way.jobs)
    alike = [
        row["seconds"] * way.n_faces / row["n_faces"]
        for row in before
        if (row["part"], row["way"], row["n_landmarks"], row["jobs"]) == own
    ]
    return alike[-1] if alike else math.nan


def _first_pass(call):
    taken = []
    memory = peak_memory_mb(lambda: taken.append(seconds_in_turns([call], 1).item()))
    return taken[0], memory
