"""Recipes: the compared methods are trained and, once they are, loaded.

Nothing of TensorFlow or scikit-learn is imported before a method is asked for: the registry of the
methods, which the figures and the report read too, names these functions.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from data_gen.datasets.dataset import load_dataset
from data_gen.models.flame import read_flame
from data_gen.models.flame_embedding import embedding_near
from deepmds_keras.io.archives import read_arrays
from deepmds_keras.io.errors import InputError
from deepmds_keras.landmarks import load_scheme
from deepmds_keras.photos import IMAGE_SIZE
from experiments.inputs import (
    load_faces,
    load_images,
    load_landmark_model,
    load_rings,
    load_shape_gram,
)
from experiments.progress import EpochBar
from experiments.run import AUTHORS_FILES, Run

if TYPE_CHECKING:
    import keras
    import numpy as np

    from deepmds_keras.baselines.aldrian import Aldrian
    from deepmds_keras.baselines.aldrian_authors import AldrianAuthors
    from deepmds_keras.baselines.linear import Linear
    from deepmds_keras.baselines.mean_shape import MeanShape
    from deepmds_keras.baselines.mobileface import MobileFace
    from deepmds_keras.baselines.ringnet import RingNet
    from deepmds_keras.baselines.ringnet_released import ReleasedRingNet
    from deepmds_keras.baselines.zhao import Zhao
    from deepmds_keras.lifting.lifter import LandmarkLifter
    from deepmds_keras.pipeline import DeepMDS

# The authors train Zhao's net on the first 3,000 of their faces, seen from the front.
_ZHAO_AUTHORS_FACES = 3000
# Largest s.d. of the errors from which the lifting network learns what a detector does, in r.m.s.
# radii of a view. Half of it, which it then expects, is 5 % of the interocular distance.
LIFTING_NOISE = 0.2
_RINGNET = (100, 50)  # identity and expression coefficients that the published RingNet finds


@contextmanager
def _trained_by(run: Run, stage: str) -> Iterator[None]:
    """Name the stage to run where what it trains cannot be restored."""
    try:
        yield
    except InputError as error:
        raise InputError(
            f"{error} Run the stage {stage} (make reproduce-{run.track}) to train it."
        ) from None


def any_way_up(model):
    """The model, which refuses no view: the audit leans heads by 90 degrees.

    Its class is another one, so that a copy with other networks predicts by these.
    """
    kind = type(model)

    def predict(self, views, **options):
        return kind.predict(self, views, **{"check_orientation": False} | options)

    model.__class__ = type(kind.__name__, (kind,), {"predict": predict})
    return model


def load_mean_shape(run: Run) -> MeanShape:
    """Return the mean of the training shapes."""
    from deepmds_keras.baselines.mean_shape import MeanShape

    train = load_faces(run, "train")
    return MeanShape().fit(train.views, train.shapes)


def load_linear(run: Run) -> Linear:
    """Return the regression, which is solved in closed form: there is nothing to keep."""
    from deepmds_keras.baselines.linear import Linear

    train = load_faces(run, "train")
    return Linear().fit(train.views, train.shapes)


def load_aldrian(run: Run) -> Aldrian:
    """Return the fit of the run's face model."""
    from deepmds_keras.baselines.aldrian import Aldrian

    return Aldrian(*load_landmark_model(run))


def load_aldrian_authors(run: Run) -> AldrianAuthors:
    """Return the fit as the authors ran it, in micrometres, the unit of their face model."""
    import numpy as np

    from data_gen.models.registry import load_model
    from deepmds_keras.baselines.aldrian_authors import AldrianAuthors

    model = load_model(run.model, run.data)
    # The basis is orthonormal over the mesh, so that a component's s.d. is the norm of its offsets.
    sd = np.linalg.norm(model.identity_basis_times_sd.reshape(model.n_identity, -1), axis=1)
    mean, basis = load_landmark_model(run)
    return AldrianAuthors(1000 * mean, 1000 * basis, 1000 * sd)


# The paper's method


def deep_mds(run: Run, variant: str, schedule: str) -> DeepMDS:
    """The untrained method, of the landmarks and sizes of a run."""
    from deepmds_keras.pipeline import DeepMDS

    return DeepMDS(
        len(load_scheme(run.scheme)),
        variant,
        schedule=schedule,
        autoencoder_epochs=run.preset.autoencoder_epochs,
        dissimilarity_epochs=run.preset.dissimilarity_epochs,
        dissimilarity_steps=run.preset.dissimilarity_steps,
        seed=run.seed,
        solver="sklearn",  # the paper's rows are scikit-learn's own
        n_jobs=run.jobs,
    )


def fit_deep_mds(model: DeepMDS, views: np.ndarray, shapes: np.ndarray, **options) -> DeepMDS:
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


def train_deep_mds(run: Run, variant: str, schedule: str) -> DeepMDS:
    """Train both networks; a data set has centred its views already if they are to be."""
    model, train = deep_mds(run, variant, schedule), load_faces(run, "train")
    return fit_deep_mds(model, train.views, train.shapes, checkpoint=run.networks)


def load_deep_mds(run: Run, variant: str, schedule: str) -> DeepMDS:
    """Return the method as trained, for views that need not be centred on the FLAME track."""
    centred = run.track == "flame" and run.protocol != "released"
    model = deep_mds(run, variant, schedule).set_params(centre_views=centred)
    with _trained_by(run, "networks"):
        return any_way_up(model.restore(run.networks, load_faces(run, "train").shapes))


def load_authors_weights(run: Run) -> DeepMDS:
    """Return the authors' released networks."""
    from deepmds_keras.pipeline import DeepMDS

    files = (Path(run.authors, name) for name in AUTHORS_FILES[run.track])
    model = DeepMDS.from_released(*files, n_landmarks=len(load_scheme(run.scheme)))
    return any_way_up(model.set_params(n_jobs=run.jobs, solver="sklearn"))


def deep_mds_networks(variant: str, n_landmarks: int, n_coefficients: int = 0) -> list[keras.Model]:
    """Build both networks, to count their parameters."""
    from deepmds_keras.networks import build_autoencoder, build_dissimilarity_net

    return [build_autoencoder(n_landmarks), build_dissimilarity_net(variant)]


# The lifting network


def fit_lifter(lifter: LandmarkLifter, views, shapes=None, **options) -> LandmarkLifter:
    """`LandmarkLifter.fit`, with a progress bar."""
    from deepmds_keras.lifting.training import Recipe

    with EpochBar(f"lifting {lifter.size}", len(Recipe(lifter.steps).blocks)) as bar:

        def progress(losses: dict[str, float]) -> None:
            bar.losses({"held_out": losses["held_out"]})

        return lifter.fit(views, shapes, progress=progress, **options)


def train_lifting(run: Run) -> LandmarkLifter:
    """Train the small network on the views of everybody else.

    On the FLAME track test views are what a detector finds, those in training exact: errors are
    added, else it takes any for a trait of the face.
    """
    from deepmds_keras.lifting.lifter import LandmarkLifter

    train = load_faces(run, "train")
    lifter = LandmarkLifter(
        len(load_scheme(run.scheme)),
        steps=run.preset.lifting_steps,
        noise=LIFTING_NOISE if run.track == "flame" else 0.0,
        seed=run.seed,
    )
    checkpoint = run.network_file("lifting-checkpoint")
    fit_lifter(lifter, train.views, train.shapes, checkpoint=checkpoint)
    lifter.save(run.network_file("lifting"))
    return lifter


def load_lifting(run: Run) -> LandmarkLifter:
    """Return the network as trained."""
    from deepmds_keras.lifting.lifter import LandmarkLifter

    with _trained_by(run, "networks"):
        return any_way_up(LandmarkLifter.load(run.network_file("lifting")))


# Zhao's net


def _zhao(run: Run, name: str) -> Zhao:
    from deepmds_keras.baselines.zhao import Zhao

    released = name == "zhao_authors" or run.protocol == "released"
    return Zhao(
        len(load_scheme(run.scheme)),
        optimizer="rmsprop" if released else "adam",
        epochs=run.preset.zhao_epochs,
        steps_per_epoch=run.preset.zhao_steps,
        seed=run.seed,
    )


def train_zhao(run: Run, name: str) -> Zhao:
    """Train `"zhao"` on the views of everybody else, `"zhao_authors"` as the authors did."""
    train = load_faces(run, "train")
    points = train.posed if name == "zhao" else train.shapes[:_ZHAO_AUTHORS_FACES]
    with EpochBar(name, run.preset.zhao_epochs) as bar:
        return _zhao(run, name).fit(points, checkpoint=run.network_file(name), progress=bar.losses)


def load_zhao(run: Run, name: str) -> Zhao:
    """Return the net as trained."""
    with _trained_by(run, "networks"):
        return _zhao(run, name).restore(run.network_file(name))


# MobileFace, which sees images


# Of MobileFace by its schedule. With a cosine 0.002 and 30,000 steps come within 5 % of the error
# of the 100,000 constant steps at 0.001 that the authors' code makes; 0.001 and 20,000 do not.
MOBILEFACE_RATES = {"cosine": 2e-3, "constant": 1e-3}


def mobileface_recipe(run: Run) -> tuple[str, int]:
    """Schedule of the learning rate and epochs."""
    preset = run.preset
    return {
        "cosine": ("cosine", preset.mobileface_epochs),
        "paper": ("constant", preset.mobileface_paper_epochs),
    }[run.mobileface]


def mobileface_file(run: Run) -> Path:
    """Checkpoint."""
    return run.network_file(f"mobileface-{run.mobileface}")


def _mobileface(run: Run) -> MobileFace:
    from deepmds_keras.baselines.mobileface import MobileFace

    schedule, epochs = mobileface_recipe(run)
    return MobileFace(
        *load_landmark_model(run),
        load_shape_gram(run),
        standardise="batch" if run.protocol == "released" else "face",
        schedule=schedule,
        learning_rate=MOBILEFACE_RATES[schedule],
        epochs=epochs,
        steps_per_epoch=run.preset.mobileface_steps,
        seed=run.seed,
    )


def train_mobileface(run: Run) -> MobileFace:
    """Train on the run's images."""
    images = load_images(run, "train")
    with EpochBar("mobileface", mobileface_recipe(run)[1]) as bar:
        return _mobileface(run).fit(
            images,
            load_dataset(run.work / "train.npz").identity[: len(images)],
            checkpoint=mobileface_file(run),
            progress=bar.losses,
        )


def load_mobileface(run: Run) -> MobileFace:
    """Return the net as trained."""
    with _trained_by(run, "mobileface"):
        return _mobileface(run).restore(mobileface_file(run))


def mobileface_networks(n_landmarks: int, n_coefficients: int) -> list[keras.Model]:
    """Build the network, to count its parameters."""
    from deepmds_keras.baselines.mobileface import build_mobileface_net

    return [build_mobileface_net(n_coefficients)]


# RingNet, which sees photos


def _ringnet(run: Run) -> RingNet:
    from deepmds_keras.baselines.ringnet import RingNet

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
    """Train on the run's images of people."""
    with EpochBar("ringnet", run.preset.ringnet_epochs) as bar:
        return _ringnet(run).fit(
            *load_rings(run), checkpoint=run.network_file("ringnet"), progress=bar.sums
        )


def load_ringnet(run: Run) -> RingNet | ReleasedRingNet:
    """Return the licensed RingNet if it was given, or ours as trained."""
    if run.ringnet is None:
        with _trained_by(run, "ringnet"):
            return _ringnet(run).restore(run.network_file("ringnet"))
    if run.data is None:
        raise InputError(
            "DATA= must be the folder of FLAME, on whose mesh the licensed RingNet has its "
            "landmarks. Received none."
        )
    from deepmds_keras.baselines.ringnet_released import ReleasedRingNet

    embedding = embedding_near(run.data)
    corners = read_flame(run.data).triangles[embedding.triangles]
    return ReleasedRingNet(run.ringnet, corners, embedding.weights)


def ringnet_networks(n_landmarks: int, n_coefficients: int) -> list[keras.Model]:
    """Build the published network, to count its parameters."""
    from deepmds_keras.baselines.ringnet_net import build_ringnet

    return [build_ringnet(*_RINGNET)]
