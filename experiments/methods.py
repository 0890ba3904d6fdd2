"""The compared methods: one row has all that steps, tables, figures and report know about it.

A new method is a new row. How it is built and trained goes into `recipes`.
"""

import inspect
from collections.abc import Mapping
from functools import partial
from operator import attrgetter
from pathlib import Path

import numpy as np

from deepmds_keras.baselines.images import IMAGE_SIZE
from deepmds_keras.errors import InputError, check_choice
from experiments import recipes
from experiments.inputs import CROP_SIZE, load_landmark_model
from experiments.method import Method
from experiments.run import AUTHORS_FILES, Run

_ALL = ("bfm", "flame", "celeba")
CONSTANT = "deep_mds_constant"
_NO_RENDERS = "left out: expressions of FLAME have no names by which people could be rendered"
# Starts from an eigenvalue problem, then sorts all pairs in each of t steps.
_EMBEDDING = "O(n^3 + t n^2 log n)"


def _deep_mds(variant: str, schedule: str, **row) -> Method:
    return Method(
        tracks=_ALL,
        build=partial(recipes.deep_mds, variant=variant, schedule=schedule),
        data=recipes.faces,
        checkpoint=attrgetter("networks"),
        restore=recipes.restore_deep_mds,
        over_seeds=True,
        deep_mds=(variant, schedule),
        networks=partial(recipes.deep_mds_networks, variant),
        complexity=_EMBEDDING,
        **row,
    )


def _mobileface_note(run: Run, detected: np.ndarray) -> str:
    if run.track == "celeba":
        return "trained on renders before an empty background, as on the BFM track"
    schedule, epochs = recipes.mobileface_schedule(run)
    rate = {"cosine": "learning rate that decays to 0", "constant": "constant learning rate"}
    return (
        f"trained for {epochs * run.preset.mobileface_steps:,} steps of 16 images at a "
        f"{rate[schedule]} (the released code: 100,000 at a constant one) to find "
        f"{len(load_landmark_model(run)[1])} coefficients of the face model"
    )


def _ringnet_note(run: Run, detected: np.ndarray) -> str:
    steps = run.preset.ringnet_epochs * run.preset.ringnet_steps
    return (
        f"retrained, {steps:,} steps, from random weights on renders of the face model; the "
        "paper's is the published one"
    )


def _noise_note(run: Run, detected: np.ndarray) -> str:
    if run.track != "flame":
        return ""
    return (
        "trained on landmarks with noise of an s.d. of up to "
        f"{100 * recipes.LANDMARK_NOISE:g} % of a view's r.m.s. radius, since a detector finds "
        "those of the test"
    )


def _map_learnt_note(run: Run, detected: np.ndarray) -> str:
    return "not in the paper; told the noise of a detector, as LandmarkLifter is"


def _landmark_lifter_note(run: Run, detected: np.ndarray) -> str:
    note = f"not in the paper; trained for {run.preset.lifting_steps:,} steps of 128 faces"
    noise = _noise_note(run, detected)
    anew = (
        "its noise is drawn anew in each mini-batch, and told, while that of others is drawn once"
    )
    return "; ".join(filter(None, (note, noise, noise and anew)))


def _mediapipe_note(run: Run, detected: np.ndarray) -> str:
    lost = int((~detected).sum())
    return f"no face found in {lost:,} of {len(detected):,} photos (N/A), which are left out"


def _model_fit_note(run: Run, detected: np.ndarray) -> str:
    if run.track == "flame":
        return ""
    return "not a method: the paper's ground truth, scored against the true landmarks"


# Methods of a figure differ in marker and, also for colour-blind readers, in colour. Okabe and
# Ito's blue, orange and vermilion are here (https://jfly.uni-koeln.de/color/). Grey is the truth's.
# The rows stand in the order of the tables.
_ROWS = (
    Method(
        id="mean_shape", title="Mean shape", tracks=_ALL,
        description="the mean of the training shapes, whatever the view",
        build=recipes.mean_shape, data=recipes.faces, over_seeds=True, pictured=False,
        colour="#8FB9DD", marker="s", mapped=_ALL, complexity="O(n)",
    ),
    Method(
        id=CONSTANT, title="Deep-MDS, one output for all", paper=CONSTANT,
        description="not a method: the output of Deep-MDS for another face's view (the paper's "
        "trivial case, that the method only outputs one specific solution)",
        colour="#BFA6A0", marker="h", drawn=False,
    ),
    Method(
        id="ridge", title="Ridge regression", tracks=_ALL,
        description="ridge regression from the view to the shape, on the same views",
        build=recipes.ridge, data=recipes.faces_with_noise, note=_noise_note, pictured=False,
        colour="#9A7DE0", marker="D", mapped=_ALL, complexity="O(n^2)",
    ),
    Method(
        id="ridge_roll_aligned", title="Ridge regression, roll-aligned views", tracks=_ALL,
        description="ridge regression on views that are turned in their plane first, to no roll",
        build=partial(recipes.ridge, roll_aligned=True), data=recipes.faces_with_noise,
        note=_noise_note, colour="#4B0082", marker="^", drawn=False, complexity="O(n^2)",
    ),
    Method(
        id="mlp", title="MLP", tracks=_ALL,
        description="multilayer perceptron of two hidden layers, with about as many parameters as "
        "LandmarkLifter",
        build=recipes.mlp, data=recipes.faces_with_noise,
        checkpoint=partial(Run.network_file, name="mlp"),
        note=_noise_note, colour="#CCBB44", marker="X", drawn=False, complexity="O(n)",
    ),
    Method(
        id="ridge_detections", title="Ridge regression, trained on detections",
        description="ridge regression trained on a detector's landmarks of other photos",
        colour="#6B4FB8", marker="s", drawn=False,
    ),
    Method(
        id="eos", title="eos (Surrey model)",
        description="the Surrey Face Model with expressions, fitted by eos to 49 landmarks",
        drawn=False, colour="#117733", marker="P",
    ),
    # The widths of Zhao's net grow with n.
    Method(
        id="zhao", title="Zhao et al.", paper="zhao", tracks=_ALL,
        description="Zhao's net trained on the same views as every method",
        build=recipes.zhao, data=recipes.posed_faces,
        checkpoint=partial(Run.network_file, name="zhao"),
        colour="#0072B2", marker="^", gallery=True, mapped=_ALL, complexity="O(n^2)",
    ),
    Method(
        id="zhao_authors", title="Zhao et al., authors' training", tracks=("bfm",),
        description="Zhao's net trained as the authors did, by RMSprop on 3,000 frontal "
        "orthographic views; tested on the same posed views as every method",
        build=partial(recipes.zhao, as_authors=True), data=recipes.frontal_faces,
        checkpoint=partial(Run.network_file, name="zhao_authors"),
        colour="#56B4E9", marker="v", drawn=False, complexity="O(n^2)",
    ),
    Method(
        id="zhao_weights", title="Zhao et al., authors' weights", tracks=_ALL,
        description="Zhao's net with the authors' own weights, nothing trained here",
        build=recipes.zhao_weights, authors=recipes.ZHAO_FILES,
        colour="#005B96", marker="<", drawn=False, complexity="O(n^2)",
    ),
    Method(
        id="zhao_frontal", title="Zhao et al., authors' protocol", tracks=("bfm",),
        description="the same net tested on frontal orthographic views, as the authors did",
        inputs="frontal views", build=partial(recipes.zhao, as_authors=True),
        checkpoint=partial(Run.network_file, name="zhao_authors"), after="zhao_authors",
        colour="#1F3A93", marker="d", drawn=False, complexity="O(n^2)",
    ),
    Method(
        id="zhao_evaluator", title="Zhao et al., authors' protocol and evaluator", fair="zhao",
        description="the same predictions as the released evaluator scores them",
        colour="#1F3A93", marker="H", drawn=False,
    ),
    Method(
        id="zhao_true_depth", title="True depth in place of Zhao et al.",
        description="not a method: what the released evaluator gives to a net that makes no error",
        colour="#1F3A93", marker="s", drawn=False,
    ),
    Method(
        id="aldrian", title="Aldrian & Smith", tracks=("bfm", "celeba"),
        description="fit of the face model to the view; nothing is trained, the model is given",
        build=recipes.aldrian, one_by_one=True,
        colour="#5A0A3C", marker="*", complexity="O(t (n k^2 + k^3))",
    ),
    Method(
        id="aldrian_authors", title="Aldrian & Smith, authors' fit", paper="aldrian",
        fair="aldrian", tracks=("bfm", "celeba"),
        description="the same fit with the scaled coefficients of the released code",
        build=recipes.aldrian_authors, one_by_one=True, reads_model=True,
        colour="#5A0A3C", marker="8", drawn=False, complexity="O(t (n k^2 + k^3))",
    ),
    Method(
        id="aldrian_learnt", title="Aldrian & Smith, learnt components",
        description="the same fit, of the principal components of the training shapes",
        colour="#5A0A3C", marker="d", drawn=False,
    ),
    Method(
        id="map", title="MAP fit (knows the model)", tracks=("bfm", "celeba"),
        description="the most probable shape and perspective camera, given the face model; nothing "
        "is trained",
        build=recipes.map_fit, one_by_one=True,
        colour="#3D2B00", marker="v", drawn=False, complexity="O(t (n^3 + n k))",
    ),
    Method(
        id="map_learnt", title="MAP fit, learnt components", tracks=("flame",),
        description="the same fit, of the principal components of the training shapes",
        build=recipes.LearntMapFit, one_by_one=True, note=_map_learnt_note,
        colour="#3D2B00", marker="^", drawn=False,
    ),
    Method(
        id="aldrian_hindsight", title="Aldrian & Smith, best noise",
        description="the same fit, given the noise that is best on the test faces: its own misfit",
        colour="#EE6677", marker="p", drawn=False,
    ),
    # A layer of this net is too small to be shared between threads.
    Method(
        id="mobileface", title="MobileFace", paper="mobileface", tracks=("bfm", "celeba"),
        description="MobileNet from an image to coefficients of the face model",
        inputs="images", image_size=IMAGE_SIZE,
        build=recipes.mobileface, data=recipes.mobileface_data,
        checkpoint=recipes.mobileface_file, networks=recipes.mobileface_networks,
        switch="MOBILEFACE", onednn=True, threads=1, memory_mb=3500,
        note=_mobileface_note, colour="#4B0082", marker="<", mapped=("celeba",),
        complexity="O(n k)",
    ),
    Method(
        id="mobileface_weights", title="MobileFace, authors' weights", tracks=("bfm", "celeba"),
        description="MobileFace with the authors' own weights, nothing trained here",
        inputs="images", image_size=IMAGE_SIZE,
        build=recipes.mobileface_weights, of_model="bfm2009",
        authors=recipes.MOBILEFACE_FILES, switch="MOBILEFACE", onednn=True,
        colour="#B79BD0", marker="P", drawn=False, complexity="O(n k)",
    ),
    Method(
        id="true_landmarks", title="True landmarks",
        description="not a method: the true landmarks, scored against the truth found on scans or "
        "photos",
        colour="#777777", drawn=False,
    ),
    Method(
        id="scan_landmarks", title="Truth found on scans",
        description="not a method: the paper's ground truth, scored against the true landmarks",
        colour="#777777", marker="s", drawn=False,
    ),
    Method(
        id="model_fit", title="Model fit",
        description="the fit of the face model to a photo; the truth found on scans starts from "
        "it, and on photos it is the truth",
        note=_model_fit_note, colour="#EE6677", marker="v", pictured=False,
    ),
    Method(
        id="ringnet", title="RingNet", paper="ringnet", tracks=("flame",),
        description="network from an image to coefficients of the face model",
        inputs="images", image_size=IMAGE_SIZE,
        build=recipes.ringnet, data=recipes.ringnet_data,
        checkpoint=recipes.ringnet_file, networks=recipes.ringnet_networks, switch="RINGNET",
        onednn=True, memory_mb=7000,
        note=_ringnet_note, colour="#3D2B00", marker="*", gallery=True, complexity="O(1)",
    ),
    Method(
        id="ringnet_licensed", title="RingNet, licensed", tracks=("flame",),
        description="the published network, to coefficients of FLAME",
        inputs="images", image_size=CROP_SIZE, build=recipes.ringnet_licensed,
        switch="RINGNET", onednn=True, memory_mb=5000,
        colour="#3D2B00", marker="h", gallery=True,
    ),
    Method(
        id="mediapipe", title="MediaPipe", paper="mediapipe", fair="mediapipe_corrected",
        tracks=("flame",),
        description="pretrained face mesh of an image, by the authors' list of points",
        inputs="images", build=partial(recipes.MediaPipe, points="authors"), switch="MEDIAPIPE",
        note=_mediapipe_note, colour="#4B0082", marker="P", pictured=False, complexity="O(1)",
    ),
    Method(
        id="mediapipe_corrected", title="MediaPipe, corrected list", tracks=("flame",),
        description="the same with the left brow's points where they should be",
        inputs="images", build=partial(recipes.MediaPipe, points="corrected"), switch="MEDIAPIPE",
        note=_mediapipe_note, colour="#5A0A3C", marker="<", gallery=True, mapped=("flame",),
    ),
    _deep_mds(
        "paper", "constant",
        id="deep_mds", title="Deep-MDS", paper="deep_mds",
        description="the paper's method: six pair features, constant learning rate",
        colour="#D55E00", marker="o", gallery=True, mapped=_ALL,
    ),
    # The autoencoder does not see pair features: it is that of `deep_mds`, in one file.
    _deep_mds(
        "released", "constant",
        id="deep_mds_released", title="Deep-MDS, released features",
        description="the same with the five pair features of the released code",
        after="deep_mds",
        colour="#E69F00", marker="p", pictured=False,
    ),
    _deep_mds(
        "paper", "cosine",
        id="deep_mds_cosine", title="Deep-MDS, cosine schedule",
        description="the same with a decaying learning rate",
        colour="#4818F0", marker=">", dashes="--", gallery=True, pictured=False, mapped=("bfm",),
    ),
    Method(
        id="deep_mds_noise", title="Deep-MDS, landmark noise in training", tracks=("flame",),
        description="the method with a decaying learning rate, on landmarks with noise like a "
        "detector's",
        build=partial(recipes.deep_mds, variant="paper", schedule="cosine"),
        data=recipes.faces_with_noise, checkpoint=lambda run: run.networks / "with-noise",
        restore=recipes.restore_deep_mds, note=_noise_note,
        colour="#B34700", marker="h", drawn=False,
    ),
    Method(
        id="deep_mds_weights", title="Deep-MDS, authors' weights", tracks=_ALL,
        description="the released networks with the authors' own weights, nothing trained here",
        build=recipes.deep_mds_weights, deep_mds=("released", None),
        networks=partial(recipes.deep_mds_networks, "released"), authors=AUTHORS_FILES,
        colour="#117733", marker="X", complexity=_EMBEDDING,
    ),
    Method(
        id="landmark_lifter", title="LandmarkLifter (ours)", tracks=_ALL,
        description="our method, not the paper's: a network that solves for camera and shape",
        build=recipes.landmark_lifter, data=recipes.faces,
        checkpoint=partial(Run.network_file, name="lifting-checkpoint"),
        restore=recipes.load_landmark_lifter, memory_mb=2500,
        note=_landmark_lifter_note, colour="#E5097F", marker="d", gallery=True, mapped=_ALL,
        complexity="O(n)",
    ),
    Method(
        id="lower_bound", title="Approximate lower bound",
        description="not a method: the error that remains for one who knows the face model and the "
        "camera",
        colour="#777777", marker="", dashes=(0, (4, 2)), drawn=False,
    ),
)  # fmt: skip
METHODS = {method.id: method for method in _ROWS}
# Of the paper's method, trained here: pair features and learning-rate schedule.
DEEP_MDS = {method.id: method.deep_mds for method in _ROWS if method.deep_mds and method.data}


def method_of(method_id: str) -> Method:
    """Row of a method.

    Raises:
        InputError: There is no such method.
    """
    check_choice(method_id, "method", METHODS)
    return METHODS[method_id]


def title(method_id: str) -> str:
    """Name of a method in tables and figures.

    Raises:
        InputError: There is no such method.
    """
    return method_of(method_id).title


def rows_of_paper(paper_rows: Mapping[str, str] = {}) -> dict[str, str]:
    """Method of the paper → the row with which its numbers are compared."""
    rows = {method.paper: method.id for method in METHODS.values() if method.paper}
    return rows | dict(paper_rows)


def methods_of(run: Run) -> list[Method]:
    """Methods that predict on a run's track, of what the run was given, in the order of the tables.

    The licensed RingNet, if it was given, takes the place of ours.
    """

    def is_given(method: Method) -> bool:
        if run.track not in method.tracks or method.of_model not in (None, run.model):
            return False
        if method.id == _other_ringnet(run.ringnet) or _wants_renders(method, run.model):
            return False
        files = method.authors[run.track] if method.authors else ()
        return not files or (run.authors and all(Path(run.authors, f).is_file() for f in files))

    return [method for method in METHODS.values() if is_given(method)]


def _other_ringnet(ringnet: str | None) -> str:
    """Of the two RingNets, the one that a run leaves out."""
    return "ringnet" if ringnet else "ringnet_licensed"


def _wants_renders(method: Method, model: str) -> bool:
    """Whether a method learns from renders of people that nobody can make of the face model."""
    return method.id == "ringnet" and model == "flame"


def train(run: Run, method_id: str):
    """Train a method; an interrupted training resumes from its checkpoint.

    Returns:
        The trained estimator.
    """
    method = method_of(method_id)
    checkpoint = method.checkpoint(run)
    model = recipes.fit(method.build(run), *method.data(run), checkpoint=checkpoint)
    if method_id == "landmark_lifter":  # whose checkpoint holds the last weights, not the best
        model.save(run.network_file(method_id))
    return model


def load(run: Run, method_id: str):
    """Return a method that is ready to predict, without any long training.

    Args:
        run: The run, whose training faces and networks are those of `run.trained`.
        method_id: Id of a method with `build`.

    Raises:
        InputError: It is not trained yet, or a file is damaged.
    """
    method, run = method_of(method_id), run.trained
    model = method.build(run)
    if method.checkpoint is None:
        return model.fit(*method.data(run)) if method.data else model
    checkpoint = method.checkpoint(run)
    try:
        if method.restore is None:
            return model.restore(checkpoint)
        return method.restore(run, model, checkpoint)
    except InputError as error:
        record, again = run.record_file(f"train-{method.trained}"), f"make reproduce-{run.track}"
        if record.exists():  # what is made from the network may be there: it is to be forced
            again = f"The same command with SNAKEMAKE='--forcerun {record}'"
        raise InputError(f"{error} {again} trains it.") from None


def predict(model, inputs, **options) -> np.ndarray:
    """Predictions of a loaded method, `(n, L, 3)`, whichever way up the faces are.

    Args:
        model: As from `load`.
        inputs: Views or images, as `model.predict` takes them.
        options: Options of `model.predict`.
    """
    if "check_orientation" in inspect.signature(model.predict).parameters:
        options.setdefault("check_orientation", False)
    return model.predict(inputs, **options)


def constant_answers(shapes: np.ndarray) -> np.ndarray:
    """The prediction for another face: its mean error is that of one answer to all views.

    The two faces are half the test set apart, so that they show different people.
    """
    return np.roll(shapes, len(shapes) // 2, axis=0)


def notes(run: Run, detected: Mapping[str, np.ndarray]) -> dict[str, str]:
    """Notes for readers of the run's table, or why a method has no measured number.

    Args:
        run: The run.
        detected: Method that was run → `(n,)` bool, whether it found each test face.
    """
    notes = {}
    for method in METHODS.values():
        if method.id in detected:
            note = method.note(run, detected[method.id]) if method.note else ""
            notes[method.id] = "; ".join(filter(None, (note, run.preset.caution)))
        elif run.track in method.tracks and method.id != _other_ringnet(run.ringnet):
            absent = _NO_RENDERS if _wants_renders(method, run.model) else method.absent
            notes[method.id] = absent
    return {method_id: note for method_id, note in notes.items() if note}
