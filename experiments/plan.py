"""What the rules of the Snakefile ask for: files, methods and commands of the steps of one run."""

import datetime
import glob
import os
import shlex
import sys
from collections.abc import Iterable, Mapping
from dataclasses import replace
from pathlib import Path

from data_gen.models.registry import OPEN, model_files, open_models
from deepmds_keras.baselines.eos_fit import surrey_files
from deepmds_keras.files import sha256_of
from deepmds_keras.landmarks import DETECTOR_ERRORS
from deepmds_keras.weights import PRETRAINED
from experiments.inputs import IMAGE_STEPS, TRAINING_IMAGES, embedding_file
from experiments.methods import METHODS, methods_of
from experiments.records import MANIFEST, PUBLISHED, listing, manifests, write_text
from experiments.run import AUTHORS_FILES, SECOND_NET, SUFFIXES, Run, left_out, options_of
from experiments.run import run_of_variables as run_of

# Steps that make the faces which methods are trained and tested on, by track.
TRAIN = {"bfm": "faces", "flame": "frames"}
TEST = {"bfm": "faces", "flame": "scans", "celeba": "photos"}
# Results of a track.
TABLES = (
    *("table.csv", "metrics.csv", "wilcoxon.csv", "table.tex", "table_paper.tex"),
    "figures/summary.png",
)
# Options by which the folders of every step are named, besides track, seed and data sets.
_ALWAYS = ("model", "bfm_scale", "preset", "protocol")


def memory_mb() -> int:
    """Memory of this machine."""
    return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") // 2**20


def track_of(wildcards) -> str:
    return Path(wildcards.work).name.partition("-")[0]


def seed_of(wildcards) -> int:
    return int(wildcards.work.partition("-seed")[2].partition("-")[0])


class Plan:
    """Files and commands of one run.

    Args:
        config: Variables of `make`.

    Attributes:
        published: Hash of what the paper prints and claims, with which results are compared.
        begun: File that is as old as the folder of arrays. Results that are older, such as
            committed ones, were not made from these arrays.
        model, open, openhead, ringnet, tf_flame, surrey, shipped: Files outside of `build`: of the
            face model, of all open ones and of the embedded one; of the licensed RingNet, with
            FLAME; photos for a figure; eos's; and the weights that come with the package.

    Raises:
        InputError: A variable has no such value, or the face model's files are missing.
    """

    def __init__(self, config: Mapping[str, str]):
        run = self.run = run_of(config)
        self._left_out = left_out(config)
        self.model = model_files(run.model, run.data)
        self.open = [f for name in open_models(run.data)[0] for f in model_files(name, run.data)]
        self.openhead = model_files(OPEN[0])
        self.ringnet = []
        if run.ringnet:  # which has its landmarks on FLAME's mesh
            files = _matching(f"{glob.escape(run.ringnet)}.*")
            self.ringnet = [*files, *model_files("flame", run.data)]
        self.tf_flame = _matching(f"{glob.escape(run.tf_flame)}/*.*") if run.tf_flame else []
        self.surrey = surrey_files(run.sfm) if run.sfm else []
        self.published = sha256_of(sorted(PUBLISHED.glob("*.csv")))
        self.shipped = [*sorted(PRETRAINED.glob("*.npz")), DETECTOR_ERRORS]
        self.begun = run.build / run.model / "begun"
        if not self.begun.exists():
            write_text(self.begun, f"{datetime.datetime.now(datetime.UTC).isoformat()}\n")

    def at(self, track: str, seed: int | str | None = None) -> Run:
        """The run of a track; its seed may be a wildcard."""
        return replace(self.run.on(track), seed=self.run.seed if seed is None else seed)

    def work(self, track: str) -> str:
        return str(self.at(track).work)

    def record(self, track: str, name: str, seed: int | str | None = None) -> str:
        return str(self.at(track, seed).record_file(name))

    def results(self, name: str | Path, *files: str, track: str = "bfm") -> list[str]:
        """Files of a folder of results, with its manifest, by its name or for several models."""
        folder = name if isinstance(name, Path) else self.at(track).experiment_results(name)
        return [str(folder / file) for file in (*files, MANIFEST)]

    def shared(self, name: str) -> Path:
        """Folder of results that are not of one face model."""
        return self.run.shared_results / name

    def other_results(self, *but: str) -> str:
        """What there is of results, but for some names: a step reads them as they are."""
        own = {self.run.experiment_results(name) for name in but}
        folders = (path.parent for path in manifests(self.run.model_results))
        return " ".join(listing(folder) for folder in folders if folder not in own)

    def step(
        self, command: str, track: str = "bfm", seed: str | None = None, uses: Iterable[str] = ()
    ) -> str:
        """Shell command of a step.

        Args:
            command: Module and items.
            track, seed: Of the run; they may be wildcards.
            uses: Options that it reads, besides those by which its folders are named.
        """
        suffixes = SUFFIXES.get(track, {name for names in SUFFIXES.values() for name in names})
        names = sorted({*_ALWAYS, *suffixes, *uses})
        options = shlex.join(options_of(self.run, names)).replace("{", "{{").replace("}", "}}")
        return (
            f"{shlex.quote(sys.executable)} -m experiments {command} --track {track} "
            f"--seed {self.run.seed if seed is None else seed} {options} --jobs {{threads}} "
            "--record {output[0]:q} --inputs {input:q}"
        )

    def to_collect(self) -> list[Path]:
        """Files that frames are collected from, but for the meshes of CoMA."""
        landmarks = [embedding_file(self.run)] if self.run.coma else []
        return [*dict.fromkeys([*self.model, *landmarks])]

    # Methods

    def compared(self, track: str, *, images: bool = True) -> list[str]:
        """Ids of the methods that a track compares; those that see images may be left out."""
        methods = methods_of(self.run.on(track))
        methods = (method for method in methods if method.switch not in self._left_out)
        return [method.id for method in methods if images or not method.sees_images]

    def trains_on_images(self, track: str) -> bool:
        """Whether a network that sees images is trained, which takes longer than all others."""
        methods = (METHODS[method] for method in self.compared(track))
        return any(method.sees_images and method.data for method in methods)

    def predictions(self, track: str, methods: Iterable[str], seed: int | None = None) -> list[str]:
        """Records of methods' predictions."""
        return [self.record(track, f"predict-{method}", seed) for method in methods]

    def to_train(self, method_id: str, track: str, seed: int | None = None) -> list[str]:
        """Records of what a method is trained on, and after."""
        method, name = METHODS[method_id], TRAIN[track]
        if method.sees_images:
            name = IMAGE_STEPS[track, TRAINING_IMAGES[track]]
        names = [name, *([f"train-{method.after}"] if method.after else [])]
        return [self.record(track, name, seed) for name in names]

    def to_load(self, method_id: str, track: str, seed: int | None = None) -> list[str | Path]:
        """Files and records from which a method is loaded, ready to predict."""
        method, trained_on = METHODS[method_id], "bfm" if track == "celeba" else track
        step = f"train-{method.trained}" if method.trained else TRAIN[trained_on]
        files = [self.record(trained_on, step, seed), *(self.model if method.reads_model else [])]
        if method.authors:
            files += [Path(self.run.authors, name) for name in method.authors[track]]
        return files + (self.ringnet if method_id == "ringnet_licensed" else [])

    def to_predict(self, method_id: str, track: str, seed: int | None = None) -> list[str | Path]:
        """The same, and records of the test faces as the method sees them."""
        steps = {TEST[track]: None}
        if METHODS[method_id].sees_images:
            steps |= {IMAGE_STEPS[track, "test"]: None}
        tested = [self.record(track, step, seed) for step in steps]
        return [*self.to_load(method_id, track, seed), *tested]

    def to_time(self, track: str, seed: int | None = None) -> list[str | Path]:
        """Records of all predictions of a track, and what these were made from."""
        methods = self.compared(track)
        files = [file for method in methods for file in self.to_predict(method, track, seed)]
        return [*dict.fromkeys([*self.predictions(track, methods, seed), *files])]

    def authors_files(self, track: str) -> list[Path]:
        """The authors' weights of a track, and their second net, if they were given."""
        names = (*AUTHORS_FILES[track], *([SECOND_NET] if track == "bfm" else []))
        files = (Path(self.run.authors, name) for name in names) if self.run.authors else ()
        return [file for file in files if file.is_file()]


def training_threads(method_id: str, cores: int) -> int:
    """Cores that a training keeps busy."""
    method = METHODS[method_id]
    return min(cores, (method.threads or 2) if method.sees_images else 1)


def _matching(pattern: str) -> list[str]:
    return sorted(glob.glob(pattern))
