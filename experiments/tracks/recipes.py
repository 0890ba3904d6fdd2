"""How each network of the experiment is trained, and loaded once it is."""

from __future__ import annotations

import numpy as np

from data_gen.datasets.dataset import load_dataset
from data_gen.models.flame import read_flame
from data_gen.models.flame_embedding import embedding_near
from deepmds_keras.baselines.mobileface import MobileFace
from deepmds_keras.baselines.ringnet import RingNet
from deepmds_keras.baselines.ringnet_released import ReleasedRingNet
from deepmds_keras.baselines.zhao import Zhao
from deepmds_keras.io.archives import read_arrays
from deepmds_keras.io.errors import InputError
from deepmds_keras.landmarks import load_scheme
from deepmds_keras.photos import IMAGE_SIZE
from deepmds_keras.pipeline import DeepMDS
from experiments.inputs import Faces, load_images, load_landmark_model, load_rings, load_shape_gram
from experiments.methods import DEEP_MDS
from experiments.progress import EpochBar
from experiments.run import Run

# The authors train Zhao's net on the first 3,000 of their faces, seen from the front.
_ZHAO_AUTHORS_FACES = 3000


def deep_mds(run: Run, method: str) -> DeepMDS:
    """One of `DEEP_MDS` with the sizes of the run, not trained yet."""
    variant, schedule = DEEP_MDS[method]
    return DeepMDS(
        len(load_scheme(run.scheme)),
        variant,
        schedule=schedule,
        autoencoder_epochs=run.preset.autoencoder_epochs,
        dissimilarity_epochs=run.preset.dissimilarity_epochs,
        dissimilarity_steps=run.preset.dissimilarity_steps,
        seed=run.seed,
        n_jobs=run.jobs,
    )


def fit(model: DeepMDS, views: np.ndarray, shapes: np.ndarray, **options) -> DeepMDS:
    """`DeepMDS.fit`, with a progress bar for each network."""
    epochs = {
        "autoencoder": model.autoencoder_epochs,
        "dissimilarity_net": model.dissimilarity_epochs,
    }
    bars: dict[str, EpochBar] = {}

    def progress(name: str, losses: dict[str, float]) -> None:
        if name not in bars:
            bars[name] = EpochBar(f"{name} {model.variant} {model.schedule}", epochs[name])
        bars[name].losses(losses)
        if bars[name].n == epochs[name]:
            bars[name].close()

    return model.fit(views, shapes, progress=progress, **options)


def train_deep_mds(run: Run, train: Faces, method: str) -> DeepMDS:
    """One of `DEEP_MDS`, trained; a data set has centred its views already if they are to be."""
    return fit(deep_mds(run, method), train.views, train.shapes, checkpoint=run.networks)


def load_deep_mds(run: Run, train: Faces, method: str) -> DeepMDS:
    """One of `DEEP_MDS` as the stage of the networks left it."""
    centred = run.track == "flame" and run.protocol == "paper"
    model = deep_mds(run, method).set_params(centre_views=centred)
    return model.restore(run.networks, train.shapes)


def zhao(run: Run) -> Zhao:
    """Zhao's net with the sizes of the run, not trained yet."""
    return Zhao(
        len(load_scheme(run.scheme)),
        epochs=run.preset.zhao_epochs,
        steps_per_epoch=run.preset.zhao_steps,
        seed=run.seed,
    )


def train_zhao(run: Run, train: Faces, method: str) -> Zhao:
    """Train `"zhao"` on the views of everybody else, `"zhao_authors"` as the authors did."""
    points = train.posed if method == "zhao" else train.shapes[:_ZHAO_AUTHORS_FACES]
    with EpochBar(method, run.preset.zhao_epochs) as bar:
        return zhao(run).fit(points, checkpoint=run.network_file(method), progress=bar.losses)


def mobileface(run: Run) -> MobileFace:
    """MobileFace with the sizes of the run, standardising as its protocol does; not trained yet."""
    return MobileFace(
        *load_landmark_model(run),
        load_shape_gram(run),
        standardise="batch" if run.protocol == "released" else "face",
        epochs=run.preset.mobileface_epochs,
        steps_per_epoch=run.preset.mobileface_steps,
        seed=run.seed,
    )


def train_mobileface(run: Run) -> MobileFace:
    """MobileFace, trained on the run's images."""
    images = load_images(run, "train")
    with EpochBar("mobileface", run.preset.mobileface_epochs) as bar:
        return mobileface(run).fit(
            images,
            load_dataset(run.work / "train.npz").identity[: len(images)],
            checkpoint=run.network_file("mobileface"),
            progress=bar.losses,
        )


def ringnet(run: Run) -> RingNet:
    """RingNet with the sizes of the run, not trained yet."""
    arrays, _ = read_arrays(run.work / "landmark_model.npz")
    return RingNet(
        arrays["mean"],
        arrays["identity_basis_times_sd"],
        arrays["expression_basis"],
        image_size=IMAGE_SIZE,
        epochs=run.preset.ringnet_epochs,
        steps_per_epoch=run.preset.ringnet_steps,
        seed=run.seed,
    )


def train_ringnet(run: Run) -> RingNet:
    """RingNet, trained on the run's images of people."""
    with EpochBar("ringnet", run.preset.ringnet_epochs) as bar:
        return ringnet(run).fit(
            *load_rings(run), checkpoint=run.network_file("ringnet"), progress=bar.sums
        )


def released_ringnet(run: Run) -> ReleasedRingNet:
    """The licensed RingNet; FLAME's landmarks on its meshes."""
    if run.data is None:
        raise InputError(
            "DATA= must be the folder of FLAME, on whose mesh the licensed RingNet has its "
            "landmarks. Received none."
        )
    embedding = embedding_near(run.data)
    corners = read_flame(run.data).triangles[embedding.triangles]
    return ReleasedRingNet(run.ringnet, corners, embedding.weights)
