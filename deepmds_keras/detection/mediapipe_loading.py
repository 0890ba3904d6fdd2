"""How MediaPipe is loaded: no more of it than is used, and without its chatter."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stderr
from importlib.util import find_spec, module_from_spec
from threading import RLock

_LOCK = RLock()  # of two threads the second would take the silence for stderr, and keep it


@contextmanager
def bare_package() -> Iterator[None]:
    """Lets parts of MediaPipe be imported without all of it.

    All of it is what the file of the package itself imports: OpenCV, matplotlib, and where they are
    installed TensorFlow and JAX, of which FaceMesh needs nothing (0.2 s instead of 5 to 20 s, and
    no libGL). Whoever imports MediaPipe later gets all of it, and the same compiled library.
    """
    if "mediapipe" in sys.modules:
        yield
        return
    sys.modules["mediapipe"] = module_from_spec(find_spec("mediapipe"))
    try:
        yield
    finally:
        for name in [name for name in sys.modules if name.partition(".")[0] == "mediapipe"]:
            if not name.startswith("mediapipe.python._framework_bindings"):
                del sys.modules[name]


@contextmanager
def without_tensorflow() -> Iterator[None]:
    """MediaPipe imports TensorFlow where it is installed, for its own documentation only."""
    loaded = "tensorflow" in sys.modules
    if not loaded:
        sys.modules["tensorflow"] = None
    try:
        yield
    finally:
        if not loaded:
            del sys.modules["tensorflow"]


@contextmanager
def silenced() -> Iterator[None]:
    """Nothing comes on stderr, where MediaPipe's library logs whatever it is told; by turns."""
    with _LOCK, open(os.devnull, "w") as nowhere, redirect_stderr(nowhere):
        kept = os.dup(2)
        os.dup2(nowhere.fileno(), 2)
        try:
            yield
        finally:
            os.dup2(kept, 2)
            os.close(kept)
