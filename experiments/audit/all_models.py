"""Step: the claims of all face models whose audit is done: `results/audit`."""

from experiments.audit.audit import combine
from experiments.run import Run


def main(run: Run) -> None:
    print(f"Of all face models: {combine(run.shared_results)}/")
