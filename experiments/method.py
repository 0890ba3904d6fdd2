"""One compared method, as stages, tables, figures and report know it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from operator import attrgetter
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import keras
    import numpy as np

    from experiments.inputs import Faces
    from experiments.run import Run


@dataclass(frozen=True, kw_only=True)
class Method:
    """One compared method.

    Attributes:
        id: As in `metrics.csv`.
        title: As in tables and figures.
        description: What it is, is trained on and is tested on.
        paper: Its id in `results/published/published.csv`, or None: the paper has no such row.
        tracks: Experiments in whose table it is.
        stage: Stage that writes its predictions; None if the last one knows them without a method.
        load: From a run to what has `predict`; never trains.
        train: From a run to the same, trained, where there is something to keep. It is done in the
            stage `networks`, or in its own if that is where it predicts.
        process: Of the stage `networks`: methods of one number are trained one after the other in
            one process, so that two that share a network must have the same.
        sees: What it is given of the test faces, where it sees no images.
        one_by_one: Whether each face is a fit of its own, which processes share.
        needs: Argument of a run without which it cannot be run, such as `"authors"`.
        absent: What the table says where it was not run.
        note: What a reader of the table must know, from a run and `(n,)` bool: whether the method
            found each test face. See `experiments.remarks`.
        colour, marker: Its look, the same in every figure.
        drawn: Whether the figures show it; otherwise only the tables.
        pictured: Whether it is drawn beside whole faces; some look there as their neighbour.
        mapped: Experiments that draw its error by landmark as a whole face.
        complexity: Time of a prediction in the number of landmarks n, derived from the algorithm;
            None keeps it out of the table of parameters.
        networks: From the numbers of landmarks and coefficients to untrained networks, to count.
        deep_mds: Pair features and learning-rate schedule, if it is the paper's method.
    """

    id: str
    title: str
    description: str
    paper: str | None = None
    tracks: tuple[str, ...] = ()
    stage: str | None = "predictions"
    load: Callable[[Run], object] | None = None
    train: Callable[[Run], object] | None = None
    process: int = 1
    sees: Callable[[Faces], np.ndarray] = attrgetter("views")
    one_by_one: bool = False
    needs: str | None = None
    absent: str = ""
    note: Callable[[Run, np.ndarray], str] | None = None
    colour: str = "#333333"
    marker: str = "o"
    drawn: bool = True
    pictured: bool = True
    mapped: tuple[str, ...] = ()
    complexity: str | None = None
    networks: Callable[[int, int], list[keras.Model]] | None = None
    deep_mds: tuple[str, str | None] | None = None
