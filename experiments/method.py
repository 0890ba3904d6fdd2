"""One compared method, as used by steps, tables, figures and report."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import keras
    import numpy as np

    from experiments.run import Run


@dataclass(frozen=True, kw_only=True)
class Method:
    """One row of the tables.

    Attributes:
        id: As in `metrics.csv`.
        title: Title in tables and figures.
        description: What it is, what it is trained on, and what it is tested on.
        paper: Its id in `results/published/published.csv`; None if the paper has no such row.
        tracks: Experiments whose tables include it.
        inputs: What it sees of a test face: `"views"`, `"frontal views"` or `"images"`, renders or
            photos. One that sees images is trained on images of the track's training faces.
        image_size: Side of the square around a face that it sees, pixels; None takes images as
            they are.
        build: Function of a run that returns the estimator: untrained, or ready if there is no
            `data`.
        data: Function of a run that returns the arguments of the estimator's `fit`. Without a
            `checkpoint` it is fitted whenever it is loaded, which takes seconds.
        checkpoint: Function of a run that returns the file, or folder, of the training, complete or
            not. That of a method that sees images is alone in its folder.
        restore: Function of a run, the untrained estimator and the checkpoint that returns the
            trained one; None uses its `restore`.
        after: Method that must be trained before this one is trained or, without a training of its
            own, predicts with the other's networks.
        switch: Variable of `make` that leaves it out with `no`.
        authors: Files of the authors' release that it needs, by track; they come with `AUTHORS=`.
        of_model: Face model without which it is left out.
        reads_model: Whether `build` reads the face model.
        onednn: Whether it uses oneDNN's convolutions: a training step then takes three quarters of
            the time.
        threads: TensorFlow's threads; None leaves them as they are in every step.
        memory_mb: Memory for its training or prediction, with some to spare.
        one_by_one: Whether each face is a separate fit.
        over_seeds: Whether it is trained from several seeds.
        note: Function of a run and `(n,)` bool, whether the method found each test face, that
            returns what a reader of the table must know.
        colour, marker, dashes: Its look, the same in every figure.
        drawn: Whether the figures show it; otherwise only the tables.
        pictured: Whether it is in the figure of whole faces; others are in a second one.
        gallery: Whether it is in the figure of photos with FLAME's landmarks.
        mapped: Experiments that draw its error by landmark as a whole face.
        complexity: Time of a prediction in the number of landmarks n, derived from the algorithm;
            None keeps it out of the table of parameters.
        fair: Of a row that repeats what the authors did, the row of the same method by its own
            paper, scored as all others.
        networks: Function of the numbers of landmarks and coefficients that returns untrained
            networks, for counting.
        deep_mds: Pair features and learning-rate schedule, if it is the paper's method.
    """

    id: str
    title: str
    description: str
    paper: str | None = None
    tracks: tuple[str, ...] = ()
    inputs: str = "views"
    image_size: int | None = None
    build: Callable[[Run], object] | None = None
    data: Callable[[Run], tuple] | None = None
    checkpoint: Callable[[Run], Path] | None = None
    restore: Callable[[Run, object, Path], object] | None = None
    after: str | None = None
    switch: str | None = None
    authors: Mapping[str, tuple[str, ...]] | None = None
    of_model: str | None = None
    reads_model: bool = False
    onednn: bool = False
    threads: int | None = None
    memory_mb: int = 2000
    one_by_one: bool = False
    over_seeds: bool = False
    note: Callable[[Run, np.ndarray], str] | None = None
    colour: str = "#333333"
    marker: str = "o"
    dashes: str | tuple = "-"
    drawn: bool = True
    pictured: bool = True
    gallery: bool = False
    mapped: tuple[str, ...] = ()
    complexity: str | None = None
    fair: str | None = None
    networks: Callable[[int, int], list[keras.Model]] | None = None
    deep_mds: tuple[str, str | None] | None = None

    @property
    def trained(self) -> str | None:
        """Method whose networks it uses, perhaps itself; None if nothing takes long to train."""
        if self.checkpoint is None:
            return None
        return self.after if self.data is None else self.id

    @property
    def sees_images(self) -> bool:
        return self.inputs == "images"

    @property
    def absent(self) -> str:
        """Note in the table if it was not run."""
        if self.authors and self.of_model:
            return f"needs their weight files (AUTHORS=folder) and MODEL={self.of_model}"
        if self.authors:
            return "their weight files were not given (AUTHORS=folder)"
        return f"left out ({self.switch}=no), or not run yet" if self.switch else ""
