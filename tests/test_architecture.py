"""The folders show the architecture: imports never point against the flow of the data."""

import ast
from graphlib import TopologicalSorter

import pytest
import runs
from places import ROOT, python

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


@pytest.mark.parametrize("package", MAY_IMPORT)
def test_no_two_modules_or_folders_import_each_other(package):
    modules, folders = {}, {}
    for path in (ROOT / package).rglob("*.py"):
        place = path.relative_to(ROOT).with_suffix("").parts
        imported = [name.split(".") for name in imports(path) if name.startswith(f"{package}.")]
        modules[".".join(place)] = {
            ".".join(name if ROOT.joinpath(*name).with_suffix(".py").exists() else name[:-1])
            for name in imported
        }
        if len(place) > 2:
            folders.setdefault(place[1], set()).update({name[1] for name in imported} - {place[1]})
    for graph in (modules, folders):
        TopologicalSorter(graph).prepare()  # which raises CycleError


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
    assert python("-c", code).returncode == 0
