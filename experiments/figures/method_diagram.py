"""The paper's method on one face: a view, its frontal view, distances, and the shape of these."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from data_gen.models.openhead import load_openhead
from data_gen.views.photo_views import sample_expressive
from data_gen.views.projections import in_camera_frame, sample_hard_cameras
from deepmds_keras.landmarks import load_scheme
from deepmds_keras.normalisation import centre, normalise
from experiments.figures.style import INK, styled
from experiments.figures.wireframe import bare, draw_wireframe, front_view, side_view

_SCHEME, _SEED = "bfm72", 9  # of a face that is turned to the side
_STEPS = ("autoencoder", "dissimilarity\nnet", "non-metric\nMDS")
_LEFT, _WIDE, _GAP = 0.01, 0.15, 0.085  # of the figure's width
_SIZE = (7.2, 1.5)


@styled
def method_diagram() -> Figure:
    """Five panels in a row, and over the arrows between them what is done."""
    from deepmds_keras.pipeline import DeepMDS  # not where pictures are rendered

    scheme, model = load_scheme(_SCHEME), DeepMDS.pretrained(f"deepmds-{_SCHEME}")
    head, rng = load_openhead(), np.random.default_rng(_SEED)
    face = head.restrict(head.landmarks[_SCHEME]).shape(*sample_expressive(head, 1, rng))
    view = normalise(centre(in_camera_frame(face, sample_hard_cameras(1, rng))[..., :2]))
    shape = model.predict(view, check_orientation=False)[0]

    figure = Figure(_SIZE)
    panels = []
    for i in range(5):
        # The last two belong together: no arrow stands between them.
        left = _LEFT + i * (_WIDE + _GAP) - max(0, i - 3) * _GAP
        panels.append(figure.add_axes((left, 0.02, _WIDE, 0.82)))
    points = (view[0], model.frontalise(view)[0], None, front_view(shape), side_view(shape))
    for axes, own in zip(panels, points, strict=True):
        if own is not None:
            draw_wireframe(axes, own, scheme.polylines, colour=INK, dot_area=3)
            bare(axes, _extent(own))
    panels[2].imshow(model.dissimilarities(view)[0], cmap="viridis", interpolation="nearest")
    panels[2].set_axis_off()
    heads = ("any view", "frontal view", "distances in 3D", "shape", "from the side")
    for axes, head_line in zip(panels, heads, strict=True):
        axes.set_title(head_line)
    for axes, step in zip(panels[:3], _STEPS, strict=True):
        _arrow(figure, axes, step)
    return figure


def _extent(points: np.ndarray) -> tuple[float, float, float, float]:
    middle, half = (points.min(0) + points.max(0)) / 2, 0.55 * np.ptp(points, axis=0).max()
    (x, y) = middle
    return x - half, x + half, y - half, y + half


def _arrow(figure: Figure, axes: Axes, step: str) -> None:
    """Point from a panel to the next one."""
    right, middle = axes.get_position().x1, 0.4
    figure.text(right + _GAP / 2, middle + 0.06, step, ha="center", va="bottom", fontsize=6)
    figure.text(right + _GAP / 2, middle, "⟶", ha="center", va="center", fontsize=13, color=INK)
