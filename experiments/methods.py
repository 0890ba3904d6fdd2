"""The compared methods: ids in files, names in tables, and whom of the paper they stand beside."""

from __future__ import annotations

from dataclasses import dataclass

from deepmds_keras.io.errors import InputError


@dataclass(frozen=True)
class Method:
    """One compared method.

    Attributes:
        id: As in `metrics.csv`.
        title: As in tables and figures.
        description: What it is, is trained on and is tested on.
        paper: Its id in `results/published/published.csv`, or None: the paper has no such row.
    """

    id: str
    title: str
    description: str
    paper: str | None = None


METHODS = (
    Method(
        "mean_shape",
        "Mean shape",
        "the mean of the training shapes, whatever the view (the paper's trivial case)",
        "mean_shape",
    ),
    Method("linear", "Linear", "ridge regression from the view to the shape, on the same views"),
    Method("zhao", "Zhao's", "Zhao's net trained on the same views as every method", "zhao"),
    Method(
        "zhao_authors",
        "Zhao's, authors' training",
        "Zhao's net trained as the authors did, on 3,000 frontal orthographic views; "
        "tested on the same posed views as every method",
    ),
    Method(
        "zhao_frontal",
        "Zhao's, authors' protocol",
        "the same net tested on frontal orthographic views, as the authors did",
    ),
    Method(
        "zhao_true_depth",
        "True depth in Zhao's place",
        "no method: what the released evaluator gives to a net that makes no error",
    ),
    Method(
        "aldrian",
        "Aldrian's",
        "fit of the face model to the view; nothing is trained, the model is given",
        "aldrian",
    ),
    Method(
        "mobileface",
        "MobileFace",
        "MobileNet from an image to coefficients of the face model",
        "mobileface",
    ),
    Method(
        "true_landmarks",
        "True landmarks",
        "no method: what the faces' own landmarks score against the truth found on scans or photos",
    ),
    Method(
        "scan_landmarks",
        "Truth found on scans",
        "no method: what the paper's pipeline takes for the truth, scored against the true one",
    ),
    Method(
        "model_fit",
        "Model fit",
        "the fit of the face model to a photo; the truth found on scans starts from it, and on "
        "photos it is the truth",
    ),
    Method(
        "ringnet",
        "RingNet",
        "network from an image to coefficients of the face model, or of FLAME",
        "ringnet",
    ),
    Method(
        "mediapipe",
        "MediaPipe",
        "pretrained face mesh of an image, by the authors' list of points",
        "mediapipe",
    ),
    Method(
        "mediapipe_corrected",
        "MediaPipe, corrected list",
        "the same with the left brow's points where they should be",
    ),
    Method(
        "ours",
        "Deep-MDS",
        "the paper's method: six pair features, constant learning rate",
        "ours",
    ),
    Method(
        "ours_released",
        "Deep-MDS, released features",
        "the same with the five pair features of the released code",
    ),
    Method("ours_stable", "Deep-MDS, decayed rate", "the same with a decaying learning rate"),
    Method(
        "authors_weights",
        "Deep-MDS, authors' weights",
        "the released networks with the authors' own weights, nothing trained here",
    ),
)

# Of the paper's method: variant of the dissimilarity net, learning-rate schedule of both networks.
DEEP_MDS = {
    "ours": ("paper", "constant"),
    "ours_released": ("released", "constant"),
    "ours_stable": ("paper", "cosine"),
}

BY_ID = {method.id: method for method in METHODS}


def title(method_id: str) -> str:
    """Name of a method in tables and figures.

    Raises:
        InputError: There is no such method.
    """
    if method_id not in BY_ID:
        raise InputError(f"method must be one of {', '.join(BY_ID)}. Received {method_id!r}.")
    return BY_ID[method_id].title
