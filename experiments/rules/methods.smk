"""Methods: trained, then asked for the shapes of the test faces, then timed."""

from experiments.methods import METHODS
from experiments.plan import seed_of, track_of, training_threads

FIRST = rf"[^/]+/[^/]+/[^/]+-seed{RUN.seed}(-[^/]+)?"  # the seed of the tables


rule train:
    input: lambda w: plan.to_train(w.method, track_of(w), seed_of(w))
    output: "{work}/records/train-{method}.json"
    params:
        track=track_of, seed=seed_of,
        recipe=lambda w: RUN.mobileface if w.method == "mobileface" else "",
    threads: lambda w: training_threads(w.method, workflow.cores)
    resources: mem_mb=lambda w: METHODS[w.method].memory_mb
    shell: step("tracks.train {wildcards.method}", "{params.track}", "{params.seed}", ["mobileface"])


use rule train as train_of_the_tables with:
    wildcard_constraints: work=FIRST
    priority: 4


use rule train as train_before_another with:
    wildcard_constraints:
        work=FIRST, method="|".join({m.after for m in METHODS.values() if m.after})
    priority: 5


# What takes longest, on one core beside all others.
use rule train as train_beside_others with:
    wildcard_constraints:
        method="|".join(m.id for m in METHODS.values() if m.sees_images and m.threads == 1)
    priority: BESIDE_OTHERS


ruleorder: train_beside_others > train_before_another > train_of_the_tables > train


rule predict:
    input: lambda w: plan.to_predict(w.method, track_of(w), seed_of(w))
    output: "{work}/records/predict-{method}.json"
    params:
        track=track_of, seed=seed_of,
        recipe=lambda w: RUN.mobileface if w.method == "mobileface" else "",
    resources: mem_mb=lambda w: METHODS[w.method].memory_mb
    priority: 3
    shell:
        step("tracks.predict {wildcards.method}", "{params.track}", "{params.seed}",
             ["data", "authors", "ringnet", "mobileface"])


# The authors' files may be of no use, which is to be known before long work.
use rule predict as predict_authors with:
    wildcard_constraints: method=r"\w+_weights"
    priority: 50


ruleorder: predict_authors > predict


# Alone, when nothing else is left but the table.
rule times:
    input: lambda w: plan.to_time(track_of(w), seed_of(w))
    output: "{work}/records/times.json"
    params: track=track_of, seed=seed_of, methods=lambda w: plan.compared(track_of(w))
    threads: workflow.cores
    shell:
        step("tracks.times {params.methods}", "{params.track}", "{params.seed}",
             ["data", "authors", "ringnet", "mobileface"])
