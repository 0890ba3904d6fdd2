"""One run of an experiment: what it was asked for, its folders, its lock and its records."""

from __future__ import annotations

import argparse
import datetime
import json
import logging
import os
import resource
import shlex
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass, replace
from pathlib import Path

from threadpoolctl import threadpool_limits

from data_gen.models.registry import MODELS
from data_gen.views.projections import PROTOCOLS
from deepmds_keras.io.atomic import whole_file
from deepmds_keras.io.errors import InputError
from experiments.locks import locked
from experiments.presets import PRESETS, Preset
from experiments.records import read_record, with_checksum
from experiments.refusals import refusals_on_one_line

EVALUATORS = ("paper", "released")
# The paper's two halves, each with landmarks of its own, which are also the folders of the authors'
# release; and the CelebA experiment, which tests the networks of the first half.
SCHEMES = {"bfm": "bfm72", "flame": "ibug51", "celeba": "bfm72"}
_BFM_FILES = ("AE_occ2orth_BFM.h5", "deep_dissim_ours.h5")
AUTHORS_FILES = {
    "bfm": _BFM_FILES,
    "celeba": _BFM_FILES,
    "flame": ("AE_occ2orth_FLAME.h5", "deep_dissim_from_2D_dist_pers_rem_proj.h5"),
}
_DATASETS = {
    "coma": "CoMA's registered meshes (https://coma.is.tue.mpg.de, after registration)",
    "casia": "CASIA-3D FaceV1 (http://biometrics.idealtest.org, after registration)",
}
# Sums of gradients are split between the threads: a network depends on their number.
_TENSORFLOW_THREADS = "2"


@dataclass(frozen=True)
class Run:
    """What identifies a run, and where its files lie.

    Attributes:
        model: Name of the morphable model.
        preset: Sizes.
        track: Which of the paper's experiments, one of `SCHEMES`.
        seed: Of faces, views, initial weights, mini-batches and test subsets.
        protocol: How faces are projected, see `data_gen.views.projections.draw_cameras`.
        data: File or folder of a model that is not embedded, or None.
        coma, casia: Folders of the data sets CoMA and CASIA-3D, or None: in `data`, if there, and
            otherwise the open stand-ins.
        celeba: Folder of the data set CelebA, or None: its stand-in.
        tf_flame: Folder of faces with 51 landmarks for a figure, see
            `experiments.tracks.celeba.celeba_flame`, or None.
        casia_index: Table of the scans of CASIA-3D that are used, or None for all.
        authors: Folder of the authors' released weights, or None.
        evaluator: How predictions are scored, one of `EVALUATORS`.
        mediapipe: Interpreter of the virtual environment that has MediaPipe, or None: the one that
            `make setup-mediapipe` makes.
        ringnet: Prefix of the licensed RingNet checkpoint, or None: ours is trained.
        jobs: Processes for the embedding and for rendering, see `experiments.tasks`.
        build: Folder of arrays and weights; results: folder of tables and figures.
    """

    model: str
    preset: Preset
    track: str = "bfm"
    seed: int = 0
    protocol: str = "paper"
    data: str | None = None
    coma: str | None = None
    casia: str | None = None
    celeba: str | None = None
    tf_flame: str | None = None
    casia_index: Path | None = None
    authors: str | None = None
    evaluator: str = "paper"
    mediapipe: str | None = None
    ringnet: str | None = None
    jobs: int = -1
    build: Path = Path("build")
    results: Path = Path("results")

    @property
    def work(self) -> Path:
        """Folder of the run's arrays and weights: one for everything that would change them."""
        name = f"{self.track}-{self.preset.name}-{self.protocol}-seed{self.seed}"
        return self.build / self.model / f"{name}{self._given}"

    @property
    def scheme(self) -> str:
        """Landmark scheme of the track."""
        return SCHEMES[self.track]

    @property
    def trained(self) -> Run:
        """The run whose training faces and networks this one tests: itself, or the BFM track's."""
        return self if self.track != "celeba" else replace(self, track="bfm", celeba=None)

    @property
    def flame(self) -> Run:
        """The run of the FLAME track with the same model, sizes and seed."""
        return replace(self, track="flame", celeba=None)

    def network_file(self, name: str) -> Path:
        """Checkpoint of a network, which is also the trained network once its epochs are done."""
        return self.work / "networks" / f"{name}.npz"

    def prediction_file(self, method: str) -> Path:
        """What a method made of the test views, or photos."""
        if method == "ringnet" and self.ringnet is not None:
            method = self.ringnet_stage
        return self.work / "predictions" / f"{method}.npz"

    @property
    def ringnet_stage(self) -> str:
        """Name of the stage, and of its files, that runs the licensed RingNet or trains ours."""
        return "ringnet" if self.ringnet is None else "ringnet-licensed"

    @property
    def evaluation(self) -> str:
        """Name of the stage that scores, of its record and of its folder of results."""
        released = "" if self.evaluator == "paper" else f"-evaluator-{self.evaluator}"
        return f"{self.track}{released}"

    @property
    def model_results(self) -> Path:
        """`results/<model>`; other presets than the paper's lie apart, not to overwrite it."""
        root = self.results if self.preset.name == "paper" else self.results / self.preset.name
        return root / self.model

    def experiment_results(self, name: str) -> Path:
        """`results/<model>/<name>`, with the protocol and seed after it if not the default."""
        protocol = "" if self.protocol == "paper" else f"-{self.protocol}"
        seed = "" if self.seed == 0 else f"-seed{self.seed}"
        return self.model_results / f"{name}{protocol}{seed}{self._given}"

    def folder_of(self, dataset: str) -> Path | None:
        """Folder of `"coma"` or `"casia"`: as named, or in `data` under its usual name, or None."""
        if getattr(self, dataset):
            return Path(getattr(self, dataset))
        inside = sorted(Path(self.data).glob("*")) if self.data else []
        names = (path for path in inside if path.is_dir())
        found = next((path for path in names if path.name.lower().startswith(dataset)), None)
        if found is None and self.model == "flame":
            # Its expressions have no names by which a stand-in could be made.
            raise InputError(
                f"{dataset.upper()}= must be the folder of {_DATASETS[dataset]}, or DATA= must "
                f"hold one that begins with {dataset}. Received neither."
            )
        return found

    @property
    def _given(self) -> str:
        """Which data sets were named, for folders: others hold what stands in for them."""
        suffixes = {"coma": "-coma", "casia": "-casia", "celeba": "-real"}
        return "".join(suffix for name, suffix in suffixes.items() if getattr(self, name))


def parse_run(description: str, arguments: list[str] | None = None) -> Run:
    """The command line that every stage shares."""
    parser = argparse.ArgumentParser(
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
    add("--casia-index", metavar="CSV", help="table of the scans of CASIA-3D that are used")
    add("--mediapipe", metavar="PYTHON", help="interpreter of the environment with MediaPipe")
    add("--ringnet", metavar="PREFIX", help="checkpoint of the licensed RingNet, to use that one")
    add("--faces", type=int, help="of make stream, instead of the preset's")
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
    for name in ("data", "authors", "coma", "casia", "celeba", "tf_flame", "mediapipe", "ringnet"):
        values[name] = values[name] or None
    values["casia_index"] = Path(values["casia_index"]) if values["casia_index"] else None
    if values["track"] != "bfm" and values["evaluator"] != "paper":
        parser.error("--evaluator must be paper but for the BFM track: no script of the authors "
                     f"scores another. Received {values['evaluator']}.")  # fmt: skip
    embedded = values["track"] == "celeba" and values["model"] == "openhead"
    if embedded and values["data"] and values["celeba"] is None:
        parser.error("--data must be a folder that holds CelebA's img_align_celeba, with "
                     f"--model openhead. Received {values['data']}.")  # fmt: skip
    for name in AUTHORS_FILES[values["track"]] if values["authors"] else ():
        if not Path(values["authors"], name).is_file():
            parser.error(f"--authors must be a folder with {name}. Received {values['authors']}.")
    return Run(**values)


@contextmanager
def stage(run: Run, name: str) -> Iterator[dict]:
    """Run one stage under the lock of the run's folder and record it in `<name>.json`.

    The record is written last, so that it stands for a stage that is complete. A file or argument
    that cannot be used, or a disk that is full, ends the process with one line and status 2. What a
    stage that was killed had half written is deleted. A stage that scores waits for others that
    write results of the same model, since some files are of them all.

    Args:
        run: The run.
        name: Of the stage.

    Yields:
        A dict for what else the record is to say; `processes_mb`, the peak memory of each process
        that the stage started, is added to its own.
    """
    record: dict = {}
    started, clock = datetime.datetime.now(datetime.timezone.utc), time.perf_counter()
    quiet_tensorflow()
    os.environ["TF_NUM_INTRAOP_THREADS"] = _TENSORFLOW_THREADS
    print(f"— {name}: {run.model}, {run.preset.name} preset, seed {run.seed}", flush=True)
    turn = locked(run.model_results, wait=True) if name == run.evaluation else nullcontext()
    with refusals_on_one_line(), locked(run.work), turn:
        for left_behind in run.work.rglob(".*.partial"):
            left_behind.unlink(missing_ok=True)
        yield record
        record |= {
            "stage": name,
            "command": "python -m experiments " + shlex.join(sys.argv[1:]),
            "started": started.isoformat(timespec="seconds"),
            "seconds": round(time.perf_counter() - clock, 1),
            "peak_memory_mb": peak_memory_mb() + sum(record.get("processes_mb", ())),
        }
        write_json(run.work / f"{name}.json", with_checksum(record))
    print(f"  {record['seconds']} s, {record['peak_memory_mb']} MB at most", flush=True)


@contextmanager
def one_core() -> Iterator[None]:
    """Compute and draw with one thread: a process a core, and sums in one order on any machine."""
    os.environ.setdefault("LP_NUM_THREADS", "1")  # of Mesa's software renderer
    with threadpool_limits(1):
        yield


def on_one_core(function: Callable, *arguments):
    """Call a function in `one_core`: as a task, for a process that needs no TensorFlow for it."""
    with one_core():
        return function(*arguments)


def load_record(run: Run, name: str) -> dict:
    """What the stage of that name recorded when it was done.

    Raises:
        InputError: It was not done, or its record is damaged.
    """
    return read_record(run.work / f"{name}.json")


def quiet_tensorflow() -> None:
    """Each network of a stage is traced once, which TensorFlow takes for one traced too often."""
    logging.getLogger("tensorflow").setLevel(logging.ERROR)


def write_json(path: Path, value: dict) -> None:
    write_text(path, json.dumps(value, indent=2, ensure_ascii=False) + "\n")


def write_text(path: Path, text: str) -> None:
    write_bytes(path, text.encode("utf-8"))


def write_bytes(path: Path, content: bytes) -> None:
    """Write a file, under a temporary name until it is complete."""
    with whole_file(path) as file:
        file.write(content)


def peak_memory_mb() -> int:
    """Largest resident set of this process, or of a child that has ended."""
    unit = 1 if sys.platform == "darwin" else 1024
    usage = (resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    return round(max(u.ru_maxrss for u in usage) * unit / 1e6)
