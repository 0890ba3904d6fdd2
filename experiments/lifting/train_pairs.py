"""Step: trains one network of `component_ablation`, of those that `component_trainings` lists.

Nets on views of the autoencoder use the run's; seeds concern what is trained here.
"""

import functools
from collections.abc import Callable

import keras
import numpy as np

from deepmds_keras.geometry.units import normalise
from deepmds_keras.networks import forward
from deepmds_keras.training import Recipe, train_autoencoder
from experiments.inputs import Faces, load_faces
from experiments.lifting.pair_nets import build_pair_net
from experiments.lifting.train import DEEP_MDS, LIFTING
from experiments.lifting.variants import SIDE_AUTOENCODER, VARIANTS, Variant, component_file
from experiments.methods import load
from experiments.progress import Progress
from experiments.recipes import fit, landmark_lifter
from experiments.records import resumable
from experiments.run import Run
from experiments.studies.pair_training import PairNet

_FROM_THE_SIDE = [2, 1]  # depth and y


def main(run: Run, name: str) -> None:
    method, _, seed = name.partition("-seed")
    train, preset, seed = load_faces(run, "train"), run.preset, int(seed)
    inputs = [run.work / "train.npz", *run.networks.glob("autoencoder-*.npz")]
    folder = resumable(run.work / "component-ablation" / name, inputs)
    checkpoint = folder / "network.npz"
    if method == SIDE_AUTOENCODER:
        recipe = Recipe(preset.autoencoder_epochs, schedule="cosine")
        target = train.shapes[..., _FROM_THE_SIDE]
        with Progress("epoch", recipe.epochs) as progress:
            network, _ = train_autoencoder(
                train.views, target, recipe, seed=seed, checkpoint=checkpoint,
                progress=lambda _: progress.update(),
            )  # fmt: skip
    elif method == LIFTING:
        lifter = landmark_lifter(run).set_params(seed=seed)
        network = fit(lifter, train.views, train.shapes, checkpoint=checkpoint)
    else:
        variant = VARIANTS[method]
        recipe = Recipe(preset.dissimilarity_epochs, preset.dissimilarity_steps, variant.schedule)
        net = build_pair_net(train.views.shape[1], variant, seed=seed)
        pairs = views_of_pairs(variant, train, autoencoder(run, variant.frontal, variant.schedule))
        training = PairNet(net, recipe, seed, variant.shuffled)
        network = fit(training, pairs, train.views, train.shapes, checkpoint=checkpoint).network
    network.save(component_file(run, method, seed))


@functools.cache
def autoencoder(run: Run, frontal: str, schedule: str) -> Callable[[np.ndarray], np.ndarray]:
    """Function from views to the views `(n, L, 2)` whose pairs a `Variant` uses."""
    if frontal != "side":
        return load(run, "deep_mds" if schedule == "constant" else DEEP_MDS).frontalise
    file = component_file(run, SIDE_AUTOENCODER, run.seed)
    network = keras.saving.load_model(file, compile=False)
    return lambda views: forward(network, views.reshape(len(views), -1)).reshape(views.shape)


def views_of_pairs(
    variant: Variant, faces: Faces, autoencoder: Callable[[np.ndarray], np.ndarray]
) -> np.ndarray:
    """Views `(n, L, 2)` whose pairs a net sees, by an `autoencoder` or as they truly are."""
    seen = faces.shapes[..., :2] if variant.frontal == "true" else autoencoder(faces.views)
    return normalise(seen) if variant.rescaled else seen
