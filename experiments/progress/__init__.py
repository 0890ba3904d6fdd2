"""Progress within a step: a bar on a terminal; under `make` and in a log, lines."""

import os
import sys
import threading
import time
from collections.abc import Iterable, Iterator
from contextlib import AbstractContextManager

from tqdm import tqdm

# Variable with the number and the machine of `make`, whose steps print side by side.
PARENT = "EXPERIMENTS_PARENT"
_EVERY = 30.0  # seconds between two lines
# tqdm's lock is a semaphore, of which Python complains where a process with a bar is killed.
tqdm.set_lock(threading.RLock())


class Progress(AbstractContextManager):
    """How much of a step, or of a part of it, is done, and how long the rest will take.

    Args:
        what: What is counted, such as `"epoch"`, or `"autoencoder: epoch"` if a step has parts.
        total: How many there are.
        done: How many an earlier run has done, which say nothing about the time.

    Attributes:
        step: What the step does, at the beginning of each line.
    """

    step = ""

    def __init__(self, what: str, total: int, done: int = 0):
        self._what, self._total, self._done, self._first = what, total, done, done
        self._created = self._start = self._said = time.monotonic()
        # What a file already holds is read in less than the delay and needs no bar.
        self._bar = tqdm(
            total=total, initial=done, desc=self._named(what), delay=2,
            disable=not sys.stderr.isatty() or PARENT in os.environ,
        )  # fmt: skip

    def __exit__(self, *_) -> None:
        self.close()

    def close(self) -> None:
        """End the bar."""
        self._bar.close()

    def update(self, n: int = 1, note: str = "") -> None:
        """Count `n` more; the bar shows the note, too."""
        self._done += n
        if not self._bar.disable:
            self._bar.set_postfix_str(note, refresh=False)
            self._bar.update(n)
            return
        now = time.monotonic()
        if now - self._created < 1:  # read from files of an earlier run
            self._start, self._first = now, self._done
        if now - self._said < _EVERY or self._done >= self._total:
            return
        self._said = now
        left = (now - self._start) * (self._total - self._done) / (self._done - self._first)
        text = self._named(f"{self._what} {self._done:,} of {self._total:,}")
        print(f"{text}, about {roughly(left)} left", flush=True)

    def _named(self, text: str) -> str:
        return f"{self.step}: {text}" if self.step else text


def counted(what: str, items: Iterable, total: int) -> Iterator:
    """Yield items, and show how many of them have been."""
    with Progress(what, total) as progress:
        for item in items:
            yield item
            progress.update()


def duration(seconds: float) -> str:
    """Text of a duration, in its two largest units."""
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    if hours:
        return f"{hours} h {minutes} min"
    if minutes:
        return f"{minutes} min {rest} s"
    return f"{seconds:.3g} s"


def roughly(seconds: float) -> str:
    """Text of an estimated duration, in tens of seconds or in minutes."""
    if seconds < 90:
        return f"{max(10, round(seconds, -1)):.0f} s"
    hours, minutes = divmod(round(seconds / 60), 60)
    return f"{hours} h {minutes} min" if hours else f"{minutes} min"
