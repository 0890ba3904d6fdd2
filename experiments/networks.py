"""Stage 2: train every network of the experiment; what is complete is loaded, not trained again."""

from __future__ import annotations

from pathlib import Path

import keras
import numpy as np
from tqdm import tqdm

from deepmds_keras.baselines.zhao import Zhao
from deepmds_keras.orientation import front_landmark
from deepmds_keras.pipeline import DeepMDS
from deepmds_keras.training import Recipe, train_autoencoder, train_dissimilarity_net
from deepmds_keras.weights import read_arrays
from experiments.faces import Faces, load_faces
from experiments.run import Run, parse_run, stage

# Method: variant of the dissimilarity net, learning-rate schedule of both networks. `ours` and
# `ours_released` share the autoencoder, which is the same in both variants.
DEEP_MDS = {
    "ours": ("paper", "constant"),
    "ours_released": ("released", "constant"),
    "ours_stable": ("paper", "cosine"),
}
# The authors train Zhao's net on the first 3,000 of their faces, seen from the front.
_ZHAO_AUTHORS_FACES = 3000


def network_file(run: Run, name: str) -> Path:
    """Checkpoint of a network, which is also the trained network once its epochs are done."""
    return run.work / "networks" / f"{name}.npz"


def autoencoder(run: Run, train: Faces, schedule: str) -> tuple[keras.Model, dict]:
    """The autoencoder and its losses by epoch."""
    name = f"autoencoder-{schedule}"
    epochs = run.preset.autoencoder_epochs
    with _bar(name, epochs) as bar:
        return train_autoencoder(
            train.views,
            train.shapes[..., :2],
            Recipe(epochs, schedule=schedule),
            seed=run.seed,
            checkpoint=network_file(run, name),
            progress=bar.losses,
        )


def dissimilarity_net(
    run: Run, train: Faces, encoder: keras.Model, variant: str, schedule: str
) -> tuple[keras.Model, dict]:
    """The dissimilarity net on the autoencoder's frontal views, and its losses by epoch."""
    name = f"dissimilarity-{variant}-{schedule}"
    preset = run.preset
    flat = train.views.reshape(len(train.views), -1)
    frontal = encoder.predict(flat, batch_size=4096, verbose=0).reshape(train.views.shape)
    with _bar(name, preset.dissimilarity_epochs) as bar:
        return train_dissimilarity_net(
            frontal,
            train.shapes,
            Recipe(preset.dissimilarity_epochs, preset.dissimilarity_steps, schedule),
            variant=variant,
            seed=run.seed,
            checkpoint=network_file(run, name),
            progress=bar.losses,
        )


def deep_mds(run: Run, train: Faces, method: str) -> tuple[DeepMDS, dict[str, dict]]:
    """One of `DEEP_MDS`, trained, and its losses by network and epoch."""
    variant, schedule = DEEP_MDS[method]
    encoder, first = autoencoder(run, train, schedule)
    net, second = dissimilarity_net(run, train, encoder, variant, schedule)
    model = DeepMDS.from_networks(
        encoder,
        net,
        front_landmark(train.shapes),
        n_landmarks=train.views.shape[1],
        variant=variant,
        schedule=schedule,
        autoencoder_epochs=run.preset.autoencoder_epochs,
        dissimilarity_epochs=run.preset.dissimilarity_epochs,
        seed=run.seed,
        n_jobs=run.jobs,
    )
    model.history_ = {"autoencoder": first, "dissimilarity_net": second}
    return model, model.history_


def zhao(run: Run, train: Faces, method: str) -> Zhao:
    """Zhao's net: `"zhao"` on the views of everybody else, `"zhao_authors"` as the authors did."""
    points = train.posed if method == "zhao" else train.shapes[:_ZHAO_AUTHORS_FACES]
    preset = run.preset
    net = Zhao(
        train.views.shape[1],
        epochs=preset.zhao_epochs,
        steps_per_epoch=preset.zhao_steps,
        seed=run.seed,
    )
    with _bar(method, preset.zhao_epochs) as bar:
        return net.fit(points, checkpoint=network_file(run, method), progress=bar.losses)


def histories(run: Run) -> dict[str, dict[str, dict]]:
    """Losses of `DEEP_MDS` by method, network and epoch, from the files of the networks."""

    def history(name):
        return read_arrays(network_file(run, name))[1]["history"]

    return {
        method: {
            "autoencoder": history(f"autoencoder-{schedule}"),
            "dissimilarity_net": history(f"dissimilarity-{variant}-{schedule}"),
        }
        for method, (variant, schedule) in DEEP_MDS.items()
    }


def main(arguments: list[str] | None = None) -> None:
    run = parse_run(__doc__, arguments)
    with stage(run, "networks") as record:
        train = load_faces(run, "train")
        record["final_rms_error"] = {}
        for method in DEEP_MDS:
            for network, losses in deep_mds(run, train, method)[1].items():
                record["final_rms_error"][f"{method}/{network}"] = {
                    mode: round(float(np.sqrt(loss[-1])), 6) for mode, loss in losses.items()
                }
        for method in ("zhao", "zhao_authors"):
            zhao(run, train, method)


class _bar(tqdm):  # noqa: N801 (tqdm's own naming)
    """A progress bar over epochs that shows the root of the mean squared errors."""

    def __init__(self, name: str, epochs: int):
        # What a file already holds is read in less than the delay and needs no bar.
        super().__init__(total=epochs, desc=name, unit="epoch", delay=2)

    def losses(self, losses: dict[str, float]) -> None:
        self.set_postfix({f"{k} r.m.s.": f"{v**0.5:.4f}" for k, v in losses.items()}, refresh=False)
        self.update()


if __name__ == "__main__":
    main()
