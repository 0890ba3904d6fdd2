"""What the tests of face models and data sets share."""

import pytest
from places import SHARED

from data_gen.models.ict import load_ict
from data_gen.models.openhead import load_openhead


@pytest.fixture(scope="session")
def head():
    return load_openhead()


@pytest.fixture(scope="session")
def ict():
    path = SHARED / "ict-facekit" / "ict_light.npz"
    if not path.is_file():
        pytest.skip("../shared/ict-facekit is absent")
    return load_ict(path)


@pytest.fixture(scope="module")
def model(head):
    """The open head; a module of tests may take another model in its place."""
    return head
