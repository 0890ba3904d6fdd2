"""The folders show the architecture: imports never point against the flow of the data."""

import ast
import subprocess
import sys

import pytest
from places import ROOT

MAY_IMPORT = {
    "data_gen": (
        "data_gen",
        "deepmds_keras.io",
        "deepmds_keras.alignment",
        "deepmds_keras.camera",
    ),
    "deepmds_keras": ("deepmds_keras",),
    "experiments": ("experiments", "deepmds_keras", "data_gen"),
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
        own = [name for name in imports(path) if name.split(".")[0] in (*MAY_IMPORT, "tests")]
        beyond = [
            name
            for name in own
            if not any(f"{name}.".startswith(f"{known}.") for known in MAY_IMPORT[package])
        ]
        assert not beyond, path


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


@pytest.mark.parametrize("package", ["data_gen", "experiments"])
def test_folders_import_only_what_lies_before_them(package):
    graph = {path.parent.name: set() for path in (ROOT / package).glob("*/__init__.py")}
    for folder, below in graph.items():
        for path in (ROOT / package / folder).rglob("*.py"):
            below |= {n.split(".")[1] for n in imports(path) if n.startswith(f"{package}.")}
        below &= graph.keys() - {folder}
    done = set()
    while ready := [f for f in graph if f not in done and graph[f] <= done]:
        done |= {*ready}
    assert done == graph.keys(), f"these import each other: {graph.keys() - done}"


def test_no_two_modules_of_experiments_share_a_name_and_none_looks_like_a_test():
    paths = [p for p in (ROOT / "experiments").rglob("*.py") if not p.stem.startswith("__")]
    names = [path.stem for path in paths]
    assert sorted({*names}) == sorted(names)
    assert not [name for name in names if name.startswith("test_") or name.endswith("_test")]


def test_only_embedding_imports_mds():
    for path in (ROOT / "deepmds_keras").rglob("*.py"):
        if "sklearn.manifold.MDS" in imports(path):
            assert path.name == "embedding.py"


def test_embedding_alone_does_not_load_tensorflow():
    code = "import sys, deepmds_keras; deepmds_keras.embed; sys.exit('tensorflow' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], cwd=ROOT).returncode == 0


def test_modules_with_tasks_do_not_load_tensorflow():
    """A worker of a cluster reads them before it is told how TensorFlow is to run."""
    modules = (ROOT / "experiments").rglob("*.py")
    paths = [path for path in modules if "experiments.tasks.unordered" in imports(path)]
    names = [".".join(path.relative_to(ROOT).with_suffix("").parts) for path in paths]
    assert len(names) > 4
    code = f"import sys, {', '.join(names)}; sys.exit('tensorflow' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], cwd=ROOT).returncode == 0
