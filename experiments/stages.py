"""The stages of all experiments, each declared once: what it needs, and where its results lie.

A new stage is a row in `STAGES`, after those that it needs, and its module; a new folder of results
a row in `RESULTS`. `python -m experiments make TARGET` runs them, as the Makefile does.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from experiments.run import Run


@dataclass(frozen=True)
class Stage:
    """One step of an experiment, which ends with a record in the folder of its track.

    Attributes:
        track: Of the experiment, one of `run.SCHEMES`.
        name: On the command line, and of the record.
        module: Below `experiments`, whose `main` it is.
        needs: Stages whose files it reads: their names, with `track/` before those of another.
        reads: Variables of `make` that name files it reads; `MODEL` stands for the face model's,
            `SEEDS` and `MOBILEFACE` are words.
        switch: Variable of `make` that leaves it out where it is `no`.
        asked: Attribute of a run without which no other stage needs it.
        given: Attribute of a run without which it is left out.
        unless: Attribute of a run with which it is left out.
        target: Of `make`, if it is the last stage of one.
        always: Whether its target runs it though it is done.
        onednn: Whether convolutions are oneDNN's: a step of training takes three quarters of the
            time.
    """

    track: str
    name: str
    module: str
    needs: tuple[str, ...] = ()
    reads: tuple[str, ...] = ()
    switch: str | None = None
    asked: str | None = None
    given: str | None = None
    unless: str | None = None
    target: str | None = None
    always: bool = False
    onednn: bool = False

    @property
    def id(self) -> str:
        return f"{self.track}/{self.name}"

    @property
    def needed(self) -> tuple[Stage, ...]:
        """The stages that it needs."""
        return tuple(_BY_ID[n if "/" in n else f"{self.track}/{n}"] for n in self.needs)

    def needed_by(self, run: Run) -> tuple[Stage, ...]:
        """The stages that it needs, but for those that the run leaves out or does not ask for."""
        return tuple(
            need
            for need in self.needed
            if need.switch not in run.without
            and (need.asked is None or getattr(run, need.asked) is not None)
        )

    def is_of(self, run: Run) -> bool:
        """Whether what the run was given is what the stage is for."""
        given = self.given is None or getattr(run, self.given) is not None
        return given and (self.unless is None or getattr(run, self.unless) is None)


_MODEL = ("MODEL",)

STAGES = (
    Stage("bfm", "authors", "tracks.authors", reads=("AUTHORS",), given="authors"),
    Stage("bfm", "faces", "tracks.bfm.faces", reads=_MODEL),
    Stage("bfm", "networks", "tracks.networks", needs=("faces",)),
    Stage("bfm", "predictions", "tracks.predictions", needs=("authors", "networks")),
    Stage("bfm", "images", "tracks.bfm.images", needs=("faces",), reads=_MODEL),
    Stage("bfm", "mobileface", "tracks.mobileface", needs=("images",), reads=("MOBILEFACE",),
          switch="MOBILEFACE", onednn=True),
    Stage("bfm", "seed", "studies.seed", needs=("faces",)),
    Stage("bfm", "seeds", "studies.seeds", needs=("seed",), reads=("MODEL", "SEEDS"),
          asked="seeds", target="seeds", always=True),
    Stage("bfm", "rounding", "studies.rounding", needs=("faces",), target="seeds"),
    Stage("bfm", "bfm", "tracks.bfm.bfm", needs=("predictions", "mobileface", "seeds"),
          target="reproduce-bfm"),
    Stage("flame", "authors", "tracks.authors", reads=("AUTHORS",), given="authors"),
    Stage("flame", "frames", "tracks.flame.frames", reads=("MODEL", "COMA")),
    Stage("flame", "scans", "tracks.flame.scans", reads=("MODEL", "CASIA", "CASIA_INDEX")),
    Stage("flame", "networks", "tracks.networks", needs=("frames",)),
    Stage("flame", "predictions", "tracks.predictions", needs=("authors", "networks", "scans")),
    Stage("flame", "mediapipe", "tracks.flame.mediapipe", needs=("scans",), switch="MEDIAPIPE"),
    Stage("flame", "rings", "tracks.flame.rings", reads=_MODEL),
    Stage("flame", "ringnet", "tracks.flame.ringnet", needs=("rings", "scans"),
          switch="RINGNET", unless="ringnet", onednn=True),
    Stage("flame", "ringnet-licensed", "tracks.flame.ringnet", needs=("scans",),
          reads=("MODEL", "RINGNET"), switch="RINGNET", given="ringnet"),
    Stage("flame", "flame", "tracks.flame.flame",
          needs=("predictions", "mediapipe", "ringnet", "ringnet-licensed"),
          target="reproduce-flame"),
    Stage("celeba", "authors", "tracks.authors", reads=("AUTHORS",), given="authors"),
    Stage("celeba", "photos", "tracks.celeba.photos", reads=("MODEL", "CELEBA")),
    Stage("celeba", "predictions", "tracks.predictions",
          needs=("authors", "photos", "bfm/networks")),
    Stage("celeba", "mobileface", "tracks.mobileface", needs=("photos", "bfm/mobileface"),
          switch="MOBILEFACE", onednn=True),
    Stage("celeba", "celeba", "tracks.celeba.celeba", needs=("predictions", "mobileface"),
          target="reproduce-celeba"),
    Stage("flame", "celeba-flame", "tracks.celeba.celeba_flame",
          needs=("networks", "ringnet", "ringnet-licensed"), reads=("TF_FLAME",),
          given="tf_flame", target="reproduce-celeba"),
    Stage("flame", "celeba-flame-stand-in", "tracks.celeba.celeba_flame",
          needs=("networks", "ringnet", "ringnet-licensed"), reads=_MODEL,
          given="drawn_photos", target="reproduce-flame"),
    Stage("bfm", "ablation", "studies.ablation", needs=("networks",),
          target="ablation", always=True),
    Stage("bfm", "audit", "audit.audit", needs=("bfm", "ablation"), reads=_MODEL,
          target="audit", always=True),
    Stage("bfm", "stream", "studies.stream", needs=("networks",), reads=_MODEL,
          target="stream", always=True),
    Stage("bfm", "portraits", "pretrained.portraits", reads=_MODEL),
    Stage("bfm", "photo-networks", "pretrained.photo_networks", needs=("portraits",)),
    Stage("bfm", "pretrained", "pretrained.pretrained", needs=("photo-networks",),
          target="pretrained", always=True),
    Stage("bfm", "hard", "lifting.hard", reads=_MODEL, target="lifting", always=True),
    Stage("bfm", "anatomy", "lifting.anatomy", needs=("networks",), reads=_MODEL,
          target="lifting", always=True),
    Stage("bfm", "transfer", "lifting.transfer", reads=_MODEL, target="lifting", always=True),
    Stage("bfm", "bench", "bench.bench", reads=_MODEL, target="bench", always=True),
)  # fmt: skip

_BY_ID = {stage.id: stage for stage in STAGES}
SWITCHES = tuple(dict.fromkeys(stage.switch for stage in STAGES if stage.switch))


@dataclass(frozen=True)
class Result:
    """A folder of `results/<model>`.

    Attributes:
        folder: Its name, before what is not the default.
        stage: Id of the stage that writes it.
        given: What the stage's target is to be given to write it.
    """

    folder: str
    stage: str
    given: str = ""

    @property
    def command(self) -> str:
        return f"make {_BY_ID[self.stage].target} {self.given}".strip()


# In the order of the report.
RESULTS = (
    Result("audit", "bfm/audit"),
    Result("bfm", "bfm/bfm"),
    Result("bfm-evaluator-released", "bfm/bfm", "EVALUATOR=released"),
    Result("flame", "flame/flame"),
    Result("flame-true-landmarks", "flame/flame"),
    Result("celeba", "celeba/celeba"),
    Result("celeba-true-landmarks", "celeba/celeba"),
    Result("celeba-flame", "flame/celeba-flame", "TF_FLAME=dir"),
    Result("celeba-flame-stand-in", "flame/celeba-flame-stand-in"),
    Result("parameters", "bfm/bfm"),
    Result("ablation", "bfm/ablation"),
    Result("seeds", "bfm/seeds"),
    Result("rounding", "bfm/rounding"),
    Result("stream", "bfm/stream"),
    Result("pretrained", "bfm/pretrained"),
    Result("lifting/hard", "bfm/hard"),
    Result("lifting/anatomy", "bfm/anatomy"),
    Result("lifting/transfer", "bfm/transfer"),
)


def stage_of(track: str, name: str) -> Stage:
    """The stage of a track by its name."""
    return _BY_ID[f"{track}/{name}"]


def stages_to(target: str) -> list[Stage]:
    """The last stages of a target of `make`; the first is of the target's own track."""
    return [stage for stage in STAGES if stage.target == target]


def with_needed(stages: Iterable[Stage], run: Run) -> list[Stage]:
    """Stages and all that they need, in an order in which they can run.

    Args:
        stages: The stages.
        run: What leaves some of them out, by `Stage.is_of` and `Stage.needed_by`.
    """
    found, left = set(), [*stages]
    while left:
        stage = left.pop()
        if stage not in found and stage.is_of(run):
            found.add(stage)
            left += stage.needed_by(run)
    return [stage for stage in STAGES if stage in found]
