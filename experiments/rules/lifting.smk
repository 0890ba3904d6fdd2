"""The lifting network against other methods and the lower bound."""

from experiments.lifting.train import BOTH, lifting_networks
from experiments.lifting.variants import SIDE_AUTOENCODER, component_trainings


rule lifting_network:
    input: lambda w: plan.open if w.network.endswith(BOTH) else plan.model
    output: f"{work('bfm')}/records/lifting-{{network}}.json"
    resources: mem_mb=2500
    shell: step("lifting.train {wildcards.network}", uses=["data"])


rule component_network:
    input:
        [record("bfm", f"train-{method}") for method in ("deep_mds", "deep_mds_cosine")],
        lambda w: [record("bfm", f"component_ablation-{SIDE_AUTOENCODER}-seed{RUN.seed}")]
        if w.training.startswith("side-") else [],
    output: f"{work('bfm')}/records/component_ablation-{{training}}.json"
    resources: mem_mb=2500
    shell: step("lifting.train_pairs {wildcards.training}")


rule hard_views:
    input:
        plan.begun, plan.model,
        [record("bfm", f"lifting-{network}") for network in lifting_networks(RUN, "hard")],
    output:
        record("bfm", "hard"),
        results("lifting/hard", "table.csv", "by_yaw.csv", "table.tex", "figures/errors_by_yaw.png"),
    threads: workflow.cores
    shell: step("lifting.hard", uses=["data"])


rule component_ablation:
    input:
        plan.begun, plan.model,
        [record("bfm", f"component_ablation-{name}") for name in component_trainings(RUN)],
    output:
        record("bfm", "component_ablation"),
        results("lifting/component-ablation", "table.csv", "seeds.csv", "table.tex",
                "figures/component_ablation.png"),
    threads: workflow.cores
    shell: step("lifting.component_ablation", uses=["data"])


rule transfer:
    input:
        plan.begun, plan.model, plan.open, plan.surrey,
        [record("bfm", f"lifting-{network}") for network in lifting_networks(RUN, "transfer")],
    output:
        record("bfm", "transfer"),
        results("lifting/transfer", "table.csv", "table.tex", "figures/transfer.png"),
    threads: workflow.cores
    shell: step("lifting.transfer", uses=["data", "sfm"])
