"""The one exception that the project raises for bad files and arguments."""

_LONGEST = 200


class InputError(ValueError):
    """A file or argument is unusable; the message names it, what was found and what is needed."""


def brief(said: object, longest: int = _LONGEST) -> str:
    """Message of a library about a file, or what is in it, on one line that is not too long."""
    line = " ".join(str(said).split())
    return line if len(line) <= longest else f"{line[:longest]}…"
