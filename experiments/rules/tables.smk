"""The paper's tables, from the predictions and times of all methods."""

from experiments.methods import METHODS
from experiments.plan import TABLES, seed_of, track_of


# The table of the methods that see landmarks, without times: printed before what takes longest.
rule preview:
    input:
        lambda w: plan.predictions(track_of(w), plan.compared(track_of(w), images=False), seed_of(w))
    output: "{work}/records/preview.json"
    params: track=track_of, seed=seed_of, methods=lambda w: plan.compared(track_of(w), images=False)
    priority: 30
    shell: step("tracks.preview {params.methods}", "{params.track}", "{params.seed}")


rule bfm:
    input:
        plan.begun, plan.predictions("bfm", plan.compared("bfm")), record("bfm", "times"),
        [record("bfm", "seed", seed) for seed in RUN.all_seeds] if RUN.seeds else [],
    output:
        record("bfm", "bfm"), results("bfm", *TABLES),
        results("parameters", "table.csv", "table.tex"),
    params: methods=plan.compared("bfm"), published=plan.published
    shell: step("tracks.bfm {params.methods}", uses=["seeds", "mobileface"])


rule bfm_evaluator_released:
    input: plan.begun, plan.predictions("bfm", plan.compared("bfm")), record("bfm", "times")
    output: record("bfm", "bfm-evaluator-released"), results("bfm-evaluator-released", *TABLES)
    params: methods=plan.compared("bfm"), published=plan.published
    shell: step("tracks.bfm {params.methods} --evaluator released", uses=["mobileface"])


rule flame:
    input: plan.begun, plan.predictions("flame", plan.compared("flame")), record("flame", "times")
    output:
        record("flame", "flame"), results("flame", *TABLES, track="flame"),
        # Nobody knows the true landmarks of real faces.
        [] if RUN.casia else results("flame-true-landmarks", *TABLES, track="flame"),
    params: methods=plan.compared("flame"), published=plan.published
    shell: step("tracks.flame {params.methods}", "flame", uses=["ringnet"])


rule celeba:
    input:
        plan.begun, plan.model,
        plan.predictions("celeba", plan.compared("celeba")), record("celeba", "times"),
    output:
        record("celeba", "celeba"), results("celeba", *TABLES, track="celeba"),
        [] if RUN.celeba else results("celeba-true-landmarks", *TABLES, track="celeba"),
    params: methods=plan.compared("celeba"), published=plan.published
    shell: step("tracks.celeba {params.methods}", "celeba", uses=["data", "mobileface"])


GALLERY = [method for method in plan.compared("flame") if METHODS[method].gallery]


rule celeba_flame:
    input:
        plan.begun, plan.model, plan.tf_flame, record("flame", "frames"),
        [file for method in GALLERY for file in plan.to_load(method, "flame")],
    output:
        record("flame", "celeba-flame"),
        results("celeba-flame" if RUN.tf_flame else "celeba-flame-substitute",
                "figures/celeba_flame.png", track="flame"),
    params: methods=GALLERY
    threads: workflow.cores
    shell:
        step("tracks.celeba_flame {params.methods}", "flame",
             uses=["data", "tf_flame", "authors", "ringnet"])
