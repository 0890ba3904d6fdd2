"""Draw the pictures of `docs/`: landmark schemes, people to try it on, and the paper's method."""

from __future__ import annotations

import argparse
import io
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from PIL import Image

from data_gen.datasets.photos_standin import PhotosStandin
from data_gen.models.openhead import load_openhead
from data_gen.rendering.albedo import Albedo
from data_gen.rendering.renderer import Lights, Renderer, square_frames
from deepmds_keras.io.atomic import write_bytes
from deepmds_keras.landmarks import load_scheme
from deepmds_keras.landmarks.conversion import convert
from experiments.figures.method_diagram import method_diagram
from experiments.figures.schemes import DPI, numbered
from experiments.running import exit_on_user_error

PICTURES = Path("docs/pictures")
_SIZE = 1000  # pixels of a side
_MARGIN = 1.16  # numbers of the outermost landmarks stand outside them
_SEED = 12  # of a light skin with dark brows
_PORTRAITS, _PORTRAITS_SEED = (7, 15, 16), [2]  # of many: unlike, and all are found


def head_image(scheme: str) -> tuple[np.ndarray, np.ndarray]:
    """The mean face from the front, `(size, size, 3)` uint8, and its landmarks, `(L, 2)` pixels."""
    head = load_openhead()
    landmarks = head.mean[None, head.landmarks[scheme], :2]
    frames = square_frames(landmarks, _SIZE, _MARGIN)
    light = Lights(np.array([[-0.2, 0.3, 0.93]]), np.array([0.5]), np.ones((1, 3)))
    colours = Albedo(head).sample(1, np.random.default_rng(_SEED))
    renderer = Renderer(head, _SIZE)
    image = renderer.draw(head.mean[None], head.mean[None], colours, frames, light)[0]
    renderer.close()
    return image, frames.pixels(landmarks)[0]


def pictures() -> dict[str, Figure]:
    """Name of the file to its picture."""
    figures = {}
    for name in ("bfm72", "ibug68"):
        scheme = load_scheme(name)
        labels = [str(number) for number in scheme.numbers]
        figures[name] = numbered(*head_image(name), labels, scheme.groups, scheme.polylines)
    scheme = load_scheme("ibug51")
    numbers = convert(np.repeat(np.arange(468.0)[:, None], 2, 1), "mediapipe", "ibug51")[:, 0]
    labels = [f"{number:.0f}" for number in numbers]
    figures["mediapipe51"] = numbered(
        *head_image("ibug51"), labels, scheme.groups, scheme.polylines
    )
    return figures


def portraits() -> bytes:
    """A photo of three people who do not exist, as JPEG: something to try the command on."""
    photos = PhotosStandin(load_openhead(), 1 + max(_PORTRAITS), _PORTRAITS_SEED)
    images = [next(photos.photos(range(k, k + 1))).image for k in _PORTRAITS]
    content = io.BytesIO()
    Image.fromarray(np.concatenate(images, axis=1)).save(content, format="jpeg", quality=92)
    return content.getvalue()


def png(figure: Figure) -> bytes:
    """The picture; equal figures give equal bytes."""
    content = io.BytesIO()
    figure.savefig(
        content, format="png", dpi=DPI, metadata={"Software": None}, pil_kwargs={"optimize": True}
    )
    return content.getvalue()


def _method() -> bytes:
    return png(method_diagram())


def main(arguments: list[str] | None = None) -> None:
    argparse.ArgumentParser(description=__doc__).parse_args(arguments)
    with exit_on_user_error():
        contents = {f"{name}.png": png(figure) for name, figure in pictures().items()}
        contents["portraits.jpg"] = portraits()
        # TensorFlow and what renders crash each other.
        with ProcessPoolExecutor(1, get_context("spawn")) as apart:
            contents["method.png"] = apart.submit(_method).result()
        for name, content in contents.items():
            write_bytes(PICTURES / name, content)
            print(PICTURES / name)
