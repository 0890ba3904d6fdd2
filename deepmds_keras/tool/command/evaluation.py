"""`deepmds evaluate`: errors of lifted faces, or other objects, on a user's true 3D landmarks."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from textwrap import fill

import numpy as np

from deepmds_keras.errors import InputError, MissingPackageError, needs
from deepmds_keras.files import map_npy, write_bytes
from deepmds_keras.geometry.alignment import align, procrustes
from deepmds_keras.geometry.camera import camera_angles
from deepmds_keras.geometry.units import centre, rescaled
from deepmds_keras.landmarks import convert, load_scheme, load_schemes, said_sizes, scheme_of
from deepmds_keras.landmarks.arrays import as_faces
from deepmds_keras.landmarks.y_axis import Y_UP_ADVICE, check_y_axis, eyes_to_mouth
from deepmds_keras.lifting.lifter import LandmarkLifter
from deepmds_keras.tool.command.onnx_export import open_lifter
from deepmds_keras.tool.detection import FOUND_BY, sd_of_landmarks, to_ibug
from deepmds_keras.tool.predict.faces import counted
from deepmds_keras.tool.predict.landmark_files import find_unusable, read_landmarks
from deepmds_keras.tool.predict.landmark_tables import read_landmark_table
from deepmds_keras.tool.predict.models import DEFAULT, scheme_of_model
from deepmds_keras.validation import find_faults

_SIZES = (51, 68)  # of shipped weights that are scored
_YAWS = (0, 15, 30, 45, 60, 90, 180)  # edges of the bins of |yaw|, degrees
_COLUMNS = ("landmarks", "method", "yaw", "n_faces", "error", "standard_error")
_UNIT = 1e-3
_LINES = {"mean shape": "s--", "lifting": "o-", "lifting, exact": "o:", "eos": "x-"}


def evaluate(
    truth: str | Path,
    *,
    landmarks: str | Path | None = None,
    y_up: bool = False,
    image_size: tuple[float, float] | None = None,
    model: str | None = None,
    scheme: str | Path | None = None,
    eos: str | Path | None = None,
    out: str | Path,
    overwrite: bool = False,
) -> list[dict]:
    """Score lifting on true 3D landmarks, against the mean shape and eos; print and write a table.

    A face's error is the mean squared difference of coordinates after alignment by a similarity,
    relative to the squared distance between the outer corners of the eyes. It leaves out the jaw
    line, whose depth schemes define differently; 68 landmarks are also scored with it. With eos, it
    covers the landmarks that its model has. For other objects than faces the error is relative to
    the mean squared coordinate of the shape, once centred.

    Args:
        truth: `.npy` `(n, L, 3)`, L 51 or 68, or as many as the model has; or with coordinates
            first, `(n, 3, 68)`, as 3DDFA has AFLW2000-3D; or `.csv` with columns `x`, `y` and `z`,
            see `read_landmark_table`. Faces as the camera sees them, in any unit; the directions
            of y and z are inferred from the faces.
        landmarks: File of the 2D landmarks to lift; None uses the x and y of the truth.
        y_up: Whether y grows upwards in `landmarks`.
        image_size: Width and height of the image if `landmarks` are fractions of them.
        model: File of `LandmarkLifter.save`, or name of shipped weights; None is those for L.
        scheme: Scheme of the model's landmarks, as for `load_scheme`; None is a face's, told by
            their number, or unnamed. With a table of your own, `landmarks` are in that order too.
        eos: eos's folder `share`: adds its fit of the Surrey model (extra `eos`).
        out: Folder for `errors.csv` and the figure `errors.png` (drawn by matplotlib).
        overwrite: Whether existing files may be replaced.

    Returns:
        Rows of the table: `landmarks, method, yaw, n_faces, error, standard_error`.

    Raises:
        InputError: A file is missing or damaged, has other landmarks or faces, or already exists.
    """
    out = Path(out)
    files = [out / "errors.csv", out / "errors.png"]
    for file in files if not overwrite else ():
        if file.exists():
            raise InputError(f"{file} already exists; choose another --out or pass --overwrite.")
    if landmarks is None and (y_up or image_size):
        raise InputError("landmarks must be given with y_up or image_size. Received none.")
    if scheme is not None and model in (None, DEFAULT):
        raise InputError("scheme must be that of a model. Received none.")
    lifter = None if model in (None, DEFAULT) else open_lifter(model)[0]
    sizes = _SIZES if lifter is None else (lifter.n_landmarks,)
    shapes, _ = rescaled(read_truth(truth, sizes))  # errors are relative
    scheme = scheme_of_model(scheme, model, shapes.shape[1])
    lifter = lifter or LandmarkLifter.pretrained(scheme)
    is_face, frame = load_scheme(scheme).is_face, lifter.weights_["mean"].T.astype(float)
    shapes = _oriented(shapes, scheme, frame)
    found_by = None
    if landmarks is None:
        views = shapes[..., :2]
        check_y_axis(views * (1, -1), scheme, str(truth))
    else:
        own = None if scheme in load_schemes() else scheme
        views = read_landmarks(landmarks, y_up=y_up, image_size=image_size, scheme=own)
        seen = own or scheme_of(views.shape[1])
        check_y_axis(views, seen, str(landmarks), needed=Y_UP_ADVICE[y_up])
        found_by = FOUND_BY.get(seen)
        try:
            views = to_ibug(convert(views, seen, scheme), found_by, scheme)
        except InputError:
            raise InputError(
                f"{landmarks} must have all landmarks of {truth}, {scheme}. Received those of "
                f"{seen}: leave what it lacks out of {truth}; the jaw is the first 17 of 68."
            ) from None
        views = views * (1, -1)
        if len(views) != len(shapes):
            raise InputError(
                f"{landmarks} must have landmarks of {len(shapes)} faces, like {truth}. "
                f"Received {len(views)}."
            )
        for face in np.flatnonzero(np.isnan(views).all((1, 2))).tolist():
            raise InputError(
                f"{landmarks} must have landmarks of each face. Received none for face {face + 1}: "
                "leave it out of both files."
            )
        for face, fault in find_unusable(views).items():
            raise InputError(f"{landmarks}, face {face + 1} of {len(views)}, {fault}.")
    sd = sd_of_landmarks(views, found_by, scheme)
    predicted = {"lifting": lifter.predict(views, landmark_sd=sd, check_orientation=False)}
    if lifter.mean_shape_ is not None:  # as it is in older files
        predicted = {"mean shape": np.broadcast_to(lifter.mean_shape_, shapes.shape)} | predicted
    if landmarks is None:
        exact = lifter.predict(views, landmark_sd=0, check_orientation=False)
        predicted["lifting, exact"] = exact
    if eos is not None:
        from deepmds_keras.baselines.eos_fit import EosFit

        fitted = EosFit(eos).predict(convert(views, scheme, "ibug51"))
        predicted["eos"] = convert(fitted, "ibug51", scheme, missing="nan")
    rows = [*_rows(predicted, shapes, scheme, frame)]
    unit = "squared eye distance" if is_face else "mean squared coordinate of the truth"
    _print(rows, counted(len(shapes), load_scheme(scheme).thing), unit)
    # All before the first is written, since the same command refuses to replace the half.
    contents, remarks = {files[0]: _csv(rows).encode()}, []
    try:
        with needs("matplotlib", "evaluate"):
            contents[files[1]] = _figure(rows, unit)
    except MissingPackageError as error:
        files[1].unlink(missing_ok=True)  # of the errors that this run replaces
        remarks = [f"No figure: {error}"]
    for file, content in contents.items():
        write_bytes(file, content)
    print(*contents, *remarks, sep="\n")
    return rows


def read_truth(path: str | Path, sizes: tuple[int, ...] = _SIZES) -> np.ndarray:
    """True landmarks, `(n, L, 3)`, L one of the sizes, see `evaluate`.

    Raises:
        InputError: The file is missing, damaged, or holds anything else.
    """
    path = Path(path)
    if path.suffix.lower() == ".csv":
        shapes = read_landmark_table(path, tuple("xyz"), sizes=sizes)
    else:
        shapes = as_faces(map_npy(path), str(path), sizes)
    if not len(shapes) or shapes.shape[1] not in sizes or shapes.shape[2] != 3:
        raise InputError(
            f"{path} must hold {said_sizes(sizes)} landmarks (x, y, z) per face, (n, L, 3). "
            f"Received shape {shapes.shape}."
        )
    if not np.isfinite(shapes).all():
        raise InputError(f"{path} must hold finite numbers. Received NaN, text or infinity.")
    shapes = shapes.astype(float)
    for face, fault in find_faults(shapes).items():
        raise InputError(f"{path}, face {face + 1} of {len(shapes)}, {fault}.")
    return shapes


def _oriented(shapes: np.ndarray, scheme: str, mean: np.ndarray) -> np.ndarray:
    """The shapes with y up and z towards the viewer, as inferred from most of the faces."""
    if np.median(eyes_to_mouth(shapes, scheme)[:, 1]) > 0:
        shapes = shapes * (1, -1, 1)
    means, mirrored = np.broadcast_to(mean, shapes.shape), shapes * (1, 1, -1)
    off = [((align(means, x, reflection=False) - x) ** 2).sum() for x in (shapes, mirrored)]
    return shapes if off[0] <= off[1] else mirrored


def _rows(
    predicted: dict[str, np.ndarray], shapes: np.ndarray, scheme: str, mean: np.ndarray
) -> Iterator[dict]:
    rotation = procrustes(np.broadcast_to(mean, shapes.shape), shapes, reflection=False).rotation
    yaw = np.abs(camera_angles(np.swapaxes(rotation, 1, 2))[0])
    bins = {f"{low} to {high}": (yaw >= low) & (yaw < high) for low, high in pairwise(_YAWS)}
    bins = {"all": np.ones(len(yaw), bool)} | bins
    known = load_scheme(scheme)
    if known.is_face:
        right, left = known.eye_corners()
        size = np.linalg.norm(shapes[:, left] - shapes[:, right], axis=1)
    else:
        size = np.sqrt((centre(shapes) ** 2).mean((1, 2)))
    inner = np.ones(len(known), bool)
    if scheme == "ibug68":
        inner = np.array(known.numbers) >= load_scheme("ibug51").numbers[0]
    for shape in predicted.values():
        inner &= np.isfinite(shape).all((0, 2))
    every = [inner] if inner.all() or "eos" in predicted else [inner, inner | True]
    for scored in every:
        truth = shapes[:, scored]
        for method, shape in predicted.items():
            off = align(shape[:, scored], truth, reflection=False) - truth
            errors = (off**2).mean((1, 2)) / size**2
            for name, some in bins.items():
                if n := int(some.sum()):
                    mean = errors[some].mean()
                    error = errors[some].std(ddof=1) / np.sqrt(n) if n > 1 else np.nan
                    row = (int(scored.sum()), method, name, n, mean, error)
                    yield dict(zip(_COLUMNS, row, strict=True))


def _csv(rows: list[dict]) -> str:
    text = io.StringIO()
    writer = csv.DictWriter(text, _COLUMNS, lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return text.getvalue()


def _print(rows: list[dict], scored: str, unit: str) -> None:
    yaws = [*dict.fromkeys(row["yaw"] for row in rows)]
    print(f"{scored}; mean squared error in 10⁻³ of the {unit}, by yaw (°)")
    cells = {(row["landmarks"], row["method"], row["yaw"]): row["error"] for row in rows}
    print(f"{'landmarks, method':26}", *(f"{yaw:>9}" for yaw in yaws))
    for landmarks, method in dict.fromkeys((key[0], key[1]) for key in cells):
        errors = (cells[landmarks, method, yaw] / _UNIT for yaw in yaws)
        print(f"{landmarks}, {method:22}", *(f"{error:9.3f}" for error in errors))


def _figure(rows: list[dict], unit: str) -> bytes:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(5, 3.5), layout="constrained")
    axes = figure.subplots()
    fewest = min(row["landmarks"] for row in rows)
    shown = [row for row in rows if row["landmarks"] == fewest and row["yaw"] != "all"]
    for method in dict.fromkeys(row["method"] for row in shown):
        line = [row for row in shown if row["method"] == method]
        axes.errorbar(
            [row["yaw"] for row in line],
            [row["error"] / _UNIT for row in line],
            [1.96 * row["standard_error"] / _UNIT for row in line],
            fmt=_LINES[method],
            capsize=2,
            label=method,
        )
    axes.set(xlabel="Yaw to either side (degrees)", ylim=(0, None))
    axes.set_ylabel(fill(f"MSE (10⁻³ of the {unit})", 40))
    figure.legend(loc="outside upper center", ncols=2, frameon=False)
    content = io.BytesIO()
    figure.savefig(content, format="png", dpi=150)
    return content.getvalue()
