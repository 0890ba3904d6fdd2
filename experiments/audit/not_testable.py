"""Claims that these faces cannot decide: on the Basel model's mesh, and on the literature."""

from __future__ import annotations

from experiments.audit.evidence import Inputs
from experiments.audit.findings import Finding, does_not_hold, holds, unknown


def measure(inputs: Inputs) -> dict:
    """Sizes of the face model's mesh."""
    return {
        "face_model": inputs.run.model,
        "mesh_vertices": inputs.model.n_vertices,
        "mesh_triangles": len(inputs.model.triangles),
    }


def triangles(
    face_model: str, mesh_vertices: int, mesh_triangles: int, n_vertices: float, n_triangles: float
) -> Finding:
    """Has the Basel model the printed numbers of vertices and triangles?"""
    ratio = n_triangles / n_vertices
    printed = f"{n_triangles:,.0f} is {ratio:.6g} times the {n_vertices:,.0f} vertices"
    if ratio == 3:
        printed += ", which is the number of their coordinates"
    if face_model != "bfm2009":
        return unknown("the Basel Face Model 2009 (`MODEL=bfm2009 DATA=…`)", f"{printed}.")
    evidence = (
        f"The file has {mesh_vertices:,} vertices and {mesh_triangles:,} triangles. {printed}."
    )
    same = (mesh_vertices, mesh_triangles) == (n_vertices, n_triangles)
    return holds(evidence) if same else does_not_hold(evidence)


def first_use() -> Finding:
    """Nothing that can be computed."""
    return unknown("a search of the literature, which is no computation")
