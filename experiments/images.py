"""Stage of MobileFace: an image of every face, the same view as its landmarks."""

from __future__ import annotations

import os

import numpy as np
from joblib import Parallel, delayed
from threadpoolctl import threadpool_limits
from tqdm import tqdm

from data_gen.dataset import Dataset, load_dataset
from data_gen.images import Scene, make_scene, render
from data_gen.models import load_model
from deepmds_keras.photos import IMAGE_SIZE
from experiments.faces import SCHEME, image_files
from experiments.run import Run, parse_run, stage

PARTS = ("train", "test")
_STREAM = 3  # of random numbers of a run, beside those of its faces and its subsets


def make_file(run: Run, part: str, file: int, scene: Scene, dataset: Dataset) -> int:
    """Write one file of images, the same whichever process does it and when.

    Returns:
        Number of images.
    """
    os.environ.setdefault("LP_NUM_THREADS", "1")  # Mesa's software renderer: a process, a core
    files = image_files(run, part)
    faces = files.ranges()[file]
    rng = np.random.default_rng([run.seed, _STREAM, PARTS.index(part), file])
    with threadpool_limits(1):  # sums in one order, however many cores there are
        files.save(file, *render(scene, dataset, faces, rng))
    return len(faces)


def main(arguments: list[str] | None = None) -> None:
    run = parse_run(__doc__, arguments)
    with stage(run, "images") as record:
        parts = {part: image_files(run, part) for part in PARTS}
        wanted = [
            (part, file)
            for part, files in parts.items()
            for file in range(len(files.ranges()))
            if not files.paths(file)[0].exists()
        ]
        if wanted:
            scene = make_scene(load_model(run.model, run.data), SCHEME, IMAGE_SIZE, run.protocol)
            datasets = {part: load_dataset(run.work / f"{part}.npz") for part in PARTS}
            tasks = (
                delayed(make_file)(run, part, file, scene, datasets[part]) for part, file in wanted
            )
            total = sum(len(files) for files in parts.values())
            done = total - sum(len(parts[part].ranges()[file]) for part, file in wanted)
            with tqdm(total=total, initial=done, desc="images", unit="image") as bar:
                for n in Parallel(run.jobs, return_as="generator_unordered")(tasks):
                    bar.update(n)
        record["checksums"] = {part: files.checksums() for part, files in parts.items()}


if __name__ == "__main__":
    main()
