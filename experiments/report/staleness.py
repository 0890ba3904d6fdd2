"""Whether results still are what one run wrote, and belong together."""

from __future__ import annotations

from collections import defaultdict
from pathlib import Path

from deepmds_keras.io.checksums import sha256_of
from deepmds_keras.io.errors import InputError
from experiments.manifest import MANIFEST, files_of, read_manifest
from experiments.published import PUBLISHED
from experiments.report.experiment import COMMANDS, Experiment, base_of, name_of, result_folders
from experiments.scoring.numbers import moment
from experiments.stages import RESULTS

_STAGES = {result.folder: result.stage.split("/")[1] for result in RESULTS}


def stale(folder: Path, published: Path = PUBLISHED) -> list[str]:
    """List what is wrong with the results of a face model, one line each.

    Args:
        folder: `results/<model>`.
        published: The transcription of the paper's numbers.

    Returns:
        Lines that name the folder, what is wrong with it, and how to make it again; none if a
        report can be made. An experiment that was never run is nothing wrong.
    """
    problems, whole = [], []
    of_now = sha256_of([published])
    for path in result_folders(folder):
        try:
            experiment = Experiment(path, read_manifest(path))
        except InputError:
            reason = (
                f"has no readable {MANIFEST}: an earlier version wrote it, or a run was stopped"
            )
            problems.append(f"{path} {reason}; {_again(path)}")
            continue
        if "files" not in experiment.manifest:
            problems.append(f"{path} was written by an earlier version; {_again(path, experiment)}")
            continue
        reasons = _changed(experiment)
        if experiment.manifest["published_sha256"] != of_now:
            reasons.append(f"{published.name} changed since")
        if reasons:
            problems.append(f"{path}: {'; '.join(reasons)}; {_again(path, experiment)}")
        else:
            whole.append(experiment)
    return problems + _of_other_runs(whole)


def _changed(experiment: Experiment) -> list[str]:
    """Files of the manifest that are not as they were written."""
    now = files_of(experiment.folder)
    listed = experiment.manifest["files"]
    missing = [name for name in listed if name not in now]
    edited = [name for name, digest in listed.items() if now.get(name, digest) != digest]
    stages = experiment.manifest["stages"]
    read = [name for record in stages for name in _changed_tables(experiment, record)]
    return [
        f"{', '.join(names)} {word}"
        for names, word in (
            (missing, "missing"),
            (edited, "changed since the run"),
            (read, "changed since it was read"),
        )
        if names
    ]


def _changed_tables(experiment: Experiment, record: dict) -> list[str]:
    """Tables of other experiments that a stage read, and that are others now."""
    tables = {name: experiment.folder.parent / name for name in record.get("tables", {})}
    return [
        name
        for name, path in tables.items()
        if not path.exists() or sha256_of([path]) != record["tables"][name]
    ]


def _of_other_runs(experiments: list[Experiment]) -> list[str]:
    """Experiments made from a stage, such as the networks, that was run anew since.

    When does not matter where one clean commit ran it on the same inputs: it makes the same.
    """
    made = defaultdict(list)
    for experiment in experiments:
        for record in experiment.manifest["stages"]:
            if "build" in record:  # those of earlier versions do not say
                key = record["build"], record["stage"]
                made[key].append((record["started"], _recipe(experiment, record), experiment))
    problems = {}
    for (_, stage), runs in made.items():
        latest, recipe, newest = max(runs, key=lambda run: run[0])
        for started, own, experiment in runs:
            if started != latest and (own is None or own != recipe):
                # A line for an experiment is enough, however many of its stages are old.
                problems.setdefault(
                    experiment.folder,
                    f"{experiment.folder} was made from stage {stage} of {moment(started)}, "
                    f"{newest.folder} from that of {moment(latest)}; "
                    f"{_again(experiment.folder, experiment)}",
                )
    return [*problems.values()]


def _recipe(experiment: Experiment, record: dict) -> tuple[str, dict] | None:
    """What decides what a stage makes: the commit and the inputs; None if the code is not known."""
    commit = experiment.manifest["commit"]
    return None if commit is None or commit.endswith("+") else (commit, record.get("inputs", {}))


def _again(folder: Path, experiment: Experiment | None = None) -> str:
    """Command that makes an experiment's results anew.

    `make` takes the last stage for done while its record is in `build/`, and would run nothing.
    """
    name = name_of(folder)
    base, model = base_of(name), folder.parents[name.count("/")].name
    stage = _STAGES.get(base, base)
    made = experiment.manifest if experiment else {}
    command = made.get("command", f"{COMMANDS.get(base, 'make')} MODEL={model}")
    work = "*"
    if "track" in made:
        work = f"{made['track']}-{made['preset']['name']}-{made['protocol']}-seed{made['seed']}*"
    return f"run: rm -f build/{model}/{work}/{stage}*.json && {command}"
