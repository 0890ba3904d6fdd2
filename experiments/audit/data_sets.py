"""Claims on the data sets, which the paper's own numbers or those of the files decide."""

from __future__ import annotations

from deepmds_keras.baselines.ringnet_released import N_VERTICES
from experiments.audit.evidence import Inputs
from experiments.audit.findings import Finding, does_not_hold, holds, unknown


def measure(inputs: Inputs) -> dict:
    """What is known without the data sets."""
    return {"flame_vertices": N_VERTICES}


def size_of_test_sets(at_least: float, casia: float) -> Finding:
    """Is every test set as large as the paper says of all?"""
    evidence = (
        f"Samplings are said to be of at least {at_least:,.0f} faces, but of CASIA-3D the paper "
        f"takes {casia:,.0f} scans. A scan in whose photo no face is found gives no test face."
    )
    return holds(evidence) if casia >= at_least else does_not_hold(evidence)


def coma_vertices(flame_vertices: int, n_vertices: float) -> Finding:
    """Have the meshes of CoMA the printed number of vertices?"""
    return unknown(
        "the raw scans of CoMA",
        f"The registered meshes, of which the landmarks are taken, have the {flame_vertices:,} "
        f"vertices of FLAME, not {n_vertices:,.0f}.",
    )
