"""The authors' weights, the claims of the paper, and everything on a page."""

from pathlib import Path

from data_gen.models.registry import OPEN
from experiments.audit.measure import TOPICS
from experiments.released_weights.bfm_mean import FILES, mean_file
from experiments.released_weights.train import trainings


MEAN = [record("bfm", "bfm_mean"), str(mean_file(plan.at("bfm")))]


rule bfm_mean:
    # A file that is missing is the step's to name.
    input: filter(Path.is_file, (Path(RUN.authors or "", name) for name in FILES))
    output: MEAN
    shell: step("released_weights.bfm_mean", uses=["authors"])


rule released_weights_training:
    input: plan.model, MEAN
    output: f"{work('bfm')}/records/released_weights-{{training}}.json"
    resources: mem_mb=2500
    shell: step("released_weights.train {wildcards.training}", uses=["data"])


IS_OPEN = RUN.model in OPEN


rule released_weights:
    input:
        plan.begun, plan.open if IS_OPEN else plan.model, plan.authors_files("bfm"),
        [*MEAN, *(record("bfm", f"released_weights-{name}") for name in trainings(RUN))]
        if IS_OPEN else [],
    output:
        record("bfm", "released_weights"),
        results(plan.shared("released-weights"), "released.csv", "trained.csv", "table.tex")
        if IS_OPEN else results("released-weights", "released.csv", "table.tex"),
    params: published=plan.published
    threads: workflow.cores
    shell: step("released_weights.score", uses=["data", "authors"])


rule measured:
    input: plan.predictions("bfm", plan.compared("bfm")), plan.authors_files("bfm")
    output: f"{work('bfm')}/records/audit-{{topic}}.json"
    params: methods=plan.compared("bfm")
    shell: step("audit.measure {wildcards.topic} {params.methods}", uses=["authors"])


SMALL = bool(RUN.preset.caution)  # such runs give no verdicts
AUDIT = ("curves", "bias", "constants", "depth", "perspective", "ranks", "samplings", "numbers")


rule audited:
    input:
        plan.begun, rules.bfm.output, rules.ablation.output,
        [record("bfm", f"audit-{topic}") for topic in TOPICS],
    output:
        record("bfm", "audit"),
        results("audit", *[f"{name}.csv" for name in (*AUDIT, *([] if SMALL else ["claims"]))]),
    params:
        topics=[*TOPICS], published=plan.published,
        others=plan.other_results("audit", "bfm", "parameters", "ablation"),
    shell: step("audit.audit {params.topics}", uses=["coma", "casia", "celeba"])


rule all_claims:
    input: plan.begun, rules.audited.output
    output: record("bfm", "claims"), f"{plan.shared('audit')}/claims.csv"
    params: published=plan.published
    shell: step("audit.all_models")


rule report:
    input: plan.begun
    output: record("bfm", "report"), f"{RUN.model_results}/report/report.md"
    params: results=plan.other_results()
    shell: step("report.report")
