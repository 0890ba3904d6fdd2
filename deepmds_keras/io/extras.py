"""Packages that not every installation has: the error that says how to get one."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from deepmds_keras.io.errors import InputError


class MissingPackageError(InputError, ImportError):
    """A package is not installed; the message names the extra that brings it."""


@contextmanager
def needs(package: str, extra: str) -> Iterator[None]:
    """Around imports of what an extra of the installation brings.

    Args:
        package: What to call it.
        extra: Of the installation, as `setup.cfg` names it.

    Raises:
        MissingPackageError: An import failed.
    """
    try:
        yield
    except ImportError as error:
        raise MissingPackageError(
            f"{package} must be installed: pip install 'deepmds-keras[{extra}]'. Received: {error}."
        ) from None
