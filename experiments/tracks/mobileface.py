"""Stage of MobileFace: train it on the images, then its predictions of the test images.

The CelebA experiment tests the net of the BFM track.
"""

from __future__ import annotations

import tensorflow as tf

from experiments.arguments import parse_run
from experiments.inputs import load_crops, load_images
from experiments.methods import METHODS, load
from experiments.running import stage
from experiments.tracks.predictions import write_prediction


def main(arguments: list[str] | None = None) -> None:
    run = parse_run(__doc__, arguments)
    # A layer of this net is too small to be shared between threads; two layers' gradients are not.
    tf.config.threading.set_intra_op_parallelism_threads(1)
    tf.config.threading.set_inter_op_parallelism_threads(2)
    with stage(run, "mobileface") as record:
        # A damaged file is to be reported before the long work.
        if run.track == "celeba":
            test = load_crops(run)
            model = load(run, "mobileface")
        else:
            test = load_images(run, "test")
            model = METHODS["mobileface"].train(run)
        record["final_rms_error_mm"] = {
            mode: round(losses[-1] ** 0.5, 6) for mode, losses in model.history_.items()
        }
        write_prediction(run, METHODS["mobileface"], model, test)
