"""MediaPipe's face landmarker for browsers, out of an npm package that is not in git."""

from __future__ import annotations

import hashlib
import io
import tarfile
from pathlib import Path
from urllib.request import urlopen

from deepmds_keras.errors import InputError, brief

# Not a later one: by its README, 1.0 and above send metrics.
VERSION = "0.10.35"
_PACKAGE = f"@mediapipe/tasks-vision@{VERSION}"
_ADDRESS = f"https://registry.npmjs.org/@mediapipe/tasks-vision/-/tasks-vision-{VERSION}.tgz"
_SECONDS = 60  # without an answer
SHA256 = {
    "vision_bundle.mjs": "55d7ab624fbb70dcc5adc4ae6d7ea9cfcb569139d3dbfbf2b1deafcb966bc0fe",
    "wasm/vision_wasm_internal.js": (
        "e7fd9858e8e8f221d9b96eddc11f8e077f263e0b7bbd79d3cbe882b134274f8c"
    ),
    "wasm/vision_wasm_internal.wasm": (
        "6a5c64584c2ab61c763b6e204afbdbc7ce1caf7f5216187322bca8df94f646bc"
    ),
}


def read_tasks_vision(place: str | Path | None) -> dict[str, bytes]:
    """Files of the package by name, those of `SHA256`, byte for byte as released.

    Args:
        place: The package as `npm pack` writes it, or its folder; None downloads it.

    Raises:
        InputError: It cannot be downloaded or read, or is another package or version.
    """
    try:
        if place is None:
            with urlopen(_ADDRESS, timeout=_SECONDS) as answer:
                files = _unpacked(answer.read())
        elif Path(place).is_dir():
            files = {name: Path(place, name).read_bytes() for name in SHA256}
        else:
            files = _unpacked(Path(place).read_bytes())
    # http.client's and zlib's errors are neither OSError nor of a common kind.
    except Exception as error:
        raise _refused(place, f"{type(error).__name__}: {brief(error)}") from None
    for name, content in files.items():
        if (found := hashlib.sha256(content).hexdigest()) != SHA256[name]:
            raise _refused(place, f"another {name}, with sha256 {found}")
    return files


def _unpacked(content: bytes) -> dict[str, bytes]:
    with tarfile.open(fileobj=io.BytesIO(content)) as archive:
        members = {name: archive.extractfile(f"package/{name}") for name in SHA256}
        return {name: member.read() if member else b"" for name, member in members.items()}


def _refused(place: str | Path | None, received: str) -> InputError:
    return InputError(
        f"{place or _ADDRESS} must be {_PACKAGE}: with a network, get it by npm pack {_PACKAGE}, "
        f"and pass the file to --tasks-vision. Received {received.rstrip('.')}."
    )
