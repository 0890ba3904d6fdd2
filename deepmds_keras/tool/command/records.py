"""Which results in a folder are of which source and options: a result belongs to both."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path

from deepmds_keras.landmarks.scheme import scheme_files
from deepmds_keras.tool.command.sources import kind_of

_RECORDS = ".deepmds-results"  # a line of JSON for each time that results were moved to the folder
# Options that have an effect on some kinds of sources only.
USED_BY = {
    "smooth": ("video", "landmarks"),
    "every": ("video",),
    "y_up": ("landmarks",),
    "image_size": ("landmarks",),
    "scheme": ("landmarks",),
    "detector": ("photo", "video"),
    "landmarker": ("photo", "video"),
}
_FILES = ("model", "landmarker")  # options that may name a file


def describe_run(source: Path, settings: Mapping) -> dict:
    """What the results of a source depend on: files with their size and time, and options.

    Times and paths stand for the content: to read all photos would take as long as some detectors.
    """
    kind = kind_of(source)
    options = {key: value for key, value in settings.items() if kind in USED_BY.get(key, (kind,))}
    given = [Path(options[key]) for key in _FILES if options.get(key)]
    if (scheme := options.get("scheme") or "").lower().endswith(".csv"):  # no shipped one
        given += scheme_files(Path(scheme))
    used = {"source": _stamp(source), "files": [_stamp(path) for path in given if path.is_file()]}
    return json.loads(json.dumps(used | {"options": options}))  # as it is read again


def read_records(folder: Path) -> dict[str, dict]:
    """The last record of each name of results: what `describe_run` says, `"results"` and `"fault"`.

    Without those some of whose files a later run replaced by results of another name.
    """
    records: dict[str, dict] = {}
    owner: dict[str, str] = {}
    path = folder / _RECORDS
    for line in path.read_text(encoding="utf-8").splitlines() if path.is_file() else ():
        try:
            record = json.loads(line)
            owner |= dict.fromkeys(record["results"], record["name"])
            records[record["name"]] = record
        except (ValueError, TypeError, KeyError):  # of a run that was killed
            continue
    return {
        name: record
        for name, record in records.items()
        if all(owner[file] == name for file in record["results"])
    }


def add_record(
    folder: Path, name: str, described: Mapping, results: list[str], fault: str | None
) -> None:
    """Note whose results the files of a name are, before they are moved to the folder.

    The fault is what a later run must say when it skips the source.
    """
    record = {"name": name, **described, "results": results, "fault": fault}
    with open(folder / _RECORDS, "a", encoding="utf-8") as file:
        file.write(f"\n{json.dumps(record)}\n")  # on its own line, even after half a record


def describe_difference(record: Mapping | None, described: Mapping) -> str | None:
    """Whose the results are, if not those that `describe_run` describes."""
    if record is None:
        return "of an unknown source"
    if record["source"][0] != described["source"][0]:
        return f"of {record['source'][0]}"
    if record["source"] != described["source"]:
        return "of an earlier version of it"
    options, before = described["options"], record["options"]
    keys = options.keys() | before.keys()
    other = sorted(key for key in keys if options.get(key) != before.get(key))
    if other or record["files"] != described["files"]:
        return f"made with other {', '.join(other) or 'weights'}"
    return None


def _stamp(path: Path) -> tuple[str, int, int]:
    status = path.stat()
    return str(path.resolve()), status.st_size, status.st_mtime_ns
