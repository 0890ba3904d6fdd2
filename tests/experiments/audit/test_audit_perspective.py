"""What a field of view changes: MATLAB's matrix as its help has it, and verdicts both ways."""

from types import SimpleNamespace

import numpy as np
import pytest

from data_gen.views.projections import Cameras, rotations
from deepmds_keras.normalisation import normalise, unit
from experiments.audit import perspective
from experiments.audit.perspective import viewmtx
from experiments.verdicts import DOES_NOT_HOLD, HOLDS, WITH_CONDITION


def test_viewmtx_gives_the_numbers_of_matlabs_help():
    point = np.array([0.5, 0, -3, 1])
    np.testing.assert_allclose((viewmtx(-37.5, 30) @ point)[:2], [0.3967, -2.4459], atol=5e-5)
    view = viewmtx(-37.5, 30, 25) @ point
    np.testing.assert_allclose(view[:2] / view[3], [0.1777, -1.8858], atol=5e-5)


@pytest.mark.parametrize(
    ("angles", "azimuth", "elevation"), [({"pitch": 20.0}, 0, 70), ({"roll": 30.0}, -30, 90)]
)
def test_from_above_an_azimuth_is_a_roll_and_an_elevation_a_pitch(angles, azimuth, elevation):
    values = {name: np.zeros(1) for name in ("yaw", "pitch", "roll", "field_of_view")}
    values |= {name: np.array([angle]) for name, angle in angles.items()}
    rotation = rotations(Cameras(np.zeros(1, int), **values))[0]
    np.testing.assert_allclose(viewmtx(azimuth, elevation)[:3, :3], rotation, atol=1e-12)


def test_angle_turns_and_scales_nothing_before_the_division():
    for angle in (1, 60):
        matrix = viewmtx(20, 70, angle)
        np.testing.assert_array_equal(matrix[:2, :3], viewmtx(20, 70)[:2, :3])
        assert np.abs(matrix[3, :3]).max() > 1e-3
    np.testing.assert_array_equal(viewmtx(20, 70)[3], [0, 0, 0, 1])


def test_division_enlarges_what_is_near():
    near, far = (viewmtx(0, 90, 40) @ [0.9, 0.5, z, 1] for z in (1.0, 0.0))
    assert near[3] < far[3]
    assert near[0] / near[3] > far[0] / far[3] > 0


@pytest.fixture(scope="module")
def measured():
    landmarks = np.random.default_rng(0).uniform(-100, 100, (30, 20, 3))
    inputs = SimpleNamespace(
        run=SimpleNamespace(seed=0),
        audited=np.arange(5, 25),
        test=SimpleNamespace(shapes=normalise(landmarks), unit_mm=unit(landmarks)[1].ravel()),
        test_dataset=SimpleNamespace(landmarks=landmarks),
    )
    return perspective.measure(inputs)


def test_views_of_the_released_generator_are_orthographic_but_for_rounding(measured):
    assert all(own["max"] < 1e-12 for own in measured["released_undivided"].values())
    assert measured["faces_seen"] == 20


@pytest.mark.parametrize("which", ["released_divided", "text"])
def test_distortion_grows_with_the_angle(measured, which):
    small, middle, large = (measured[which][angle] for angle in (5, 25, 60))
    assert 0.001 < small["rms"] < small["max"] < 0.1
    # To first order in the angle.
    assert 4 < middle["rms"] / small["rms"] < 6.5
    assert middle["rms"] < large["rms"]


def test_half_of_the_texts_views_are_perspective(measured):
    assert measured["perspective_share"]["paper"] == pytest.approx(0.5, abs=0.02)
    assert measured["perspective_share"]["released"] == pytest.approx(0.3, abs=0.02)


def test_detectors_errors_are_in_both_coordinates(measured):
    # 3 mm in each of two, of a face of about 200 mm.
    assert measured["detector_rms"] == pytest.approx(3 * 2**0.5 / 200, rel=0.1)


@pytest.mark.parametrize(
    ("released", "text", "verdict"),
    [
        (3.4e-16, 0.0123, WITH_CONDITION),
        (0.0034, 0.0123, HOLDS),
        (3.4e-16, 2e-16, DOES_NOT_HOLD),
    ],
)
def test_perspective_views(released, text, verdict):
    finding = perspective.perspective_views(
        released_undivided={a: {"rms": released / 2, "max": released} for a in ("5", "25")},
        released_divided={a: {"rms": 0.0456, "max": 0.1} for a in ("5", "25")},
        text={a: {"rms": text / 2, "max": text} for a in ("5", "25")},
        perspective_share={"paper": 0.51, "released": 0.29},
        detector_rms=0.0212,
        faces_seen=77,
    )
    assert finding.verdict == verdict
    assert "5° to 25°" in finding.evidence
    for number in ("77 faces", "3.4" if released < 1e-9 else "0.0034", "4.6 %", "51 %", "2.1 %"):
        assert number in finding.evidence
