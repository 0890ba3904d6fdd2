"""Progress: bars, on a terminal only, and durations as text."""

from __future__ import annotations

import threading

from tqdm import tqdm

# tqdm's lock is a semaphore, of which Python complains where a process with a bar is killed.
tqdm.set_lock(threading.RLock())


class Bar(tqdm):
    """tqdm's bar, absent where standard error is no terminal."""

    def __init__(self, *arguments, **options):
        super().__init__(*arguments, disable=None, **options)


class EpochBar(Bar):
    """A progress bar over epochs that shows the losses."""

    def __init__(self, name: str, epochs: int):
        # What a file already holds is read in less than the delay and needs no bar.
        super().__init__(total=epochs, desc=name, unit="epoch", delay=2)

    def losses(self, losses: dict[str, float]) -> None:
        """Show mean squares as their roots."""
        self.sums({f"{name} r.m.s.": value**0.5 for name, value in losses.items()})

    def sums(self, losses: dict[str, float]) -> None:
        """Show losses as they are."""
        self.set_postfix({k: f"{v:.4f}" for k, v in losses.items()}, refresh=False)
        self.update()


def duration(seconds: float) -> str:
    """Text of a duration, in its two largest units."""
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    if hours:
        return f"{hours} h {minutes} min"
    if minutes:
        return f"{minutes} min {rest} s"
    return f"{seconds:.3g} s"
