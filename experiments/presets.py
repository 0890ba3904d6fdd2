"""The two sizes at which every experiment runs: the paper's, and one to see that it works."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Preset:
    """Sizes of the BFM experiment.

    Attributes:
        train_faces, test_faces: Sizes of the two sets (paper, section "Datasets").
        autoencoder_epochs: Passes over the training faces. The paper and its code leave the total
            open; 30 is where the training error of the autoencoder no longer falls by much.
        dissimilarity_epochs: Epochs of `dissimilarity_steps` faces each (released code: 30 × 1000).
        zhao_epochs: Epochs of Zhao's net (released code: 10 × 1000 steps).
        train_images: Training faces of which MobileFace sees an image.
        mobileface_epochs: Epochs of MobileFace (released code: 200 × 500 steps).
        n_subsets, subset_size: Random subsets of the test set (paper, "Evaluation Criteria").
        timed_faces: Test faces over which the time of a prediction is taken.
        n_seeds: Repetitions of `make seeds`.
    """

    name: str
    train_faces: int
    test_faces: int
    autoencoder_epochs: int
    dissimilarity_epochs: int
    dissimilarity_steps: int
    zhao_epochs: int
    zhao_steps: int
    train_images: int
    mobileface_epochs: int
    mobileface_steps: int
    n_subsets: int
    subset_size: int
    timed_faces: int
    n_seeds: int


PAPER = Preset(
    "paper", 20_000, 5_000, 30, 30, 1000, 10, 1000, 20_000, 200, 500, 10, 500, 200, 5
)  # fmt: skip
SMOKE = Preset("smoke", 4_800, 20, 6, 3, 400, 2, 100, 160, 2, 10, 10, 10, 2, 2)
PRESETS = {preset.name: preset for preset in (PAPER, SMOKE)}
