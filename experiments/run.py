"""One run of an experiment: what it was asked for, and where its files lie."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

from deepmds_keras.io.errors import InputError
from experiments.presets import Preset

EVALUATORS = ("paper", "released")
MOBILEFACES = ("cosine", "paper")
# The paper's two halves, each with landmarks of its own, which are also the folders of the authors'
# release; and the CelebA experiment, which tests the networks of the first half.
SCHEMES = {"bfm": "bfm72", "flame": "ibug51", "celeba": "bfm72"}
_BFM_FILES = ("AE_occ2orth_BFM.h5", "deep_dissim_ours.h5")
AUTHORS_FILES = {
    "bfm": _BFM_FILES,
    "celeba": _BFM_FILES,
    "flame": ("AE_occ2orth_FLAME.h5", "deep_dissim_from_2D_dist_pers_rem_proj.h5"),
}
# Data sets of each track, and what folders made of them end with.
_SUFFIXES = {
    "bfm": {},
    "flame": {"coma": "-coma", "casia": "-casia"},
    "celeba": {"celeba": "-real"},
}
_DATASETS = {
    "coma": "CoMA's registered meshes (https://coma.is.tue.mpg.de, after registration)",
    "casia": "CASIA-3D FaceV1 (http://biometrics.idealtest.org, after registration)",
}


@dataclass(frozen=True)
class Run:
    """Identity of a run, and the places of its files.

    Attributes:
        model: Name of the morphable model.
        preset: Sizes.
        track: Which of the paper's experiments, one of `SCHEMES`.
        seed: Of faces, views, initial weights, mini-batches and test subsets.
        protocol: How faces are projected, see `data_gen.views.projections.sample_cameras`.
        data: File or folder of a model that is not embedded, or None.
        coma, casia, celeba: Folders of the data sets CoMA, CASIA-3D and CelebA, or None: their
            open stand-ins.
        tf_flame: Folder of faces with 51 landmarks for a figure, see
            `experiments.tracks.celeba.celeba_flame`, or None.
        casia_index: Table of the scans of CASIA-3D that are used, or None for all.
        authors: Folder of the authors' released weights, or None.
        evaluator: How predictions are scored, one of `EVALUATORS`.
        ringnet: Prefix of the licensed RingNet checkpoint, or None: ours is trained.
        mobileface: How MobileFace is trained, one of `MOBILEFACES`: with a cosine schedule, or as
            the paper's authors did, which takes longer.
        seeds: Number of seeds over which the BFM table shows Deep-MDS, or None: of its own alone.
        without: Variables of `make` that leave stages out.
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
    ringnet: str | None = None
    mobileface: str = "cosine"
    seeds: int | None = None
    without: tuple[str, ...] = ()
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
        return self.on("bfm") if self.track == "celeba" else self

    @property
    def drawn_photos(self) -> bool | None:
        """Whether photos can be drawn for those of TF_FLAME, or None: they are given, or the face
        model's expressions have no names.
        """
        return True if self.tf_flame is None and self.model != "flame" else None

    @property
    def n_seeds(self) -> int:
        """Of `make seeds`."""
        return self.seeds or self.preset.n_seeds

    def on(self, track: str) -> Run:
        """The run of a track with the same model, sizes and seed."""
        return self if track == self.track else replace(self, track=track, evaluator="paper")

    def record_file(self, stage: str) -> Path:
        """Record of a stage that is done."""
        return self.work / f"{self.evaluation if stage == self.track else stage}.json"

    @property
    def networks(self) -> Path:
        """Folder of checkpoints, which are also the trained networks once their epochs are done."""
        return self.work / "networks"

    def network_file(self, name: str) -> Path:
        """Checkpoint of a network."""
        return self.networks / f"{name}.npz"

    def prediction_file(self, method: str) -> Path:
        """File of a method's predictions for the test views, or photos."""
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
        """Folder of `"coma"`, `"casia"` or `"celeba"`, or None: its stand-in."""
        folder = getattr(self, dataset)
        if folder is None and self.model == "flame" and dataset in _DATASETS:
            # Its expressions have no names by which a stand-in could be made.
            raise InputError(
                f"{dataset.upper()}= must be the folder of {_DATASETS[dataset]}, or DATA= must "
                f"hold one that begins with {dataset}. Received neither."
            )
        return None if folder is None else Path(folder)

    @property
    def _given(self) -> str:
        """Suffix of folders for data sets that were named: others hold their stand-ins."""
        return "".join(
            suffix for name, suffix in _SUFFIXES[self.track].items() if getattr(self, name)
        )
