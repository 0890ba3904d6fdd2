"""No two data sets share a person: none that trains with one that tests, in the arrays of a run.

People are told apart by their landmarks without expression, wherever the arrays come from.
"""

from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest
import runs

from data_gen.datasets.dataset import load_dataset
from deepmds_keras.files import read_arrays
from experiments.inputs import face_model
from experiments.lifting import transfer
from experiments.lifting.train import transfer_faces
from experiments.lifting.views import CONDITIONS, hard_views, training_views
from experiments.presets import TINY
from experiments.run import Run
from experiments.studies import stream_part

RUN = replace(Run(), preset=TINY)
LEAST_MM = 0.3  # between two people, at the landmark where they differ most


def people(identity, run):
    """Landmarks `(n, L, 3)` of the faces, or of the people in several of them."""
    model = face_model(run)
    identity = np.unique(identity, axis=0).astype(float)
    return model.at_landmarks(run.scheme).shape(identity)


@pytest.fixture(scope="module")
def streamed():
    """Coefficients of the faces in the first two shards of the stream."""
    drawn = []

    def make_dataset(*arguments, **options):
        drawn.append(stream_make_dataset(*arguments, **options).identity)
        raise InterruptedError  # before anything is predicted

    stream_make_dataset = stream_part.make_dataset
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(stream_part, "make_dataset", make_dataset)
        for file, faces in [*stream_part.shards(RUN).items()][:2]:
            with pytest.raises(InterruptedError):
                stream_part.write_shard(RUN, file, faces, face_model(RUN), {})
    return drawn


def of_bfm(whole_bfm, whole_celeba, streamed):
    """Faces of the BFM track and of what is trained or tested with its methods or its model."""
    work, photos = runs.work(whole_bfm, "bfm"), runs.work(whole_celeba, "celeba") / "photos.npz"
    sets = {part: load_dataset(work / f"{part}.npz").landmarks for part in ("train", "test")}
    sets["photos"] = read_arrays(photos)[0]["truth"]
    sets |= {f"shard {k}": people(identity, RUN) for k, identity in enumerate(streamed)}
    for condition in CONDITIONS[:2]:  # one of each protocol; the others have the same faces
        sets[f"{condition.protocol} training"] = training_views(RUN, condition.training).shapes
        sets[f"{condition.protocol} tests"] = hard_views(RUN, condition).shapes
    return sets


def of_flame(whole_flame):
    """Frames, which start and end neutral, the people of the rings, and scans of neutral faces."""
    work = runs.work(whole_flame, "flame")
    scans, _ = read_arrays(work / "scans.npz")
    sets = {
        "frames": load_dataset(work / "train.npz").landmarks,
        "rings": people(load_dataset(work / "rings.npz").identity, RUN.on("flame")),
        "scans": scans["truth"][scans["condition"] == "neutral"],
    }
    assert len(sets["scans"]) == TINY.scan_subjects
    return sets


@pytest.mark.parametrize(
    "track", [*(pytest.param(t, marks=pytest.mark.slow) for t in ("bfm", "flame")), "transfer"]
)
def test_no_two_data_sets_share_a_person(request, track):
    if track == "bfm":
        sets = of_bfm(*map(request.getfixturevalue, ("whole_bfm", "whole_celeba", "streamed")))
    elif track == "flame":
        sets = of_flame(request.getfixturevalue("whole_flame"))
    else:  # with their expressions
        sets = {"training": transfer_faces(RUN, "openhead")[1]}
        sets["tests"] = transfer.tested_faces(RUN, "openhead", 0.0)[1]
    for one, other in combinations(sets, 2):
        first, second = (sets[name].reshape(len(sets[name]), -1) for name in (one, other))
        apart = min(np.abs(first - face).max(1).min() for face in second)
        assert apart > LEAST_MM, (one, other)
