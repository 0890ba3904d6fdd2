"""How each network of the experiment is trained; one whose file is complete is only loaded."""

from __future__ import annotations

import keras

from data_gen.datasets.dataset import load_dataset
from data_gen.models.flame import read_flame
from data_gen.models.flame_embedding import embedding_near
from deepmds_keras.baselines.mobileface import MobileFace
from deepmds_keras.baselines.ringnet import RingNet
from deepmds_keras.baselines.ringnet_released import ReleasedRingNet
from deepmds_keras.baselines.zhao import Zhao
from deepmds_keras.io.archives import read_arrays
from deepmds_keras.io.errors import InputError
from deepmds_keras.networks import forward
from deepmds_keras.orientation import front_landmark
from deepmds_keras.photos import IMAGE_SIZE
from deepmds_keras.pipeline import DeepMDS
from deepmds_keras.training import Recipe, train_autoencoder, train_dissimilarity_net
from experiments.inputs import Faces, load_images, load_landmark_model, load_rings, load_shape_gram
from experiments.methods import DEEP_MDS, network_names
from experiments.progress import EpochBar
from experiments.run import Run

# The authors train Zhao's net on the first 3,000 of their faces, seen from the front.
_ZHAO_AUTHORS_FACES = 3000


def autoencoder(run: Run, train: Faces, method: str) -> tuple[keras.Model, dict]:
    """The autoencoder and its losses by epoch."""
    name, schedule = network_names(method)["autoencoder"], DEEP_MDS[method][1]
    epochs = run.preset.autoencoder_epochs
    with EpochBar(name, epochs) as bar:
        return train_autoencoder(
            train.views,
            train.shapes[..., :2],
            Recipe(epochs, schedule=schedule),
            seed=run.seed,
            checkpoint=run.network_file(name),
            progress=bar.losses,
        )


def dissimilarity_net(
    run: Run, train: Faces, encoder: keras.Model, method: str
) -> tuple[keras.Model, dict]:
    """The dissimilarity net on the autoencoder's frontal views, and its losses by epoch."""
    name, (variant, schedule) = network_names(method)["dissimilarity_net"], DEEP_MDS[method]
    preset = run.preset
    flat = train.views.reshape(len(train.views), -1)
    frontal = forward(encoder, flat).reshape(train.views.shape)
    with EpochBar(name, preset.dissimilarity_epochs) as bar:
        return train_dissimilarity_net(
            frontal,
            train.shapes,
            Recipe(preset.dissimilarity_epochs, preset.dissimilarity_steps, schedule),
            variant=variant,
            seed=run.seed,
            checkpoint=run.network_file(name),
            progress=bar.losses,
        )


def deep_mds(run: Run, train: Faces, method: str) -> tuple[DeepMDS, dict[str, dict]]:
    """One of `DEEP_MDS`, trained, and its losses by network and epoch."""
    variant, schedule = DEEP_MDS[method]
    encoder, first = autoencoder(run, train, method)
    net, second = dissimilarity_net(run, train, encoder, method)
    model = DeepMDS.from_networks(
        encoder,
        net,
        front_landmark(train.shapes),
        n_landmarks=train.views.shape[1],
        variant=variant,
        centre_views=run.track == "flame" and run.protocol == "paper",
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
    with EpochBar(method, preset.zhao_epochs) as bar:
        return net.fit(points, checkpoint=run.network_file(method), progress=bar.losses)


def mobileface(run: Run) -> MobileFace:
    """MobileFace on the run's images, standardising as the run's protocol does."""
    images = load_images(run, "train")
    preset = run.preset
    model = MobileFace(
        *load_landmark_model(run),
        load_shape_gram(run),
        standardise="batch" if run.protocol == "released" else "face",
        epochs=preset.mobileface_epochs,
        steps_per_epoch=preset.mobileface_steps,
        seed=run.seed,
    )
    with EpochBar("mobileface", preset.mobileface_epochs) as bar:
        return model.fit(
            images,
            load_dataset(run.work / "train.npz").identity[: len(images)],
            checkpoint=run.network_file("mobileface"),
            progress=bar.losses,
        )


def ringnet(run: Run) -> RingNet:
    """RingNet on the run's images of people."""
    arrays, _ = read_arrays(run.work / "landmark_model.npz")
    preset = run.preset
    model = RingNet(
        arrays["mean"],
        arrays["identity_basis_times_sd"],
        arrays["expression_basis"],
        image_size=IMAGE_SIZE,
        epochs=preset.ringnet_epochs,
        steps_per_epoch=preset.ringnet_steps,
        seed=run.seed,
    )
    with EpochBar("ringnet", preset.ringnet_epochs) as bar:
        return model.fit(
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
