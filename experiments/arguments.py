"""The command line that every stage shares."""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path

from data_gen.models.registry import MODELS
from data_gen.views.projections import PROTOCOLS
from experiments.presets import PRESETS
from experiments.run import AUTHORS_FILES, EVALUATORS, MOBILEFACES, SCHEMES, Run
from experiments.stages import SWITCHES

_PATHS = ("data", "coma", "casia", "celeba", "tf_flame", "casia_index")


def parse_run(description: str, arguments: list[str] | None = None) -> Run:
    """The command line that every stage shares."""
    parser = _Parser(
        description=description, formatter_class=argparse.ArgumentDefaultsHelpFormatter
    )
    add = parser.add_argument
    add("--track", choices=tuple(SCHEMES), default="bfm", help="which experiment")
    add("--model", choices=MODELS, default="openhead", help="morphable model of the faces")
    add("--data", metavar="PATH", help="file or folder of a model that is not embedded")
    add("--preset", choices=tuple(PRESETS), default="paper", help="sizes of the experiment")
    add("--seed", type=int, default=0, help="of everything random")
    add("--protocol", choices=PROTOCOLS, default="paper", help="how faces are projected")
    add("--authors", metavar="DIR", help="folder of the authors' released weights (*.h5)")
    add("--coma", metavar="DIR", help="folder of the data set CoMA, instead of its stand-in")
    add("--casia", metavar="DIR", help="folder of the data set CASIA-3D, instead of its stand-in")
    add("--celeba", metavar="DIR", help="folder of the data set CelebA, instead of its stand-in")
    add("--tf-flame", metavar="DIR", help="folder of photos with 51 landmarks, for a figure")
    add("--evaluator", choices=EVALUATORS, default="paper", help="how predictions are scored")
    add("--mobileface", choices=MOBILEFACES, default="cosine", help="how MobileFace is trained")
    add("--casia-index", metavar="CSV", help="table of the scans of CASIA-3D that are used")
    add("--ringnet", metavar="PREFIX", help="checkpoint of the licensed RingNet, to use that one")
    add("--without", choices=SWITCHES, action="append", default=[], help="stages to leave out")
    add("--faces", type=int, help="of make stream, instead of the preset's")
    add("--seeds", type=int, help="number of them, of make seeds and of the BFM table")
    add("--jobs", type=int, default=-1, help="processes side by side, -1 for every core")
    add("--build", type=Path, default=Path("build"), help="folder of arrays and weights")
    add("--results", type=Path, default=Path("results"), help="folder of tables and figures")
    values = vars(parser.parse_args(arguments))
    if values["seed"] < 0:
        parser.error(f"--seed must not be negative. Received {values['seed']}.")
    values["preset"] = PRESETS[values["preset"]]
    faces = values.pop("faces")
    if faces is not None:
        if faces < 2:
            parser.error(f"--faces must be at least 2. Received {faces}.")
        values["preset"] = replace(values["preset"], streamed_faces=faces)
    if values["seeds"] is not None and values["seeds"] < 2:
        parser.error(f"--seeds must be at least 2. Received {values['seeds']}.")
    for name in (*_PATHS, "authors", "ringnet"):
        values[name] = values[name] or None
    for name in _PATHS:
        if values[name] and not Path(values[name]).exists():
            option = name.replace("_", "-")
            parser.error(f"--{option} must be a file or folder. Received {values[name]}, which "
                         "does not exist.")  # fmt: skip
    values["casia_index"] = Path(values["casia_index"]) if values["casia_index"] else None
    values["without"] = tuple(values["without"])
    for name in ("coma", "casia", "celeba") if values["data"] else ():
        values[name] = values[name] or _within(Path(values["data"]), name)
    if values["track"] != "bfm" and values["evaluator"] != "paper":
        parser.error("--evaluator must be paper but for the BFM track: no script of the authors "
                     f"scores another. Received {values['evaluator']}.")  # fmt: skip
    if values["model"] == "openhead" and values["data"] and Path(values["data"]).is_file():
        parser.error("--data must be a folder of data sets with --model openhead, which is "
                     f"embedded. Received the file {values['data']}.")  # fmt: skip
    embedded = values["track"] == "celeba" and values["model"] == "openhead"
    if embedded and values["data"] and values["celeba"] is None:
        parser.error("--data must be a folder that holds CelebA's img_align_celeba, with "
                     f"--model openhead. Received {values['data']}.")  # fmt: skip
    for name in AUTHORS_FILES[values["track"]] if values["authors"] else ():
        if not Path(values["authors"], name).is_file():
            parser.error(f"--authors must be a folder with {name}. Received {values['authors']}.")
    return Run(**values)


def _within(data: Path, dataset: str) -> str | None:
    """Folder of a data set under its usual name, in the folder of all data."""
    folders = [data, *sorted(data.glob("*"))]
    if dataset == "celeba":
        found = (path for path in folders if (path / "img_align_celeba").is_dir())
    else:
        found = (p for p in folders[1:] if p.is_dir() and p.name.lower().startswith(dataset))
    return next(map(str, found), None)


class _Parser(argparse.ArgumentParser):
    """One whose refusals are one line, as all others."""

    def error(self, message: str):
        self.exit(2, f"error: {message}\n")
