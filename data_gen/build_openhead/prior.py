"""Random heads: the distribution that MakeHuman's sliders are drawn from.

Two layers: MakeHuman's macro targets (sex, age, origin, weight, muscle) with their multilinear
weights, and local sliders with normal draws whose s.d.s are in `identity_prior.csv`. Those were
fitted once to the landmark covariance of ICT-FaceKit: the macro targets' covariance (sampled) plus
each slider's direction times its variance is linear in the variances, so bounded least squares
gives them. Nothing of ICT-FaceKit's geometry enters the head: only how much, and together with
what, each landmark varies among real faces.
"""

from itertools import product
from pathlib import Path

import numpy as np

from data_gen.build_openhead.cut import Head
from data_gen.build_openhead.makehuman import MakeHumanAssets
from deepmds_keras.files import read_table

IDENTITY_PRIOR = Path(__file__).parent / "identity_prior.csv"
WHO = [*product(("female", "male"), ("young", "old"))]
ORIGINS, LEVELS = ("african", "asian", "caucasian"), ("min", "average", "max")
MACRO_TARGETS = (
    *(f"{origin}-{sex}-{age}" for (sex, age), origin in product(WHO, ORIGINS)),
    *(
        f"universal-{sex}-{age}-{muscle}muscle-{weight}weight"
        for (sex, age), muscle, weight in product(WHO, LEVELS, LEVELS)
    ),
)
MALE_BETA, AGE_BETA, ORIGIN_DIRICHLET = (0.7, 0.7), (1.2, 2.2), (0.7, 0.7, 0.7)
WEIGHT_SD, MUSCLE_SD = 0.14, 0.12
SLIDER_CUT = 2.5  # draws are cut at this many s.d.


def sample_heads(
    assets: MakeHumanAssets, head: Head, n: int, rng: np.random.Generator, progress=iter
) -> np.ndarray:
    """`(n, V, 3)` float32 heads in mm, not aligned; `progress` over targets is as `tqdm.tqdm`."""
    sd, mixing, negative, positive = _read_prior()
    male, age = rng.beta(*MALE_BETA, n), rng.beta(*AGE_BETA, n)
    origin = rng.dirichlet(ORIGIN_DIRICHLET, n)
    weight = np.clip(rng.normal(0.5, WEIGHT_SD, n), 0, 1)
    muscle = np.clip(rng.normal(0.5, MUSCLE_SD, n), 0, 1)
    draws = np.clip(rng.standard_normal((len(sd), n)), -SLIDER_CUT, SLIDER_CUT).T * sd
    sliders = np.clip(draws @ mixing, -1, 1)
    macro = [f"macrodetails/{name}" for name in MACRO_TARGETS]
    names = {*macro, *negative, *positive} - {""}
    offsets = {name: head.restrict(assets.target(name)) for name in progress(sorted(names))}
    base = head.restrict(assets.vertices)
    offsets[""] = np.zeros_like(base)
    heads = np.repeat(base[None].astype(np.float32), n, axis=0)
    for weights, targets in (
        (macro_weights(male, age, origin, weight, muscle), macro),
        (np.maximum(sliders, 0), positive),
        (np.maximum(-sliders, 0), negative),
    ):
        flat = np.float32([offsets[name].ravel() for name in targets])
        heads += (weights.astype(np.float32) @ flat).reshape(heads.shape)
    return heads


def macro_weights(male, age, origin, weight, muscle) -> np.ndarray:
    """MakeHuman's weights `(n, M)` of MACRO_TARGETS; the first 12 sum to one, so do the rest.

    Args:
        male, age: `(n,)` 0 (female, young) to 1 (male, old).
        origin: `(n, 3)` shares of ORIGINS, summing to one.
        weight, muscle: `(n,)` 0 (least) to 1 (most), 0.5 being the average.
    """

    def hats(level):
        return np.column_stack(
            [np.maximum(1 - 2 * level, 0), 1 - np.abs(2 * level - 1), np.maximum(2 * level - 1, 0)]
        )

    by_sex, by_age = np.column_stack([1 - male, male]), np.column_stack([1 - age, age])
    who = np.einsum("ns,na->nsa", by_sex, by_age)
    by_origin = np.einsum("nsa,no->nsao", who, origin)
    by_build = np.einsum("nsa,nm,nw->nsamw", who, hats(muscle), hats(weight))
    return np.hstack([by_origin.reshape(len(male), -1), by_build.reshape(len(male), -1)])


def _read_prior() -> tuple[np.ndarray, np.ndarray, list[str], list[str]]:
    """P parameters that move S sliders in [-1, 1].

    Returns:
        `(P,)` standard deviations; `(P, S)`, by how much a parameter moves a slider: 0, 1 or -1;
        and the `S` targets that are applied at -1, `""` for none, and at 1.
    """
    rows = read_table(IDENTITY_PRIOR)
    sliders: dict[tuple[str, str], int] = {}
    moves = []  # (parameter, slider, direction)
    for parameter, row in enumerate(rows):
        twins = [(row["target_negative"], row["target_positive"])]
        if row["kind"].startswith("pair_"):
            twins.append(tuple(name.replace("/l-", "/r-") for name in twins[0]))
        for side, slider in enumerate(twins):
            direction = -1 if side and row["kind"] == "pair_asymmetric" else 1
            moves.append((parameter, sliders.setdefault(slider, len(sliders)), direction))
    mixing = np.zeros((len(rows), len(sliders)))
    for parameter, slider, direction in moves:
        mixing[parameter, slider] = direction
    sd = np.array([float(row["sd"]) for row in rows])
    return sd, mixing, [negative for negative, _ in sliders], [positive for _, positive in sliders]
