"""README and docs are what `make docs` writes from the committed results."""

import pytest
from places import committed

from docs.make_docs import pages

TEXTS = pages(committed())


@pytest.mark.parametrize("page", TEXTS)
def test_make_docs_would_change_nothing(page):
    assert (committed() / page).read_text(encoding="utf-8") == TEXTS[page]
