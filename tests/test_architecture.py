"""The folders show the architecture: imports never point against the flow of the data."""

import ast
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
MAY_IMPORT = {
    "data_gen": {"data_gen"},
    "deepmds_keras": {"deepmds_keras"},
    "experiments": {"experiments", "deepmds_keras", "data_gen"},
}


def imports(path):
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            yield from (f"{node.module}.{alias.name}" for alias in node.names)


@pytest.mark.parametrize("package", MAY_IMPORT)
def test_packages_import_only_what_lies_before_them(package):
    for path in (ROOT / package).rglob("*.py"):
        own = {name.split(".")[0] for name in imports(path)} & {*MAY_IMPORT, "tests"}
        assert own <= MAY_IMPORT[package], path


@pytest.mark.parametrize("package", ["data_gen", "deepmds_keras", "experiments"])
def test_modules_import_only_what_lies_before_them(package):
    graph = {}
    for path in (ROOT / package).rglob("*.py"):
        module = ".".join(path.relative_to(ROOT).with_suffix("").parts)
        graph[module] = {
            name.rsplit(".", 1)[0] if not (ROOT / f"{name.replace('.', '/')}.py").exists() else name
            for name in imports(path)
            if name.startswith(f"{package}.")
        }
    done = set()
    while ready := [m for m in graph if m not in done and not (graph[m] & graph.keys()) - done]:
        done |= {*ready}
    assert done == graph.keys(), f"these import each other: {graph.keys() - done}"


def test_only_embedding_imports_mds():
    for path in (ROOT / "deepmds_keras").rglob("*.py"):
        if "sklearn.manifold.MDS" in imports(path):
            assert path.name == "embedding.py"


def test_embedding_alone_does_not_load_tensorflow():
    code = "import sys, deepmds_keras; deepmds_keras.embed; sys.exit('tensorflow' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], cwd=ROOT).returncode == 0
