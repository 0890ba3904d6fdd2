"""Step: what photos of real people, without ground truth, tell about detectors and methods.

It compares the landmarks of the same faces from two detectors. Their differences give the table by
which prediction corrects a detector, `deepmds_keras/landmarks/detectors.csv`. A method is reliable
if its shapes from both are similar, and unlike those of other people.
"""

import numpy as np
import pandas as pd

from data_gen.models.registry import OPEN, open_models
from deepmds_keras.deep_mds import DeepMDS
from deepmds_keras.errors import InputError
from deepmds_keras.files import read_npz
from deepmds_keras.geometry.alignment import align
from deepmds_keras.geometry.units import centre, normalise, rms_radius
from deepmds_keras.landmarks import DETECTOR_ERRORS, load_scheme
from deepmds_keras.lifting.lifter import LandmarkLifter
from deepmds_keras.tool.detection import detector_sd, measured, move
from experiments.lifting.transfer import Trained
from experiments.methods import title
from experiments.pretrained.portraits import read_portraits
from experiments.pretrained.pretrained import SCHEMES, errors_of, trained_beside
from experiments.pretrained.residuals import (
    along_face,
    mean_residuals,
    misfits,
    of_detectors,
    residuals,
    sd_in_pixels,
)
from experiments.records import write_csv
from experiments.run import Run
from experiments.scoring.numbers import between
from experiments.streams import Stream
from experiments.studies.study_results import write_results

_SCHEME = "ibug51"
_KEPT = "dlib"  # trained on iBUG 300-W: the other detector's landmarks move to its
# Assumed variance of the errors, of both detectors together, relative to that of their difference.
# Errors are correlated, between neighbouring landmarks and between the two detectors, and weigh
# more than white ones of the same size: with 1, which the table has beside it, the shapes from the
# two agree less.
_STRENGTH = 6.0
# Faces are one photo, in two sizes, if they differ by less than this r.m.s. distance in radii. The
# two detectors differ by more on every photo.
_ONE_PHOTO = 0.03
_RESAMPLINGS = 10_000  # of the people
_COLUMNS = {
    "Ratio": ("ratio", "low", "high"),
    "Less LandmarkLifter's": ("less", "less_low", "less_high"),
}
_GIVEN = {_STRENGTH: "As shipped", 1.0: "S.d. that explain the differences"}
_NOTES = (
    "Ratio: mean squared distance between the shapes of one face from two detectors, over that "
    "between different faces; 0 if the detectors agree, 1 if a shape says nothing about a person. "
    "95 % intervals by bootstrap over the people: no order holds whose difference has 0 in it.",
)
_LIFTER = "landmark_lifter"
_NOTHING = 1e-12  # a distance that is rounding


def main(run: Run) -> dict:
    arrays = read_npz(run.real)
    if not {"dlib", "mediapipe"} <= {*arrays}:
        raise InputError(f"{run.real} must hold arrays dlib and mediapipe. Received {[*arrays]}.")
    # To image coordinates, y down.
    faces = {name: np.float64(arrays[name]) * (1, -1) for name in ("dlib", "mediapipe")}
    kept = different_photos(faces)
    faces = {name: of[kept] for name, of in faces.items()}
    shipped = LandmarkLifter.pretrained(_SCHEME), DeepMDS.pretrained(f"deepmds-{_SCHEME}")
    methods = trained_beside(run, _SCHEME, *shipped)
    # First of all, since everything below reads the s.d. in it.
    if run.preset.name == "full" and not open_models(run.data)[1]:
        write_csv(DETECTOR_ERRORS, detector_table(run, faces, methods.lifter))
        measured.cache_clear()
    found = of_detectors(methods.lifter, faces)
    off = found[_KEPT, "detector"]
    table = pd.DataFrame(
        {"strength": strength} | row | {"n_faces": len(off)}
        for strength in _GIVEN
        for row in reliability(methods, faces, off, run.seed, strength)
    )
    tables = {
        "table": table,
        "misfit": pd.DataFrame(misfits(found)),
        "residuals": mean_residuals(found),
    }
    texts = {
        (_GIVEN[strength], head): [between(*ends) for ends in rows[[*names]].to_numpy()]
        for strength, rows in table.groupby("strength", sort=False)
        for head, names in _COLUMNS.items()
    }
    methods_shown = pd.Index(table["method"].map(title).unique(), name="Method")
    cells = pd.DataFrame(texts, index=methods_shown)
    return write_results(run, "real", tables, cells, _NOTES)


def different_photos(faces: dict[str, np.ndarray]) -> np.ndarray:
    """Numbers of the faces without those that both detectors say are an earlier one's photo."""
    one_photo = True
    for landmarks in faces.values():
        alike = centre(landmarks) / rms_radius(landmarks)[:, None, None]
        square = 2 * _squares(alike, alike)  # of both coordinates of a landmark
        one_photo = one_photo & (square < _ONE_PHOTO**2)
    return np.flatnonzero(~np.tril(one_photo, -1).any(1))


def differences(faces: dict[str, np.ndarray]) -> np.ndarray:
    """`(n, 51, 2)` from MediaPipe's landmarks to dlib's, in axes and radii of the upright face."""
    return along_face(faces["dlib"] - faces["mediapipe"], faces["mediapipe"])


def detector_table(run: Run, faces: dict[str, np.ndarray], lifter: LandmarkLifter) -> pd.DataFrame:
    """Rows of `detector, landmark, dx, dy, sd`, landmarks by their iBUG numbers.

    dlib's landmarks move back by their mean residual of the lifted shapes, the jaw apart;
    MediaPipe's to where dlib's are then. The s.d. of landmarks relative to each other are those on
    rendered photos; their common scale is set by the difference on real ones.
    """
    apart = differences(faces)
    variances = {name: _variance(run, name) for name in SCHEMES}
    both = sum(variance[-apart.shape[1] :] for variance in variances.values()).mean()
    size = np.sqrt(_STRENGTH * apart.var(0).mean() / both)
    sds = {name: (size * np.sqrt(variance)).round(5) for name, variance in variances.items()}
    kept = faces[_KEPT]
    off = residuals(lifter, kept, sd_in_pixels(kept, sds[_KEPT][-apart.shape[1] :]))
    parts = []
    for detector, (scheme, *_) in SCHEMES.items():
        sd = sds[detector]
        offset = np.zeros((len(sd), 2))
        offset[-apart.shape[1] :] = _offset(detector, apart, off)
        part = {"detector": detector, "landmark": load_scheme(scheme).numbers}
        part |= {"dx": offset[:, 0], "dy": offset[:, 1], "sd": sd}
        parts.append(pd.DataFrame(part))
    return pd.concat(parts).round(5)


def _offset(detector: str, apart: np.ndarray, off: np.ndarray) -> np.ndarray:
    """By how much a detector's landmarks move, `(51, 2)`, from differences and residuals."""
    return -off.mean(0) if detector == _KEPT else apart.mean(0) - off.mean(0)


def _variance(run: Run, detector: str) -> np.ndarray:
    """`(L,)` of a coordinate of each landmark about its mean error on rendered photos."""
    photos = (read_portraits(run, model, further=True) for model in OPEN)
    errors = (errors_of(each, detector) for each in photos)
    return np.mean([e[detected].var(0).mean(1) for e, detected in errors], axis=0)


def reliability(
    methods: Trained,
    faces: dict[str, np.ndarray],
    off: np.ndarray,
    seed: int = 0,
    strength: float = _STRENGTH,
) -> list[dict]:
    """Similarity of a face's shapes from both detectors, for each method.

    Offsets and the size of the s.d. come from one half of the faces, the test from the other.

    Args:
        faces: Landmarks `(n, 51, 2)` in images by detector.
        off: `(n, 51, 2)` residuals of dlib's landmarks, as from `residuals`.
        seed: Of the bootstrap.
        strength: Of the s.d. that methods are told, as `_STRENGTH`, with which the s.d. ship.

    Returns:
        Rows of `method, ratio, low, high, less, less_low, less_high, within, between`: the ratio of
        `_NOTES` with its interval, the ratio less that of the lifter, and the two distances after
        alignment, in squared units of `normalise`.
    """
    apart, found = differences(faces), {}
    n = len(apart)
    for half in (np.arange(n) % 2, np.arange(n) // (n // 2 + 1)):
        for tested in (half == 0, half == 1):
            size = np.sqrt(apart[~tested].var(0).mean() / apart.var(0).mean())
            size *= np.sqrt(strength / _STRENGTH)
            predicted = []
            for name, of in faces.items():
                moved = move(of[tested], _SCHEME, _offset(name, apart[~tested], off[~tested]))
                sd = size * sd_in_pixels(moved, detector_sd(name, _SCHEME))
                predicted.append(methods.predict(moved * (1, -1), sd))
            first, second = predicted
            for method in first:
                distances = np.full((n, n), np.nan)
                pair = normalise(first[method]), normalise(second[method])
                distances[np.ix_(tested, tested)] = _squares(*pair)
                found.setdefault(method, []).append(distances)
    pairs = {method: _mean_of_known(distances) for method, distances in found.items()}
    rng = np.random.default_rng([seed, Stream.PEOPLE])
    drawn = np.vstack([np.ones(n), rng.multinomial(n, np.full(n, 1 / n), _RESAMPLINGS)])
    measured = {method: _within_and_between(of, drawn) for method, of in pairs.items()}
    ratios = {
        method: np.where(others > _NOTHING, own / np.maximum(others, _NOTHING), np.nan)
        for method, (own, others) in measured.items()
    }
    rows = []
    for method, (own, others) in measured.items():
        row = {"method": method} | _interval(ratios[method], "ratio", "low", "high")
        less = ratios[method] - ratios[_LIFTER]
        row |= _interval(less, "less", "less_low", "less_high")
        rows.append(row | {"within": own[0].item(), "between": others[0].item()})
    return rows


def _squares(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Mean squared differences of each first face from all second ones, aligned to it: `(n, n)`."""
    return np.stack([((align(second, of) - of) ** 2).mean((1, 2)) for of in first])


def _mean_of_known(distances: list[np.ndarray]) -> np.ndarray:
    """Mean over the halves in which two people were tested together; NaN if there is none."""
    counts = np.isfinite(distances).sum(0)
    return np.nansum(distances, axis=0) / np.where(counts, counts, np.nan)


def _within_and_between(pairs: np.ndarray, drawn: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Mean distances of a person from itself and from others, `(B,)`, if each is drawn so often.

    Pairs are `(n, n)`, NaN for people who were never tested together; `drawn` is `(B, n)`.
    """
    n = len(pairs)
    known = np.isfinite(pairs) & ~np.eye(n, dtype=bool)
    others = np.where(known, pairs, 0)
    within = drawn @ np.diag(pairs) / drawn.sum(1)
    of_others = np.einsum("bi,ij,bj->b", drawn, others, drawn)
    return within, of_others / np.einsum("bi,ij,bj->b", drawn, known.astype(float), drawn)


def _interval(values: np.ndarray, *names: str) -> dict[str, float]:
    """The first of the values, which is of all people as they are, and an interval of the rest."""
    ends = np.quantile(values[1:], [0.025, 0.975])
    return dict(zip(names, map(float, [values[0], *ends]), strict=True))
