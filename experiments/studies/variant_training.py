"""Training and scoring of the method with one of its parts changed."""

from __future__ import annotations

import keras
from scipy.stats import sem

from data_gen.views.projections import PROJECTIONS
from deepmds_keras.networks import forward
from deepmds_keras.orientation import front_landmark
from deepmds_keras.pipeline import DeepMDS
from deepmds_keras.training import Recipe, train_autoencoder, train_dissimilarity_net
from experiments.inputs import Faces, load_faces
from experiments.methods import load
from experiments.progress import EpochBar
from experiments.records import write_json
from experiments.run import Run
from experiments.scoring.scores import score, subsets
from experiments.studies.variants import Variant

_AUTOENCODER_BATCH = 16
_METHODS = {"constant": "ours", "cosine": "ours_stable"}


def train_and_score(run: Run, variant: Variant, seed: int) -> None:
    """Write the losses of a variant's dissimilarity net, and its errors on the first test subset.

    Args:
        run: The run, whose faces and networks are made.
        variant: What to change.
        seed: Of the initial weights and the order of what is changed.
    """
    train, test = load_faces(run, "train"), load_faces(run, "test")
    train = train[slice(variant.faces)]
    encoder = _encoder(run, variant, train, seed)
    flat = train.views.reshape(len(train.views), -1)
    preset = run.preset
    with EpochBar(f"{variant.id} {seed}", preset.dissimilarity_epochs) as bar:
        net, history = train_dissimilarity_net(
            forward(encoder, flat).reshape(train.views.shape),
            train.shapes,
            Recipe(preset.dissimilarity_epochs, preset.dissimilarity_steps, variant.schedule),
            shuffled=variant.shuffled,
            chain=variant.chain,
            seed=seed,
            checkpoint=variant.file(run, seed, "npz"),
            progress=bar.losses,
        )
    model = DeepMDS(train.views.shape[1])
    model.autoencoder_, model.dissimilarity_net_ = encoder, net
    model.front_landmark_ = front_landmark(train.shapes)
    tested = test[subsets(run, len(test.views))[0]]
    scores = score(model.predict(tested.views), tested)
    facing = (tested.cameras.projection == PROJECTIONS.index("orthographic")) & (
        tested.cameras.yaw == 0
    )
    values = {
        "loss_train": history["train"][-1],
        "loss_inference": history["inference"][-1],
        "mse": scores.mse.mean(),
        "mse_sem": sem(scores.mse),
        "mse_frontal": scores.mse[facing].mean(),
        "mse_posed": scores.mse[~facing].mean(),
        "depth_corr": scores.depth_corr.mean(),
    }
    values = {metric: float(value) for metric, value in values.items()}
    write_json(variant.file(run, seed), {"values": values, "history": history})


def _encoder(run: Run, variant: Variant, train: Faces, seed: int) -> keras.Model:
    if not variant.with_autoencoder:
        view = keras.Input((2 * train.views.shape[1],), name="view")
        return keras.Model(view, keras.layers.Identity(name="same_view")(view))
    if variant.faces is None:
        return load(run, _METHODS[variant.schedule]).autoencoder_
    epochs = run.preset.autoencoder_epochs
    # As many steps as on all faces, so that only the number of faces differs.
    steps = run.preset.train_faces // _AUTOENCODER_BATCH
    path = variant.file(run, seed, "npz")
    with EpochBar(f"{variant.id} {variant.faces}", epochs) as bar:
        return train_autoencoder(
            train.views,
            train.shapes[..., :2],
            Recipe(epochs, steps, variant.schedule, batch_size=_AUTOENCODER_BATCH),
            seed=seed,
            checkpoint=path.with_name(f"{path.stem}-autoencoder.npz"),
            progress=bar.losses,
        )[0]
