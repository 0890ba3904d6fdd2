"""The one exception that the project raises for bad files and arguments."""

_LONGEST = 200


class InputError(ValueError):
    """A file or argument is unusable; the message names it, what was found and what is needed."""


def brief(said: object) -> str:
    """Message of a library about a file, on one line that is not too long."""
    line = " ".join(str(said).split())
    return line if len(line) <= _LONGEST else f"{line[:_LONGEST]}…"
