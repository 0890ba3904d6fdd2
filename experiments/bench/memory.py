"""Memory that a call needs on top of what is there before it."""

from __future__ import annotations

import ctypes
import math
from collections.abc import Callable
from pathlib import Path

_PROCESS = Path("/proc/self")
_RESET_PEAK = "5"  # of the peak of the resident set, see proc_pid_clear_refs(5)
NO_GAUGE = "peak memory cannot be read on this system"


def peak_memory_mb(call: Callable[[], object]) -> float:
    """Call a function and find the most memory that this process held meanwhile.

    The peak is the system's own, so that what a library allocates counts, too. Memory that was
    freed before but not handed back is handed back first: else the call would find it.

    Returns:
        Megabytes more than before the call; NaN where the system does not tell (other than Linux).
    """
    _hand_back()
    try:
        (_PROCESS / "clear_refs").write_text(_RESET_PEAK)
        before = _megabytes("VmRSS")
    except OSError:
        call()
        return math.nan
    call()
    return max(0.0, _megabytes("VmHWM") - before)


def _hand_back() -> None:
    trim = getattr(ctypes.CDLL(None), "malloc_trim", None)  # of the GNU C library
    if trim is not None:
        trim(0)


def _megabytes(name: str) -> float:
    lines = (_PROCESS / "status").read_text().splitlines()
    (kibibytes,) = (line.split()[1] for line in lines if line.startswith(f"{name}:"))
    return int(kibibytes) * 1024 / 1e6
