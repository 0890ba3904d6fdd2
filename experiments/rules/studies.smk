"""Studies of the paper's method: seeds, scales, ablation, many faces, speed."""

from experiments.methods import METHODS
from experiments.objects.shapes import OBJECTS, object_file
from experiments.plan import seed_of
from experiments.studies.scale import trainings as scale_trainings
from experiments.studies.stream_part import stream_parts
from experiments.studies.variant import ablation_trainings


rule seed:
    input:
        lambda w: plan.predictions(
            "bfm", [m.id for m in METHODS.values() if m.over_seeds], seed_of(w)
        )
    output: "{work}/records/seed.json"
    params: seed=seed_of
    shell: step("studies.seed", seed="{params.seed}")


rule seeds:
    input: plan.begun, [record("bfm", "seed", seed) for seed in RUN.all_seeds]
    output:
        record("bfm", "seeds"),
        results("seeds", "table.csv", "metrics.csv", "table.tex", "figures/errors_by_seed.png"),
    shell: step("studies.seeds", uses=["seeds"])


# The faces and networks of scale 1 are those of the main table.
rule scale:
    input:
        plan.model, lambda w: [record("bfm", "seed", w.seed)] if float(w.scale) == 1 else [],
    output: f"{work('bfm')}/records/scale-{{scale}}-seed{{seed}}.json"
    wildcard_constraints: scale=r"[\d.]+"
    resources: mem_mb=2500
    shell: step("studies.scale {wildcards.scale} {wildcards.seed}", uses=["data"])


rule scales:
    input:
        plan.begun,
        [record("bfm", f"scale-{scale:g}-seed{seed}") for scale, seed in scale_trainings(RUN)],
    output:
        record("bfm", "scales"),
        results("scales", "table.csv", "metrics.csv", "table.tex", "figures/errors.png"),
    params: published=plan.published
    shell: step("studies.scales", uses=["seeds"])


rule variant:
    input:
        record("bfm", "faces"),
        [record("bfm", f"train-{method}") for method in ("deep_mds", "deep_mds_cosine")],
    output: f"{work('bfm')}/records/variant-{{variant}}-seed{{seed}}.json"
    resources: mem_mb=2000
    shell: step("studies.variant {wildcards.variant} {wildcards.seed}")


rule ablation:
    input:
        plan.begun,
        [record("bfm", f"variant-{name}-seed{seed}") for name, seed in ablation_trainings(RUN)],
    output:
        record("bfm", "ablation"),
        results("ablation", "table.csv", "metrics.csv", "losses.csv", "curves.csv", "table.tex",
                "figures/mini_batches.png", "figures/training_faces.png"),
    shell: step("studies.ablation")


rule stream_part:
    input: plan.model, record("bfm", "train-deep_mds")
    output: f"{work('bfm')}/records/stream-{{part}}.json"
    resources: mem_mb=2000
    shell: step("studies.stream_part {wildcards.part}", uses=["data", "faces"])


rule stream:
    input: plan.begun, [record("bfm", f"stream-{part}") for part in stream_parts(RUN)]
    output: record("bfm", "stream"), results("stream", "table.csv", "table.tex", "figures/errors.png")
    shell: step("studies.stream", uses=["faces"])


rule object:
    input: lambda w: object_file(RUN.objects or "", w.object)
    output: f"{work('bfm')}/records/object-{{object}}-seed{{seed}}.json"
    resources: mem_mb=2500
    shell: step("objects.train {wildcards.object} {wildcards.seed}", uses=["objects"])


rule objects:
    input:
        plan.begun,
        [record("bfm", f"object-{name}-seed{seed}") for name in OBJECTS for seed in RUN.few_seeds],
    output:
        record("bfm", "objects"),
        results(plan.shared("objects"), "table.csv", "metrics.csv", "table.tex", "figures/errors.png"),
    shell: step("objects.table", uses=["objects"])


rule bench:
    input: plan.begun, plan.model, plan.surrey, plan.shipped
    output:
        record("bfm", "bench"),
        results(plan.shared("bench"), "bench.csv", "bench.tex", "figures/bench.png"),
    params: run=[RUN.model, RUN.protocol, RUN.seed]  # which share the folder of results
    threads: workflow.cores
    shell: step("bench.bench", uses=["data", "sfm"])


rule footprint:
    input: plan.begun
    output: record("bfm", "footprint"), results(plan.shared("footprint"), "footprint.csv")
    threads: workflow.cores
    shell: step("bench.footprint")
