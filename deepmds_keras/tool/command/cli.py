"""The command line of `deepmds`: its arguments, and what it prints about a source."""

from __future__ import annotations

import argparse
import inspect
import math
from collections.abc import Callable, Iterator
from pathlib import Path

from deepmds_keras import __version__
from deepmds_keras.geometry.views import sample_views
from deepmds_keras.landmarks import load_scheme, said_sizes
from deepmds_keras.tool.command.outputs import FORMATS
from deepmds_keras.tool.detection import DETECTORS, default_detector
from deepmds_keras.tool.predict.faces import Face, counted, frame_of
from deepmds_keras.tool.predict.models import DEFAULT, FALLBACK, FAMILIES
from deepmds_keras.tool.predict.smoothing import CAUSAL, RATE
from deepmds_keras.tool.predict.videos import tell_tracks

_DESCRIPTION = """\
Finds faces in photos and videos and estimates their landmarks in 3D, or lifts 2D
landmarks from files. Shapes face the front: +x to the subject's left, +y up, +z out of the
face. A single view does not show the true size: --interocular sets it."""
_LISTED_FAULTS = 10  # of one source
_SCHEME = (
    "order and names of the landmarks: a scheme by name, or your own table (csv) "
    "(default: by their number)"
)
_ANGLES = {
    "yaw": "largest turn of the shapes to either side",
    "pitch": "largest turn up and down",
    "roll": "largest lean to either side",
    "field_of_view": "largest angle that a shape fills in the camera; 0 is orthographic",
}
_EPILOG = """\
examples:
  deepmds predict photo.jpg --view
  deepmds predict photos/ --out faces --jobs 4
  deepmds predict clip.mp4 --smooth 2
  deepmds predict landmarks.csv --interocular 90 --format csv,ply

Unchanged sources that have results of the same options are skipped, so the same command resumes an
interrupted run. Other results in their place are an error; --overwrite replaces them.
Exit status: 0; 1 if a source could not be used (the others are done); 2 for wrong arguments;
130 after Ctrl-C."""


def parse(arguments: list[str] | None = None) -> argparse.Namespace:
    """Read the command line; wrong arguments end the process, with the usage and status 2.

    Returns:
        `command`, `"predict"`, `"live"`, `"export"`, `"train"` or `"evaluate"`, and the keyword
        arguments of `run`, `write_live_page`, `export`, `train` or `evaluate`.
    """
    parser = argparse.ArgumentParser(
        prog="deepmds", description="3D face landmarks from a single image."
    )
    parser.add_argument("--version", action="version", version=f"deepmds-keras {__version__}")
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")
    predict = commands.add_parser(
        "predict",
        help="3D landmarks from photos, videos or 2D landmarks",
        description=_DESCRIPTION,
        epilog=_EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add = predict.add_argument
    add("sources", nargs="+", metavar="SOURCE",
        help="photo, folder of photos, video, or landmarks (csv, npy, pts, json) of "
        f"{said_sizes()} points, or as many as the model has")  # fmt: skip
    add("--recursive", action="store_true", help="include photos in subfolders")
    add("--out", type=Path, default=Path("deepmds-out"), metavar="DIR",
        help="folder of the results (default: deepmds-out)")  # fmt: skip
    add("--format", dest="formats", type=_formats, default=("csv",), metavar="LIST",
        help=f"any of {', '.join(FORMATS)}, in addition to the picture (default: csv); glb is the "
        "head of --mesh for Blender, Unity and the web (extra mesh)")  # fmt: skip
    add("--overwrite", action="store_true",
        help="redo finished sources, and replace existing files")  # fmt: skip
    add("--view", action="store_true",
        help="also write HTML pages with faces that can be rotated")  # fmt: skip
    add("--mesh", action="store_true",
        help="also write a head fitted to each face: NAME.mesh.ply, NAME.mesh.obj")  # fmt: skip
    add("--detector", choices=DETECTORS,
        help="; or ".join(f"{name} ({row.licence})" for name, row in DETECTORS.items())
        + " (default: the first that is installed)")  # fmt: skip
    add(
        "--landmarker",
        metavar="FILE",
        help="MediaPipe face landmarker (.task) (default: the one in the package)",
    )
    add("--y-up", action="store_true", help="y points up in landmark files")
    add("--scheme", metavar="NAME|FILE", help=_SCHEME)
    add("--image-size", nargs=2, type=_number(0, "a number above 0"), metavar=("W", "H"),
        help="x and y in landmark files are fractions of an image of this size, as from "
        "MediaPipe")  # fmt: skip
    add("--smooth", type=_smooth, default=0.0, metavar="FRAMES|causal",
        help="smooth each face of a video over time, never across gaps: with a Gaussian of this "
        "standard deviation in frames, or from earlier frames only (causal); the rows of a "
        f"landmark file count as frames of one face ({RATE} a second for causal)")  # fmt: skip
    add("--every", type=_number(0, "1 or more", int), default=1, metavar="N",
        help="use every Nth frame of a video (default: 1)")  # fmt: skip
    add("--interocular", type=_number(0, "a number above 0"), metavar="MM",
        help="distance between the outer corners of the eyes; results are then in mm")  # fmt: skip
    add("--model", metavar="NAME|FILE",
        help=f"{' or '.join(FAMILIES)}, shipped weights by name, or a file from "
        f"LandmarkLifter.save() or DeepMDS.save() (default: {DEFAULT})")  # fmt: skip
    add("--jobs", type=_number(0, "1 or more, or -1", int), default=-1, metavar="N",
        help="number of processes (default: one per core)")  # fmt: skip
    live = commands.add_parser(
        "live",
        help="write a page that shows faces from a camera in 3D",
        description="Writes one HTML file of 7 MB that finds faces from a camera, photo or video "
        "with MediaPipe and shows them in 3D, in a browser, without a network. To write it, "
        "MediaPipe's browser package is downloaded from registry.npmjs.org (10 MB), unless "
        "--tasks-vision names it.",
    )
    add = live.add_argument
    add("path", type=Path, metavar="OUT", help="new file, such as live.html")
    add("--model", default=FAMILIES[DEFAULT].shipped[FALLBACK], metavar="NAME|FILE",
        help="weights of a lifter for 51 landmarks: shipped ones, or a file from "
        "LandmarkLifter.save() (default: %(default)s)")  # fmt: skip
    add("--tasks-vision", type=Path, metavar="FILE|DIR",
        help="that package as downloaded by npm pack, or its unpacked folder")  # fmt: skip
    export = commands.add_parser(
        "export",
        help="write a lifter as an ONNX model",
        description="Writes a lifter as an ONNX model, with its inputs, outputs, landmarks and "
        "axes in its metadata. It needs pip install '.[onnx]', from the repository.",
    )
    export.add_argument("out", type=Path, metavar="OUT", help="new file, such as model.onnx")
    export.add_argument("--model", default=FAMILIES[DEFAULT].shipped[FALLBACK], metavar="NAME|FILE",
        help="shipped weights of a lifter, or a file from LandmarkLifter.save() (default: "
        "%(default)s)")  # fmt: skip
    export.add_argument("--scheme", metavar="NAME|FILE", help=_SCHEME)
    _add_train(commands)
    evaluate = commands.add_parser(
        "evaluate",
        help="score lifting on your own true 3D landmarks",
        description="Lifts the x and y of true 3D landmarks and scores the shapes against them, by "
        "yaw, next to the mean shape and, with --eos, eos. Writes a table and, with the extra "
        "evaluate, a figure.",
    )
    add = evaluate.add_argument
    add("truth", metavar="TRUTH",
        help="npy (n, L, 3), L = 51, 68 or the model's, or csv with columns x, y, z and face, one "
        "landmark per row; faces as the camera sees them")  # fmt: skip
    add("--landmarks", metavar="FILE",
        help="2D landmarks to lift, as predict takes them, in the order of --scheme if that is a "
        "table of yours (default: x and y of TRUTH)")  # fmt: skip
    add("--y-up", action="store_true", help="y points up in that file")
    add("--image-size", nargs=2, type=_number(0, "a number above 0"), metavar=("W", "H"),
        help="size of the image if that file has fractions of it")  # fmt: skip
    add("--model", metavar="NAME|FILE",
        help="shipped weights of a lifter, or a file from LandmarkLifter.save(), for faces or "
        "other objects (default: the shipped weights for L)")  # fmt: skip
    add("--scheme", metavar="NAME|FILE", help=_SCHEME)
    add("--eos", metavar="DIR",
        help="eos's folder share: adds its fit of the Surrey Face Model (extra eos)")  # fmt: skip
    add("--out", type=Path, default=Path("deepmds-evaluation"), metavar="DIR",
        help="folder of the results (default: %(default)s)")  # fmt: skip
    add("--overwrite", action="store_true", help="replace existing results")
    options = parser.parse_args(arguments)
    if options.command == "predict" and options.detector is None:
        options.detector = default_detector(options.landmarker)
    return options


def _add_train(commands: argparse._SubParsersAction) -> None:
    train = commands.add_parser(
        "train",
        help="train a lifter for other objects on their 3D shapes",
        description="Trains a lifter on random views of given shapes and reports its error on "
        "held-out shapes, next to the mean shape and ridge regression. The same command resumes an "
        "interrupted training run. It needs pip install '.[keras]', from the repository.",
        formatter_class=argparse.ArgumentDefaultsHelpFormatter,
    )
    add = train.add_argument
    add("source", metavar="SHAPES",
        help="npy (n, L, 3): L landmarks of n shapes, at best 55 or more; +y up")  # fmt: skip
    add("out", metavar="OUT", help="new file, such as chair.npz, for predict --model")
    for name, help_text in _ANGLES.items():
        default = inspect.signature(sample_views).parameters[name].default
        number = _number(-1e-300, "a number, not negative")
        option = f"--{name.replace('_', '-')}"
        add(option, type=number, default=default, metavar="DEGREES", help=help_text)
    add("--noise", type=_number(-1e-300, "a number, not negative"), default=0.05, metavar="SD",
        help="largest s.d. of the landmark noise, in r.m.s. radii of a view")  # fmt: skip
    add("--missing", type=_number(-1e-300, "a number, not negative"), default=0.2, metavar="SHARE",
        help="largest share of hidden landmarks")  # fmt: skip
    add("--steps", type=_number(0, "1 or more", int), default=4000, metavar="N",
        help="number of mini-batches")  # fmt: skip
    add("--seed", type=_number(-1, "0 or more", int), default=0, metavar="N",
        help="seed of everything that is random")  # fmt: skip


def lines_about(source: Path, faces: list[Face], most: int) -> Iterator[str]:
    """Lines to print about a finished source: its first faces, up to `most`."""
    if faces[0].frame_ref is not None:
        frames = {frame_of(face).frame for face in faces}
        yield f"{source}: faces in {counted(len(frames), 'frame')}"
        yield from tell_tracks(faces, most)
        return
    seen = [face for face in faces if not face.is_gap]
    gaps = len(faces) - len(seen)
    thing = load_scheme(faces[0].scheme).thing
    said = [counted(len(seen), thing), *([counted(gaps, "gap")] if gaps else [])]
    yield f"{source}: {', '.join(said)}"
    for face in seen[:most]:
        yield f"  {face.name}: {face.angles}"
        yield from (f"    {note}" for note in face.notes)
    if rest := seen[most:]:
        yield f"  and {len(rest)} more, {sum(bool(face.notes) for face in rest)} of them with notes"


def fault_of(source: Path, faces: list[Face]) -> str | None:
    """Describe the faces that are gaps because they cannot be used."""
    faults = {i: face.notes[0] for i, face in enumerate(faces, 1) if face.is_gap and face.notes}
    if not faults:
        return None
    listed = [f"{i:,}" for i in faults][:_LISTED_FAULTS]
    listed += ["…"] if len(faults) > len(listed) else []
    return (
        f"{source}: {len(faults):,} of {len(faces):,} {load_scheme(faces[0].scheme).thing}s cannot "
        "be used and are gaps: "
        f"{', '.join(listed)}. "
        f"The first {min(faults.items())[1]}"
    )


def printable(text: str) -> str:
    """Text on one line, whatever a file's name contains."""
    return "".join(letter if letter.isprintable() else repr(letter)[1:-1] for letter in text)


def _formats(text: str) -> tuple[str, ...]:
    formats = [part.strip() for part in text.lower().split(",")]
    unknown = [name for name in formats if name not in FORMATS]
    if unknown:
        raise argparse.ArgumentTypeError(
            f"must be some of {', '.join(FORMATS)}, with commas between. Received {unknown[0]!r}."
        )
    # In one order, so that the same formats resume a run however they were typed.
    return tuple(name for name in FORMATS if name in formats)


def _smooth(text: str) -> float | str:
    wanted = f"a number, not negative, or {CAUSAL}"
    return text if text == CAUSAL else _number(-1e-300, wanted)(text)


def _number(least: float, wanted: str, kind: type = float) -> Callable[[str], float]:
    """An argument type: a finite number in the wanted range."""

    def parsed(text: str) -> float:
        try:
            value = kind(text)
        except ValueError:
            value = math.nan
        if not (least < value < math.inf or (value == -1 and wanted.endswith("-1"))):
            raise argparse.ArgumentTypeError(f"must be {wanted}. Received {text!r}.")
        return value

    return parsed
