"""Faces, views and images."""

from experiments.records import listing


rule faces:
    input: plan.model
    output: record("bfm", "faces", "{seed}")
    shell: step("datasets.faces", seed="{wildcards.seed}", uses=["data"])


# Of what takes longest, on one core from the beginning; last where there is no other core.
BESIDE_OTHERS = 20 if workflow.cores > 1 else 0


rule images:
    input: plan.model, record("bfm", "faces")
    output: record("bfm", "images")
    threads: workflow.cores
    priority: BESIDE_OTHERS
    shell: step("datasets.images", uses=["data"])


rule frames:
    input: lambda w: plan.to_collect()
    output: record("flame", "frames")
    params: coma=listing(RUN.coma)
    threads: workflow.cores
    shell: step("datasets.frames", "flame", uses=["data"])


rule scans:
    input: plan.model, *filter(None, [RUN.casia_index])
    output: record("flame", "scans")
    params: casia=listing(RUN.casia)
    threads: workflow.cores
    shell: step("datasets.scans", "flame", uses=["data", "casia_index"])


rule rings:
    input: plan.model
    output: record("flame", "rings")
    threads: workflow.cores
    shell: step("datasets.rings", "flame", uses=["data"])


rule photos:
    input: plan.model
    output: record("celeba", "photos")
    params: celeba=listing(RUN.celeba)
    threads: workflow.cores
    shell: step("datasets.photos", "celeba", uses=["data"])
