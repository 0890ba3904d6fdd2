"""The compared methods: what stages, tables, figures and report know of each is its row here.

A new method is a new row. What trains and loads it goes into `recipes`.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial

import numpy as np

from deepmds_keras.io.errors import InputError
from deepmds_keras.normalisation import normalise
from experiments import recipes, remarks
from experiments.method import Method
from experiments.run import Run

_ALL = ("bfm", "flame", "celeba")
# Starts from an eigenvalue problem and then sorts all pairs in each of t steps.
_EMBEDDING = "O(n^3 + t n^2 log n)"


def _trained_deep_mds(variant: str, schedule: str, **row) -> Method:
    return Method(
        tracks=_ALL,
        load=partial(recipes.load_deep_mds, variant=variant, schedule=schedule),
        train=partial(recipes.train_deep_mds, variant=variant, schedule=schedule),
        deep_mds=(variant, schedule),
        networks=partial(recipes.deep_mds_networks, variant),
        complexity=_EMBEDDING,
        **row,
    )


# Okabe and Ito's palette (https://jfly.uni-koeln.de/color/), whose hues stay apart for colour-blind
# readers; the added ones differ from their neighbours in lightness and marker. Grey is the truth's.
# The rows stand in the order of the tables.
_ROWS = (
    Method(
        id="mean_shape",
        title="Mean shape",
        description="the mean of the training shapes, whatever the view (the paper's trivial case)",
        paper="mean_shape",
        tracks=_ALL,
        load=recipes.load_mean_shape,
        colour="#8C6D31",
        marker="s",
        mapped=_ALL,
        complexity="O(n)",
    ),
    Method(
        id="linear",
        title="Linear",
        description="ridge regression from the view to the shape, on the same views",
        tracks=_ALL,
        load=recipes.load_linear,
        colour="#222222",
        marker="D",
        mapped=_ALL,
        complexity="O(n^2)",
    ),
    # The widths of Zhao's net grow with n.
    Method(
        id="zhao",
        title="Zhao et al.",
        description="Zhao's net trained on the same views as every method",
        paper="zhao",
        tracks=_ALL,
        load=partial(recipes.load_zhao, name="zhao"),
        train=partial(recipes.train_zhao, name="zhao"),
        colour="#0072B2",
        marker="^",
        mapped=_ALL,
        complexity="O(n^2)",
    ),
    Method(
        id="zhao_authors",
        title="Zhao et al., authors' training",
        description="Zhao's net trained as the authors did, by RMSprop on 3,000 frontal "
        "orthographic views; tested on the same posed views as every method",
        tracks=("bfm",),
        load=partial(recipes.load_zhao, name="zhao_authors"),
        train=partial(recipes.train_zhao, name="zhao_authors"),
        colour="#56B4E9",
        marker="v",
        drawn=False,
        complexity="O(n^2)",
    ),
    Method(
        id="zhao_frontal",
        title="Zhao et al., authors' protocol",
        description="the same net tested on frontal orthographic views, as the authors did",
        tracks=("bfm",),
        load=partial(recipes.load_zhao, name="zhao_authors"),
        sees=lambda test: normalise(test.shapes[..., :2]),
        colour="#1F3A93",
        marker="d",
        drawn=False,
        complexity="O(n^2)",
    ),
    Method(
        id="zhao_true_depth",
        title="True depth in place of Zhao et al.",
        description="no method: what the released evaluator gives to a net that makes no error",
        stage=None,
        drawn=False,
    ),
    Method(
        id="aldrian",
        title="Aldrian & Smith",
        description="fit of the face model to the view; nothing is trained, the model is given",
        paper="aldrian",
        tracks=("bfm", "celeba"),
        load=recipes.load_aldrian,
        one_by_one=True,
        colour="#009E73",
        marker="*",
        complexity="O(t (n k^2 + k^3))",
    ),
    Method(
        id="aldrian_authors",
        title="Aldrian & Smith, authors' fit",
        description="the same fit with the scaled coefficients of the released code",
        tracks=("bfm", "celeba"),
        load=recipes.load_aldrian_authors,
        one_by_one=True,
        colour="#005A41",
        marker="8",
        drawn=False,
        complexity="O(t (n k^2 + k^3))",
    ),
    Method(
        id="mobileface",
        title="MobileFace",
        description="MobileNet from an image to coefficients of the face model",
        paper="mobileface",
        tracks=("bfm", "celeba"),
        stage="mobileface",
        load=recipes.load_mobileface,
        train=recipes.train_mobileface,
        absent="left out (MOBILEFACE=no), or still to come",
        note=remarks.of_mobileface,
        colour="#7B1FA2",
        marker="<",
        mapped=("celeba",),
        complexity="O(n k)",
        networks=recipes.mobileface_networks,
    ),
    Method(
        id="true_landmarks",
        title="True landmarks",
        description="no method: what the faces' own landmarks score against the truth found on "
        "scans or photos",
        stage=None,
        colour="#777777",
        drawn=False,
    ),
    Method(
        id="scan_landmarks",
        title="Truth found on scans",
        description="no method: what the paper's pipeline takes for the truth, scored against the "
        "true one",
        stage=None,
        colour="#777777",
        marker="s",
        drawn=False,
    ),
    Method(
        id="model_fit",
        title="Model fit",
        description="the fit of the face model to a photo; the truth found on scans starts from "
        "it, and on photos it is the truth",
        stage=None,
        note=remarks.of_model_fit,
        colour="#6A7B00",
        marker="P",
    ),
    Method(
        id="ringnet",
        title="RingNet",
        description="network from an image to coefficients of the face model, or of FLAME",
        paper="ringnet",
        tracks=("flame",),
        stage="ringnet",
        load=recipes.load_ringnet,
        train=recipes.train_ringnet,
        absent="left out (RINGNET=no), or still to come",
        note=remarks.of_ringnet,
        colour="#5F6B7A",
        marker=">",
        complexity="O(1)",
        networks=recipes.ringnet_networks,
    ),
    Method(
        id="mediapipe",
        title="MediaPipe",
        description="pretrained face mesh of an image, by the authors' list of points",
        paper="mediapipe",
        tracks=("flame",),
        stage="mediapipe",
        absent="left out (MEDIAPIPE=no), or still to come",
        note=remarks.of_mediapipe,
        colour="#00727A",
        marker="H",
        complexity="O(1)",
    ),
    Method(
        id="mediapipe_corrected",
        title="MediaPipe, corrected list",
        description="the same with the left brow's points where they should be",
        tracks=("flame",),
        stage="mediapipe",
        note=remarks.of_mediapipe,
        colour="#2AA198",
        marker="8",
        mapped=("flame",),
    ),
    # `ours` and `ours_released` share the autoencoder, which is the same in both variants.
    _trained_deep_mds(
        "paper",
        "constant",
        id="ours",
        title="Deep-MDS",
        description="the paper's method: six pair features, constant learning rate",
        paper="ours",
        process=0,
        colour="#D55E00",
        marker="o",
        mapped=_ALL,
    ),
    _trained_deep_mds(
        "released",
        "constant",
        id="ours_released",
        title="Deep-MDS, released features",
        description="the same with the five pair features of the released code",
        process=0,
        colour="#E69F00",
        marker="h",
        pictured=False,
    ),
    _trained_deep_mds(
        "paper",
        "cosine",
        id="ours_stable",
        title="Deep-MDS, cosine schedule",
        description="the same with a decaying learning rate",
        colour="#8C1C13",
        marker="p",
        mapped=("bfm",),
    ),
    Method(
        id="authors_weights",
        title="Deep-MDS, authors' weights",
        description="the released networks with the authors' own weights, nothing trained here",
        tracks=_ALL,
        load=recipes.load_authors_weights,
        needs="authors",
        absent="their weight files were not given (AUTHORS=folder)",
        colour="#CC79A7",
        marker="X",
        complexity=_EMBEDDING,
        networks=partial(recipes.deep_mds_networks, "released"),
        deep_mds=("released", None),
    ),
    Method(
        id="lifting",
        title="Lifting",
        description="ours, beside the paper: a network that solves for the camera and the shape",
        tracks=_ALL,
        load=recipes.load_lifting,
        train=recipes.train_lifting,
        note=remarks.of_lifting,
        colour="#E5097F",
        marker="d",
        mapped=_ALL,
        complexity="O(n)",
    ),
    Method(
        id="lifting_large",
        title="Lifting, large",
        description="the same with a network four times as large",
        stage=None,
        colour="#7A0044",
        marker="D",
        drawn=False,
    ),
    Method(
        id="limit",
        title="Limit",
        description="no method: what noise and a single view leave open to one that knows the face "
        "model and the camera",
        stage=None,
        colour="#777777",
        drawn=False,
    ),
)
METHODS = {method.id: method for method in _ROWS}
# Of the paper's method, trained here: pair features and learning-rate schedule.
DEEP_MDS = {method.id: method.deep_mds for method in _ROWS if method.deep_mds and method.train}


def title(method_id: str) -> str:
    """Name of a method in tables and figures.

    Raises:
        InputError: There is no such method.
    """
    if method_id not in METHODS:
        raise InputError(f"method must be one of {', '.join(METHODS)}. Received {method_id!r}.")
    return METHODS[method_id].title


def load(run: Run, method_id: str):
    """Return a method that is ready to predict; nothing is trained.

    Args:
        run: The run, whose faces and networks are those of `run.trained`.
        method_id: Of a method that has `load`.

    Raises:
        InputError: It is not trained yet, which names the stage to run, or a file is damaged.
    """
    return METHODS[method_id].load(run.trained)


def methods_of(run: Run, stage: str) -> list[Method]:
    """Methods whose predictions a stage of the run writes, in the order of the tables."""
    own = (m for m in METHODS.values() if m.stage == stage and run.track in m.tracks)
    return [m for m in own if m.needs is None or getattr(run, m.needs) is not None]


def notes(run: Run, found: Mapping[str, np.ndarray]) -> dict[str, str]:
    """Notes that a reader of the run's table needs, or why a method has no number of ours.

    Args:
        run: The run.
        found: Of each method that was run, `(n,)` bool: whether it found each test face.
    """
    said = {}
    for method in METHODS.values():
        if method.id in found:
            note = method.note(run, found[method.id]) if method.note else ""
            said[method.id] = "; ".join(filter(None, (note, run.preset.caution)))
        elif run.track in method.tracks:
            said[method.id] = method.absent
    return {method_id: note for method_id, note in said.items() if note}
