"""What the tests of the tool share."""

import pytest
from writers.heads import drawn_heads


@pytest.fixture(scope="session")
def heads(apart):
    """Images of five open heads, and their 51 landmarks in pixels."""
    return apart(drawn_heads)
