"""Step of the BFM track: random faces and their views."""

import numpy as np

from data_gen.datasets.dataset import make_dataset, save_dataset
from deepmds_keras.files import write_arrays
from experiments.inputs import face_model
from experiments.progress import Progress
from experiments.run import Run
from experiments.streams import Stream


def main(run: Run) -> dict:
    """Write the training faces, the test faces and the landmark model of a run."""
    model = face_model(run)
    landmarks = model.at_landmarks(run.scheme)
    components = model.identity_basis_times_sd.reshape(model.n_identity, -1)
    arrays = {
        "mean": landmarks.mean,
        "identity_basis_times_sd": landmarks.identity_basis_times_sd,
        "shape_gram": components @ components.T / components.shape[1],
    }
    write_arrays(run.work / "landmark_model.npz", arrays, {"model": model.name})
    sizes = {"train": run.preset.train_faces, "test": run.preset.test_faces}
    streams = {"train": Stream.TRAIN_FACES, "test": Stream.TEST_FACES}
    for part, n in sizes.items():
        rng = np.random.default_rng([run.seed, streams[part]])
        with Progress(f"{part} face", n) as bar:
            dataset = make_dataset(
                model, n, rng, scheme=run.scheme, protocol=run.protocol, progress=bar.update
            )
        save_dataset(run.work / f"{part}.npz", dataset)
    return {"model": model.name, "model_sha256": model.sha256}
