"""The function that checks each claim."""

from __future__ import annotations

from collections.abc import Callable
from types import ModuleType

from experiments.audit import (
    bias,
    complexity,
    criteria,
    data_sets,
    dissimilarity,
    lifted_distances,
    mini_batches,
    noise,
    not_testable,
    occlusion,
    parameter_counts,
    perspective,
    posed_photos,
    poses,
    ranking,
    significance,
    zhao,
)
from experiments.audit.findings import Finding

_TOPICS = (
    dissimilarity, parameter_counts, complexity, poses, perspective, occlusion, mini_batches,
    criteria, significance, ranking, zhao, bias, posed_photos, data_sets, not_testable, noise,
    lifted_distances,
)  # fmt: skip
# By name: modules whose `measure` gives their checks the inputs.
TOPICS: dict[str, ModuleType] = {module.__name__.rpartition(".")[2]: module for module in _TOPICS}
# What is measured anew each time: it takes seconds, or is of results that may have changed.
NOT_KEPT = (
    "parameter_counts", "mini_batches", "ranking", "zhao", "posed_photos", "data_sets",
    "not_testable",
)  # fmt: skip

# By the ids of `results/published/claims.csv`.
CHECKS: dict[str, Callable[..., Finding]] = {
    "symmetric": dissimilarity.symmetric,
    "exact-distances": dissimilarity.exact_distances,
    "rank-above-two": dissimilarity.rank_above_two,
    "distance-rank": dissimilarity.distance_rank,
    "shape-classes": dissimilarity.shape_classes,
    "parameters-dissimilarity": parameter_counts.below_bound,
    "parameters-ours": parameter_counts.ours,
    "parameters-zhao": parameter_counts.zhao,
    "parameters-mobileface": parameter_counts.mobileface,
    "parameters-ringnet": parameter_counts.ringnet,
    "parameters-fewest": parameter_counts.fewest,
    "inference-time": parameter_counts.inference_time,
    "cubic-time": complexity.cubic_time,
    "many-landmarks": complexity.many_landmarks,
    "complexity-others": complexity.others_as_printed,
    "aldrian-slower": parameter_counts.aldrian_slower,
    "frontal-view": poses.frontal_view,
    "autoencoder-needed": poses.autoencoder_needed,
    "projection-independent": poses.projection_independent,
    "perspective-views": perspective.perspective_views,
    "occlusion": occlusion.occlusion,
    "mini-batches": mini_batches.same_face_batches,
    "short-connection": mini_batches.short_connection,
    "five-layers": mini_batches.five_layers,
    "mse-formula": criteria.mse_formula,
    "depth-corr-meaning": criteria.depth_corr_meaning,
    "depth-corr-percent": criteria.depth_corr_percent,
    "casia-depth-corr": criteria.casia_depth_corr,
    "p-value": significance.p_value,
    "p-value-casia": significance.p_value_of_casia,
    "significance": significance.samplings,
    "bfm-mse": ranking.as_printed,
    "training-luck": mini_batches.known_to,
    "trivial-case": ranking.beats_constant,
    "bfm-rank": ranking.second,
    "zhao-score": zhao.bfm_score,
    "zhao-orthographic": zhao.orthographic_only,
    "unbiased": bias.unbiased,
    "model-based-bias": bias.model_based_bias,
    "celeba-aldrian": ranking.celeba_beats_aldrian,
    "celeba-mobileface": ranking.celeba_like_mobileface,
    "celeba-zhao": zhao.celeba_score,
    "casia-comparable": ranking.casia_like_others,
    "pose-51": posed_photos.pose_invariant_51,
    "mediapipe-poses": posed_photos.mediapipe_poses,
    "bfm-triangles": not_testable.triangles,
    "coma-vertices": data_sets.coma_vertices,
    "test-set-size": data_sets.size_of_test_sets,
    "first-use": not_testable.first_use,
    "landmark-noise": noise.withstands,
    "missing-landmarks": occlusion.missing_landmarks,
    "training-faces": mini_batches.enough_faces,
    "lifted-distances": lifted_distances.nothing_added,
    "lifting-poses": poses.lifting_independent,
    "lifting-unbiased": bias.lifting_unbiased,
}


def topic_of(check: Callable[..., Finding]) -> str:
    """Topic among `TOPICS` that gives a check its inputs."""
    return check.__module__.rpartition(".")[2]
