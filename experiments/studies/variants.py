"""The method with one of its parts changed: what can be."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

from experiments.run import Run


@dataclass(frozen=True)
class Variant:
    """Difference of one training from the paper's method.

    Attributes:
        id, title: In files; in tables and figures.
        schedule: Learning rate of both networks.
        shuffled, chain: As for `train_dissimilarity_net`.
        with_autoencoder: Whether the net is given the autoencoder's frontal views, or the views as
            they are.
        faces: Training faces of both networks, the first of all; None for all, and the run's own
            autoencoder.
    """

    id: str
    title: str
    schedule: str = "constant"
    shuffled: bool = False
    chain: tuple[int, int] | None = None
    with_autoencoder: bool = True
    faces: int | None = None

    def file(self, run: Run, seed: int, kind: str = "json") -> Path:
        """Of its scores, or (`"npz"`) of its dissimilarity net."""
        faces = "" if self.faces is None else f"-{self.faces}"
        return run.work / "ablation" / f"{self.id}{faces}-seed{seed}.{kind}"


VARIANTS = (
    Variant("same_face", "The paper's method: mini-batches of one face"),
    Variant("shuffled", "Shuffled mini-batches", shuffled=True),
    Variant("same_face_stable", "Mini-batches of one face, cosine schedule", "cosine"),
    Variant("shuffled_stable", "Shuffled mini-batches, cosine schedule", "cosine", shuffled=True),
    Variant("no_short_connection", "Without the short connection", chain=(5, 20)),
    Variant("no_autoencoder", "Without the autoencoder", with_autoencoder=False),
)
# Nets of other depths, each as wide as less than 3,000 trainable parameters let it be.
DEPTHS = (
    Variant("two_layers_stable", "Two layers of 48, cosine schedule", "cosine", chain=(2, 48)),
    Variant("three_layers_stable", "Three layers of 34, cosine schedule", "cosine", chain=(3, 34)),
    Variant("five_layers_stable", "Five layers of 24, cosine schedule", "cosine", chain=(5, 24)),
    Variant("eight_layers_stable", "Eight layers of 18, cosine schedule", "cosine", chain=(8, 18)),
)
FEWER_FACES = (
    Variant("fewer_faces", "Fewer training faces"),
    Variant("fewer_faces_stable", "Fewer training faces, cosine schedule", "cosine"),
)
TITLES = {variant.id: variant.title for variant in (*VARIANTS, *DEPTHS, *FEWER_FACES)}


def fewer_faces(run: Run) -> list[Variant]:
    """`FEWER_FACES` for every number of them."""
    sizes = run.preset.training_sizes
    return [replace(variant, faces=n) for variant in FEWER_FACES for n in sizes]
