"""Random numbers of a run come from the streams that are declared in one place."""

import ast
import re
from collections import defaultdict

import numpy as np
from places import ROOT

from deepmds_keras.streams import Stream as TrainingStream
from experiments.streams import Stream

EXPERIMENTS = ROOT / "experiments"
MODULES = {
    path.relative_to(EXPERIMENTS).as_posix(): path.read_text(encoding="utf-8")
    for path in EXPERIMENTS.rglob("*.py")
}
# Two modules draw from it, on purpose: they test the same faces.
SHARED = {"RELEASED_WEIGHTS_FACES": {"released_weights/train.py", "released_weights/score.py"}}


def seeds():
    """What generators of a run's seed are made of, as code."""
    for text in MODULES.values():
        yield from re.findall(r"default_rng\([a-z.]*run\.seed\)", text)
        for node in ast.walk(ast.parse(text)):
            sequence = isinstance(node, ast.List | ast.Tuple) and node.elts
            if sequence and ast.unparse(node.elts[0]).endswith("run.seed"):
                yield ast.unparse(node)


def test_every_generator_of_a_runs_seed_names_its_stream():
    expressions = [*seeds()]
    assert len(expressions) > 15
    assert [seed for seed in expressions if "tream" not in seed] == []


def test_no_two_stages_and_no_training_share_random_numbers():
    streams = [*TrainingStream, *Stream]
    first = {np.random.default_rng([0, stream]).integers(1 << 62) for stream in streams}
    assert len({*map(int, streams)}) == len(streams) == len(first)
    assert np.random.default_rng(0).integers(1 << 62) not in first


def test_every_stream_is_drawn_from_in_one_module():
    """A data set drawn from another's stream would be that data set."""
    users = defaultdict(set)
    for module, text in MODULES.items():
        for name in re.findall(r"\bStream\.([A-Z_]+)", text):
            if name in Stream.__members__ and module != "streams.py":
                users[name].add(module)
    assert {*users} == {*Stream.__members__}
    assert {name: modules for name, modules in users.items() if len(modules) > 1} == SHARED
