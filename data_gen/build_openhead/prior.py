"""Random heads: the distribution that MakeHuman's sliders are drawn from.

Two layers: MakeHuman's macro targets (sex, age, origin, weight, muscle) with their multilinear
weights, and local sliders with normal draws whose s.d.s stand in `identity_prior.csv`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from data_gen.build_openhead.cut import Head
from data_gen.build_openhead.makehuman import MakeHumanAssets
from data_gen.build_openhead.tables import IDENTITY_PRIOR
from deepmds_keras.files import read_table

SEXES = ("female", "male")
AGES = ("young", "old")
ORIGINS = ("african", "asian", "caucasian")
MUSCLES = ("minmuscle", "averagemuscle", "maxmuscle")
WEIGHTS = ("minweight", "averageweight", "maxweight")
MACRO_TARGETS = (
    *(f"{origin}-{sex}-{age}" for sex in SEXES for age in AGES for origin in ORIGINS),
    *(
        f"universal-{sex}-{age}-{muscle}-{weight}"
        for sex in SEXES
        for age in AGES
        for muscle in MUSCLES
        for weight in WEIGHTS
    ),
)

MALE_BETA = (0.7, 0.7)
AGE_BETA = (1.2, 2.2)
ORIGIN_DIRICHLET = (0.7, 0.7, 0.7)
WEIGHT_SD, MUSCLE_SD = 0.14, 0.12
SLIDER_CUT = 2.5  # draws are cut at this many s.d.


@dataclass(frozen=True, eq=False)
class IdentityPrior:
    """P parameters move S sliders; a slider in [-1, 1] applies one of two targets.

    Attributes:
        names: `(P,)` str.
        sd: `(P,)` float, s.d. of each parameter.
        asymmetric: `(P,)` bool, whether the parameter breaks the left-right symmetry.
        mixing: `(P, S)` float, by how much a parameter moves a slider: 0, 1 or -1.
        base: `(V, 3)` float, mm, vertices before any target.
        macro: `(M, V, 3)` float, mm, offsets of MACRO_TARGETS.
        negative, positive: `(S, V, 3)` float, mm, offsets of the sliders at -1 and 1; a slider
            without a negative target has zeros there.
        one_sided: `(S,)` bool, whether the slider has no negative target.
    """

    names: np.ndarray
    sd: np.ndarray
    asymmetric: np.ndarray
    mixing: np.ndarray
    base: np.ndarray
    macro: np.ndarray
    negative: np.ndarray
    positive: np.ndarray
    one_sided: np.ndarray

    def restrict(self, vertices: np.ndarray) -> IdentityPrior:
        """The same prior on some vertices only."""
        fields = {name: getattr(self, name) for name in self.__dataclass_fields__}
        for name in ("base", "macro", "negative", "positive"):
            fields[name] = fields[name][..., vertices, :]
        return IdentityPrior(**fields)

    def sample(self, n: int, rng: np.random.Generator, sd: np.ndarray | None = None) -> np.ndarray:
        """`(n, V, 3)` float32 heads in mm, not aligned; `sd` replaces the s.d.s of the table."""
        sd = self.sd if sd is None else sd
        male, age = rng.beta(*MALE_BETA, n), rng.beta(*AGE_BETA, n)
        origin = rng.dirichlet(ORIGIN_DIRICHLET, n)
        weight = np.clip(rng.normal(0.5, WEIGHT_SD, n), 0, 1)
        muscle = np.clip(rng.normal(0.5, MUSCLE_SD, n), 0, 1)
        draws = np.clip(rng.standard_normal((len(sd), n)), -SLIDER_CUT, SLIDER_CUT).T * sd
        sliders = np.clip(draws @ self.mixing, -1, 1)
        heads = np.repeat(self.base[None].astype(np.float32), n, axis=0)
        for weights, targets in (
            (macro_weights(male, age, origin, weight, muscle), self.macro),
            (np.maximum(sliders, 0), self.positive),
            (np.maximum(-sliders, 0), self.negative),
        ):
            flat = targets.reshape(len(targets), -1).astype(np.float32)
            heads += (weights.astype(np.float32) @ flat).reshape(heads.shape)
        return heads


def macro_weights(male, age, origin, weight, muscle) -> np.ndarray:
    """MakeHuman's weights of the macro targets.

    Args:
        male: `(n,)` 0 (female) to 1 (male).
        age: `(n,)` 0 (young) to 1 (old).
        origin: `(n, 3)` shares of ORIGINS, summing to one.
        weight, muscle: `(n,)` 0 (least) to 1 (most), 0.5 being the average.

    Returns:
        `(n, M)` weights in the order of MACRO_TARGETS; the first 12 sum to one, so do the rest.
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


def load_prior(assets: MakeHumanAssets, head: Head, progress=iter) -> IdentityPrior:
    """Reads `identity_prior.csv` and the targets that it names.

    Args:
        assets: Where the targets are.
        head: The cut to restrict them to.
        progress: Wraps the list of names that is gone through, as `tqdm.tqdm` does.
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

    names = {f"macrodetails/{name}" for name in MACRO_TARGETS}.union(*sliders) - {""}
    offsets = {name: head.restrict(assets.target(name)) for name in progress(sorted(names))}
    offsets[""] = np.zeros_like(head.restrict(assets.mesh.vertices))
    return IdentityPrior(
        names=np.array([row["parameter"] for row in rows]),
        sd=np.array([float(row["sd"]) for row in rows]),
        asymmetric=np.array([row["kind"].endswith("asymmetric") for row in rows]),
        mixing=mixing,
        base=head.restrict(assets.mesh.vertices),
        macro=np.array([offsets[f"macrodetails/{name}"] for name in MACRO_TARGETS]),
        negative=np.array([offsets[negative] for negative, _ in sliders]),
        positive=np.array([offsets[positive] for _, positive in sliders]),
        one_sided=np.array([negative == "" for negative, _ in sliders]),
    )
