"""Stage of MobileFace: an image of every face, the same view as its landmarks."""

from __future__ import annotations

import functools
from collections.abc import Callable
from pathlib import Path

import numpy as np

from data_gen.datasets.dataset import Dataset, load_dataset
from data_gen.datasets.image_files import ImageFiles
from data_gen.datasets.images import Scene, make_scene, render
from data_gen.models.registry import load_model
from deepmds_keras.photos import IMAGE_SIZE
from experiments.arguments import parse_run
from experiments.inputs import image_files
from experiments.progress import Bar
from experiments.run import Run
from experiments.running import stage
from experiments.streams import Stream
from experiments.tasks import unordered

PARTS = ("train", "test")


def make_file(
    run: Run,
    part: str,
    files: ImageFiles,
    file: int,
    scene: Callable[[Run], Scene],
    seed: tuple[int, ...],
) -> int:
    """Write one file of images, the same whichever process does it and when.

    Returns:
        Number of images.
    """
    faces = files.ranges()[file]
    rng = np.random.default_rng([*seed, file])
    path = run.work / f"{part}.npz"
    dataset = _dataset(path, path.stat().st_mtime_ns)
    files.save(file, *render(_scene(run, scene), dataset, faces, rng))
    return len(faces)


def make_images(
    run: Run,
    parts: dict[str, ImageFiles],
    seed_of: Callable[[str], tuple[int, ...]],
    scene: Callable[[Run], Scene],
) -> dict[str, dict[str, str]]:
    """Write the images of data sets of the run that are not there yet.

    Args:
        run: The run.
        parts: Name of a data set, which lies in `<name>.npz`, to its files of images.
        seed_of: From that name to the seed of its images.
        scene: Makes the scene, in every process that draws.

    Returns:
        Checksums of all files, by data set.
    """
    wanted = [
        (part, file)
        for part, files in parts.items()
        for file in range(len(files.ranges()))
        if not files.paths(file)[0].exists()
    ]
    if wanted:
        scene(run)  # what cannot be drawn is refused here, once
        total = sum(len(files) for files in parts.values())
        done = total - sum(len(parts[part].ranges()[file]) for part, file in wanted)
        tasks = ((run, part, parts[part], file, scene, seed_of(part)) for part, file in wanted)
        with Bar(total=total, initial=done, desc="images", unit="image") as bar:
            for n in unordered(run.jobs, make_file, tasks):
                bar.update(n)
    return {part: files.checksums() for part, files in parts.items()}


def scene_of(run: Run) -> Scene:
    """Scene in which the run's face model is drawn for MobileFace."""
    return make_scene(load_model(run.model, run.data), run.scheme, IMAGE_SIZE, run.protocol)


@functools.cache
def _scene(run: Run, scene: Callable[[Run], Scene]) -> Scene:
    return scene(run)


@functools.cache
def _dataset(path: Path, modified: int) -> Dataset:
    """A file as it was at that time: workers of a cluster may live longer than it."""
    return load_dataset(path)


def main(arguments: list[str] | None = None) -> None:
    run = parse_run(__doc__, arguments)
    with stage(run, "images") as record:
        record["checksums"] = make_images(
            run,
            {part: image_files(run, part) for part in PARTS},
            lambda part: (run.seed, Stream.IMAGES, PARTS.index(part)),
            scene_of,
        )
