"""The one exception that the project raises for bad files and arguments."""

_LONGEST = 200


class InputError(ValueError):
    """A file or argument is unusable; the message names it, what was found and what is needed."""


def brief(said: object) -> str:
    """What a library says about a file, or a part of a file, on one line that is not too long."""
    line = " ".join(str(said).split())
    return line if len(line) <= _LONGEST else f"{line[:_LONGEST]}…"
