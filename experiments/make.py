"""Make what a target of the Makefile stands for: run the stages that are missing, in order."""

from __future__ import annotations

import os
import signal
import subprocess
import sys

from experiments.arguments import parse_run
from experiments.build_key import check_key, is_done
from experiments.run import Run
from experiments.running import exit_on_user_error
from experiments.stages import STAGES, Stage, stages_to, with_needed
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


def main(arguments: list[str] | None = None) -> None:
    target, *options = [*arguments] or [""]
    if target not in TARGETS:
        print(f"error: TARGET must be one of {', '.join(TARGETS)}. Received {target}.",
              file=sys.stderr)  # fmt: skip
        raise SystemExit(2)
    goals = stages_to(target)
    own = [*options, "--track", goals[0].track]
    run = parse_run(__doc__, own)
    with exit_on_user_error():
        todo = missing(run, target)
    # A stage is not to live on alone.
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(128 + signal.SIGTERM))
    for stage in todo:
        # The authors' files and scripts are of the target's own track.
        other = ["--track", stage.track, "--authors", "", "--evaluator", "paper"]
        _start(stage, own if stage.track == run.track else [*options, *other])
    if not goals[0].always:
        show.main(own)


def _start(stage: Stage, options: list[str]) -> None:
    """Run a stage in a process of its own; end with its status if it does not succeed."""
    onednn = {"TF_ENABLE_ONEDNN_OPTS": "1"} if stage.onednn else {}
    command = [sys.executable, "-m", "experiments", stage.name, *options]
    status = subprocess.run(command, env=os.environ | onednn).returncode
    if status:
        raise SystemExit(128 - status if status < 0 else status)
