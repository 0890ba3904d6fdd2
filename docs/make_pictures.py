"""Draw the pictures of `docs/`: landmark schemes, people to try it on, and the paper's method.

Run from the repository: `python -m docs.make_pictures`, or `make pictures`.
"""

import io
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patheffects import withStroke
from PIL import Image

from data_gen.appearance import Albedo, Lights
from data_gen.datasets.photos_substitute import PhotosSubstitute
from data_gen.models.openhead import load_openhead
from data_gen.renderer import Renderer, square_frames
from data_gen.views import sample_expressive, sample_hard_cameras
from deepmds_keras.files import write_bytes
from deepmds_keras.geometry.units import centre, normalise
from deepmds_keras.geometry.views import in_camera_frame
from deepmds_keras.landmarks import LandmarkScheme, convert, load_scheme
from experiments.figures.style import INK, styled
from experiments.figures.wireframe import bare, draw_wireframe, front_view, side_view

_PICTURES = Path(__file__).parent / "pictures"
_DPI = 160
_SIZE = 1000  # pixels of a side of the face
_MARGIN = 1.16  # numbers of the outermost landmarks stand outside them
_SEED = 12  # of a light skin with dark brows
_PORTRAITS, _PORTRAITS_SEED = (7, 15, 16), [2]  # unlike each other, and all are detected

_FONT = 10.5  # points: on a phone, which shows the picture at about 0.4 of its size, still 9 pixels
_BOX = np.array([(19.0, 22.0), (35.0, 22.0), (51.0, 22.0)])  # pixels of one, two, three digits
_PALE = 0.5  # share of white in the photo, so that what is drawn on it stands out
_STEP = 5  # of the photo's colours, which halves the bytes of the picture
# Of Okabe and Ito's palette, darkened where it is read as text.
_COLOURS = {
    "brow": "#B34700",
    "eye": "#005B96",
    "nose": "#00674A",
    "outer_mouth": "#A6266E",
    "inner_mouth": "#5B2A86",
    "jaw": INK,
    "chin": INK,
}
_RADII, _ANGLES = np.linspace(18, 90, 13), np.linspace(0, 2 * np.pi, 24, endpoint=False)
_SPOTS = (_RADII[:, None, None] * np.stack([np.cos(_ANGLES), np.sin(_ANGLES)], axis=1)).reshape(
    -1, 2
)  # pixels from a landmark to where its number may stand
_ALONG = np.linspace(0.25, 0.8, 5)[:, None]  # places on a leader by which it is kept off numbers
_CLEAR = 8.0  # pixels between a number and the landmarks of others
_PASSES = 8

_METHOD_SEED = 9  # of a face that is turned to the side
_LEFT, _WIDE, _GAP = 0.01, 0.15, 0.085  # of the figure's width


def scheme_picture(name: str, labels: Sequence[str]) -> Figure:
    """A landmark scheme on the mean face, each landmark with its label."""
    head, scheme = load_openhead(), load_scheme(name)
    landmarks = head.mean[None, head.landmarks[name], :2]
    frames = square_frames(landmarks, _SIZE, _MARGIN)
    light = Lights(np.array([[-0.2, 0.3, 0.93]]), np.array([0.5]), np.ones((1, 3)))
    colours = Albedo(head).sample(1, np.random.default_rng(_SEED))
    renderer = Renderer(head, _SIZE)
    image = renderer.draw(head.mean[None], head.mean[None], colours, frames, light)[0]
    renderer.close()
    return numbered(image, frames.pixels(landmarks)[0], labels, scheme)


@styled
def numbered(
    image: np.ndarray, points: np.ndarray, labels: Sequence[str], scheme: LandmarkScheme
) -> Figure:
    """The landmarks on a picture of a face, a colour a facial part, as large as the picture.

    Args:
        image: `(H, W, 3)` uint8.
        points: `(L, 2)` pixels, x right and y down from the left upper corner.
        labels: L short texts, the numbers, of up to three digits.
    """
    height, width = image.shape[:2]
    figure = Figure(figsize=(width / _DPI, height / _DPI), dpi=_DPI)
    axes = figure.add_axes((0, 0, 1, 1))
    axes.set_axis_off()
    pale = np.uint8(255 * _PALE + (1 - _PALE) * image) // _STEP * _STEP
    axes.imshow(pale, extent=(0, width, height, 0), interpolation="nearest")
    draw_wireframe(axes, points, scheme.polylines, colour="white", linewidth=1.2, dot_area=0)
    parts = [group.removeprefix("right_").removeprefix("left_") for group in scheme.groups]
    colours = [_COLOURS[part] for part in parts]
    text = {"size": _FONT, "ha": "center", "va": "center_baseline", "weight": "bold"}
    halo = [withStroke(linewidth=2, foreground="white")]
    halves = _BOX[[len(label) - 1 for label in labels]] / 2
    spots = place_numbers(points, halves)
    for point, spot, half, label, colour in zip(
        points, spots, halves, labels, colours, strict=True
    ):
        way = spot - point
        end = point + way * (1 - (half / np.abs(way).clip(1e-9)).min())
        axes.plot(*np.stack([point, end], axis=1), color=colour, lw=0.9)
        axes.text(*spot, label, color=colour, path_effects=halo, **text)
    axes.scatter(*points.T, s=16, c=colours, linewidths=0.6, edgecolors="white", zorder=4)
    for x, side, align in ((0.015, "subject’s right", "left"), (0.985, "subject’s left", "right")):
        axes.text(x, 0.015, side, transform=axes.transAxes, ha=align, size=_FONT, color=INK)
    axes.set(xlim=(0, width), ylim=(height, 0))
    return figure


def place_numbers(points: np.ndarray, half: np.ndarray) -> np.ndarray:
    """Where the numbers stand: near their landmarks, off each other and off every landmark.

    Each in turn takes the best of a ring of places, given those of the others, a few times over.

    Args:
        points: `(L, 2)` pixels.
        half: `(L, 2)` half the width and height of each text.

    Returns:
        `(L, 2)` pixels, the middle of each text.
    """
    spots = points + _SPOTS[0]
    everyone = np.arange(len(points))
    for _ in range(_PASSES):
        before = spots.copy()
        for i in everyone:
            others = everyone != i
            candidates = points[i] + _SPOTS
            leader = points[i] + _ALONG[:, None] * (candidates - points[i])
            reach = half[i] + half[others]
            crowding = (
                np.prod((reach - np.abs(candidates[:, None] - spots[others])).clip(0), axis=2),
                100.0 * _inside(points[i : i + 1], candidates[:, None], half[i] + 3),
                100.0 * _inside(points[others], candidates[:, None], half[i] + _CLEAR),
                50.0 * _inside(leader[:, :, None], spots[others], half[others]).sum(0),
            )
            cost = np.linalg.norm(_SPOTS, axis=1) + sum(part.sum(-1) for part in crowding)
            spots[i] = candidates[cost.argmin()]
        if (spots == before).all():
            break
    return spots


def _inside(points: np.ndarray, middles: np.ndarray, half: np.ndarray | float) -> np.ndarray:
    """Mask of points in boxes, given by their middles and half sizes; shapes as broadcast."""
    return (np.abs(points - middles) < half).all(-1)


@styled
def method_picture() -> Figure:
    """The paper's method on one face: a view, its frontal view, distances, and their shape."""
    from deepmds_keras.deep_mds import DeepMDS  # not in the process that renders

    scheme, model = load_scheme("bfm72"), DeepMDS.pretrained("deepmds-bfm72")
    head, rng = load_openhead(), np.random.default_rng(_METHOD_SEED)
    face = head.at_landmarks("bfm72").shape(*sample_expressive(head, 1, rng))
    view = normalise(centre(in_camera_frame(face, sample_hard_cameras(1, rng))[..., :2]))
    shape = model.predict(view, check_orientation=False)[0]

    figure = Figure((7.2, 1.7))
    # The last two panels belong together: no arrow stands between them.
    lefts = [_LEFT + i * (_WIDE + _GAP) - max(0, i - 3) * _GAP for i in range(5)]
    panels = [figure.add_axes((left, 0.02, _WIDE, 0.82)) for left in lefts]
    faces = (view[0], model.frontalise(view)[0], None, front_view(shape), side_view(shape))
    for axes, points in zip(panels, faces, strict=True):
        if points is None:
            distances = model.dissimilarities(view)[0]
            axes.imshow(distances, cmap="viridis", interpolation="nearest")
            axes.set_axis_off()
            continue
        draw_wireframe(axes, points, scheme.polylines, colour=INK, dot_area=3)
        (x, y), half = (points.min(0) + points.max(0)) / 2, 0.55 * np.ptp(points, axis=0).max()
        bare(axes, (x - half, x + half, y - half, y + half))
    heads = ("any view", "frontal view", "distances in 3D", "shape", "from the side")
    for axes, head_line in zip(panels, heads, strict=True):
        axes.set_title(head_line)
    steps = {
        "autoencoder": "144-64-32\n-16-16-32\n-64-144",
        "dissimilarity\nnet": "each pair:\n6-20-20-20\n-20-20-1",
        "non-metric\nMDS": "",
    }
    for axes, (step, widths) in zip(panels[:3], steps.items(), strict=True):
        x = axes.get_position().x1 + _GAP / 2
        figure.text(x, 0.46, step, ha="center", va="bottom", fontsize=6.5)
        figure.text(x, 0.33, widths, ha="center", va="top", fontsize=6.5, color=INK)
        figure.text(x, 0.4, "⟶", ha="center", va="center", fontsize=13, color=INK)
    return figure


def portraits() -> bytes:
    """A photo of three people who do not exist, as JPEG: something to try the command on."""
    photos = PhotosSubstitute(load_openhead(), 1 + max(_PORTRAITS), _PORTRAITS_SEED)
    images = [next(photos.photos(range(k, k + 1))).image for k in _PORTRAITS]
    content = io.BytesIO()
    Image.fromarray(np.concatenate(images, axis=1)).save(content, format="jpeg", quality=92)
    return content.getvalue()


def _png(figure: Figure) -> bytes:
    content = io.BytesIO()
    options = {"dpi": _DPI, "metadata": {"Software": None}, "pil_kwargs": {"optimize": True}}
    figure.savefig(content, format="png", **options)
    return content.getvalue()


def _method_png() -> bytes:
    return _png(method_picture())


def main() -> None:
    """Write all of them."""
    mesh_numbers = np.repeat(np.arange(468.0)[:, None], 2, axis=1)
    of_mediapipe = [f"{k:.0f}" for k in convert(mesh_numbers, "mediapipe", "ibug51")[:, 0]]
    contents = {"mediapipe51.png": _png(scheme_picture("ibug51", of_mediapipe))}
    for name in ("bfm72", "ibug68"):
        labels = [str(number) for number in load_scheme(name).numbers]
        contents[f"{name}.png"] = _png(scheme_picture(name, labels))
    contents["portraits.jpg"] = portraits()
    # TensorFlow and the renderer crash each other in one process.
    with ProcessPoolExecutor(1, get_context("spawn")) as apart:
        contents["method.png"] = apart.submit(_method_png).result()
    for name, content in contents.items():
        write_bytes(_PICTURES / name, content)
        print(_PICTURES / name)


if __name__ == "__main__":
    main()
