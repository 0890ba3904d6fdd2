"""Sizes of all experiments: full, a small one to see that everything works, and a tiny one.

The tests of steps use the last. With a prime number of steps above 50, each step is a separate
call: a single step is traced, not a loop of steps, which takes longer than the training.
"""

from dataclasses import dataclass, field, fields


def _size(full, smoke, tiny=None):
    """What a size is at each preset; at `tiny` as at `smoke` unless it is given."""
    return field(default=full, metadata={"smoke": smoke, "tiny": smoke if tiny is None else tiny})


@dataclass(frozen=True, kw_only=True)
class Preset:
    """Sizes of the experiments; the defaults are those of the preset `full`."""

    name: str = "full"
    # Faces of the BFM track (paper, section "Datasets").
    train_faces: int = _size(20_000, 4_800, 53 * 16)
    test_faces: int = _size(5_000, 20, 10)
    # Training set of the FLAME track where it is made here (as many as CoMA has).
    frame_subjects: int = _size(12, 3, 2)
    frames: int = _size(20_466, 4_800, 53 * 16)
    # Test set of the FLAME track where it is made here (as many as the paper takes from CASIA-3D).
    scan_subjects: int = _size(123, 4, 2)
    scans: int = _size(3_937, 24, 12)
    # Test photos of the CelebA experiment; of CelebA, the first of its test images.
    photos: int = _size(5_000, 24, 12)
    # Neither the paper nor its code gives the total; at 30 the training error no longer falls much.
    autoencoder_epochs: int = _size(30, 6, 3)
    # Epochs of `dissimilarity_steps` faces each (released code: 30 × 1000).
    dissimilarity_epochs: int = _size(30, 3)
    dissimilarity_steps: int = _size(1000, 400, 53)
    # Epochs of Zhao's net of `zhao_steps` mini-batches each. After 20 its error no longer falls
    # much. As the authors trained it (released code: 10 × 1000 steps).
    zhao_epochs: int = _size(20, 2)
    zhao_authors_epochs: int = _size(10, 2)
    zhao_steps: int = _size(1000, 100, 53)
    # Mini-batches of 128 faces of the lifting network. Its error on held-out faces falls as long as
    # the learning rate does.
    lifting_steps: int = _size(6000, 200, 3)
    # Training faces with an image for MobileFace.
    train_images: int = _size(20_000, 160, 32)
    # Epochs of MobileFace with a cosine schedule, and by the paper's recipe (released code:
    # 200 × 500 steps).
    mobileface_epochs: int = _size(60, 2)
    mobileface_paper_epochs: int = _size(200, 2)
    mobileface_steps: int = _size(500, 10, 1)
    # People whom RingNet is trained on, and images of each.
    ring_subjects: int = _size(2_000, 8, 4)
    ring_images: int = _size(10, 6)
    # Epochs of RingNet, of `ringnet_steps` mini-batches each.
    ringnet_epochs: int = _size(10, 2)
    ringnet_steps: int = _size(80, 3, 1)
    # Random subsets of the test set (paper, "Evaluation Criteria"). At `tiny` few are alike, whose
    # tests take long.
    n_subsets: int = _size(10, 10)
    subset_size: int = _size(500, 10, 5)
    # Test faces over which the time of a prediction is taken; repetitions after one to warm up.
    timed_faces: int = _size(50, 2, 1)
    timed_passes: int = _size(5, 5, 1)
    # Seeds of `make seeds` without SEEDS, and of each variant in `make ablation`.
    n_seeds: int = _size(10, 2)
    ablation_seeds: int = _size(5, 2)
    # Numbers of training faces of `make ablation`, below `train_faces`.
    training_sizes: tuple[int, ...] = _size((500, 2_000, 8_000), (160,), (53,))
    # Test faces on which `make audit` measures what takes long.
    audited_faces: int = _size(200, 4)
    # Simulated methods that differ by chance alone, to judge the tests.
    simulations: int = _size(500, 500, 20)
    # Faces for which `make bench` times our code, a fifth for the slower ways, and the authors'
    # implementation; training steps that it times; repetitions after the first, 0 to keep that.
    bench_faces: int = _size(1_000, 20)
    bench_released_faces: int = _size(20, 1)
    bench_steps: int = _size(500, 4)
    bench_passes: int = _size(3, 0)
    # Photos of each open face model on which `make pretrained` measures detectors and methods.
    test_portraits: int = _size(1_000, 20, 6)
    # Further ones, from which `make real-faces` takes the s.d. of the detectors' landmarks.
    further_portraits: int = _size(500, 20, 6)
    # Mini-batches of the lifters that ship.
    shipped_steps: int = _size(6_000, 200, 3)
    # Training views of each shape of `make objects`; an eighth of it in the tests.
    object_views: int = _size(40, 2)
    # Faces of `make stream`, and those in each of its files.
    streamed_faces: int = _size(1_000_000, 1_000, 100)
    faces_per_file: int = _size(5_000, 100, 10)
    # Warning on figures and below tables.
    caution: str = _size("", "smoke: too short to mean anything")


def _preset(name: str) -> Preset:
    sizes = {size.name: size.metadata[name] for size in fields(Preset) if size.metadata}
    return Preset(name=name, **sizes)


FULL = Preset()
SMOKE = _preset("smoke")
TINY = _preset("tiny")
PRESETS = {preset.name: preset for preset in (FULL, SMOKE, TINY)}
