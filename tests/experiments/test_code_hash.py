"""The hash of the code: what it covers, and what it does not see."""

import pytest

from experiments import code_hash


@pytest.fixture
def tree(tmp_path, monkeypatch):
    """A package of three modules, of which one imports the next within a function."""
    files = {
        "__init__": "",
        "first": '"""First."""\n\nimport numpy\n\n\ndef f():\n    from experiments import second\n',
        "second": "from experiments.third import g\n",
        "third": '"""Third."""\n\n\ndef g():\n    """Say it."""\n    return 1  # one\n',
        "other": "x = 1\n",
    }
    (tmp_path / "experiments").mkdir()
    for name, text in files.items():
        (tmp_path / "experiments" / f"{name}.py").write_text(text)
    monkeypatch.setattr(code_hash, "_ROOT", tmp_path)
    return tmp_path / "experiments"


def of_first():
    code_hash._read.cache_clear()
    return code_hash.code_hash(["experiments.first"])


def test_it_changes_with_the_code_of_all_that_is_imported(tree):
    before = of_first()
    assert of_first() == before
    third = tree / "third.py"
    third.write_text(third.read_text().replace("return 1", "return 2"))
    assert of_first() != before


def test_words_layout_and_other_modules_do_not_count(tree):
    before = of_first()
    third = tree / "third.py"
    third.write_text('"""Otherwise."""\n\ndef g():\n\n    return 1\n')
    (tree / "other.py").write_text("x = 2\n")
    assert of_first() == before
