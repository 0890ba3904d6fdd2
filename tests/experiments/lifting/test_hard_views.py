"""Views of the protocol: what differs between conditions, and what does not."""

from dataclasses import replace

import numpy as np
import pytest

from data_gen.views.projections import project
from experiments.lifting.contenders import filler, misfit
from experiments.lifting.views import (
    CONDITIONS,
    FACE_MM,
    MIXED,
    MOST_MISSING,
    find_hidden,
    hard_faces,
    landmark_model,
    sample_training,
    training_faces,
)
from experiments.presets import TINY
from experiments.run import Run

BY_ID = {condition.id: condition for condition in CONDITIONS}


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    preset = replace(TINY, test_faces=60)
    return Run("openhead", preset, build=tmp_path_factory.mktemp("build"), jobs=1)


def test_conditions_of_a_protocol_see_the_same_faces(run):
    exact = hard_faces(run, BY_ID["hard_0"])
    for name, noise in (("hard_1", 1), ("hard_3", 3)):
        faces = hard_faces(run, BY_ID[name])
        assert np.array_equal(faces.identity, exact.identity)
        assert np.array_equal(faces.cameras.yaw, exact.cameras.yaw)
        assert np.std(faces.views - exact.views) == pytest.approx(noise / 100 * FACE_MM, rel=0.03)
        assert (faces.sd_mm == noise / 100 * FACE_MM).all()
    np.testing.assert_array_equal(exact.views, project(exact.shapes, exact.cameras))
    assert not np.array_equal(hard_faces(run, BY_ID["paper_0"]).identity, exact.identity)


def test_what_is_missing_at_one_share_is_missing_at_more(run):
    missing = [np.isnan(hard_faces(run, BY_ID[f"hard_1_missing_{n}"]).views) for n in (30, 50)]
    assert [own.mean() for own in missing] == pytest.approx([0.3, 0.5], abs=0.03)
    assert not (missing[0] & ~missing[1]).any()


def test_turned_heads_hide_landmarks_of_the_far_side(run):
    find_hidden(run)
    faces = hard_faces(run, BY_ID["hard_1_hidden"])
    hidden = np.isnan(faces.views).all(-1)
    turned = np.abs(faces.cameras.yaw)
    assert hidden[turned > 40].sum(1).mean() > 2 * hidden[turned < 20].sum(1).mean()
    # Turned to its own left, towards +x, a face hides its own left.
    left = landmark_model(run).mean[:, 0] > 0
    far = hidden[faces.cameras.yaw > 30]
    assert far[:, left].sum() > 3 * far[:, ~left].sum()


def test_faces_to_train_on_are_as_their_condition_says(run):
    faces = sample_training(landmark_model(run), MIXED, 500, np.random.default_rng(0))
    missing = np.isnan(faces.views[..., 0]).mean(1)
    assert missing.min() < 0.02
    assert 0.9 * MOST_MISSING < missing.max() < MOST_MISSING + 0.15
    assert 0 < faces.sd_mm.min() < 0.01 * FACE_MM < 0.029 * FACE_MM < faces.sd_mm.max()
    own, tested = training_faces(run, BY_ID["hard_1"]), hard_faces(run, BY_ID["hard_1"])
    assert len(own) == TINY.train_faces
    assert np.isfinite(own.views).all()
    assert not np.isin(own.identity, tested.identity).any()


def test_missing_coordinates_are_filled_in_better_than_by_their_mean(run):
    condition = BY_ID["hard_1_missing_30"]
    faces, whole = hard_faces(run, condition), hard_faces(run, BY_ID["hard_1"])
    missing = np.isnan(faces.views)
    filled = filler(run, condition)(faces.views)
    assert np.array_equal(filled[~missing], faces.views[~missing])
    mean = training_faces(run, BY_ID["hard_1"]).views.mean(0)
    assert np.std((filled - whole.views)[missing]) < 0.3 * np.std((mean - whole.views)[missing])


def test_a_camera_misses_the_views_by_their_noise_and_their_perspective(run):
    kinds = ("affine", "orthographic")
    affine, orthographic = (misfit(run, BY_ID["paper_0"], kind) for kind in kinds)
    assert 0 < affine < orthographic < 0.5
    affine, orthographic = (misfit(run, BY_ID["hard_3"], kind) for kind in kinds)
    assert 0.03 * FACE_MM * 0.9 < affine < orthographic
