"""Make what a target of the Makefile stands for: run the stages that are missing, in order."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Mapping
from dataclasses import replace
from statistics import median

from deepmds_keras.io.errors import InputError
from experiments.arguments import parse_run
from experiments.build_key import check_key, is_done
from experiments.manifest import MANIFEST, read_manifest
from experiments.run import Run
from experiments.running import exit_on_user_error
from experiments.scoring.numbers import duration
from experiments.stages import STAGES, SWITCHES, Stage, stages_to, with_needed
from experiments.tracks import show

TARGETS = tuple(dict.fromkeys(stage.target for stage in STAGES if stage.target))


def missing(run: Run, target: str) -> list[Stage]:
    """Stages that a target would run, if those before them change nothing that is there.

    Raises:
        InputError: A stage's folder was made of other files than the run names.
    """
    goals, found = stages_to(target), []
    stages = with_needed(goals, run)
    for stage in stages:
        check_key(run.on(stage.track), stage.name)
    for stage in stages:
        again = stage in goals and stage.always or {*found} & {*stage.needed}
        if again or not is_done(run.on(stage.track), stage.name):
            found.append(stage)
    return found


def in_turns(run: Run, target: str, todo: list[Stage]) -> list[list[Stage]]:
    """The stages to run in one turn or two: what comes soon first, with a table of its own.

    What `make` can leave out, MobileFace or RingNet, is most of the time; the table without it
    need not wait.
    """
    goal = stages_to(target)[0]
    soon = {*with_needed([goal], replace(run, without=SWITCHES))}
    first = [stage for stage in todo if stage in soon]
    later = [stage for stage in todo if stage not in soon]
    waits = {*later} & {*with_needed([goal], run)}
    if goal.always or not waits or is_done(run.on(goal.track), goal.name):
        return [todo]
    return [first, [*later, goal]]


def main(arguments: list[str] | None = None) -> None:
    target, *options = [*arguments] or [""]
    if target not in TARGETS:
        print(f"error: TARGET must be one of {', '.join(TARGETS)}. Received {target}.",
              file=sys.stderr)  # fmt: skip
        raise SystemExit(2)
    goal = stages_to(target)[0]
    own = [*options, "--track", goal.track]
    run = parse_run(__doc__, own)
    with exit_on_user_error():
        turns = in_turns(run, target, missing(run, target))
    # A stage is not to live on alone.
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(128 + signal.SIGTERM))
    left = [stage for turn in turns for stage in turn]
    number, seconds = len(left), usual_seconds(run)
    for turn in turns:
        last = turn is turns[-1]
        without = [] if last else [word for name in SWITCHES for word in ("--without", name)]
        for stage in turn:
            print(progress_line(left, number, seconds), flush=True)
            # The authors' files and scripts are of the target's own track.
            other = ["--track", stage.track, "--authors", "", "--evaluator", "paper"]
            given = own if stage.track == run.track else [*options, *other]
            _start(stage, [*given, *without] if stage == goal else given)
            left.pop(0)
        if not goal.always:
            show.main(own)
        if not last:
            print("\nThe rest of the table follows.\n", flush=True)


def usual_seconds(run: Run) -> dict[str, float]:
    """Id of a stage to how long it took for the results that are there, of runs of this size."""
    found: dict[str, list[float]] = {}
    for path in run.model_results.parent.glob(f"*/**/{MANIFEST}"):
        try:
            made = read_manifest(path.parent)
        except InputError:  # a damaged one is the report's to refuse
            continue
        if made.get("preset", {}).get("name") != run.preset.name:
            continue
        for record in made["stages"]:
            # Stages of several tracks have one name; a build begins with its track.
            track = record.get("build", made["track"]).partition("-")[0]
            found.setdefault(f"{track}/{record['stage']}", []).append(record["seconds"])
    return {stage: median(seconds) for stage, seconds in found.items()}


def progress_line(left: list[Stage], number: int, seconds: Mapping[str, float]) -> str:
    """Which stage of how many begins, and about how long all that are left take."""
    known = [seconds[stage.id] for stage in left if stage.id in seconds]
    about = f", about {duration(sum(known))} left" if known else ""
    more = " or more" * (0 < len(known) < len(left))
    return f"Stage {number - len(left) + 1} of {number}: {left[0].name}{about}{more}"


def _start(stage: Stage, options: list[str]) -> None:
    """Run a stage in a process of its own; end with its status if it does not succeed."""
    onednn = {"TF_ENABLE_ONEDNN_OPTS": "1"} if stage.onednn else {}
    command = [sys.executable, "-m", "experiments", stage.name, *options]
    status = subprocess.run(command, env=os.environ | onednn).returncode
    if status:
        raise SystemExit(128 - status if status < 0 else status)
