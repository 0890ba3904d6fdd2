"""Claims on dissimilarities: what the net learns, what MDS makes of it, and ranks of distances."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from deepmds_keras.alignment import align, is_mirrored
from deepmds_keras.embedding import (
    check_dissimilarities,
    classical_scaling,
    embed,
    pairwise_distances,
)
from deepmds_keras.metrics import mse
from deepmds_keras.normalisation import normalise
from deepmds_keras.proximities import proximities
from experiments.audit.evidence import Inputs
from experiments.audit.findings import Finding, does_not_hold, holds, holds_if
from experiments.scoring.numbers import enumeration, scientific
from experiments.streams import Stream

if TYPE_CHECKING:
    from deepmds_keras.pipeline import DeepMDS

# Shares below which a number is nothing but rounding: of networks, and of all else.
_FLOAT32, _FLOAT64 = 1e-5, 1e-9
# How far an eigenvalue, or an error, must stand out from another one to be called larger.
_CLEARLY = 2
_DIMENSIONS = (1, 2, 3, 4, 5, 6)
_CLOUDS = 50  # random ones of each dimension or class
_FEW_POINTS, _MANY_DIMENSIONS = 5, 10
_SHOWN = 8  # eigenvalues
_TRUE, _LEARNT, _FRONTAL = "true 3D distances", "learnt dissimilarities", "frontal view"


def measure(inputs: Inputs) -> dict:
    """Measure what the checks below name, on the audited test faces and on random points."""
    model = inputs.method("ours")
    rng = np.random.default_rng([inputs.run.seed, Stream.AUDIT_DISSIMILARITY])
    views = inputs.test.views[inputs.audited]
    shapes = inputs.test.shapes[inputs.audited].astype(float)
    frontal = model.frontalise(views)
    outputs = net_outputs(model, frontal)
    return {
        "n_faces": len(shapes),
        "asymmetry": float(np.abs(outputs - net_outputs(model, frontal, swapped=True)).max()),
        "largest_output": float(np.abs(outputs).max()),
        "from_exact": _from_exact(shapes, inputs.method("mean_shape").predict(views)),
        **_of_learnt(model.dissimilarities(views), frontal.astype(float), shapes),
        **_ranks(shapes, rng),
        "classes": _classes(model, shapes[:_CLOUDS], rng),
    }


def symmetric(asymmetry: float, largest_output: float, n_faces: int) -> Finding:
    """Does the net answer the same whichever landmark of a pair comes first?"""
    evidence = (
        f"The net was given every pair of landmarks of {n_faces} test faces in both orders. "
        f"Its two outputs differ by {scientific(asymmetry, 2)} at most, where the largest output "
        f"is {scientific(largest_output, 3)}."
    )
    return (holds if asymmetry <= _FLOAT32 * largest_output else does_not_hold)(evidence)


def exact_distances(from_exact: Mapping[str, float], n_faces: int) -> Finding:
    """Is nothing but rounding left where MDS is given the true distances?"""
    classical, non_metric = from_exact["classical"], from_exact["non_metric"]
    bound = _FLOAT64 * from_exact["mean_shape"]
    evidence = (
        f"From the true distances of {n_faces} test faces classical scaling leaves an MSE of "
        f"{scientific(classical, 2)} and non-metric MDS one of {scientific(non_metric, 2)}; "
        f"the mean shape has {scientific(from_exact['mean_shape'], 3)}."
    )
    if classical > bound:
        return does_not_hold(evidence)
    if non_metric > bound:
        return holds_if("by classical scaling, not by non-metric MDS", evidence)
    left_open = ["place", "direction"]
    if from_exact["mirrored"] > 0:
        left_open.append("mirror image")
        evidence += (
            f" Non-metric MDS mirrors {100 * from_exact['mirrored']:.3g} % of the faces; without a "
            f"reflection to align them, its MSE is {scientific(from_exact['unreflected'], 3)}."
        )
    return holds_if(
        f"but for {enumeration(left_open)}, which distances do not tell, and for the scale, which "
        "non-metric MDS leaves open",
        evidence,
    )


def rank_above_two(
    spectra: Mapping, effective_numbers: Mapping, matrix_ranks: Mapping, lifted: Mapping,
    n_faces: int,
) -> Finding:  # fmt: skip
    """Does a third eigenvalue stand out, and does its component make the shape better?"""
    _, _, third, fourth, *_ = spectra[_LEARNT]
    true, flat = spectra[_TRUE][2], abs(spectra[_FRONTAL][2])
    effective = [f"{number:.2f}" for number in effective_numbers.values()]
    ranks = [str(rank) for rank in matrix_ranks.values()]
    evidence = (
        f"The squared dissimilarities of {n_faces} test faces, doubly centred, have eigenvalues. "
        f"In the sum of their absolute values the third has a share of {_percent(third)}, the "
        f"fourth one of {_percent(abs(fourth))}. With true distances the third has "
        f"{_percent(true)}, with distances in the frontal view {_percent(flat)}. Effective numbers "
        f"of true, learnt and frontal ones are {enumeration(effective)}. Classical scaling has an "
        f"MSE of {scientific(lifted['two'], 3)} with two components and of "
        f"{scientific(lifted['three'], 3)} with three. A rank alone lifts nothing: the matrices "
        f"themselves have ranks {enumeration(ranks)}. Square roots of the frontal view's distances "
        f"have a third eigenvalue of {_percent(lifted['roots_third'])}, but with it an MSE of "
        f"{scientific(lifted['roots'], 3)}."
    )
    stands_out = third > _CLEARLY * abs(fourth) and third > _CLEARLY * flat
    lifts = lifted["two"] > _CLEARLY * lifted["three"]
    return (holds if stands_out and lifts else does_not_hold)(evidence)


def distance_rank(
    ranks: Sequence[Mapping[str, int]], residual: float, flat_rank: int, few_points_rank: int
) -> Finding:
    """Have the distances of points of D dimensions rank D - 1, in any matrix made of them?"""
    listed = {key: enumeration([str(row[key]) for row in ranks]) for key in ranks[0]}
    evidence = (
        f"Points had {listed['dimensions']} dimensions, the last of them faces. Their squared "
        f"distances, doubly centred, have ranks {listed['centred']}; the squared distances "
        f"{listed['squared']}; the distances {listed['distances']}. Classical scaling with D "
        f"components gives the points back but for {scientific(residual, 1)} of their variance. "
        f"Two readings favour the paper. 3D points in a plane have the rank {flat_rank}. "
        f"{_FEW_POINTS} points of {_MANY_DIMENSIONS} dimensions have {few_points_rank}, since n "
        "points have n − 1 at most."
    )
    as_claimed = any(
        all(row[matrix] == row["dimensions"] - 1 for row in ranks)
        for matrix in ("centred", "squared", "distances")
    )
    return (holds if as_claimed else does_not_hold)(evidence)


def shape_classes(classes: Mapping[str, Mapping[str, float]]) -> Finding:
    """Does MDS, or else the net trained on faces, fail on shapes of other classes?"""
    others = [name for name in classes if name != "faces"]
    residual = max(max(own["classical"], own["non_metric"]) for own in classes.values())
    learnt = [
        f"{_percent(own['learnt'])} on {name} ({_percent(own['flat'])})"
        for name, own in classes.items()
    ]
    evidence = (
        f"From true distances MDS gives back faces, {enumeration(others)}, to "
        f"{scientific(residual, 1)} of their variance at worst. The net, trained on faces and "
        f"given true frontal views, leaves a part of the variance: {enumeration(learnt)}. In "
        "brackets is what an answer without depth leaves. A view tells the depth of faces and half "
        "spheres only. Nets trained on several classes were not tried."
    )
    if residual > _FLOAT64:
        return holds(evidence)
    # What is no better than an answer without depth is not recovered.
    fails = [_CLEARLY * classes[name]["learnt"] > classes[name]["flat"] for name in others]
    condition = "of dissimilarities learnt from faces, not of MDS"
    return holds_if(condition, evidence) if all(fails) else does_not_hold(evidence)


def net_outputs(model: DeepMDS, frontal: np.ndarray, *, swapped: bool = False) -> np.ndarray:
    """Output of the net for all pairs, or for all the other way round.

    `(n, L, 2)` frontal views → `(n, L (L - 1) / 2)`.
    """
    from deepmds_keras.networks import forward  # Here: who only judges need not load TensorFlow.

    points = np.float32(normalise(frontal))
    pair = np.triu_indices(points.shape[1], 1)
    first, second = pair[::-1] if swapped else pair
    features = proximities(points[:, first], points[:, second], model.variant)
    flat = features.reshape(-1, features.shape[-1])
    return forward(model.dissimilarity_net_, flat).reshape(features.shape[:2])


def doubly_centred(dissimilarities: np.ndarray) -> np.ndarray:
    """`(n, L, L)` → minus half the squares, whose rows and columns sum to 0 (Torgerson 1952)."""
    centring = np.eye(dissimilarities.shape[-1]) - 1 / dissimilarities.shape[-1]
    return -0.5 * centring @ np.square(dissimilarities) @ centring


def eigenvalues(dissimilarities: np.ndarray) -> np.ndarray:
    """Shares in the sum of absolute values: `(n, L, L)` → `(n, L)`, the largest ones first."""
    values = np.linalg.eigvalsh(doubly_centred(dissimilarities))
    order = np.argsort(-np.abs(values), axis=1)
    return np.take_along_axis(values, order, 1) / np.abs(values).sum(1, keepdims=True)


def _from_exact(shapes, mean_shapes):
    exact = pairwise_distances(shapes)
    non_metric = embed(exact)
    unreflected = mse(align(non_metric, shapes, reflection=False), shapes)
    return {
        "classical": _error(classical_scaling(exact), shapes),
        "non_metric": _error(non_metric, shapes),
        "unreflected": float(unreflected.mean()),
        "mirrored": float(is_mirrored(non_metric, shapes).mean()),
        "mean_shape": _error(mean_shapes, shapes),
    }


def _of_learnt(learnt, frontal, shapes):
    learnt = check_dissimilarities(np.abs(learnt))
    matrices = {
        _TRUE: pairwise_distances(shapes),
        _LEARNT: learnt,
        _FRONTAL: pairwise_distances(frontal),
    }
    shares = {name: eigenvalues(own) for name, own in matrices.items()}
    roots = np.sqrt(matrices[_FRONTAL])
    in_a_plane = np.pad(classical_scaling(learnt, 2), ((0, 0), (0, 0), (0, 1)))
    return {
        # Where the sign differs from face to face: the mean size with the sign of most.
        "spectra": {
            name: (np.abs(own).mean(0) * np.where(np.median(own, 0) < 0, -1, 1))[:_SHOWN].tolist()
            for name, own in shares.items()
        },
        "effective_numbers": {
            name: float((1 / np.square(own).sum(1)).mean()) for name, own in shares.items()
        },
        "matrix_ranks": {name: _rank(own) for name, own in matrices.items()},
        "lifted": {
            "two": _error(in_a_plane, shapes),
            "three": _error(classical_scaling(learnt), shapes),
            "roots": _error(classical_scaling(roots), shapes),
            "roots_third": float(eigenvalues(roots)[:, 2].mean()),
        },
    }


def _ranks(shapes, rng):
    clouds = [rng.standard_normal((_CLOUDS, shapes.shape[1], size)) for size in _DIMENSIONS]
    few = rng.standard_normal((_CLOUDS, _FEW_POINTS, _MANY_DIMENSIONS))
    rows, residual = [], 0.0
    for points in (*clouds, shapes):
        matrices, n_dimensions = pairwise_distances(points), points.shape[-1]
        back = align(classical_scaling(matrices, n_dimensions), points)
        residual = max(residual, np.mean((back - points) ** 2) / _variance(points).mean())
        rows.append(
            {
                "dimensions": n_dimensions,
                "centred": _rank(doubly_centred(matrices)),
                "squared": _rank(np.square(matrices)),
                "distances": _rank(matrices),
            }
        )
    return {
        "ranks": rows,
        "residual": float(residual),
        "flat_rank": _rank(doubly_centred(pairwise_distances(shapes * (1, 1, 0)))),
        "few_points_rank": _rank(doubly_centred(pairwise_distances(few))),
    }


def _classes(model, faces, rng):
    clouds = rng.standard_normal((len(faces), faces.shape[1], 3))
    balls = clouds / np.linalg.norm(clouds, axis=-1, keepdims=True)
    classes = {
        "faces": faces,
        "random clouds": clouds,
        # Scaled by its largest coordinate a random direction ends on a side of the cube.
        "cubes": clouds / np.abs(clouds).max(-1, keepdims=True),
        "half spheres": np.concatenate([balls[..., :2], np.abs(balls[..., 2:])], axis=-1),
    }
    return {name: _class_errors(model, normalise(shapes)) for name, shapes in classes.items()}


def _class_errors(model, shapes):
    exact = pairwise_distances(shapes)
    learnt = np.zeros_like(exact)
    first, second = np.triu_indices(shapes.shape[1], 1)
    learnt[:, first, second] = np.abs(net_outputs(model, shapes[..., :2]))
    answers = {
        "classical": classical_scaling(exact),
        "non_metric": embed(exact),
        "learnt": embed(learnt + np.swapaxes(learnt, 1, 2)),
        "flat": shapes * (1, 1, 0),
    }
    return {
        name: float((mse(align(points, shapes), shapes) / _variance(shapes)).mean())
        for name, points in answers.items()
    }


def _error(points, shapes) -> float:
    return float(mse(align(points, shapes), shapes).mean())


def _variance(points):
    return np.mean((points - points.mean(1, keepdims=True)) ** 2, axis=(1, 2))


def _rank(matrices) -> int:
    """That of most matrices `(n, L, L)`."""
    sizes = np.linalg.svd(matrices, compute_uv=False)
    return int(np.median((sizes > _FLOAT64 * sizes[:, :1]).sum(1)))


def _percent(share: float) -> str:
    return f"{scientific(100 * share, 2)} %"
