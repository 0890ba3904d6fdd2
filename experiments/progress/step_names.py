"""What each step does, in words of a reader, by the file of its record."""

import re
from pathlib import Path

from experiments.methods import METHODS, title

_WORDS = {
    "faces": "sample faces and their views",
    "images": "render an image of each face",
    "frames": "collect faces with expressions",
    "scans": "find landmarks in photos and on scans",
    "rings": "render people for RingNet",
    "photos": "fit the face model to photos",
    "times": "time each method",
    "preview": "print the table of the landmark methods",
    "bfm": "score each method and draw",
    "bfm-evaluator-released": "score as the authors' evaluator does",
    "flame": "score each method and draw",
    "celeba": "score each method and draw",
    "celeba-flame": "draw photos with FLAME's landmarks",
    "seed": "score one seed",
    "seeds": "compare the seeds",
    "scales": "compare the scales",
    "objects": "compare the methods on objects",
    "ablation": "compare the variants",
    "stream": "score many faces",
    "hard": "measure lifting on hard views",
    "component_ablation": "measure Deep-MDS part by part",
    "transfer": "measure on faces of another model",
    "surface": "measure heads fitted to landmarks",
    "portraits": "render photos and find the faces in them",
    "pretrained": "measure the shipped weights",
    "real": "measure on real faces",
    "bench": "time each part and the authors' code",
    "footprint": "measure the installed package",
    "bfm_mean": "read the Basel mean from the authors' weights",
    "released_weights": "measure the authors' weights",
    "audit": "decide the claims",
    "claims": "gather the claims of both face models",
    "report": "write the report",
}
# Of steps that are done for several things, which follow.
_KINDS = {
    "scale": "train on faces of scale",
    "object": "train on",
    "variant": "train for the ablation",
    "stream": "score some of many faces",
    "lifting": "train for the studies of lifting",
    "component_ablation": "train for Deep-MDS part by part",
    "pretrained": "train weights to ship",
    "released_weights": "train around the Basel mean",
    "audit": "audit",
}


def in_words(record: Path) -> str:
    """Such as `train Deep-MDS (cosine schedule), seed 3`; the seed is left out if it is 0."""
    return f"{_step(record.stem)}{_seed(record.parent.parent.name)}"


def _step(name: str) -> str:
    kind, _, item = name.partition("-")
    if name in _WORDS:
        return _WORDS[name]
    if kind in ("train", "predict") and item in METHODS:
        method, _, more = title(item).partition(", ")
        return f"{kind}{' with' * (kind == 'predict')} {method}" + (f" ({more})" if more else "")
    if kind in _KINDS:
        item, _, seed = item.partition("-seed")
        words = re.sub(r"(\d)-(\d)", r"\1 to \2", item).replace("_", " ").replace("-", ", ")
        return f"{_KINDS[kind]}: {words}" + (f", seed {seed}" if seed else "")
    return name


def _seed(work: str) -> str:
    found = re.search(r"-seed([1-9]\d*)", work)
    return f", seed {found[1]}" if found else ""
