"""What users see of Snakemake: one line per step, with the approximate time left."""

import logging
import re
import sys
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path
from statistics import median

from deepmds_keras.errors import InputError, brief
from experiments.progress import roughly
from experiments.progress.step_names import in_words
from experiments.records import manifests, read_manifest, read_record, steps_of

# Not by SIGTERM, with which `make` ends its steps.
_KILLED = re.compile(r"--record (\S+) .* died with <Signals\.(SIG(?!TERM)\w+)")


class JobLines(logging.Handler):
    """Handler of Snakemake's events that prints a line for each job that begins.

    Args:
        workflow: Snakemake's, whose plan is known once it begins.
        seconds: Name of a step → its usual duration.
    """

    def __init__(self, workflow, seconds: dict[str, float]):
        super().__init__()
        self._workflow, self._seconds = workflow, seconds
        self._jobs: dict[int, tuple[Path, int]] = {}
        self._left: set[int] = set()
        self._begun, self._failed = 0, False

    def emit(self, record: logging.LogRecord) -> None:
        event = getattr(record, "event", None)
        if event == "run_info":
            jobs = (job for job in self._workflow.dag.needrun_jobs() if job.output)
            self._jobs = {job.jobid: (Path(job.output[0]), job.threads) for job in jobs}
            self._left = {*self._jobs}
        elif event == "job_info" and record.jobid in self._jobs:
            self._begun += 1
            print(self._line(record.jobid), flush=True)
        elif event == "job_finished":
            self._left.discard(record.job_id)
        elif event == "job_error" and record.rule_msg:  # of a cluster, whose logs have the reason
            job = f"{in_words(self._jobs[record.jobid][0])}, job {record.aux.get('external_jobid')}"
            print(f"error: {job}:", brief(record.rule_msg), *record.log, file=sys.stderr)
        elif event in (None, "error") and record.levelno >= logging.ERROR:
            message = " ".join(record.getMessage().split())
            # A failed step has already printed its own message, unless a signal ended it.
            if killed := _KILLED.search(message):
                print(f"error: {in_words(Path(killed[1]))}: ended by {killed[2]}.", file=sys.stderr)
            self._failed |= "CalledProcessError" in message or message.startswith("Exiting")
            if message and not self._failed:
                print(f"error: {message}", file=sys.stderr)

    def _line(self, job: int) -> str:
        """`Step 3 of 12: train Deep-MDS, about 8 min left`; of a dry run, what the step takes."""
        file = self._jobs[job][0]
        text = f"Step {self._begun} of {len(self._jobs)}: {in_words(file)}"
        if self._workflow.dryrun:
            seconds = self._seconds.get(file.stem)
            return text if seconds is None else f"{text}, about {roughly(seconds)}"
        known = [
            self._seconds[file.stem] * threads
            for file, threads in (self._jobs[other] for other in self._left)
            if file.stem in self._seconds
        ]
        if not known:
            return text
        about = "at least" if len(known) < len(self._left) else "about"
        return f"{text}, {about} {roughly(sum(known) / self._workflow.cores)} left"


def usual_seconds(build: Path, results: Path, preset: str) -> dict[str, float]:
    """Duration of each step, the median over runs of the same size, by the name of its record."""
    durations: dict[str, list[float]] = {}
    for step in _steps(build, results):
        if step.get("preset", {}).get("name") == preset:
            durations.setdefault(step["name"], []).append(step["seconds"])
    return {name: median(seconds) for name, seconds in durations.items()}


def _steps(build: Path, results: Path) -> Iterable[dict]:
    for path in build.glob("*/*/records/*.json"):
        with suppress(InputError):  # a damaged one is for its readers to refuse
            yield read_record(path)
    for path in manifests(results):
        with suppress(InputError):
            yield from steps_of(read_manifest(path.parent))
