"""Checks on Zhao's method: the evaluator's part in its score, and the views that it works on."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest

from data_gen.datasets.dataset import make_dataset, save_dataset
from data_gen.models.openhead import load_openhead
from deepmds_keras.normalisation import normalise, unit
from experiments.audit import zhao
from experiments.audit.claims import judge, load_claims
from experiments.inputs import Faces
from experiments.presets import SMOKE
from experiments.run import Run
from experiments.scoring.scores import score
from experiments.tracks.bfm.released_evaluator import TRUE_DEPTH
from experiments.verdicts import DOES_NOT_HOLD, HOLDS, UNKNOWN, WITH_CONDITION

CLAIMS = load_claims()
CELEBA = pd.DataFrame(
    [
        ("zhao", "mse", 5e-5),
        ("zhao", "mse", 7e-5),
        ("zhao", "depth_corr", 71.9),
        ("ours", "mse", 1),
    ],
    columns=["method", "metric", "value"],
)


class FrontalNet:
    """Takes every view for a frontal one of the mean face: worse, the more a face is turned."""

    def __init__(self, dataset):
        landmarks = dataset.landmarks.astype(float)
        self.depth = (landmarks[..., 2:] / unit(landmarks[..., :2])[1]).mean(0)

    def predict(self, views):
        return np.concatenate([views, np.broadcast_to(self.depth, (*views.shape[:2], 1))], axis=2)


@pytest.fixture(scope="module")
def dataset():
    return make_dataset(load_openhead(), 120, np.random.default_rng(0))


@pytest.fixture(scope="module")
def inputs(dataset, tmp_path_factory):
    rng = np.random.default_rng(1)
    truth = np.float32(normalise(dataset.landmarks))
    test = Faces(
        views=np.float32(normalise(dataset.views)),
        shapes=truth,
        unit_mm=unit(dataset.landmarks)[1].ravel(),
        posed=truth,
        cameras=dataset.cameras,
    )
    noise = {"zhao": 0.008, "zhao_authors": 0.03, "zhao_frontal": 0.003, "ours": 0.012}
    shapes = {m: truth + s * rng.standard_normal(truth.shape) for m, s in noise.items()}
    folder = tmp_path_factory.mktemp("run")
    return SimpleNamespace(
        run=Run("openhead", SMOKE, build=folder / "build", results=folder / "results"),
        test=test,
        test_dataset=dataset,
        predictions=shapes,
        scores={method: score(own, test) for method, own in shapes.items()},
        method=lambda method: FrontalNet(dataset),
        results=lambda experiment: {"celeba": CELEBA}.get(experiment),
    )


@pytest.fixture(scope="module")
def measured(inputs):
    return zhao.measure(inputs)


def judged(claim, check, measured, **changed):
    return judge(CLAIMS[claim], check, {**measured, **changed})


def with_error(consistent, method, error):
    return consistent | {method: consistent[method] | {"mse": error}}


def test_the_score_is_the_evaluators_not_the_methods(measured):
    finding = judged("zhao-score", zhao.bfm_score, measured)
    assert finding.verdict == DOES_NOT_HOLD
    assert measured["consistent"]["zhao_frontal"]["mse"] == pytest.approx(9e-6, rel=0.1)
    assert 1.5e-3 < measured["released"][TRUE_DEPTH]["mse"] < 3e-3
    assert measured["released"]["zhao_frontal"]["mse"] > 1.5e-3
    assert 1e-3 < measured["flat"]["mse"] < 3e-3
    assert "The paper prints 22 × 10⁻⁴ and 71.42" in finding.evidence
    assert "inferred" in finding.evidence


@pytest.mark.parametrize(
    ("method", "verdict"),
    [("zhao_frontal", HOLDS), ("zhao", HOLDS), ("zhao_authors", WITH_CONDITION)],
)
def test_a_net_that_errs_as_much_as_printed_and_most_bears_the_claim_out(measured, method, verdict):
    consistent = with_error(measured["consistent"], method, 2.1e-3)
    finding = judged("zhao-score", zhao.bfm_score, measured, consistent=consistent)
    assert finding.verdict == verdict
    assert "21 × 10⁻⁴" in finding.evidence


def test_a_net_that_errs_as_much_as_printed_but_not_most_is_not_the_worst(measured):
    consistent = with_error(measured["consistent"], "zhao", 2.1e-3)
    consistent = with_error(consistent, "ours", 3e-3)
    finding = judged("zhao-score", zhao.bfm_score, measured, consistent=consistent)
    assert finding.verdict == DOES_NOT_HOLD


def test_a_printed_score_that_nothing_gives_stays_open(measured):
    printed = {"mse": 0.5, "depth_corr": 50.0}
    assert judged("zhao-score", zhao.bfm_score, measured, printed=printed).verdict == UNKNOWN


def test_a_net_sees_the_views_of_each_kind(dataset):
    seen = []

    class Recording(FrontalNet):
        def predict(self, views):
            seen.append(views)
            return super().predict(views)

    errors = zhao.by_projection(Recording(dataset), dataset)
    perspective, same_poses, orthographic, frontal = seen
    through = dataset.cameras.projection == 1
    assert np.allclose(perspective, normalise(dataset.views[through]), atol=1e-4)
    assert np.allclose(orthographic, normalise(dataset.views[~through]), atol=1e-4)
    assert np.allclose(frontal, normalise(dataset.landmarks[..., :2]), atol=1e-4)
    # At most 5 degrees of perspective: not the same views, but nearly.
    assert 1e-4 < np.abs(perspective - same_poses).max() < 0.05
    assert errors["frontal"] < errors["orthographic"]
    assert errors["frontal"] < errors["perspective"]
    assert errors["perspective"] == pytest.approx(errors["same_poses"], rel=0.2)


def views(own, authors):
    kinds = ("perspective", "same_poses", "orthographic", "frontal")
    return {"zhao": dict(zip(kinds, own, strict=True)),
            "zhao_authors": dict(zip(kinds, authors, strict=True))}  # fmt: skip


GOOD, POOR = 6e-5, 7e-4


@pytest.mark.parametrize(
    ("own", "authors", "verdict"),
    [
        ((POOR, GOOD, GOOD, GOOD), (POOR, GOOD, GOOD, GOOD), HOLDS),
        # Worse because of the poses of the perspective views, not because of their projection.
        ((POOR, POOR, GOOD, GOOD), (GOOD, GOOD, GOOD, GOOD), DOES_NOT_HOLD),
        ((GOOD, GOOD, GOOD, GOOD), (POOR, POOR, POOR, GOOD), WITH_CONDITION),
        ((GOOD, GOOD, GOOD, GOOD), (GOOD, GOOD, GOOD, GOOD), DOES_NOT_HOLD),
    ],
)
def test_only_a_projection_that_makes_views_worse_bears_out_the_claim(own, authors, verdict):
    finding = zhao.orthographic_only(views(own, authors))
    assert finding.verdict == verdict
    assert ("7 × 10⁻⁴" in finding.evidence) == (POOR in own + authors)
    assert ("turned orthographic views fail" in finding.condition) == (verdict == WITH_CONDITION)


def test_nets_are_measured_by_projection(measured):
    finding = judged("zhao-orthographic", zhao.orthographic_only, measured)
    assert measured["views"].keys() == {"zhao", "zhao_authors"}
    assert finding.verdict == WITH_CONDITION  # the net knows frontal views only


def test_the_score_on_celeba_is_a_tenth_of_the_evaluators(measured):
    finding = judged("celeba-zhao", zhao.celeba_score, measured)
    assert finding.verdict == DOES_NOT_HOLD
    celeba = measured["celeba"]
    assert celeba["consistent"] == {"mse": pytest.approx(6e-5), "depth_corr": 71.9}
    assert celeba["perfect"] == measured["released"][TRUE_DEPTH]  # no faces of its own here
    assert "0.6 × 10⁻⁴" in finding.evidence
    assert "a slip of a factor of 10, is inferred" in finding.evidence


def test_the_faces_of_celeba_are_taken_where_they_are(inputs, dataset):
    folder = replace(inputs.run, track="celeba").work
    folder.mkdir(parents=True)
    narrow = dataset.landmarks * np.float32((1, 1, 0.5))
    save_dataset(folder / "test.npz", replace(dataset, landmarks=narrow))
    own = zhao.errors_on_celeba(inputs, CELEBA)
    (folder / "test.npz").unlink()
    instead = zhao.errors_on_celeba(inputs, CELEBA)
    # A face of half the depth is spoilt more by rescaling its depth to that of its width.
    assert own["perfect"]["mse"] > 1.3 * instead["perfect"]["mse"]
    assert (own["faces"], instead["faces"]) == ("its faces", "the test faces of the BFM track")


@pytest.mark.parametrize(
    ("own", "perfect", "verdict"),
    [(2e-4, 2e-3, HOLDS), (1e-6, 2e-4, DOES_NOT_HOLD), (1e-6, 2e-3, DOES_NOT_HOLD),
     (1e-6, 1e-1, UNKNOWN)],
)  # fmt: skip
def test_the_score_on_celeba_is_judged_by_both_numbers(measured, own, perfect, verdict):
    celeba = {k: dict(v) for k, v in measured["celeba"].items() if k != "faces"}
    celeba["consistent"]["mse"], celeba["perfect"]["mse"] = own, perfect
    assert zhao.celeba_score(celeba | {"faces": "its faces"}).verdict == verdict


def test_without_the_celeba_experiment_its_score_stays_open():
    finding = zhao.celeba_score(None)
    assert finding.verdict == UNKNOWN
    assert "reproduce-celeba" in finding.condition
