"""What the tests of face models and data sets share."""

import pytest

from data_gen.models.openhead import load_openhead


@pytest.fixture(scope="session")
def head():
    return load_openhead()


@pytest.fixture(scope="module")
def model(head):
    """The open head; a module of tests may take another model in its place."""
    return head
