"""Hash of the code that makes results: of modules and all of ours that they import."""

from __future__ import annotations

import ast
import functools
import hashlib
import io
import tokenize
from collections.abc import Iterable, Iterator
from pathlib import Path

_ROOT = Path(__file__).parents[1]
_PACKAGES = ("data_gen", "deepmds_keras", "experiments")


def code_hash(modules: Iterable[str]) -> str:
    """sha256 of modules, and of all modules of this repository that they import, at any time.

    Comments, docstrings and empty lines do not count.

    Args:
        modules: Names, such as `"experiments.tracks.bfm.bfm"`.
    """
    found: set[str] = set()
    left = [*modules]
    while left:
        name = left.pop()
        if name not in found:
            found.add(name)
            left += _read(_file_of(name))[1]
    digest = hashlib.sha256()
    for name in sorted(found):
        digest.update(f"{name}\n{_read(_file_of(name))[0]}\n".encode())
    return digest.hexdigest()


def _file_of(module: str) -> Path | None:
    """None of what is no module of this repository."""
    path = _ROOT.joinpath(*module.split("."))
    files = (path.with_suffix(".py"), path / "__init__.py")
    return next((file for file in files if file.is_file()), None)


@functools.cache
def _read(path: Path) -> tuple[str, tuple[str, ...]]:
    """The lines of a file that count, and the modules that it imports."""
    text = path.read_text(encoding="utf-8")
    tree, lines = ast.parse(text), text.splitlines()
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        if token.type == tokenize.COMMENT:
            row, column = token.start
            lines[row - 1] = lines[row - 1][:column]
    for node in ast.walk(tree):
        if isinstance(node, (ast.Module, ast.ClassDef, ast.FunctionDef)) and ast.get_docstring(
            node
        ):
            said = node.body[0]
            lines[said.lineno - 1 : said.end_lineno] = [""] * (said.end_lineno - said.lineno + 1)
    names = dict.fromkeys(name for name in _imported(tree) if _file_of(name))
    return "\n".join(line.rstrip() for line in lines if line.strip()), tuple(names)


def _imported(tree: ast.Module) -> Iterator[str]:
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and not node.level and node.module:
            names = [node.module, *(f"{node.module}.{alias.name}" for alias in node.names)]
        else:
            continue
        yield from (name for name in names if name.split(".")[0] in _PACKAGES)
