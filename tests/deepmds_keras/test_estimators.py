"""What the estimators share: orientation, scores as scikit-learn asks for them, and examples."""

import doctest
import importlib

import numpy as np
import pytest
from sklearn.model_selection import cross_val_score

from data_gen.models.openhead import load_openhead
from data_gen.views.photo_views import sample_photo_views
from deepmds_keras import DeepMDS, InputError, LandmarkLifter, align, metrics, normalise
from deepmds_keras.normalisation import centre


@pytest.fixture(scope="module")
def faces():
    """Views, y up, and shapes of 300 faces."""
    views, shapes, _ = sample_photo_views(load_openhead(), "ibug51", 300, np.random.default_rng(3))
    return views, shapes


@pytest.fixture(scope="module", params=["deepmds", "lifting"])
def estimator(request, faces):
    if request.param == "deepmds":
        return DeepMDS.pretrained("deepmds-ibug51")
    return LandmarkLifter(51, steps=1).fit(*faces)


@pytest.mark.parametrize(
    ("turned", "message"),
    [((1, -1), "y must grow upwards"), ((-1, 1), "mirrored"), ((-1, -1), "upright")],
)
def test_views_of_wrong_orientation_are_refused_unless_told(estimator, faces, turned, message):
    views = faces[0][:3].copy()
    views[1] *= turned
    with pytest.raises(InputError, match=f"views, face 2 of 3: .*{message}.*check_orientation"):
        estimator.predict(views)
    assert np.isfinite(estimator.predict(views, check_orientation=False)).all()


def test_missing_landmarks_are_not_judged(faces):
    lifter = LandmarkLifter(51, steps=1).fit(*faces)
    views = faces[0][:2] * (1, -1)
    visible = np.arange(51) > 10
    assert np.isfinite(lifter.predict(views, visible=visible)).all()


def test_the_score_is_that_of_the_predictions(estimator, faces):
    views, shapes = faces
    truth = normalise(centre(shapes))
    predicted, mean = estimator.predict(views), np.broadcast_to(truth.mean(0), truth.shape)
    own, trivial = (metrics.mse(align(x, truth), truth).mean() for x in (predicted, mean))
    assert estimator.score(views, shapes) == pytest.approx(1 - own / trivial)
    assert metrics.explained_share(shapes, 3 * shapes) == pytest.approx(1)
    assert metrics.explained_share(mean, shapes) == pytest.approx(0, abs=1e-9)
    with pytest.raises(InputError, match="two faces"):
        metrics.explained_share(shapes[:1], shapes[:1])


def test_scikit_learn_cross_validates_a_lifter(faces):
    scores = cross_val_score(LandmarkLifter(51, steps=100), *faces, cv=2)
    assert scores.shape == (2,)
    assert (scores > 0).all()


@pytest.mark.parametrize("module", ["pipeline", "lifting.lifter", "predict.api"])
def test_examples_of_the_help_run(module):
    result = doctest.testmod(importlib.import_module(f"deepmds_keras.{module}"))
    assert result.attempted
    assert not result.failed
