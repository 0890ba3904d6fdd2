"""Stage of RingNet: train it, or take the licensed one; then its predictions of the test photos."""

from __future__ import annotations

import numpy as np
import tensorflow as tf
from PIL import Image

from data_gen.datasets.image_files import ImageFiles
from deepmds_keras.photos import IMAGE_SIZE
from experiments.arguments import parse_run
from experiments.inputs import load_crops
from experiments.methods import METHODS, load
from experiments.running import stage
from experiments.tracks.predictions import write_prediction


def shrunk(images: ImageFiles) -> np.ndarray:
    """The test photos at the size that our RingNet sees, `(n, 96, 96, 3)`."""
    small = np.empty((len(images), IMAGE_SIZE, IMAGE_SIZE, 3), np.uint8)
    for faces in images.ranges():
        for k, image in zip(faces, images[slice(faces.start, faces.stop)], strict=True):
            size = (IMAGE_SIZE, IMAGE_SIZE)
            small[k] = Image.fromarray(image).resize(size, Image.Resampling.BOX)
    return small


def main(arguments: list[str] | None = None) -> None:
    run = parse_run(__doc__, arguments)
    tf.config.threading.set_inter_op_parallelism_threads(2)
    with stage(run, run.ringnet_stage) as record:
        test = load_crops(run)  # a damaged file is to be reported before the long work
        record["methods"] = ["ringnet"]
        if run.ringnet is not None:
            write_prediction(run, METHODS["ringnet"], load(run, "ringnet"), test)
        else:
            model = METHODS["ringnet"].train(run)
            record["final_losses"] = {
                mode: round(losses[-1], 6) for mode, losses in model.history_.items()
            }
            write_prediction(run, METHODS["ringnet"], model, shrunk(test))
