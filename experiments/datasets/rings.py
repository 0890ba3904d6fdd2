"""Step of RingNet: images of people, several of each, in all expressions and poses."""

import numpy as np

from data_gen.datasets.dataset import make_rings, save_dataset
from deepmds_keras.files import write_arrays
from experiments.datasets.images import make_images
from experiments.inputs import face_model
from experiments.run import Run
from experiments.streams import Stream

_N_IDENTITY = 100  # leading components that RingNet estimates, as many as in the published one


def main(run: Run) -> dict:
    """Write the data set `rings.npz`, its images, and the model of the landmarks in them."""
    model, preset = face_model(run), run.preset
    landmarks = model.at_landmarks(run.scheme)
    write_arrays(
        run.work / "landmark_model.npz",
        {
            "mean": landmarks.mean,
            "identity_basis_times_sd": landmarks.identity_basis_times_sd[:_N_IDENTITY],
            "expression_basis": landmarks.expression_basis,
        },
        {"model": model.name},
    )
    rng = np.random.default_rng([run.seed, Stream.RINGS])
    dataset = make_rings(
        model,
        preset.ring_subjects,
        preset.ring_images,
        rng,
        scheme=run.scheme,
        protocol=run.protocol,
    )
    save_dataset(run.work / "rings.npz", dataset)
    checksums = make_images(run, "rings", (run.seed, Stream.RING_IMAGES))
    return {"checksums": {"rings": checksums}}
