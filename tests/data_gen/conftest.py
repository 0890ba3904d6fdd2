"""What the tests of face models and data sets share."""

import pytest


@pytest.fixture(scope="module")
def model(head):
    """The open head; a module of tests may take another model in its place."""
    return head
