"""Sizes at which every experiment runs: the paper's, a small one to see that it works, a tiny one.

Stages are tested at the last.
"""

from __future__ import annotations

from dataclasses import dataclass, replace


@dataclass(frozen=True, kw_only=True)
class Preset:
    """Sizes of the experiments.

    Attributes:
        train_faces, test_faces: Faces of the BFM track (paper, section "Datasets").
        frame_subjects, frames: Training set of the FLAME track where it is made here (as many as
            CoMA has).
        scan_subjects, scans: Test set of the FLAME track where it is made here (as many as the
            paper takes from CASIA-3D).
        photos: Test photos of the CelebA experiment; of CelebA, the first of its test images.
        autoencoder_epochs: Passes over the training faces. The paper and its code leave the total
            open; 30 is where the training error of the autoencoder no longer falls by much.
        dissimilarity_epochs: Epochs of `dissimilarity_steps` faces each (released code: 30 × 1000).
        zhao_epochs: Epochs of Zhao's net (released code: 10 × 1000 steps).
        lifting_steps: Mini-batches of 128 faces of the lifting network. Its error on faces held out
            falls as long as the learning rate does.
        train_images: Training faces of which MobileFace sees an image.
        mobileface_epochs, mobileface_paper_epochs: Epochs of MobileFace with a cosine schedule, and
            by the paper's recipe (released code: 200 × 500 steps).
        ring_subjects, ring_images: People whom RingNet is trained on, and images of each.
        ringnet_epochs: Epochs of RingNet, of `ringnet_steps` mini-batches each.
        n_subsets, subset_size: Random subsets of the test set (paper, "Evaluation Criteria").
        timed_faces: Test faces over which the time of a prediction is taken.
        n_seeds: Of `make seeds`, where SEEDS does not say.
        ablation_seeds: Of each training of `make ablation`.
        training_sizes: Numbers of training faces of `make ablation`, below `train_faces`.
        audited_faces: Test faces on which `make audit` measures what takes long.
        timed_landmarks: Numbers of landmarks for which it, and `make bench`, time the embedding.
        bench_faces, bench_released_faces: Faces on which `make bench` times ours, a fifth for the
            slower ways, and the released way.
        bench_many_faces: Numbers of faces by which it times the growth.
        bench_steps, bench_variants: Training steps that it times, and whether in every variant or
            only in the released way and ours.
        bench_passes: Times that it takes a time anew after the first pass; 0 keeps that one's.
        bench_compared_faces: Test faces of a run on which it compares the two solvers.
        error_portraits, test_portraits: Photos of each open face model on which `make pretrained`
            measures the detectors' errors, and the methods.
        shipped_steps: Mini-batches of the lifters that ship.
        fitted_faces: Test faces of `make lifting` that a face model is fitted to.
        streamed_faces, faces_per_file: Faces of `make stream`, and those of one of its files.
        caution: Stands on figures and below tables.
    """

    name: str
    train_faces: int
    test_faces: int
    frame_subjects: int
    frames: int
    scan_subjects: int
    scans: int
    photos: int
    autoencoder_epochs: int
    dissimilarity_epochs: int
    dissimilarity_steps: int
    zhao_epochs: int
    zhao_steps: int
    lifting_steps: int
    train_images: int
    mobileface_epochs: int
    mobileface_paper_epochs: int
    mobileface_steps: int
    ring_subjects: int
    ring_images: int
    ringnet_epochs: int
    ringnet_steps: int
    n_subsets: int
    subset_size: int
    timed_faces: int
    n_seeds: int
    ablation_seeds: int
    training_sizes: tuple[int, ...]
    audited_faces: int
    timed_landmarks: tuple[int, ...]
    bench_faces: int
    bench_released_faces: int
    bench_many_faces: tuple[int, ...]
    bench_steps: int
    bench_variants: bool
    bench_passes: int
    bench_compared_faces: int
    error_portraits: int
    test_portraits: int
    shipped_steps: int
    fitted_faces: int
    streamed_faces: int
    faces_per_file: int
    caution: str = ""


PAPER = Preset(
    name="paper",
    train_faces=20_000,
    test_faces=5_000,
    frame_subjects=12,
    frames=20_466,
    scan_subjects=123,
    scans=3_937,
    photos=5_000,
    autoencoder_epochs=30,
    dissimilarity_epochs=30,
    dissimilarity_steps=1000,
    zhao_epochs=10,
    zhao_steps=1000,
    lifting_steps=6000,
    train_images=20_000,
    mobileface_epochs=60,
    mobileface_paper_epochs=200,
    mobileface_steps=500,
    ring_subjects=2_000,
    ring_images=10,
    ringnet_epochs=10,
    ringnet_steps=80,
    n_subsets=10,
    subset_size=500,
    timed_faces=50,
    n_seeds=10,
    ablation_seeds=5,
    training_sizes=(500, 2_000, 8_000),
    audited_faces=200,
    timed_landmarks=(51, 72, 150, 300, 478),
    bench_faces=1_000,
    bench_released_faces=20,
    bench_many_faces=(100, 1_000, 10_000, 100_000),
    bench_steps=500,
    bench_variants=True,
    bench_passes=3,
    bench_compared_faces=500,
    error_portraits=5_000,
    test_portraits=1_000,
    shipped_steps=20_000,
    fitted_faces=500,
    streamed_faces=1_000_000,
    faces_per_file=5_000,
)
SMOKE = Preset(
    name="smoke",
    train_faces=4_800,
    test_faces=20,
    frame_subjects=3,
    frames=4_800,
    scan_subjects=4,
    scans=24,
    photos=24,
    autoencoder_epochs=6,
    dissimilarity_epochs=3,
    dissimilarity_steps=400,
    zhao_epochs=2,
    zhao_steps=100,
    lifting_steps=200,
    train_images=160,
    mobileface_epochs=2,
    mobileface_paper_epochs=2,
    mobileface_steps=10,
    ring_subjects=8,
    ring_images=6,
    ringnet_epochs=2,
    ringnet_steps=3,
    n_subsets=10,
    subset_size=10,
    timed_faces=2,
    n_seeds=2,
    ablation_seeds=2,
    training_sizes=(160,),
    audited_faces=4,
    timed_landmarks=(51, 72, 100),
    bench_faces=20,
    bench_released_faces=1,
    bench_many_faces=(10, 20),
    bench_steps=4,
    bench_variants=False,
    bench_passes=0,
    bench_compared_faces=10,
    error_portraits=40,
    test_portraits=20,
    shipped_steps=200,
    fitted_faces=10,
    streamed_faces=1_000,
    faces_per_file=100,
    caution="smoke: too short to mean anything",
)
# Of the tests. A prime number of steps above 50 is a call each: what is traced is one step, not a
# loop of them, which takes longer than to train.
TINY = replace(
    SMOKE,
    name="tiny",
    train_faces=53 * 16,
    test_faces=10,
    frame_subjects=2,
    frames=53 * 16,
    scan_subjects=2,
    scans=12,
    photos=12,
    autoencoder_epochs=3,
    dissimilarity_steps=53,
    zhao_steps=53,
    lifting_steps=3,
    error_portraits=12,
    test_portraits=6,
    shipped_steps=3,
    train_images=32,
    mobileface_steps=1,
    ring_subjects=4,
    ringnet_steps=1,
    subset_size=8,
    timed_faces=1,
    training_sizes=(53,),
    streamed_faces=100,
    faces_per_file=10,
)
PRESETS = {preset.name: preset for preset in (PAPER, SMOKE, TINY)}
