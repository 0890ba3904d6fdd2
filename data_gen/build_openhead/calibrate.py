"""Fits the s.d.s of the identity sliders to the landmark covariance of ICT-FaceKit.

Nothing of ICT-FaceKit's geometry enters the head: only how much, and together with what, each
landmark varies among real faces. In use only with `--calibrate`; the result is
`identity_prior.csv`.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from scipy.optimize import lsq_linear

from data_gen.build_openhead.cut import Head
from data_gen.build_openhead.prior import IdentityPrior
from data_gen.build_openhead.tables import IDENTITY_PRIOR
from deepmds_keras.alignment import align, procrustes
from deepmds_keras.errors import InputError
from deepmds_keras.files import read_npz, read_table, write_bytes

CANTHI = (0, 56)  # outer corners of the eyes, landmarks 1 and 57 of bfm72: their distance is 1
PUPILS = [4, 53]  # left out: ICT-FaceKit has them on the eyelid
RIDGE = 0.03
SD_CAP = 0.45
NO_EFFECT = 0.01  # slider directions shorter than this (at 1) do not move the landmarks
ROUNDS = 5


def fit_sds(prior: IdentityPrior, head: Head, average: np.ndarray, ict: Path) -> np.ndarray:
    """`(P,)` s.d.s under which the 72 landmarks vary as ICT-FaceKit's do.

    The covariance is the macro targets' (sampled) plus each parameter's direction times its
    variance: linear in the variances, so bounded least squares finds them. A common factor then
    makes up for what clipping takes away.

    Args:
        prior: The sliders; its s.d.s are not used.
        head: The cut.
        average: `(V, 3)` the average adult, where directions are taken.
        ict: Path of ICT-FaceKit Light as npz (`mean`, `identity`, `landmarks72`).
    """
    prior = prior.restrict(head.landmarks["bfm72"])
    ict_mean, ict_cov = _ict_covariance(ict)
    macro_cov = _covariance(prior.sample(4000, np.random.default_rng(1), 0 * prior.sd), ict_mean)
    directions = _directions(prior, average[head.landmarks["bfm72"]], ict_mean)

    no_pupils = np.repeat(~np.isin(np.arange(len(ict_mean)), PUPILS), 3)
    block = np.ix_(no_pupils, no_pupils)
    moves = directions[:, no_pupils]
    lower, upper = _bounds(prior)
    gram = (moves @ moves.T) ** 2
    goal = np.einsum("pi,ij,pj->p", moves, (ict_cov - macro_cov)[block], moves)
    # The ridge pulls what the landmarks do not determine towards a moderate variance.
    diagonal = np.diag(gram)
    ridge = RIDGE * np.median(diagonal[diagonal > 1e-8])
    factor = np.linalg.cholesky(gram + ridge * np.eye(len(gram)))
    right = np.linalg.solve(factor, goal + ridge * 0.15 * upper**2)
    sd = np.sqrt(lsq_linear(factor.T, right, bounds=(lower**2, upper**2)).x)
    unseen = np.linalg.norm(directions, axis=1) < NO_EFFECT
    sd[unseen] = np.where(prior.asymmetric, 0.05, 0.2)[unseen]

    scale = 1.0
    for round_ in range(ROUNDS):
        rng = np.random.default_rng(11 + round_)
        heads = prior.sample(6000, rng, np.minimum(sd * scale, SD_CAP))
        scale *= (np.trace(_covariance(heads, ict_mean)) / np.trace(ict_cov)) ** -0.45
    return np.minimum(sd * scale, SD_CAP)


def write_sds(sd: np.ndarray, path: Path = IDENTITY_PRIOR) -> None:
    """Puts new s.d.s into the table of the prior, all else unchanged."""
    rows = read_table(path)
    lines = path.read_text(encoding="utf-8").splitlines()
    lines = [*(line for line in lines if line.startswith("#")), ",".join(rows[0])]
    values = [str(value) for value in np.round(sd, 3)]
    lines += [",".join({**row, "sd": x}.values()) for row, x in zip(rows, values, strict=True)]
    write_bytes(path, ("\n".join(lines) + "\n").encode())


def _bounds(prior: IdentityPrior) -> tuple[np.ndarray, np.ndarray]:
    """`(P,)` least and greatest s.d.: what looked plausible, tighter for ears and asymmetry."""
    lower = np.where(prior.asymmetric, 0.02, 0.06)
    upper = np.where(prior.asymmetric, 0.30, 0.42)
    edge = np.char.startswith(prior.names, "ears/") | np.char.startswith(prior.names, "neck/")
    lower[edge] = np.where(prior.asymmetric, 0.02, 0.15)[edge]
    upper[edge] = np.where(prior.asymmetric, 0.08, 0.25)[edge]
    for stem in ("head/head-age", "nose/nose-greek", "chin/chin-cleft"):
        upper[np.char.startswith(prior.names, stem)] = 0.3
    return lower, upper


def _directions(prior: IdentityPrior, average: np.ndarray, goal: np.ndarray) -> np.ndarray:
    """`(P, 3L)` what a parameter at 1 does to the landmarks, up to similarity, in ICT's frame."""
    unit = np.linalg.norm(average[CANTHI[0]] - average[CANTHI[1]])
    rotation, scale, _ = procrustes(average / unit, goal, reflection=False)
    slopes = (prior.positive - prior.negative) / np.where(prior.one_sided, 1, 2)[:, None, None]
    moves = np.einsum("ps,slj->plj", prior.mixing, slopes) @ rotation * (scale / unit)
    here = (average - average.mean(0)) / unit @ rotation * scale
    shifts = [np.tile(axis, (len(here), 1)) for axis in np.eye(3)]
    turns = [np.cross(axis, here) for axis in np.eye(3)]
    tangent, _ = np.linalg.qr(np.array([*shifts, *turns, here]).reshape(7, -1).T)
    flat = moves.reshape(len(moves), -1)
    return flat - flat @ tangent @ tangent.T


def _ict_covariance(path: Path) -> tuple[np.ndarray, np.ndarray]:
    model = read_npz(path, "ICT-FaceKit Light (npz)")
    try:
        landmarks = model["landmarks72"]
        mean, basis = model["mean"][landmarks], model["identity"][:, landmarks]
    except (KeyError, IndexError) as error:
        raise InputError(
            f"{path} must be ICT-FaceKit Light as npz, with mean, identity and landmarks72. "
            f"Received: {error}."
        ) from None
    draws = np.random.default_rng(0).standard_normal((5000, len(basis)))
    faces, mean = _generalised_procrustes(mean + np.einsum("nk,kij->nij", draws, basis))
    return mean, np.cov(faces.reshape(len(faces), -1).T)


def _covariance(faces: np.ndarray, goal: np.ndarray) -> np.ndarray:
    """`(3L, 3L)` landmark covariance in ICT's frame, similarity removed."""
    faces, mean = _generalised_procrustes(faces.astype(float))
    rotation, _, _ = procrustes(mean, goal, reflection=False)
    return np.cov((faces @ rotation).reshape(len(faces), -1).T)


def _generalised_procrustes(faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Aligned `(n, L, 3)` faces and their mean, the outer canthi of which are 1 apart."""
    mean = faces[0]
    for _ in range(5):
        aligned = align(faces, mean - mean.mean(0))
        mean = aligned.mean(0)
        unit = np.linalg.norm(mean[CANTHI[0]] - mean[CANTHI[1]])
        mean = mean / unit
    return aligned / unit, mean
