"""Random numbers of a run come from the streams that are declared in one place."""

import ast
import re

import numpy as np
from places import ROOT

from deepmds_keras.streams import Stream as TrainingStream
from experiments.streams import Stream

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
    expressions = [*seeds()]
    assert len(expressions) > 15
    assert [seed for seed in expressions if "tream" not in seed] == []


def test_no_two_stages_and_no_training_share_random_numbers():
    streams = [*TrainingStream, *Stream]
    first = {np.random.default_rng([0, stream]).integers(1 << 62) for stream in streams}
    assert len({*map(int, streams)}) == len(streams) == len(first)
    assert np.random.default_rng(0).integers(1 << 62) not in first
