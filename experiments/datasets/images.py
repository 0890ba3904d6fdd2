"""Step of MobileFace: an image of every face, in the view of its landmarks."""

import functools

import numpy as np

from data_gen.datasets.dataset import load_dataset
from data_gen.datasets.images import Scene, make_scene, render
from data_gen.renderer import MARGIN
from deepmds_keras.baselines.images import IMAGE_SIZE
from experiments.inputs import CROP_MARGIN, face_model, image_files
from experiments.progress import Progress
from experiments.records import resumable
from experiments.run import Run
from experiments.streams import Stream
from experiments.tasks import unordered


def make_images(run: Run, part: str, seed: tuple[int, ...]) -> dict[str, str]:
    """Write the images of a data set of the run that an earlier run has not written yet.

    Args:
        part: Name of the data set, which lies in `<part>.npz`.
        seed: Seed of light and skin.

    Returns:
        Checksums of the files, by name.

    Raises:
        InputError: The face model cannot be drawn.
    """
    files = image_files(run, part)
    resumable(files.folder, [run.work / f"{part}.npz"], model=_scene(run).model.sha256)
    faces = files.ranges()
    missing = [file for file in range(len(faces)) if not files.paths(file)[0].exists()]
    done = len(files) - sum(len(faces[file]) for file in missing)
    tasks = ((run, part, file, seed) for file in missing)
    with Progress(f"{part} image", len(files), done) as bar:
        for n in unordered(run.jobs, _make_file, tasks):
            bar.update(n)
    return files.checksums()


def _make_file(run: Run, part: str, file: int, seed: tuple[int, ...]) -> int:
    """Write one file of images, the same whichever process does it; return their number."""
    files = image_files(run, part)
    faces = files.ranges()[file]
    rng = np.random.default_rng([*seed, file])
    files.save(file, *render(_scene(run), _dataset(run.work / f"{part}.npz"), faces, rng))
    return len(faces)


_dataset = functools.cache(load_dataset)


@functools.cache
def _scene(run: Run) -> Scene:
    """Scene in which people are drawn for RingNet, or neutral faces for MobileFace."""
    model = face_model(run)
    if run.track == "flame":
        return make_scene(model, run.scheme, IMAGE_SIZE, margin=CROP_MARGIN, expressive=True)
    margin = None if run.protocol == "released" else MARGIN
    return make_scene(model, run.scheme, IMAGE_SIZE, margin=margin)


def main(run: Run) -> dict:
    checksums = {
        part: make_images(run, part, (run.seed, Stream.IMAGES, number))
        for number, part in enumerate(("train", "test"))
    }
    return {"checksums": checksums}
