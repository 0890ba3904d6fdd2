"""How a command ends that cannot go on: with one line, not with a traceback."""

from __future__ import annotations

import errno
import sys
from collections.abc import Iterator
from contextlib import contextmanager

from deepmds_keras.io.errors import InputError

_FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
_FORBIDDEN = (errno.EACCES, errno.EROFS, errno.EIO)


@contextmanager
def refusals_on_one_line() -> Iterator[None]:
    """End with one line and status 2 on a file or argument that cannot be used, or a full disk."""
    try:
        yield
    except InputError as error:
        reason = str(error)
    except OSError as error:
        if error.errno not in (*_FULL, *_FORBIDDEN):
            raise
        reason = f"{error.filename or 'A file'}: {error.strerror}."
        if error.errno in _FULL:
            reason += " Free some space and run again; what is complete is kept."
    else:
        return
    print(f"error: {reason}", file=sys.stderr)
    raise SystemExit(2)
