"""Stage of RingNet: images of people, several of each, in all expressions and poses."""

from __future__ import annotations

from functools import cache

import numpy as np

from data_gen.datasets.dataset import save_dataset
from data_gen.datasets.images import Scene, make_scene
from data_gen.datasets.rings import make_rings
from data_gen.models.expressions import sample_expressions
from data_gen.models.morphable_model import MorphableModel
from data_gen.models.registry import load_model
from deepmds_keras.io.archives import write_arrays
from deepmds_keras.photos import IMAGE_SIZE
from experiments.arguments import parse_run
from experiments.inputs import CROP_MARGIN, ring_files
from experiments.run import Run
from experiments.running import stage
from experiments.streams import Stream
from experiments.tracks.bfm.images import make_images

_N_IDENTITY = 100  # leading components that RingNet estimates, as many as the published one


def make_people(run: Run, model: MorphableModel) -> None:
    """Write the data set `rings.npz`, and the model of the landmarks that RingNet estimates."""
    preset = run.preset
    landmarks = model.restrict(model.landmarks[run.scheme])
    write_arrays(
        run.work / "landmark_model.npz",
        {
            "mean": landmarks.mean,
            "identity_basis_times_sd": landmarks.identity_basis_times_sd[:_N_IDENTITY],
            "expression_basis": landmarks.expression_basis,
        },
        {"model": model.name},
    )
    rng = np.random.default_rng([run.seed, Stream.RINGS])
    expressions = sample_expressions(model, preset.ring_subjects * preset.ring_images, rng)
    dataset = make_rings(
        model,
        preset.ring_subjects,
        preset.ring_images,
        expressions,
        rng,
        scheme=run.scheme,
        protocol=run.protocol,
    )
    save_dataset(run.work / "rings.npz", dataset)


def scene_of(run: Run) -> Scene:
    """Scene in which people are drawn for RingNet."""
    return make_scene(_model(run), run.scheme, IMAGE_SIZE, margin=CROP_MARGIN, expressive=True)


@cache  # a run that goes on may need it neither for people nor for images
def _model(run: Run) -> MorphableModel:
    return load_model(run.model, run.data, run.scheme)


def main(arguments: list[str] | None = None) -> None:
    run = parse_run(__doc__, arguments)
    with stage(run, "rings") as record:
        if not (run.work / "rings.npz").exists():
            make_people(run, _model(run))
        record["checksums"] = make_images(
            run, {"rings": ring_files(run)}, lambda part: (run.seed, Stream.RING_IMAGES), scene_of
        )
