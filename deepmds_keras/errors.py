"""The exceptions that the project raises for bad files, bad arguments and missing packages."""

import io
import os
import sys
from collections.abc import Collection, Iterator
from contextlib import contextmanager

KERAS_BACKENDS = ("jax", "openvino", "torch")  # packages that Keras loads if it is told to
_LONGEST = 200
_used_in: dict[str, int] = {}  # the process in which each library with threads was used first


class InputError(ValueError):
    """A file or argument is unusable; the message names it, what it is and what is needed."""


class MissingPackageError(InputError, ImportError):
    """A package is not installed; the message names the extra that brings it."""


def brief(message: object, longest: int = _LONGEST) -> str:
    """A library's message, or the content of a file, on one line of limited length."""
    line = " ".join(str(message).split())
    return line if len(line) <= longest else f"{line[:longest]}…"


def escape_unprintable() -> None:
    """Let characters that the terminal's encoding lacks, such as "×", be printed as escapes."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")


def check_fork(library: str) -> None:
    """Refuse a library in a fork of the process that used it: its threads are not in there.

    Raises:
        InputError: This is such a fork, which would wait for them for ever.
    """
    if _used_in.setdefault(library, os.getpid()) != os.getpid():
        raise InputError(
            f"{library} cannot be used in a fork of a process that has used it: "
            "start processes by multiprocessing.get_context('spawn'). Received a fork."
        )


def check_choice(value: object, name: str, choices: Collection[str]) -> None:
    """Raise InputError for a value that is none of the choices; the message calls it `name`."""
    if value not in tuple(choices):  # which need not be hashable
        choices = ", ".join(choices) or "none"
        raise InputError(f"{name} must be one of {choices}. Received {value!r}.")


@contextmanager
def naming(subject: object) -> Iterator[None]:
    """Context that names a file or argument before the message of an InputError."""
    try:
        yield
    except InputError as error:
        raise InputError(f"{subject}: {error}") from None


@contextmanager
def needs(package: str, extra: str) -> Iterator[None]:
    """Context for importing packages that an optional extra of `setup.cfg` installs.

    Raises:
        MissingPackageError: An import failed; the message names the package and the extra.
    """
    try:
        yield
    except MissingPackageError:  # its message already says what is missing
        raise
    except ImportError as error:
        backend = str(error.name).partition(".")[0]
        if backend in KERAS_BACKENDS:
            raise InputError(
                f"KERAS_BACKEND must be tensorflow, or jax if installed. Received {backend}."
            ) from None
        raise MissingPackageError(
            f"{package} must be installed: from the repository, pip install '.[{extra}]'. "
            f"Received: {error}."
        ) from None
