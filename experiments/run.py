"""One run of an experiment: its options, the locations of its files, and its command line."""

from __future__ import annotations

import argparse
from collections.abc import Collection
from dataclasses import dataclass, field, fields, replace
from pathlib import Path

import numpy as np

from data_gen.models.registry import MODELS
from data_gen.views import PROTOCOLS
from deepmds_keras.errors import InputError
from experiments.presets import PRESETS, Preset

_FEW = 3  # seeds
EVALUATORS = ("paper", "released")
MOBILEFACES = ("cosine", "paper")
# The paper's two halves, each with its own landmarks, named like the folders of the authors'
# release; and the CelebA experiment, which tests the networks of the first half.
SCHEMES = {"bfm": "bfm72", "flame": "ibug51", "celeba": "bfm72"}
_BFM_FILES = ("AE_occ2orth_BFM.h5", "deep_dissim_ours.h5")
AUTHORS_FILES = {
    "bfm": _BFM_FILES,
    "celeba": _BFM_FILES,
    "flame": ("AE_occ2orth_FLAME.h5", "deep_dissim_from_2D_dist_pers_rem_proj.h5"),
}
SECOND_NET = "deep_dissim_ours2.h5"  # of the BFM track, which the paper does not mention
# Data sets of each track, and the suffix of folders made from them.
SUFFIXES = {
    "bfm": {},
    "flame": {"coma": "-coma", "casia": "-casia"},
    "celeba": {"celeba": "-real"},
}
_DATASETS = {
    "coma": "CoMA's registered meshes (https://coma.is.tue.mpg.de, after registration)",
    "casia": "CASIA-3D FaceV1 (http://biometrics.idealtest.org, after registration)",
}


def _option(help: str, default=None, **argument):
    """A field of `Run` with its option on the command line."""
    return field(default=default, metadata={"help": help} | argument)


@dataclass(frozen=True)
class Run:
    """Identity of a run, and the locations of its files.

    Each attribute but the last two is an option of every step: `casia_index` is `--casia-index`.
    `build` is the folder of arrays and weights, `results` that of tables and figures.
    """

    model: str = _option("morphable model of the faces", "openhead", choices=MODELS)
    preset: Preset = _option("sizes of the experiment", PRESETS["full"], choices=tuple(PRESETS))
    track: str = _option("which of the paper's experiments", "bfm", choices=tuple(SCHEMES))
    bfm_scale: float = _option("factor on the standard deviations of MODEL=bfm68", 1.0, type=float)
    seed: int = _option("seed of everything random", 0, type=int)
    protocol: str = _option("how faces are projected", "paper", choices=PROTOCOLS)
    data: str | None = _option("file or folder of a model that is not embedded")
    coma: str | None = _option("folder of the data set CoMA, instead of its substitute")
    casia: str | None = _option("folder of the data set CASIA-3D, instead of its substitute")
    celeba: str | None = _option("folder of the data set CelebA, instead of its substitute")
    tf_flame: str | None = _option("folder of photos with 51 landmarks, for a figure")
    sfm: str | None = _option("eos's folder share, with the Surrey Face Model, to test on")
    casia_index: str | None = _option("table of the scans of CASIA-3D that are used")
    authors: str | None = _option("folder of the authors' released weights (*.h5)")
    evaluator: str = _option("how predictions are scored", "paper", choices=EVALUATORS)
    ringnet: str | None = _option("prefix of the licensed RingNet's checkpoint, to use that one")
    mobileface: str = _option("how MobileFace is trained", "cosine", choices=MOBILEFACES)
    real: str | None = _option("npz of landmarks of real faces, by two detectors")
    objects: str | None = _option("folder of npz files of objects other than faces")
    seeds: int | None = _option("number of seeds, for the BFM table and make seeds", type=int)
    faces: int | None = _option("number of faces of make stream (default: the preset's)", type=int)
    jobs: int = _option("processes side by side, -1 for every core", -1, type=int)
    build: Path = Path("build")
    results: Path = Path("results")

    @property
    def work(self) -> Path:
        """Folder of the run's arrays and weights, separate for all options that change them."""
        name = f"{self.track}-{self.preset.name}-{self.protocol}-seed{self.seed}"
        return self.build / self.model / f"{name}{self._given}"

    @property
    def scheme(self) -> str:
        """Landmark scheme of the track, or of a face model that knows no other."""
        return MODELS[self.model].scheme or SCHEMES[self.track]

    @property
    def trained(self) -> Run:
        """The run whose training faces and networks this one tests: itself, or the BFM track's."""
        return self.on("bfm") if self.track == "celeba" else self

    @property
    def all_seeds(self) -> range:
        """Seeds of `make seeds`, and of the BFM table with `SEEDS=`."""
        return range(self.seed, self.seed + (self.seeds or self.preset.n_seeds))

    @property
    def few_seeds(self) -> range:
        """Seeds of studies that train a lot."""
        return range(self.seed, self.seed + min(_FEW, self.preset.n_seeds))

    @property
    def streamed_faces(self) -> int:
        """Number of faces of `make stream`."""
        return self.faces or self.preset.streamed_faces

    def on(self, track: str) -> Run:
        """The run of a track with the same model, sizes and seed."""
        return self if track == self.track else replace(self, track=track, evaluator="paper")

    def record_file(self, name: str) -> Path:
        """Record of a finished step, see `experiments.records`."""
        return self.work / "records" / f"{name}.json"

    @property
    def networks(self) -> Path:
        """Folder of checkpoints, which become the trained networks after the last epoch."""
        return self.work / "networks"

    def network_file(self, name: str) -> Path:
        """Checkpoint of a network."""
        return self.networks / f"{name}.npz"

    def prediction_file(self, method: str) -> Path:
        """File of a method's predictions for the test views, or photos."""
        return self.work / "predictions" / f"{method}.npz"

    @property
    def evaluation(self) -> str:
        """Name of the scoring step, of its record and of its folder of results."""
        released = "" if self.evaluator == "paper" else f"-evaluator-{self.evaluator}"
        return f"{self.track}{released}"

    @property
    def shared_results(self) -> Path:
        """Of all face models: `results`; presets other than `full` have separate folders."""
        return self.results if self.preset.name == "full" else self.results / self.preset.name

    @property
    def model_results(self) -> Path:
        """`<model>` in `shared_results`."""
        return self.shared_results / self.model

    def experiment_results(self, name: str) -> Path:
        """`results/<model>/<name>`, with the protocol and seed after it if not the default."""
        protocol = "" if self.protocol == "paper" else f"-{self.protocol}"
        seed = "" if self.seed == 0 else f"-seed{self.seed}"
        return self.model_results / f"{name}{protocol}{seed}{self._given}"

    def folder_of(self, dataset: str) -> Path | None:
        """Folder of `"coma"`, `"casia"` or `"celeba"`, or None for its substitute."""
        folder = getattr(self, dataset)
        if folder is None and self.model == "flame" and dataset in _DATASETS:
            # Its expressions have no names by which a substitute could be made.
            raise InputError(
                f"{dataset.upper()}= must be the folder of {_DATASETS[dataset]}, or DATA= must "
                f"have a subfolder whose name begins with {dataset}. Received neither."
            )
        return None if folder is None else Path(folder)

    @property
    def _given(self) -> str:
        """Suffix of folders made at another scale, or from given data sets, not substitutes."""
        suffixes = [s for name, s in SUFFIXES[self.track].items() if getattr(self, name)]
        scale = [] if self.bfm_scale == 1 else [f"-scale{self.bfm_scale:g}"]
        return "".join(scale + suffixes)


class Parser(argparse.ArgumentParser):
    """Argument parser whose errors are one line, like all others; options are not abbreviated."""

    def __init__(self, prog: str, **options):
        super().__init__(prog, allow_abbrev=False, **options)

    def error(self, message: str):
        self.exit(2, f"error: {message}\n")


OPTIONS = {option.name: option for option in fields(Run) if option.metadata}
# Variables of `make` that leave steps out, and their values; of RINGNET also a prefix of files.
_SWITCHES = {"MOBILEFACE": ("yes", *MOBILEFACES, "no"), "RINGNET": None, "MEDIAPIPE": ("yes", "no")}
EXISTING = ("data", "coma", "casia", "celeba", "tf_flame", "sfm", "real", "objects", "casia_index")
# The last are a folder and a prefix of files, of which `check_given` knows what they must hold.
_PATHS = (*EXISTING, "authors", "ringnet")


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of `Run` to a parser."""
    for name, option in OPTIONS.items():
        default = option.default.name if isinstance(option.default, Preset) else option.default
        flag = f"--{name.replace('_', '-')}"
        metavar = None if "choices" in option.metadata else name.upper()
        parser.add_argument(flag, default=default, metavar=metavar, **option.metadata)


def options_of(run: Run, names: Collection[str] = OPTIONS) -> list[str]:
    """Command-line words of some options of a run."""
    words = []
    for name in names:
        value = getattr(run, name)
        if value is not None:
            text = value.name if isinstance(value, Preset) else str(value)
            words += [f"--{name.replace('_', '-')}", text]
    return words


def run_of(values: dict) -> Run:
    """The run of parsed options; empty paths count as none, data sets within `--data` are used.

    Raises:
        InputError: A path does not exist, or options contradict each other.
    """
    given = {name: values[name] for name in OPTIONS} | {"preset": PRESETS[values["preset"]]}
    given |= {name: values[name] or None for name in _PATHS}
    _check_numbers(given)
    for name in EXISTING:
        if given[name] and not Path(given[name]).exists():
            raise InputError(
                f"{name.upper()} must be a file or folder. {given[name]} does not exist."
            )
    for name in ("coma", "casia", "celeba") if given["data"] else ():
        given[name] = given[name] or _within(Path(given["data"]), name)
    run = Run(**given)
    if not 0 < run.bfm_scale < np.inf or run.bfm_scale != 1 and run.model != "bfm68":
        raise InputError(
            "BFM_SCALE must be a positive number, and 1 unless MODEL=bfm68. "
            f"Received {run.bfm_scale:g} with MODEL={run.model}."
        )
    if MODELS[run.model].scheme and (run.track != "bfm" or run.authors):
        raise InputError(
            f"MODEL={run.model} works only on the BFM track, without AUTHORS: its landmarks differ "
            f"from the released networks', and it has no mesh. Received the track {run.track}."
        )
    if run.track != "bfm" and run.evaluator != "paper":
        raise InputError(
            "EVALUATOR must be paper except on the BFM track: the authors have no script that "
            f"scores another. Received {run.evaluator}."
        )
    if run.model == "openhead" and run.data and Path(run.data).is_file():
        raise InputError(
            "DATA must be a folder of data sets with MODEL=openhead, which is embedded. Received "
            f"the file {run.data}."
        )
    if run.model == "openhead" and run.track == "celeba" and run.data and not run.celeba:
        raise InputError(
            "DATA must be a folder that holds CelebA's img_align_celeba, with MODEL=openhead. "
            f"Received {run.data}."
        )
    return run


def run_of_variables(variables: dict[str, str], track: str = "bfm") -> Run:
    """The run that the variables of `make` describe.

    Args:
        variables: `MODEL`, `DATA` and so on; empty or missing ones get their defaults. A switch
            such as `RINGNET=no` leaves steps out, see `left_out`.

    Raises:
        InputError: A variable has no such value.
    """
    # Snakemake turns some into numbers.
    variables = {name: str(value) for name, value in variables.items() if value is not None}
    for name, values in _SWITCHES.items():
        if values and variables.get(name, "yes") not in values:
            raise InputError(
                f"{name} must be one of {', '.join(values)}. Received {variables[name]}."
            )
    words = ["--track", track]
    for name, value in variables.items():
        is_switch = name in _SWITCHES and value in ("yes", "no")
        if value and not is_switch:
            words += [f"--{name.lower().replace('_', '-')}", value]
    parser = Parser("make")
    add_options(parser)
    return run_of(vars(parser.parse_args(words)))


def left_out(variables: dict[str, str]) -> set[str]:
    """Switches that are `no`: `"MOBILEFACE"`, `"RINGNET"`, `"MEDIAPIPE"`."""
    return {name for name in _SWITCHES if variables.get(name) == "no"}


def _check_numbers(given: dict) -> None:
    for name, least in (("seed", 0), ("seeds", 2), ("faces", 2)):
        if given[name] is not None and given[name] < least:
            raise InputError(f"{name.upper()} must be at least {least}. Received {given[name]}.")
    if given["jobs"] < 1 and given["jobs"] != -1:
        raise InputError(
            f"JOBS must be at least 1, or -1 for every core. Received {given['jobs']}."
        )


def _within(data: Path, dataset: str) -> str | None:
    """Folder of a data set under its usual name, in the folder of all data."""
    folders = [data, *sorted(data.glob("*"))]
    if dataset == "celeba":
        matching = (path for path in folders if (path / "img_align_celeba").is_dir())
    else:
        matching = (p for p in folders[1:] if p.is_dir() and p.name.lower().startswith(dataset))
    return next(map(str, matching), None)
