"""Damaged and hostile files: every loader reads them or refuses them by one line, and runs nothing.

`FUZZ=10` makes ten times as many damaged files; they are the same each time.
"""

from __future__ import annotations

import io
import os
import pickle
import re
import struct
import zlib

import h5py
import numpy as np
import pytest
from PIL import Image
from scipy.io import savemat
from writers.models import flame_arrays
from writers.pickles import PYTHON2, Calls, chumpy_pickle
from writers.scans import asc, vrml

from data_gen.mesh_files import read_asc_points, read_ply, read_vrml_points
from data_gen.models.array_files import load_plain_pickle
from data_gen.models.basel import load_bfm2009, load_bfm2017
from data_gen.models.flame import read_flame
from data_gen.models.openhead import OPENHEAD, load_openhead
from deepmds_keras.errors import InputError
from deepmds_keras.tool.detection.photos import open_photo
from deepmds_keras.tool.predict.landmark_files import read_landmarks

N = round(40 * float(os.environ.get("FUZZ", "1")))
CUBE = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], np.float32)
TRIANGLES = np.array([(0, 1, 3), (0, 3, 2), (4, 6, 7), (4, 7, 5), (0, 4, 5), (2, 3, 7)], np.int32)
PHOTO = Image.fromarray(np.random.default_rng(0).integers(0, 255, (36, 40, 3), np.uint8))
BASIS = np.random.default_rng(0).normal(size=(24, 2)).astype(np.float32)
MEAN_BASIS_SD = {"MU": CUBE.reshape(-1, 1) * 1e5, "PC": BASIS, "EV": np.ones((2, 1))}
BFM2009 = {prefix + k: a for prefix in ("shape", "tex") for k, a in MEAN_BASIS_SD.items()}
BFM2017 = {"mean": CUBE.ravel(), "pcaBasis": BASIS, "pcaVariance": np.ones(2)}
FLAME = flame_arrays(CUBE * 0.1, TRIANGLES)
PLY = (
    b"ply\nformat binary_little_endian 1.0\nelement vertex 8\nproperty float x\nproperty float y\n"
)
PLY += b"property float z\nelement face 1\nproperty list uchar int vertex_indices\nend_header\n"
POINTS = [f"{i}.5 {i * i % 7}.5" for i in range(68)]


def content(save, *arguments, **options):
    save(file := io.BytesIO(), *arguments, **options)
    return file.getvalue()


def save_h5(buffer, options=None):
    with h5py.File(buffer, "w") as file:
        for key, array in BFM2017.items():
            file.create_dataset(f"shape/model/{key}", data=array)
        file["shape/representer/cells"] = TRIANGLES.T
        if options:  # of an array that was never written
            del file["shape/model/mean"]
            file.create_dataset("shape/model/mean", dtype=np.float32, **options)


# Name of a small whole file: its content, and what reads it.
TARGETS = {
    "2009.mat": (content(savemat, BFM2009 | {"tl": TRIANGLES + 1}), load_bfm2009),
    "2017.h5": (content(save_h5), load_bfm2017),
    "flame.pkl": (chumpy_pickle(lambda ch: FLAME | {"J": ch(x=BASIS)}, 2), read_flame),
    "plain.pkl": (PYTHON2, load_plain_pickle),
    "openhead.npz": (OPENHEAD.read_bytes(), load_openhead),
    "mesh.ply": (PLY + CUBE.tobytes() + b"\3" + TRIANGLES[:1].tobytes(), read_ply),
    "scan.wrl": (vrml(CUBE).encode(), read_vrml_points),
    "scan.asc": (asc(CUBE).encode(), read_asc_points),
    "photo.jpg": (content(PHOTO.save, "jpeg"), open_photo),
    "photo.png": (content(PHOTO.save, "png"), open_photo),
    "photo.tif": (content(PHOTO.save, "tiff", compression="tiff_lzw"), open_photo),
    "a.npy": (content(np.save, np.random.default_rng(0).uniform(1, 500, (68, 2))), read_landmarks),
    "a.csv": ("\n".join(["x,y", *POINTS]).replace(" ", ",").encode(), read_landmarks),
    "a.pts": ("\n".join(["version: 1\nn_points: 68\n{", *POINTS, "}"]).encode(), read_landmarks),
}
HUGE_MAT = struct.pack("<IIIIIIii", 6, 8, 6, 0, 5, 8, 2**31 - 1, 2**31 - 1)
HUGE_MAT += struct.pack("<II8sIId", 1, 7, b"shapeMU", 9, 8, 1.5)
HUGE = {
    "2009.mat": TARGETS["2009.mat"][0][:128] + struct.pack("<II", 14, len(HUGE_MAT)) + HUGE_MAT,
    "2017.h5": content(save_h5, {"shape": (2 * 10**9,), "chunks": True}),
    "plain.pkl": b"\x80\x04\x8e" + (1 << 40).to_bytes(8, "little") + b"abc.",
    "mesh.ply": TARGETS["mesh.ply"][0].replace(b"vertex 8", b"vertex 4000000000"),
    "photo.jpg": b"BM" + struct.pack("<IIIIiiHH", 58, 0, 54, 40, 60_000, 60_000, 1, 24) + bytes(28),
}


def damaged(data, rng):
    """A cut, a changed bit, noise in the place of bytes or between them, or another number."""
    start = int(rng.integers(min(len(data), rng.choice([300, len(data)]))))
    noise, number = rng.bytes(int(rng.integers(1, 9))), int(rng.choice([0, 1, 255, 2**31, 2**63]))
    word = rng.choice([b"nan", b"-1", b"1e400", b"99999999999", b"x"])
    digits = re.search(rb"\d+", data[start:])
    match rng.choice(6):
        case 0:
            return data[:start]
        case 1:
            return data[:start] + bytes([data[start] ^ 1 << rng.integers(8)]) + data[start + 1 :]
        case 2:
            return data[:start] + noise + data[start + len(noise) :]
        case 3:
            return data[:start] + noise + data[start:]
        case 4 if digits:
            return data[: start + digits.start()] + word + data[start + digits.end() :]
        case _:
            return data[:start] + struct.pack("<Q", number)[:4] + data[start + 4 :]


@pytest.mark.parametrize("name", TARGETS)
def test_damaged_files_are_read_or_refused(name, tmp_path):
    (whole, load), path, n_refused = TARGETS[name], tmp_path / name, 0
    path.write_bytes(whole)
    load(path)
    for i in range(N):
        path.write_bytes(damaged(whole, np.random.default_rng([zlib.crc32(name.encode()), i])))
        try:
            load(path)
        except InputError as error:
            n_refused += 1
            assert str(path) in str(error) and "\n" not in str(error) and len(str(error)) < 1000, i
    assert n_refused > N / 10  # the damage is damage


@pytest.mark.parametrize("name", HUGE)
def test_a_small_file_that_claims_to_be_huge_is_refused(name, tmp_path):
    (tmp_path / name).write_bytes(HUGE[name])
    with pytest.raises(InputError, match=name):
        TARGETS[name][1](tmp_path / name)


@pytest.mark.parametrize("name", TARGETS)
def test_nothing_in_a_file_is_run(name, tmp_path):
    path, harm = tmp_path / name, tmp_path / "harm"
    call = Calls(os.mkdir, str(harm))
    objects = np.array([call], object)
    numpy = content(np.savez, allow_pickle=True, mean=objects), content(np.save, objects)
    postscript = b"%!PS-Adobe-3.0 EPSF-3.0\n(" + str(harm).encode() + b") (w) file closefile\n"
    pickles = (pickle.dumps([call], protocol) for protocol in (0, 2, 4))
    for hostile in (*pickles, *numpy, postscript):
        path.write_bytes(hostile)
        with pytest.raises(InputError, match=name):
            TARGETS[name][1](path)
        assert not harm.exists()
