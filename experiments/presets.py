"""Sizes of all experiments: full, a small one to see that everything works, and a tiny one.

The tests of steps use the last.
"""

from dataclasses import dataclass, replace


@dataclass(frozen=True, kw_only=True)
class Preset:
    """Sizes of the experiments; the defaults are those of the preset `full`.

    Attributes:
        train_faces, test_faces: Faces of the BFM track (paper, section "Datasets").
        frame_subjects, frames: Training set of the FLAME track where it is made here (as many as
            CoMA has).
        scan_subjects, scans: Test set of the FLAME track where it is made here (as many as the
            paper takes from CASIA-3D).
        photos: Test photos of the CelebA experiment; of CelebA, the first of its test images.
        autoencoder_epochs: Epochs of the autoencoder. Neither the paper nor its code gives the
            total; at 30 its training error no longer falls much.
        dissimilarity_epochs: Epochs of `dissimilarity_steps` faces each (released code: 30 × 1000).
        zhao_epochs: Epochs of Zhao's net of `zhao_steps` mini-batches each. After 20 its error no
            longer falls much.
        zhao_authors_epochs: The same where it is trained as the authors did (released code:
            10 × 1000 steps).
        lifting_steps: Mini-batches of 128 faces of the lifting network. Its error on held-out faces
            falls as long as the learning rate does.
        train_images: Training faces with an image for MobileFace.
        mobileface_epochs, mobileface_paper_epochs: Epochs of MobileFace with a cosine schedule, and
            by the paper's recipe (released code: 200 × 500 steps).
        ring_subjects, ring_images: People whom RingNet is trained on, and images of each.
        ringnet_epochs: Epochs of RingNet, of `ringnet_steps` mini-batches each.
        n_subsets, subset_size: Random subsets of the test set (paper, "Evaluation Criteria").
        timed_faces: Test faces over which the time of a prediction is taken.
        timed_passes: Repetitions of such a prediction, after a first one for warming up.
        n_seeds: Number of seeds of `make seeds` without SEEDS.
        ablation_seeds: Number of seeds of each variant in `make ablation`.
        training_sizes: Numbers of training faces of `make ablation`, below `train_faces`.
        audited_faces: Test faces on which `make audit` measures what takes long.
        simulations: Number of simulated methods that differ by chance alone, to judge the tests.
        bench_faces, bench_released_faces: Faces for which `make bench` times our code, a fifth for
            the slower ways, and the authors' implementation.
        bench_steps: Training steps that it times.
        bench_passes: Repetitions of each measurement after the first; 0 keeps the first.
        test_portraits: Photos of each open face model on which `make pretrained` measures
            detectors and methods.
        shipped_steps: Mini-batches of the lifters that ship.
        object_views: Training views of each shape of `make objects`; an eighth of it in the tests.
        streamed_faces, faces_per_file: Faces of `make stream`, and those in each of its files.
        caution: Warning on figures and below tables.
    """

    name: str = "full"
    train_faces: int = 20_000
    test_faces: int = 5_000
    frame_subjects: int = 12
    frames: int = 20_466
    scan_subjects: int = 123
    scans: int = 3_937
    photos: int = 5_000
    autoencoder_epochs: int = 30
    dissimilarity_epochs: int = 30
    dissimilarity_steps: int = 1000
    zhao_epochs: int = 20
    zhao_authors_epochs: int = 10
    zhao_steps: int = 1000
    lifting_steps: int = 6000
    train_images: int = 20_000
    mobileface_epochs: int = 60
    mobileface_paper_epochs: int = 200
    mobileface_steps: int = 500
    ring_subjects: int = 2_000
    ring_images: int = 10
    ringnet_epochs: int = 10
    ringnet_steps: int = 80
    n_subsets: int = 10
    subset_size: int = 500
    timed_faces: int = 50
    timed_passes: int = 5
    n_seeds: int = 10
    ablation_seeds: int = 5
    training_sizes: tuple[int, ...] = (500, 2_000, 8_000)
    audited_faces: int = 200
    simulations: int = 500
    bench_faces: int = 1_000
    bench_released_faces: int = 20
    bench_steps: int = 500
    bench_passes: int = 3
    test_portraits: int = 1_000
    shipped_steps: int = 6_000
    object_views: int = 40
    streamed_faces: int = 1_000_000
    faces_per_file: int = 5_000
    caution: str = ""


FULL = Preset()
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
    zhao_authors_epochs=2,
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
    bench_faces=20,
    bench_released_faces=1,
    bench_steps=4,
    bench_passes=0,
    test_portraits=20,
    shipped_steps=200,
    object_views=2,
    streamed_faces=1_000,
    faces_per_file=100,
    caution="smoke: too short to mean anything",
)
# For the tests. With a prime number of steps above 50, each step is a separate call: a single
# step is traced, not a loop of steps, which takes longer than the training.
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
    test_portraits=6,
    shipped_steps=3,
    train_images=32,
    mobileface_steps=1,
    ring_subjects=4,
    ringnet_steps=1,
    subset_size=5,  # few are alike, whose tests take long
    simulations=20,
    timed_faces=1,
    timed_passes=1,
    training_sizes=(53,),
    streamed_faces=100,
    faces_per_file=10,
)
PRESETS = {preset.name: preset for preset in (FULL, SMOKE, TINY)}
