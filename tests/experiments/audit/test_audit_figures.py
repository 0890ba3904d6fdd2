"""Figures of the audit: what is drawn is what was measured, at its place, with its unit."""

import numpy as np
import pandas as pd
import pytest
from matplotlib.colors import to_hex

from deepmds_keras.io.errors import InputError
from experiments.figures import audit_curves as audit
from experiments.figures import style

POSES = ("yaw", "pitch", "roll", "field_of_view")
SPECTRA = {
    "true 3D distances": [0.6, 0.3, 0.1, 1e-17],
    "learnt dissimilarities": [0.5, 0.3, 0.15, -0.05],
    "frontal view": [0.6, 0.4, -1e-16, 1e-17],
}


def curves(sweeps, values=(500, 2000, 8000)):
    rows = [
        (sweep, value, method, mse * (1 + k), 0.1 * mse)
        for sweep in sweeps
        for method, mse in (("ours", 1e-4), ("without_autoencoder", 3e-4), ("linear", 1e-5))
        for k, value in enumerate(values)
    ]
    return pd.DataFrame(rows, columns=["sweep", "value", "method", "mse", "sem"])


def times():
    return pd.DataFrame(
        [(n, part, 1e-4 * n**2) for part in audit._PARTS for n in (51, 72, 478)],
        columns=["landmarks", "part", "ms"],
    )


def losses(variants=("same_face", "shuffled", "same_face_stable", "shuffled_stable")):
    return pd.DataFrame(
        [
            (variant, seed, epoch, (k + 1) * 1e-4 / epoch, (k + 1) * 2e-4 / epoch)
            for k, variant in enumerate(variants)
            for seed in range(2)
            for epoch in (1, 2, 3)
        ],
        columns=["variant", "seed", "epoch", "train", "inference"],
    )


BIAS = {
    "mean_shape": {"slope": 0.0, "slope_se": 0.0, "correlation": 0.0},
    "ours": {"slope": 0.4, "slope_se": 0.05, "correlation": -0.3},
}
DRAWN = {
    "poses": lambda: audit.error_curves(curves(POSES), POSES, {"yaw": (-45, 45), "roll": (0, 0)}),
    "training": lambda: audit.error_curves(curves(["training_faces"]), ["training_faces"], {}),
    "spectra": lambda: audit.spectra(SPECTRA),
    "timings": lambda: audit.timings(times()),
    "bias": lambda: audit.bias(BIAS),
    "mini_batches": lambda: audit.mini_batches(losses()),
}


@pytest.mark.parametrize("name", DRAWN)
def test_equal_inputs_give_equal_bytes_of_a_small_wide_figure(name, tmp_path):
    figure = DRAWN[name]()
    assert figure.get_size_inches()[0] == 7.2
    first = style.save(figure, tmp_path / "first", name)
    second = style.save(DRAWN[name](), tmp_path / "second", name)
    for one, other in zip(first, second, strict=True):
        assert one.read_bytes() == other.read_bytes()
        assert one.stat().st_size < 300_000


def test_each_sweep_has_a_panel_with_its_unit():
    figure = DRAWN["poses"]()
    assert [axes.get_xlabel() for axes in figure.axes] == [
        "Yaw (degrees)",
        "Pitch (degrees)",
        "Roll (degrees)",
        "Field of view (degrees)",
    ]
    assert "(squared normalised units)" in figure.axes[0].get_ylabel()
    two = ["noise_percent", "missing_percent"]
    assert len(audit.error_curves(curves(two), two, {}).axes) == 2


def test_curves_are_the_errors_with_their_confidence_intervals():
    axes = DRAWN["training"]().axes[0]
    assert axes.get_xscale() == axes.get_yscale() == "log"
    np.testing.assert_allclose(
        axes.lines[0].get_xydata(), [[500, 1e-4], [2000, 2e-4], [8000, 3e-4]]
    )
    band = axes.collections[0].get_paths()[0].vertices
    at_first = band[band[:, 0] == 500][:, 1]
    np.testing.assert_allclose([at_first.min(), at_first.max()], [0.804e-4, 1.196e-4])


def test_training_views_are_shaded_where_they_are():
    figure = DRAWN["poses"]()
    for axes, limits in zip(figure.axes, [(-45, 45), None, (0, 0), None], strict=True):
        shaded = [(patch.get_x(), patch.get_x() + patch.get_width()) for patch in axes.patches]
        assert shaded == ([limits] if limits else [])
    written = [text.get_text() for text in figure.legends[0].get_texts()]
    assert written == ["Deep-MDS", "Deep-MDS without autoencoder", "Linear", "training views"]


def test_unknown_sweeps_and_methods_are_refused():
    with pytest.raises(InputError, match="sweeps must be of yaw.* Received colour"):
        audit.error_curves(curves(["yaw"]), ["colour"], {})
    with pytest.raises(InputError, match="magic"):
        audit.error_curves(curves(["yaw"]).assign(method="magic"), ["yaw"], {})


def test_negative_eigenvalues_are_hollow_and_those_of_rounding_at_the_foot():
    axes = DRAWN["spectra"]().axes[0]
    dots = {name: axes.lines[4 * k : 4 * k + 4] for k, name in enumerate(SPECTRA)}
    faces = [to_hex(dot.get_markerfacecolor()) for dot in dots["learnt dissimilarities"]]
    assert faces[:3] == ["#d55e00"] * 3
    assert faces[3] == "#ffffff"
    heights = [dot.get_ydata()[0] for dot in dots["frontal view"]]
    np.testing.assert_allclose(heights, [0.6, 0.4, 1e-4, 1e-4])
    assert to_hex(dots["frontal view"][2].get_markerfacecolor()) != "#ffffff"


def test_guide_of_the_times_is_cubic():
    *parts, guide = DRAWN["timings"]().axes[0].lines
    assert [line.get_label() for line in parts] == list(audit._PARTS)
    first, last = guide.get_xydata()[[0, -1]]
    assert last[1] / first[1] == pytest.approx((478 / 51) ** 3)
    np.testing.assert_allclose(parts[0].get_ydata()[-1], 1e-4 * 478**2)


def test_slopes_have_their_intervals_and_landmarks_of_bias():
    slopes, correlations = DRAWN["bias"]().axes
    assert [text.get_text() for text in slopes.texts] == ["always the\nmean shape", "unbiased"]
    assert [label.get_text() for label in slopes.get_yticklabels()] == ["Mean shape", "Deep-MDS"]
    interval = slopes.collections[1].get_segments()[0]
    np.testing.assert_allclose(interval, [[0.4 - 0.098, 1], [0.4 + 0.098, 1]])
    assert correlations.get_xlim()[0] < -0.3
    assert slopes.get_ylim()[0] > slopes.get_ylim()[1]  # the first method on top


def test_every_seed_of_the_mini_batches_is_a_line_in_both_modes():
    axes = DRAWN["mini_batches"]().axes
    assert len(axes) == 4
    assert [len(panel.lines) for panel in axes] == [4] * 4
    np.testing.assert_allclose(axes[0].lines[0].get_ydata(), [1, 1 / 2, 1 / 3])
    np.testing.assert_allclose(axes[1].lines[2].get_ydata()[0], 4)
    np.testing.assert_allclose(axes[2].lines[0].get_ydata()[0], 3)
    assert axes[2].get_ylabel().startswith("Decayed rate")
    assert len(audit.mini_batches(losses(("same_face", "shuffled"))).axes) == 2
