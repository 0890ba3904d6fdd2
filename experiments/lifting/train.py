"""Step: trains one network of `hard` or `transfer`, by its name; resumes from its checkpoint."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from data_gen.models.registry import OPEN, load_model, model_files, open_models
from data_gen.views import sample_photo_views
from experiments.lifting.views import CONDITIONS, Condition, training_views
from experiments.recipes import deep_mds, fit, landmark_lifter
from experiments.records import resumable
from experiments.run import Run
from experiments.streams import Stream

SEEDED = "hard_1"  # the condition for which LandmarkLifter is trained from several seeds
DEEP_MDS, LIFTING = "deep_mds_cosine", "landmark_lifter"
TRANSFERRED = (DEEP_MDS, LIFTING)
TRANSFER_SCHEME, BOTH = "ibug51", "both"
_HARD_RATE = 3e-3
_MOST_NOISE_MM = 6.0


def lifting_networks(run: Run, study: str) -> list[str]:
    """Names of the networks of `"hard"` or `"transfer"`, the slow ones first."""
    if study == "transfer":
        return [transfer_name(m, faces) for faces in transfer_models(run) for m in TRANSFERRED]
    files = [hard_file(run, DEEP_MDS, c, run.seed) for c in CONDITIONS if not c.missing]
    files += [hard_file(run, LIFTING, c, seed) for c in CONDITIONS for seed in hard_seeds(run, c)]
    return [*dict.fromkeys(file.stem for file in files)]


def transfer_models(run: Run) -> list[str]:
    """Training faces of `"transfer"`: the run's model and, for the open head, both open models."""
    both = run.model == OPEN[0] and not open_models(run.data)[1]
    return [run.model, BOTH] if both else [run.model]


def transfer_name(method: str, faces: str) -> str:
    """Name of a network of `"transfer"`."""
    return f"transfer-{method}" + f"-{BOTH}" * (faces == BOTH)


def hard_seeds(run: Run, condition: Condition) -> range:
    """Seeds from which LandmarkLifter is trained for a condition."""
    return run.few_seeds[: None if condition.id == SEEDED else 1]


def hard_file(run: Run, method: str, condition: Condition, seed: int) -> Path:
    """Network that a method uses in a condition."""
    return network_file(run, f"hard-{method}-{condition.training.id}-seed{seed}")


def network_file(run: Run, name: str) -> Path:
    return run.work / "lifting" / f"{name}.npz"


def load_network(file: Path):
    """Read a `LandmarkLifter` or a `DeepMDS`, depending on the name of the file."""
    if "deep" not in file.stem:
        from deepmds_keras.lifting.lifter import LandmarkLifter

        return LandmarkLifter.load(file)
    from deepmds_keras.deep_mds import DeepMDS

    return DeepMDS.load(file).set_params(solver="numba", n_jobs=1)


def main(run: Run, name: str) -> None:
    models = OPEN if name.endswith(BOTH) else (run.model,)
    inputs = [file for model in models for file in model_files(model, run.data)]
    folder = resumable(run.work / "lifting" / "checkpoints" / name, inputs)
    checkpoint = folder if DEEP_MDS in name else folder / "network.npz"
    network, data, options = _untrained(run, *name.split("-"))
    fit(network, *data, checkpoint=checkpoint, **options).save(network_file(run, name))


def _untrained(run: Run, study: str, method: str, training: str = "", seed: str = "") -> tuple:
    """A network by the parts of its name, and the arguments and options of its `fit`."""
    if study == "transfer":
        views, shapes, sd = transfer_faces(run, training or run.model)
        if method == DEEP_MDS:
            net = deep_mds(run.on("flame"), "paper", "cosine").set_params(centre_views=True)
            return net, (views, shapes), {}
        lifter = landmark_lifter(run).set_params(n_landmarks=views.shape[1])
        return lifter, (views, shapes), {"landmark_sd": sd}
    condition = next(c.training for c in CONDITIONS if c.training.id == training)
    faces = training_views(run, replace(condition, missing=0.0))
    if method == DEEP_MDS:
        return deep_mds(run, "paper", "cosine"), (faces.views, faces.shapes), {}
    # In each mini-batch other landmarks are missing, as many as other methods learn to fill in.
    lifter = landmark_lifter(run).set_params(
        missing=condition.missing, learning_rate=_HARD_RATE, seed=int(seed.removeprefix("seed"))
    )
    return lifter, (faces.views, faces.shapes), {"landmark_sd": faces.sd_mm}


def transfer_faces(run: Run, faces: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Training faces of a model, or in equal parts of `BOTH` open ones.

    Returns:
        Views `(n, L, 2)` and shapes `(n, L, 3)`, millimetres, and the s.d. of each view's noise.
    """
    rng = np.random.default_rng([run.seed, Stream.TRANSFER_TRAINING])
    sd = _MOST_NOISE_MM * rng.random(run.preset.train_faces) ** 2  # mostly small
    names = OPEN if faces == BOTH else (faces,)
    parts = [
        sample_photo_views(
            load_model(name, run.data, TRANSFER_SCHEME), TRANSFER_SCHEME, len(some), rng,
            detector_sd=some[:, None, None],
        )[:2]
        for name, some in zip(names, np.array_split(sd, len(names)), strict=True)
    ]  # fmt: skip
    views, shapes = map(np.concatenate, zip(*parts, strict=True))
    return views, shapes, sd
