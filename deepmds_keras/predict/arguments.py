"""Arguments of `deepmds predict`."""

from __future__ import annotations

import argparse
import math
from dataclasses import dataclass
from pathlib import Path

from deepmds_keras import __version__
from deepmds_keras.detection.detectors import DETECTORS, default_detector
from deepmds_keras.landmarks.conversion import said_sizes
from deepmds_keras.predict.models import DEFAULT, FALLBACK, FAMILIES
from deepmds_keras.predict.outputs import FORMATS

_DESCRIPTION = """\
Finds the faces in photos and videos, and the 3D shape of their landmarks; or takes
landmarks that are given. Shapes face the front: +x to the subject's left, +y up, +z out of the
face. One view does not show the true size: --interocular sets it."""
_EPILOG = """\
examples:
  deepmds predict photo.jpg --view
  deepmds predict photos/ --out faces --jobs 4
  deepmds predict clip.mp4 --smooth 2
  deepmds predict landmarks.csv --interocular 90 --format csv,ply

A run that was stopped goes on by the same command; what no run wrote is never overwritten. Exit
status: 0, or 1 if a source could not be used (the others are done), 2 for wrong arguments, 130 if
Ctrl-C stopped it."""


@dataclass(frozen=True)
class Options:
    """The arguments.

    Attributes:
        sources: Photos, folders of photos, videos, files of landmarks.
        recursive: Whether to take the photos in folders within folders.
        out: Folder of the results.
        formats: Some of `FORMATS`; None leaves it to the number of faces.
        force: Whether to do again what is done.
        view: Whether to write a page.
        mesh: Whether to write whole heads through the landmarks.
        detector: One of `DETECTORS`.
        landmarker: File of a face landmarker for MediaPipe, or None.
        y_up: y grows upwards in files of landmarks.
        image_size: Width and height of which their x and y are fractions, or None.
        smooth: Standard deviation of the smoothing over the rows of such files, or the frames of
            videos; 0 is none.
        every: Which frames of videos are looked at: 1 is each, 2 every other.
        interocular: Millimetres between the outer corners of the eyes, or None.
        model: File or name of weights, or None.
        jobs: Processes; -1 is one for each core.
    """

    sources: list[str]
    recursive: bool
    out: Path
    formats: tuple[str, ...] | None
    force: bool
    view: bool
    mesh: bool
    detector: str
    landmarker: str | None
    y_up: bool
    image_size: tuple[float, float] | None
    smooth: float
    every: int
    interocular: float | None
    model: str | None
    jobs: int


@dataclass(frozen=True)
class Export:
    """The arguments of `deepmds export`.

    Attributes:
        out: File of the ONNX model.
        model: File or name of a lifter's weights.
    """

    out: Path
    model: str


def parse(arguments: list[str] | None = None) -> Options | Export:
    """Read the command line; wrong arguments end the process, with the usage and status 2."""
    parser = argparse.ArgumentParser(
        prog="deepmds", description="3D face landmarks from a single image."
    )
    parser.add_argument("--version", action="version", version=f"deepmds-keras {__version__}")
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")
    predict = commands.add_parser(
        "predict",
        help="3D landmarks of the faces in photos, or of given landmarks",
        description=_DESCRIPTION,
        epilog=_EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add = predict.add_argument
    add("sources", nargs="+", metavar="SOURCE",
        help="photo, folder of photos, video, or landmarks (csv, npy, pts, json) of "
        f"{said_sizes()} points")  # fmt: skip
    add("--recursive", action="store_true", help="take the photos in folders within folders too")
    add("--out", type=Path, default=Path("deepmds-out"), metavar="DIR",
        help="folder of the results (default: deepmds-out)")  # fmt: skip
    add("--format", dest="formats", type=_formats, metavar="LIST",
        help=f"some of {', '.join(FORMATS)} (default: csv,json,ply,obj; of many faces in one file "
        "and of a video csv,npz)")  # fmt: skip
    add("--force", action="store_true", help="do again what is done already")
    add("--view", action="store_true",
        help="write HTML pages too, on which faces can be turned, and index.html")  # fmt: skip
    add("--mesh", action="store_true",
        help="write the head through the landmarks too: NAME.mesh.ply, NAME.mesh.obj")  # fmt: skip
    add("--detector", choices=DETECTORS,
        help="; or ".join(f"{name} ({row.licence})" for name, row in DETECTORS.items())
        + " (default: the first that is installed)")  # fmt: skip
    add("--landmarker", metavar="FILE",
        help="face landmarker of your own (.task), for MediaPipe 0.10.30 or later")  # fmt: skip
    add("--y-up", action="store_true", help="y grows upwards in files of landmarks")
    add("--image-size", nargs=2, type=_positive, metavar=("W", "H"),
        help="x and y in files of landmarks are fractions of an image of this size, as MediaPipe "
        "has them")  # fmt: skip
    add("--smooth", type=_not_negative, default=0.0, metavar="FRAMES",
        help="smooth each face of a video over time by a Gaussian of this standard deviation, but "
        "not over gaps; the rows of a file of landmarks are frames of one face")  # fmt: skip
    add("--every", type=_count, default=1, metavar="N",
        help="look at every N-th frame of a video (default: 1)")  # fmt: skip
    add("--interocular", type=_positive, metavar="MM",
        help="millimetres between the outer corners of the eyes: results are in mm")  # fmt: skip
    add("--model", metavar="NAME|FILE",
        help=f"{' or '.join(FAMILIES)}, shipped weights by name, or a file of "
        f"LandmarkLifter.save() or DeepMDS.save() (default: {DEFAULT})")  # fmt: skip
    add("--jobs", type=_jobs, default=-1, metavar="N",
        help="processes side by side (default: one for each core)")  # fmt: skip
    export = commands.add_parser(
        "export",
        help="a lifter as an ONNX model",
        description="Writes a lifter as an ONNX model, whose inputs, outputs, landmarks and axes "
        "stand in it. It needs pip install 'deepmds-keras[onnx]'.",
    )
    export.add_argument("out", type=Path, metavar="OUT", help="new file, such as model.onnx")
    export.add_argument("--model", default=FAMILIES[DEFAULT].shipped[FALLBACK], metavar="NAME|FILE",
        help="shipped weights of a lifter, or a file of LandmarkLifter.save() (default: "
        "%(default)s)")  # fmt: skip
    values = vars(parser.parse_args(arguments))
    if values["command"] == "predict" and values["detector"] is None:
        values["detector"] = "mediapipe" if values["landmarker"] else default_detector()
    return (Export if values.pop("command") == "export" else Options)(**values)


def _formats(text: str) -> tuple[str, ...]:
    formats = tuple(dict.fromkeys(part.strip() for part in text.lower().split(",")))
    unknown = [name for name in formats if name not in FORMATS]
    if unknown:
        raise argparse.ArgumentTypeError(
            f"must be some of {', '.join(FORMATS)}, with commas between. Received {unknown[0]!r}."
        )
    return formats


def _positive(text: str) -> float:
    value = _not_negative(text)
    if value == 0:
        raise argparse.ArgumentTypeError("must be above 0. Received 0.")
    return value


def _not_negative(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not (math.isfinite(value) and value >= 0):
        raise argparse.ArgumentTypeError(f"must be a number, not negative. Received {text!r}.")
    return value


def _jobs(text: str) -> int:
    return -1 if text == "-1" else _count(text, "1 or more, or -1")


def _count(text: str, wanted: str = "1 or more") -> int:
    if not (text.isdecimal() and int(text) > 0):
        raise argparse.ArgumentTypeError(f"must be {wanted}. Received {text!r}.")
    return int(text)
