"""Step: train the method from one seed with one of its parts changed, and score it.

The module is light to import, since every command reads the names of the variants.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from experiments.run import Run

if TYPE_CHECKING:
    import keras

    from deepmds_keras.deep_mds import DeepMDS
    from experiments.inputs import Faces

_METHODS = {"constant": "deep_mds", "cosine": "deep_mds_cosine"}


@dataclass(frozen=True)
class Variant:
    """Difference of a training from the paper's method.

    Attributes:
        schedule: Learning rate of both networks.
        shuffled: As for `PairNet`.
        chain: Number of hidden layers and units per layer of a net without skip connection.
        with_autoencoder: Whether the dissimilarity net sees frontal views or the input views.
    """

    title: str
    schedule: str = "constant"
    shuffled: bool = False
    chain: tuple[int, int] | None = None
    with_autoencoder: bool = True


VARIANTS = {
    "same_face": Variant("The paper's method: mini-batches of one face"),
    "shuffled": Variant("Shuffled mini-batches", shuffled=True),
    "same_face_cosine": Variant("Mini-batches of one face, cosine schedule", "cosine"),
    "shuffled_cosine": Variant("Shuffled mini-batches, cosine schedule", "cosine", shuffled=True),
    "no_skip_connection": Variant("Without the skip connection", chain=(5, 20)),
    "no_autoencoder": Variant("Without the autoencoder", with_autoencoder=False),
    # Nets of other depths, each as wide as fewer than 3,000 trainable parameters allow.
    "two_layers_cosine": Variant("Two layers of 48, cosine schedule", "cosine", chain=(2, 48)),
    "three_layers_cosine": Variant("Three layers of 34, cosine schedule", "cosine", chain=(3, 34)),
    "five_layers_cosine": Variant("Five layers of 24, cosine schedule", "cosine", chain=(5, 24)),
    "eight_layers_cosine": Variant("Eight layers of 18, cosine schedule", "cosine", chain=(8, 18)),
    "fewer_faces": Variant("Fewer training faces"),
    "fewer_faces_cosine": Variant("Fewer training faces, cosine schedule", "cosine"),
}


def ablation_trainings(run: Run) -> list[tuple[str, int]]:
    """Item and seed of each training: `("shuffled", 3)`, or with faces `("fewer_faces-500", 0)`.

    Those on fewer faces train both networks, from one seed.
    """
    seeds = range(run.seed, run.seed + run.preset.ablation_seeds)
    fewer = [name for name in VARIANTS if name.startswith("fewer_faces")]
    on_all = [(name, seed) for name in VARIANTS if name not in fewer for seed in seeds]
    sizes = run.preset.training_sizes
    return on_all + [(f"{name}-{size}", run.seed) for name in fewer for size in sizes]


def scores_file(run: Run, item: str, seed: int) -> Path:
    """File of a training's losses and errors."""
    return run.work / "ablation" / f"{item}-seed{seed}.json"


def main(run: Run, item: str, seed: str) -> None:
    """Train a variant, an item of `ablation_trainings`, from a seed of weights and order of faces.

    Its losses, and its errors on the first test subset, are written.
    """
    import pandas as pd

    from deepmds_keras.geometry.views import PROJECTIONS
    from experiments.inputs import load_faces
    from experiments.records import write_json
    from experiments.scoring.scores import score, subsets

    name, _, size = item.partition("-")
    train, test = load_faces(run, "train"), load_faces(run, "test")
    test = test[subsets(run, len(test.views))[0]]
    train = train[: int(size or run.preset.train_faces)]
    model, history = train_variant(run, VARIANTS[name], int(seed), train)
    scores = score(model.predict(test.views), test)
    mse = pd.Series(scores.mse)
    orthographic = test.cameras.projection == PROJECTIONS.index("orthographic")
    frontal = orthographic & (test.cameras.yaw == 0)
    values = {
        "loss_train": history["train"][-1],
        "loss_inference": history["inference"][-1],
        "mse": mse.mean(),
        "mse_sem": mse.sem(),
        "mse_frontal": mse[frontal].mean(),
        "mse_posed": mse[~frontal].mean(),
        "depth_corr": scores.depth_corr.mean(),
    }
    values = {metric: float(value) for metric, value in values.items()}
    write_json(scores_file(run, item, int(seed)), {"values": values, "history": history})


def train_variant(
    run: Run, variant: Variant, seed: int, faces: Faces
) -> tuple[DeepMDS, dict[str, list[float]]]:
    """Train the changed parts: returns the method, and the dissimilarity net's losses by epoch.

    The autoencoder is the run's, unless there are fewer faces.
    """
    import keras

    from deepmds_keras.deep_mds import DeepMDS
    from deepmds_keras.geometry.orientation import front_landmark
    from deepmds_keras.geometry.units import normalise
    from deepmds_keras.networks import forward
    from deepmds_keras.training import Recipe, train_autoencoder
    from experiments.methods import load
    from experiments.progress import Progress
    from experiments.studies.pair_training import PairNet

    preset, flat = run.preset, faces.views.reshape(len(faces.views), -1)
    model = DeepMDS(faces.views.shape[1])
    model.front_landmark_ = front_landmark(faces.shapes)
    if not variant.with_autoencoder:
        view = keras.Input(flat.shape[1:], name="view")
        model.autoencoder_ = keras.Model(view, keras.layers.Identity(name="same_view")(view))
    elif len(flat) == preset.train_faces:
        model.autoencoder_ = load(run, _METHODS[variant.schedule]).autoencoder_
    else:
        # As many steps as on all faces, so that only the number of faces differs.
        steps = preset.train_faces // Recipe.batch_size
        recipe = Recipe(preset.autoencoder_epochs, steps, variant.schedule)
        frontal = faces.shapes[..., :2]
        with Progress("autoencoder: epoch", recipe.epochs) as progress:
            model.autoencoder_, _ = train_autoencoder(
                faces.views, frontal, recipe, seed=seed, progress=lambda _: progress.update()
            )
    recipe = Recipe(preset.dissimilarity_epochs, preset.dissimilarity_steps, variant.schedule)
    frontal = normalise(forward(model.autoencoder_, flat).reshape(faces.views.shape))
    training = PairNet(build_net(variant.chain, seed), recipe, seed, variant.shuffled)
    with Progress("dissimilarity net: epoch", recipe.epochs) as progress:
        training.fit(frontal, faces.views, faces.shapes, progress=lambda _: progress.update())
    model.dissimilarity_net_ = training.network
    return model, training.history_


def build_net(chain: tuple[int, int] | None, seed: int) -> keras.Model:
    """The paper's dissimilarity net, or one of other hidden layers in a row."""
    import keras

    from deepmds_keras.networks import build_dissimilarity_net, dense_block
    from deepmds_keras.proximities import VARIANTS

    if chain is None:
        return build_dissimilarity_net(seed=seed)
    pair = x = keras.Input((VARIANTS["paper"],), name="pair_features")
    n_layers, units = chain
    for number in range(n_layers):
        x = dense_block(x, units, f"hidden_{number + 1}", seed=1000 * seed + number)
    distance = dense_block(x, 1, "distance", seed=1000 * seed + n_layers, activated=False)
    return keras.Model(pair, distance, name=f"dissimilarity_chain_{n_layers}x{units}")
