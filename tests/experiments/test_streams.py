"""Random numbers of a run come from the streams that are declared in one place."""

import ast
import re

from places import ROOT

EXPERIMENTS = ROOT / "experiments"


def seeds():
    """What generators of a run's seed are made of, as code."""
    for path in EXPERIMENTS.rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            code = ast.unparse(node)
            sequence = isinstance(node, ast.List | ast.Tuple) and node.elts
            if sequence and ast.unparse(node.elts[0]).endswith("run.seed"):
                yield code
            if re.fullmatch(r".*default_rng\([a-z.]*run\.seed\)", code):
                yield code


def test_every_generator_of_a_runs_seed_names_its_stream():
    found = [*seeds()]
    assert len(found) > 15
    assert [seed for seed in found if "tream" not in seed] == []
