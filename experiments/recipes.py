"""How the compared methods are built, trained and restored.

Frameworks are imported only to build a method: figures and tables need the registry alone.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from data_gen.datasets.dataset import load_dataset
from deepmds_keras.baselines.images import IMAGE_SIZE
from deepmds_keras.files import read_arrays
from deepmds_keras.geometry.units import normalise, rms_radius
from deepmds_keras.landmarks import load_scheme
from experiments.inputs import face_model, load_faces, load_images, load_landmark_model
from experiments.progress import Progress
from experiments.run import AUTHORS_FILES, Run
from experiments.streams import Stream

if TYPE_CHECKING:
    import keras

# The authors train Zhao's net on the first 3,000 of their faces, seen from the front.
_ZHAO_AUTHORS_FACES = 3000
# Largest s.d. of the noise in training that stands for a detector's, in r.m.s. radii of a view.
LANDMARK_NOISE = 0.2
# What methods that are told the noise of a detector expect: 5 % of the interocular distance.
DETECTOR_SD = LANDMARK_NOISE / 2
# MobileFace's learning rate by schedule. With a cosine, 0.002 and 30,000 steps come within 5 % of
# the error of the 100,000 constant steps at 0.001 in the authors' code; 0.001 and 20,000 do not.
MOBILEFACE_RATES = {"cosine": 2e-3, "constant": 1e-3}
_LEAST_PERSPECTIVE_SD = 1e-3  # where all views are orthographic
_LEAST_COMPONENT_SD = 0.003  # of normalised shapes: what is below it moves no landmark visibly
# Of the authors' release, by track.
ZHAO_FILES = dict.fromkeys(("bfm", "celeba"), ("deep_PAMI_occ_5000.h5",))
ZHAO_FILES |= {"flame": ("deep_PAMI_depth_FLAME.h5",)}
MOBILEFACE_FILES = dict.fromkeys(("bfm", "celeba"), ("deep_mobileface_occ.h5",))
_RINGNET = (100, 50)  # identity and expression coefficients that the published RingNet finds


def fit(model, *data, **options):
    """Call `model.fit(*data, **options)`, with the progress of each network that it trains."""
    epochs = _epochs(model)
    bars: dict[str, Progress] = {}

    def progress(*report) -> None:
        *names, losses = report  # only methods with several networks name them
        (name,) = names or epochs
        if name not in bars:
            part = f"{name.replace('_', ' ')}: " if len(epochs) > 1 else ""
            bars[name] = Progress(f"{part}epoch", epochs[name])
        # Mean squares are shown as their roots; RingNet's losses are none.
        power = 1 if name == "RingNet" else 0.5
        bars[name].update(note=", ".join(f"{k} {v**power:.4f}" for k, v in losses.items()))

    model = model.fit(*data, progress=progress, **options)
    for bar in bars.values():
        bar.close()
    return model


def _epochs(model) -> dict[str, int]:
    """Number of reports of `fit`, by network."""
    if hasattr(model, "autoencoder_epochs"):
        return {
            "autoencoder": model.autoencoder_epochs,
            "dissimilarity_net": model.dissimilarity_epochs,
        }
    if hasattr(model, "epochs"):
        return {type(model).__name__: model.epochs}
    from deepmds_keras.lifting.trainer import block_sizes

    return {"LandmarkLifter": len(block_sizes(model.steps))}


# What methods are fitted to


def faces(run: Run) -> tuple[np.ndarray, np.ndarray]:
    """Views `(n, L, 2)` and shapes `(n, L, 3)` of the training faces, normalised."""
    train = load_faces(run, "train")
    return train.views, train.shapes


def faces_with_noise(run: Run) -> tuple[np.ndarray, np.ndarray]:
    """`faces`, on the FLAME track with landmark noise, since its test views are a detector's.

    Each face draws an s.d. up to `LANDMARK_NOISE`, as in the training of the lifting network.
    """
    views, shapes = faces(run)
    if run.track != "flame":
        return views, shapes
    rng = np.random.default_rng([run.seed, Stream.LANDMARK_NOISE])
    sd = LANDMARK_NOISE * rng.random(len(views)) * rms_radius(views)
    return normalise(views + sd[:, None, None] * rng.standard_normal(views.shape)), shapes


def posed_faces(run: Run) -> tuple[np.ndarray]:
    """Views of the training faces and, in their unit, depth: `(n, L, 3)`."""
    return (load_faces(run, "train").posed,)


def frontal_faces(run: Run) -> tuple[np.ndarray]:
    """Frontal training faces, as many as the authors train Zhao's net on."""
    return (load_faces(run, "train").shapes[:_ZHAO_AUTHORS_FACES],)


# Without a training step


def mean_shape(run: Run):
    from deepmds_keras.baselines.closed_form import MeanShape

    return MeanShape()


def ridge(run: Run, *, roll_aligned: bool = False):
    from deepmds_keras.baselines.closed_form import RidgeRegression

    return RidgeRegression(roll_aligned=roll_aligned)


def aldrian(run: Run):
    from deepmds_keras.baselines.closed_form import Aldrian

    return Aldrian(*load_landmark_model(run))


def aldrian_authors(run: Run):
    """The fit as the authors ran it, in micrometres, the unit of their face model."""
    from deepmds_keras.baselines.closed_form import AldrianAuthors

    sd = face_model(run).component_sd
    mean, basis = load_landmark_model(run)
    return AldrianAuthors(1000 * mean, 1000 * basis, 1000 * sd)


def map_fit(run: Run):
    """The fit that knows the face model, and how far away the cameras of the training views are."""
    fields_of_view = load_faces(run, "train").cameras.field_of_view
    return map_fit_of(*load_landmark_model(run), fields_of_view)


class LearntMapFit:
    """Fit of the principal components of the training faces, told the noise of a detector."""

    def __init__(self, run: Run):
        from deepmds_keras.baselines.map_fit import principal_components

        train = load_faces(run, "train")
        mean, basis = principal_components(train.shapes, _LEAST_COMPONENT_SD)
        self._fit = map_fit_of(mean, basis, train.cameras.field_of_view)
        self.n_parameters = mean.size + basis.size

    def predict(self, views: np.ndarray) -> np.ndarray:
        return self._fit.predict(views, DETECTOR_SD * rms_radius(views))


def map_fit_of(mean: np.ndarray, basis: np.ndarray, fields_of_view: np.ndarray):
    """The fit of a face model whose prior of the perspective is that of cameras."""
    from deepmds_keras.baselines.map_fit import MapFit
    from deepmds_keras.geometry.views import perspectives

    known = perspectives(fields_of_view, mean)
    prior = float(known.mean()), max(float(known.std()), _LEAST_PERSPECTIVE_SD)
    return MapFit(mean, basis, perspective=prior)


class MediaPipe:
    """MediaPipe's face mesh, read by a list of points: `"authors"` or `"corrected"`.

    In the latter the left brow is where it should be.
    """

    def __init__(self, run: Run, points: str):
        self.points = points

    def predict(self, photos: np.ndarray) -> np.ndarray:
        """Landmarks `(n, 51, 3)` in pixels; NaN where no face is found."""
        from deepmds_keras.tool.detection.mediapipe_landmarks import detect, landmarks51

        return landmarks51(detect(photos), self.points)


# The paper's method


def deep_mds(run: Run, variant: str, schedule: str):
    """The untrained method, of the landmarks and sizes of a run."""
    from deepmds_keras.deep_mds import DeepMDS

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


def restore_deep_mds(run: Run, model, checkpoint: Path):
    """Load both networks; on the FLAME track, views need not be centred.

    Its training views are centred already, except in the released protocol.
    """
    centred = run.track == "flame" and run.protocol != "released"
    model.restore(checkpoint, load_faces(run, "train").shapes)
    return model.set_params(centre_views=centred)  # which training did not


def deep_mds_weights(run: Run):
    """The authors' released networks."""
    from deepmds_keras.deep_mds import DeepMDS

    files = (Path(run.authors, name) for name in AUTHORS_FILES[run.track])
    model = DeepMDS.from_released(*files, n_landmarks=len(load_scheme(run.scheme)))
    return model.set_params(n_jobs=run.jobs, solver="sklearn")


def deep_mds_networks(variant: str, n_landmarks: int, n_coefficients: int) -> list[keras.Model]:
    """Build both networks, to count their parameters."""
    from deepmds_keras.networks import build_autoencoder, build_dissimilarity_net

    return [build_autoencoder(n_landmarks), build_dissimilarity_net(variant)]


# Other networks that see views


def landmark_lifter(run: Run):
    """The small lifting network.

    On the FLAME track it trains with noise as in `faces_with_noise`, redrawn in each mini-batch.
    """
    from deepmds_keras.lifting.lifter import LandmarkLifter

    return LandmarkLifter(
        len(load_scheme(run.scheme)),
        steps=run.preset.lifting_steps,
        noise=LANDMARK_NOISE if run.track == "flame" else 0.0,
        seed=run.seed,
    )


def load_landmark_lifter(run: Run, model, checkpoint: Path):
    """Load the best weights; the checkpoint holds the last ones."""
    lifter = type(model).load(run.network_file("landmark_lifter"))
    if run.track == "flame":  # a detector's errors exceed those of good landmarks
        lifter.default_sd_ = DETECTOR_SD
    return lifter


def mlp(run: Run, n_landmarks: int | None = None):
    """The MLP, for the run's landmarks trained for as many steps as `landmark_lifter`."""
    from deepmds_keras.baselines.mlp import MLP

    steps = -(-run.preset.lifting_steps // MLP.epochs)
    n_landmarks = n_landmarks or len(load_scheme(run.scheme))
    return MLP(n_landmarks, steps_per_epoch=steps, seed=run.seed)


def zhao(run: Run, *, as_authors: bool = False):
    """Zhao's net, trained by Adam or, as the authors did, by RMSprop."""
    from deepmds_keras.baselines.zhao import Zhao

    as_authors = as_authors or run.protocol == "released"
    return Zhao(
        len(load_scheme(run.scheme)),
        optimizer="rmsprop" if as_authors else "adam",
        epochs=run.preset.zhao_authors_epochs if as_authors else run.preset.zhao_epochs,
        steps_per_epoch=run.preset.zhao_steps,
        seed=run.seed,
    )


def zhao_weights(run: Run):
    """Zhao's net with the authors' weights, whose output is in metres on the FLAME track."""
    import keras

    from deepmds_keras.baselines.zhao import Zhao, normalise_view

    model = Zhao(len(load_scheme(run.scheme)))
    model.load_released(Path(run.authors, *ZHAO_FILES[run.track]))
    if run.track == "flame":
        mean = load_dataset(run.work / "train.npz").landmarks.mean(0)
        metres, net = normalise_view(mean[None, :, :2])[1].item() / 1000, model.network_
        model.network_ = keras.Model(net.input, net.output / metres, name=net.name)
    return model


# Networks that see images


def mobileface_schedule(run: Run) -> tuple[str, int]:
    """Schedule of the learning rate and epochs."""
    if run.mobileface == "paper":
        return "constant", run.preset.mobileface_paper_epochs
    return "cosine", run.preset.mobileface_epochs


def mobileface(run: Run):
    from deepmds_keras.baselines.mobileface import MobileFace

    schedule, epochs = mobileface_schedule(run)
    landmark_model, _ = read_arrays(run.work / "landmark_model.npz")
    return MobileFace(
        *load_landmark_model(run),
        landmark_model["shape_gram"],
        standardise="batch" if run.protocol == "released" else "face",
        schedule=schedule,
        learning_rate=MOBILEFACE_RATES[schedule],
        epochs=epochs,
        steps_per_epoch=run.preset.mobileface_steps,
        seed=run.seed,
    )


def mobileface_weights(run: Run):
    """MobileFace with the authors' weights, for coefficients of the Basel model of 2009."""
    from deepmds_keras.baselines.mobileface import MobileFace

    model = MobileFace(*load_landmark_model(run), None)
    return model.load_released(Path(run.authors, *MOBILEFACE_FILES[run.track]))


def mobileface_data(run: Run) -> tuple:
    """Images of training faces, and coefficients of each, `(n, K)`."""
    images = load_images(run, "train")
    return images, load_dataset(run.work / "train.npz").identity[: len(images)]


def mobileface_file(run: Run) -> Path:
    # Kept apart from the networks that see views, which are deleted if the views change.
    return run.work / "mobileface" / f"{run.mobileface}.npz"


def mobileface_networks(n_landmarks: int, n_coefficients: int) -> list[keras.Model]:
    """Build the network, to count its parameters."""
    from deepmds_keras.baselines.mobileface import build_mobileface_net

    return [build_mobileface_net(n_coefficients)]


def ringnet(run: Run):
    from deepmds_keras.baselines.ringnet import RingNet

    landmark_model, _ = read_arrays(run.work / "landmark_model.npz")
    return RingNet(
        landmark_model["mean"],
        landmark_model["identity_basis_times_sd"],
        landmark_model["expression_basis"],
        image_size=IMAGE_SIZE,
        epochs=run.preset.ringnet_epochs,
        steps_per_epoch=run.preset.ringnet_steps,
        seed=run.seed,
    )


def ringnet_licensed(run: Run):
    """The published network, whose checkpoint was given, with its landmarks on FLAME's mesh."""
    from data_gen.models.flame import load_embedding, read_flame
    from data_gen.models.registry import model_files
    from deepmds_keras.baselines.ringnet_released import ReleasedRingNet

    flame, landmarks = model_files("flame", run.data)
    embedding = load_embedding(landmarks)
    corners = read_flame(flame)["f"][embedding.triangles]
    return ReleasedRingNet(run.ringnet, corners, embedding.weights)


def ringnet_data(run: Run) -> tuple:
    """Images of people, the landmarks `(n, L, 2)` in them, and the person in each, `(n,)`."""
    images = load_images(run, "rings")
    subjects = np.arange(len(images)) // run.preset.ring_images
    return images, images.landmarks(), subjects


def ringnet_file(run: Run) -> Path:
    return run.work / "ringnet" / "ringnet.npz"


def ringnet_networks(n_landmarks: int, n_coefficients: int) -> list[keras.Model]:
    """Build the published network, to count its parameters."""
    from deepmds_keras.baselines.ringnet import build_ringnet

    return [build_ringnet(*_RINGNET)]
