"""The weights that ship with the package, on rendered photos and on real ones."""

from deepmds_keras.landmarks import DETECTOR_ERRORS
from experiments.pretrained.train import NETWORKS


rule portraits:
    input: plan.open
    output: record("bfm", "portraits")
    threads: workflow.cores
    shell: step("pretrained.portraits", uses=["data"])


rule photo_network:
    input: lambda w: plan.open if w.network.startswith("lifting") else plan.openhead
    output: f"{work('bfm')}/records/pretrained-{{network}}.json"
    resources: mem_mb=2500
    shell: step("pretrained.train {wildcards.network}", uses=["data"])


# It also replaces the weights of the package, at full size and if both open models are there.
rule pretrained:
    input:
        plan.begun, plan.open, plan.surrey, DETECTOR_ERRORS, record("bfm", "portraits"),
        [record("bfm", f"pretrained-{network}") for network in NETWORKS],
    output:
        record("bfm", "pretrained"),
        results("pretrained", "table.csv", "detection.csv", "table.tex"),
    threads: workflow.cores
    shell: step("pretrained.pretrained", uses=["data", "sfm"])


# It also replaces the table of detectors of the package, at full size.
rule real_faces:
    input: plan.begun, plan.open, plan.shipped, RUN.real or [], record("bfm", "portraits")
    output:
        record("bfm", "real"),
        results("real", "table.csv", "misfit.csv", "residuals.csv", "table.tex"),
    threads: workflow.cores
    shell: step("pretrained.real_faces", uses=["data", "real"])


# It also replaces the head of `deepmds predict --mesh`.
rule surface:
    input: plan.begun, plan.open, plan.shipped
    output: record("bfm", "surface"), results("surface", "table.csv", "table.tex")
    threads: workflow.cores
    shell: step("pretrained.surface", uses=["data"])
