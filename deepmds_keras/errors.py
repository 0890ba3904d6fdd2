"""The exceptions that the project raises for bad files, bad arguments and missing packages."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from contextlib import contextmanager

_LONGEST = 200


class InputError(ValueError):
    """A file or argument is unusable; the message names it, what it is and what is needed."""


class MissingPackageError(InputError, ImportError):
    """A package is not installed; the message names the extra that brings it."""


def brief(message: object, longest: int = _LONGEST) -> str:
    """Message of a library about a file, or what is in it, on one line that is not too long."""
    line = " ".join(str(message).split())
    return line if len(line) <= longest else f"{line[:longest]}…"


def check_choice(value: object, name: str, choices: Collection[str]) -> None:
    """Raise InputError, which calls it `name`, for a value that is none of the choices."""
    if value not in choices:
        choices = ", ".join(choices) or "none"
        raise InputError(f"{name} must be one of {choices}. Received {value!r}.")


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
    except MissingPackageError:  # says what is missing itself
        raise
    except ImportError as error:
        raise MissingPackageError(
            f"{package} must be installed: from the repository, pip install '.[{extra}]'. "
            f"Received: {error}."
        ) from None
