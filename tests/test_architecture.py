"""The folders show the architecture: imports never point against the flow of the data."""

import ast
import subprocess
import sys

import pytest
import runs
from places import ROOT

MAY_IMPORT = {
    "data_gen": (
        "data_gen",
        "deepmds_keras.errors",
        "deepmds_keras.files",
        "deepmds_keras.geometry",
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
        internal = [name for name in imports(path) if name.split(".")[0] in (*MAY_IMPORT, "tests")]
        beyond = [
            name
            for name in internal
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


@pytest.mark.parametrize("package", ["data_gen", "deepmds_keras", "experiments"])
def test_folders_import_only_what_lies_before_them(package):
    graph = {path.parent.name: set() for path in (ROOT / package).glob("*/*.py")}
    for folder, below in graph.items():
        for path in (ROOT / package / folder).rglob("*.py"):
            below |= {n.split(".")[1] for n in imports(path) if n.startswith(f"{package}.")}
        below &= graph.keys() - {folder}
    done = set()
    while ready := [f for f in graph if f not in done and graph[f] <= done]:
        done |= {*ready}
    assert done == graph.keys(), f"these import each other: {graph.keys() - done}"


@pytest.mark.parametrize("package", MAY_IMPORT)
def test_a_folder_is_read_at_a_glance(package):
    folders = {path.parent for path in (ROOT / package).rglob("*.py")}
    sizes = {str(folder): len([*folder.glob("[!_]*.py")]) for folder in folders}
    assert max(sizes.values()) <= 12, sizes


def test_only_embedding_imports_mds():
    paths = (ROOT / "deepmds_keras").rglob("*.py")
    users = [p.name for p in paths if any(n.startswith("sklearn.manifold") for n in imports(p))]
    assert users == ["embedding.py"]


@pytest.mark.parametrize(
    ("code", "absent"),
    [
        ("from deepmds_keras import embed", {"tensorflow"}),
        ("import deepmds_keras.baselines.closed_form", {"tensorflow"}),
        ("import experiments.methods", {"tensorflow", "keras", "sklearn", "pandas"}),
        # Mesa's and TensorFlow's copies of LLVM do not live in one process.
        (f"import {', '.join(f'experiments.{name}' for name in runs.RENDERING)}", {"tensorflow"}),
    ],
    ids=("embedding", "closed form", "methods", "rendering"),
)
def test_what_needs_no_framework_loads_none(code, absent):
    code += f"; import sys; sys.exit(bool({absent} & sys.modules.keys()))"
    assert subprocess.run([sys.executable, "-c", code], cwd=ROOT).returncode == 0
