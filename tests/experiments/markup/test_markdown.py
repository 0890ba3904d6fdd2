"""Texts show as they are in Markdown, also in the cells of a table."""

import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st
from markdown_it import MarkdownIt

from experiments.markup.markdown import Notes, Table, markdown, row

PARSER = MarkdownIt("commonmark", {"html": True}).enable("table")
CHARACTERS = st.text(r"\`*_{}<>|#~&;[]a1 ", min_size=1, max_size=12)


def shown(cell):
    """What a reader sees in the second cell of a row."""
    tokens = PARSER.parse(f"| a | b |\n| :-- | --: |\n{row(['x', cell])}\n")
    children = [token for token in tokens if token.type == "inline"][3].children
    return "".join(child.content for child in children)


@given(CHARACTERS.map(str.strip).filter(lambda t: "**" not in t and t.count("`") < 2))
def test_a_text_without_marks_shows_as_it_is(text):
    assert shown(text) == text


@pytest.mark.parametrize(
    ("text", "seen"),
    [("`a | b`", "a | b"), ("&lt;b&gt; & c", "&lt;b&gt; & c"), ("2<sup>1, 2</sup>", None)],
)
def test_marks_are_kept_and_bars_in_code_end_no_cell(text, seen):
    assert shown(text) == (seen or text)


def test_a_note_of_several_cells_is_written_once():
    notes = Notes()
    assert notes.mark(["b", "a"]) == "<sup>1, 2</sup>"
    assert notes.mark(["a"]) == "<sup>2</sup>"
    assert notes.mark([]) == ""
    assert notes == ["b", "a"]


def test_a_page_has_one_blank_line_between_blocks():
    rows = pd.DataFrame({"Claim": ["x"], "Where": ["y"]})
    of = {"verdicts": Table("All.", rows, ("Where",), ("n",)), "counts": ["1 holds."]}
    text = markdown("markup/claims_page.md.j2", of={**of, "evidence": [("**x**", ["7"])]})
    assert "\n\nAll.\n\n| Claim | Where |\n| :-- | :-- |\n| x | y |\n\n1. n\n\n" in text
    assert "\n\n\n" not in text
    assert text.endswith("</details>\n")
