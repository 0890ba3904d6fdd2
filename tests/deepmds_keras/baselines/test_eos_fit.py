"""eos's fit, where eos-py and the Surrey Face Model are at hand."""

import numpy as np
import pytest
from places import SHARED

from deepmds_keras import InputError, align
from deepmds_keras.baselines.eos_fit import NUMBERS, EosFit
from deepmds_keras.geometry.views import project, sample_perspective_cameras
from experiments.lifting.surrey import sample_surrey

SFM = SHARED / "sfm"


@pytest.mark.skipif(not SFM.is_dir(), reason="../shared/sfm is absent")
def test_the_fit_finds_faces_of_its_own_model_wherever_and_however_large_they_are(tmp_path):
    pytest.importorskip("eos", reason="eos-py has no wheel here")
    known = [number - 18 for number in NUMBERS]
    rng = np.random.default_rng(0)
    shapes = sample_surrey(SFM, 20, rng)[:, known]
    cameras = sample_perspective_cameras(20, rng, yaw=40, pitch=10, roll=10, field_of_view=(5, 10))
    views = np.full((20, 51, 2), np.nan)
    views[:, known] = project(shapes, cameras)
    fitted = EosFit(SFM / "sfm_shape_3448.bin").predict(views)
    assert np.isnan(fitted).any(2).sum() == 40
    off = align(fitted[:, known], shapes, reflection=False) - shapes
    off_mean = align(np.stack([shapes.mean(0)] * 20), shapes, reflection=False) - shapes
    assert (off**2).mean() < 0.4 * (off_mean**2).mean()
    again = EosFit(SFM).predict(0.01 * views + 7)
    np.testing.assert_allclose(align(again[:, known], fitted[:, known]), fitted[:, known], atol=0.5)
    (tmp_path / "sfm_shape_3448.bin").write_bytes(b"no model")
    for path in SFM.glob("*"):
        if path.name != "sfm_shape_3448.bin":
            (tmp_path / path.name).symlink_to(path)
    with pytest.raises(InputError, match="must hold eos's files, undamaged"):
        EosFit(tmp_path)
