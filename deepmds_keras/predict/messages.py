"""What `deepmds predict` says on the terminal: a line for each source, face and fault."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

from tqdm import tqdm

from deepmds_keras.errors import InputError
from deepmds_keras.predict import source_files
from deepmds_keras.predict.faces import Face
from deepmds_keras.predict.videos import tell_tracks

_NAMED_FAULTS = 10  # of one source


def complain(error: InputError, kind: str = "error") -> None:
    """One line on stderr."""
    tqdm.write(f"{kind}: {printable(str(error))}", file=sys.stderr)


def lines_of(source: Path, faces: list[Face], files: list[Path]) -> Iterator[str]:
    """Lines that tell the reader of a source."""
    named = [str(files[0]), *(file.name for file in files[1:4]), *["…"] * (len(files) > 4)]
    if faces[0].moment is not None:
        n_frames = len({face.moment.frame for face in faces})
        yield f"{source}: faces in {n_frames} frames → {', '.join(named)}"
        yield from tell_tracks(faces, source_files.DRAWN_FACES)
        return
    seen = [face for face in faces if not face.is_gap]
    gaps = len(faces) - len(seen)
    counted = f"{len(seen)} face{'s' * (len(seen) > 1)}" + f", {gaps} gap{'s' * (gaps > 1)}" * (
        gaps > 0
    )
    yield f"{source}: {counted} → {', '.join(named)}"
    some = source_files.DRAWN_FACES
    for face in seen[:some]:
        yield f"  {face.name}: {face.angles}"
        yield from (f"    {note}" for note in face.notes)
    if len(seen) > some:
        noted = sum(bool(face.notes) for face in seen[some:])
        yield f"  pictures are of the first {some}; {noted} of the others have notes"


def faults_of(source: Path, faces: list[Face]) -> InputError | None:
    """The faces that are gaps because they cannot be used."""
    faults = {i: face.notes[0] for i, face in enumerate(faces, 1) if face.is_gap and face.notes}
    if not faults:
        return None
    some = [f"{i:,}" for i in faults][:_NAMED_FAULTS]
    return InputError(
        f"{source}: {len(faults):,} of {len(faces):,} faces cannot be used and are gaps: "
        f"{', '.join(some)}{', …' * (len(faults) > len(some))}. The first {min(faults.items())[1]}"
    )


def printable(text: str) -> str:
    """On one line, whatever is in a file's name."""
    return "".join(letter if letter.isprintable() else repr(letter)[1:-1] for letter in text)
