"""Stage of MobileFace: an image of every face, the same view as its landmarks."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from joblib import Parallel, delayed

from data_gen.datasets.dataset import Dataset, load_dataset
from data_gen.datasets.image_files import ImageFiles
from data_gen.datasets.images import Scene, make_scene, render
from data_gen.models.registry import load_model
from deepmds_keras.photos import IMAGE_SIZE
from experiments.inputs import image_files
from experiments.progress import Bar
from experiments.run import Run, one_core, parse_run, stage
from experiments.streams import Stream

PARTS = ("train", "test")


def make_file(
    files: ImageFiles, file: int, scene: Scene, dataset: Dataset, seed: tuple[int, ...]
) -> int:
    """Write one file of images, the same whichever process does it and when.

    Returns:
        Number of images.
    """
    faces = files.ranges()[file]
    rng = np.random.default_rng([*seed, file])
    with one_core():
        files.save(file, *render(scene, dataset, faces, rng))
    return len(faces)


def make_images(
    run: Run,
    parts: dict[str, ImageFiles],
    seed_of: Callable[[str], tuple[int, ...]],
    make: Callable[[], Scene],
) -> dict[str, dict[str, str]]:
    """Write the images of data sets of the run that are not there yet.

    Args:
        run: The run.
        parts: Name of a data set, which lies in `<name>.npz`, to its files of images.
        seed_of: From that name to the seed of its images.
        make: Makes the scene.

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
        scene = make()
        datasets = {part: load_dataset(run.work / f"{part}.npz") for part in parts}
        tasks = (
            delayed(make_file)(parts[part], file, scene, datasets[part], seed_of(part))
            for part, file in wanted
        )
        total = sum(len(files) for files in parts.values())
        done = total - sum(len(parts[part].ranges()[file]) for part, file in wanted)
        with Bar(total=total, initial=done, desc="images", unit="image") as bar:
            for n in Parallel(run.jobs, return_as="generator_unordered")(tasks):
                bar.update(n)
    return {part: files.checksums() for part, files in parts.items()}


def main(arguments: list[str] | None = None) -> None:
    run = parse_run(__doc__, arguments)

    def scene() -> Scene:
        return make_scene(load_model(run.model, run.data), run.scheme, IMAGE_SIZE, run.protocol)

    with stage(run, "images") as record:
        record["checksums"] = make_images(
            run,
            {part: image_files(run, part) for part in PARTS},
            lambda part: (run.seed, Stream.IMAGES, PARTS.index(part)),
            scene,
        )
