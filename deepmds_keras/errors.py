"""The one exception that this package raises for bad files and arguments."""


class InputError(ValueError):
    """A file or argument is unusable; the message names it, what was found and what is needed."""
