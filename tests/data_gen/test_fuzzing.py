"""Damaged files: every loader reads them or refuses them by its own error, and nothing else.

Thousands of files are made from small whole ones by seeded damage, the same ones each time, and
loaded in another process: a crash, a hang or memory without bounds ends that process and not the
tests. `make test` makes a tenth of the numbers below, ten at least, `FUZZ=20` twenty times as many.
"""

from __future__ import annotations

import faulthandler
import functools
import io
import json
import multiprocessing
import os
import pickle
import re
import signal
import struct
import sys
import time
import warnings
import zipfile
import zlib
from collections import Counter
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import h5py
import numpy as np
import pytest
from mutations import damaged
from PIL import Image, features
from scipy.io import savemat
from scipy.sparse import coo_array, csc_matrix, csr_matrix
from writers.keras2 import write_keras2
from writers.landmark_files import LAYOUTS, written
from writers.models import write_h5, write_ict_folder, write_ict_npz
from writers.pickles import LYING, PYTHON2, Calls, chumpy_pickle
from writers.scans import asc, vrml, write_ply

from data_gen.datasets.casia import CasiaScan, load_scan, read_index, write_index
from data_gen.datasets.celeba import CelebaImage, find_images, load_image
from data_gen.datasets.coma import load_coma
from data_gen.datasets.dataset import Dataset, load_dataset, save_dataset
from data_gen.datasets.image_files import ImageFiles
from data_gen.formats.plain_pickle import load_plain_pickle
from data_gen.formats.ply import read_ply
from data_gen.formats.vrml import read_asc_points, read_vrml_points
from data_gen.landmarks import load_basel_anchors
from data_gen.models.bfm2009 import load_bfm2009
from data_gen.models.bfm2017 import load_bfm2017
from data_gen.models.flame import load_flame
from data_gen.models.flame_embedding import LandmarkEmbedding, load_embedding
from data_gen.models.ict import load_ict
from data_gen.models.openhead import LAYOUT, load_openhead, read_openhead
from data_gen.views.projections import sample_cameras
from deepmds_keras.errors import InputError
from deepmds_keras.files import read_arrays, read_table, write_arrays
from deepmds_keras.keras2_weights import read_keras2_weights
from deepmds_keras.photos import open_photo
from deepmds_keras.predict.landmark_files import read_landmarks

resource = pytest.importorskip("resource", reason="memory is limited as on Linux")
pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="memory is limited as on Linux")

FUZZ = float(os.environ.get("FUZZ", "0.1"))
SECONDS = 60  # for one file, which takes some milliseconds
FINE = ("loaded", "refused")
# What no loader of data does, by the names of Python's audit events.
FORBIDDEN = {
    *("pickle.find_class", "os.system", "os.exec", "os.fork", "os.posix_spawn", "subprocess.Popen"),
    *("os.remove", "os.rename", "os.mkdir", "os.rmdir", "os.chmod", "socket.connect"),
}

CORNERS = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], float)
QUADS = np.array(
    [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
)
TRIANGLES = QUADS[:, [0, 1, 2, 0, 2, 3]].reshape(-1, 3)
V = len(CORNERS)
PIXELS = np.random.default_rng(0).integers(0, 255, (36, 40, 3), np.uint8)


def normal(*shape):
    """The same numbers each time."""
    return np.random.default_rng(shape).normal(size=shape)


def shares(n, k):
    """`(n, k)` positive, rows sum to 1."""
    return np.random.default_rng([n, k]).dirichlet(np.ones(k), n)


EMBEDDING = LandmarkEmbedding(np.random.default_rng(0).integers(0, 12, 51), shares(51, 3))


@dataclass(frozen=True)
class Target:
    """A loader, and the small whole files that damage is done to.

    Attributes:
        write: Writes the whole files into an empty folder.
        load: Called with the path of a file, whole or damaged.
        error: What the loader may raise.
        n: Damaged files where `FUZZ` is 1.
        memory: MB that a file may cost.
        kept: Names, as `Path.match` takes them, of files that stay whole.
    """

    write: Callable[[Path], object]
    load: Callable[[Path], object]
    error: type[Exception] = InputError
    n: int = 500
    memory: int = 512
    kept: tuple[str, ...] = ()


def write_bfm2009(folder):
    basis = np.linalg.qr(normal(3 * V, 2))[0].astype(np.float32)
    arrays = {
        f"{prefix}{key}": array
        for prefix in ("shape", "tex")
        for key, array in {
            "MU": CORNERS.reshape(-1, 1).astype(np.float32) * 1e5,
            "PC": basis,
            "EV": np.ones((2, 1), np.float32),
        }.items()
    }
    arrays["tl"] = (TRIANGLES + 1).astype(np.int32)
    for compressed in (False, True):
        savemat(folder / f"{compressed}.mat", arrays, do_compression=compressed)


def write_bfm2017(folder):
    names = [*load_basel_anchors()][:3]
    points = [
        {"id": name, "coordinates": corner}
        for name, corner in zip(names, CORNERS.tolist(), strict=False)
    ]
    arrays = {
        "shape/representer/points": CORNERS.T.astype(np.float32),
        "shape/representer/cells": TRIANGLES.T.astype(np.uint32),
        "metadata/landmarks/json": json.dumps(points),
    }
    for group in ("shape", "expression", "color"):
        arrays[f"{group}/model/mean"] = CORNERS.ravel().astype(np.float32)
        arrays[f"{group}/model/pcaBasis"] = normal(3 * V, 2).astype(np.float32)
        arrays[f"{group}/model/pcaVariance"] = np.ones(2, np.float32)
    write_h5(folder, arrays, "contiguous.h5")
    with h5py.File(folder / "chunked.h5", "w") as file:
        for key, value in arrays.items():
            chunked = {"chunks": True, "compression": "gzip"} if np.ndim(value) else {}
            file.create_dataset(key, data=value, **chunked)


def write_head_parts(folder):
    """What the landmarks of a 2017 model are found by, for `load_head` to put together."""
    head = load_openhead()
    points = [
        {"id": name, "coordinates": head.mean[vertex["openhead"]].tolist()}
        for name, vertex in load_basel_anchors().items()
    ]
    (folder / "json").write_text(json.dumps(points))
    (folder / "mean").write_bytes(np.float32(head.mean).tobytes())
    (folder / "cells").write_bytes(np.uint32(head.triangles.T).tobytes())


def load_head(file):
    text, mean, cells = ((file.parent / part).read_bytes() for part in ("json", "mean", "cells"))
    mean = np.frombuffer(mean[: len(mean) // 12 * 12], np.float32)
    cells = np.frombuffer(cells[: len(cells) // 12 * 12], np.uint32)
    arrays = {
        "shape/representer/points": mean.reshape(-1, 3).T,
        "shape/representer/cells": cells.reshape(3, -1),
        "metadata/landmarks/json": np.frombuffer(text, np.uint8),
        "shape/model/mean": mean,
        "shape/model/pcaBasis": np.ones((len(mean), 1), np.float32),
        "shape/model/pcaVariance": np.ones(1, np.float32),
    }
    return load_bfm2017(write_h5(file.parents[1], arrays))


def write_ict(folder, write):
    arrays = {
        "mean": CORNERS,
        "identity": normal(100, V, 3).round(4),
        "expression": normal(1, V, 3).round(4),
        "expression_names": ["jawOpen"],
        "quads": QUADS.tolist(),
    }
    write(folder, arrays)


def write_flame(folder, suffix):
    arrays = {
        "v_template": CORNERS * 0.1,
        "f": TRIANGLES.astype(np.uint32),
        "shapedirs": normal(V, 3, 400).astype(np.float32),
        "posedirs": normal(V, 3, 36).astype(np.float32),
        "J_regressor": csc_matrix(shares(5, V)),
        "kintree_table": np.array([[2**32 - 1, 0, 1, 1, 1], range(5)], np.uint32),
        "weights": shares(V, 5),
    }
    if suffix == ".npz":
        arrays["J_regressor"] = arrays["J_regressor"].toarray()
        np.savez(folder / "flame.npz", **arrays)
    else:
        held = lambda ch: arrays | {"shapedirs": ch(x=arrays["shapedirs"])}  # noqa: E731
        (folder / "generic_model.pkl").write_bytes(chumpy_pickle(held, 2))
    write_embedding(folder)


def write_embedding(folder, protocols=(2,)):
    for protocol in protocols:
        for n in (51, 68):
            again = np.arange(51 - n, 51)
            arrays = {
                "lmk_face_idx": EMBEDDING.triangles[again].astype(np.uint32),
                "lmk_b_coords": EMBEDDING.weights[again],
            }
            name = f"flame_static_embedding{protocol if len(protocols) > 1 else ''}.pkl"
            (folder / name).write_bytes(pickle.dumps(arrays, protocol))


def write_pickles(folder):
    dense = np.array([[0, 1.5, 0, 2], [0, 0, 0, 0], [3, 0, 4, 0]])

    def held(ch):
        return {
            "sparse": [kind(dense) for kind in (csr_matrix, csc_matrix, coo_array)],
            "arrays": (np.arange(6.0).reshape(2, 3), np.array(["a", "bc"]), np.float32(2)),
            "chumpy": ch(x=np.eye(2), a={1: [1.5, None, 10**20]}),
            "rest": [b"bytes", "text", True, {3}, frozenset([4])],
        }

    for protocol in range(pickle.HIGHEST_PROTOCOL + 1):
        (folder / f"{protocol}.pkl").write_bytes(chumpy_pickle(held, protocol))
    (folder / "python2.pkl").write_bytes(PYTHON2)


def write_meshes(folder):
    vertices, triangles = CORNERS.astype(np.float32), TRIANGLES.astype(np.int32)
    write_ply(folder / "text.ply", vertices, triangles, text=True)
    write_ply(folder / "little.ply", vertices, triangles)
    write_ply(folder / "big.ply", vertices.astype(float), triangles, byte_order=">")


def write_coma(folder):
    for name in ("a", "b"):
        file = folder / "FaceTalk_170725_00137_TA" / "bareteeth" / f"bareteeth.{name}.ply"
        write_ply(file, CORNERS.astype(np.float32) * 0.1, TRIANGLES.astype(np.int32))


def load_mesh(file):
    coma = load_coma(file.parents[2], EMBEDDING)
    if coma.skipped:
        raise InputError(f"{file}: {coma.skipped}")
    return coma


def cap():
    """Points of a scan: a cap that bulges towards the scanner, millimetres."""
    x, y = np.mgrid[-60:60:24j, -60:60:24j].reshape(2, -1)
    return np.stack([x, y, -(x**2 + y**2) / 100 - 900], axis=1).round(2)


def write_scan(folder):
    write_images(folder, "001-001.bmp")
    (folder / "001-001.wrl").write_text(vrml(cap()))
    (folder / "001-001.asc").write_text(asc(cap()))


def write_points(folder):
    (folder / "a.wrl").write_text(vrml(cap()[:20]))
    (folder / "b.wrl").write_text(
        '#VRML V2.0 utf8\nDEF f Shape { info "a # b" appearance Appearance { }\n'
        "geometry IndexedFaceSet { coord Coordinate { point [ 1 2 3, -4.5 5e1 6 # c\n 7 8 9 ] }\n"
        "texCoord TextureCoordinate { point [ 0 0, 1 1 ] } coordIndex [ 0 1 2 -1 ] } }\n"
    )
    (folder / "c.asc").write_text("# points\n" + asc(cap()[:20]))


def write_images(folder, *names):
    for name in names:
        Image.fromarray(PIXELS).save(folder / name)
    palette = Image.fromarray(PIXELS).quantize(16)
    palette.save(folder / "palette.png", transparency=b"\x00\x80")


def scan_of(file):
    image = file if file.suffix not in (".wrl", ".asc") else file.with_name("001-001.bmp")
    return CasiaScan("001", 1, image, file.with_name("001-001.wrl") if image == file else file)


SCANS = [CasiaScan("001", k, Path(f"{k}.bmp"), Path(f"{k}.wrl")) for k in range(1, 6)]


def write_celeba(folder):
    lines = [f"{number:06d}.jpg {number % 3}" for number in range(1, 10)]
    images = folder / "img_align_celeba"
    images.mkdir()
    for line in lines:
        (images / line[:10]).touch()
    (folder / "list_eval_partition.txt").write_text("\n".join(lines))


def write_dataset(folder):
    faces = (normal(3, n).astype(np.float32) for n in (4, 0, 15, 10))
    identity, expression, landmarks, views = faces
    shapes = landmarks.reshape(3, 5, 3), views.reshape(3, 5, 2)
    cameras = sample_cameras(3, np.random.default_rng(0))
    described = {"model": "openhead", "seed": 0}
    save_dataset(folder / "a.npz", Dataset(identity, expression, *shapes, cameras, described))


def load_image_files(file):
    images = ImageFiles(file.parent, 3, 8)
    return images[:], images.landmarks(range(3))


def write_openhead(folder):
    sizes = {"V": V, "K": 2, "E": 1, "T": len(TRIANGLES)}
    arrays = {}
    for key, (kind, shape) in LAYOUT.items():
        shape = [sizes.get(size, size) for size in shape]
        arrays[key] = np.zeros(shape, {"f": np.float32, "i": np.int32, "U": "<U7"}[kind])
    np.savez_compressed(folder / "a.npz", **arrays | {"mean": CORNERS, "triangles": TRIANGLES})


def write_weights(folder):
    arrays = {"encode_1/kernel": normal(4, 3), "encode_1/bias": np.zeros(3)}
    described = {"parameters": {"n_landmarks": 51}, "history": {"loss": [1.0, 0.5]}}
    for compressed in (False, True):
        write_arrays(folder / f"{compressed}.npz", arrays, described, compressed=compressed)


@functools.cache
def method():
    """The whole method, untrained."""
    from deepmds_keras.networks import build_autoencoder, build_dissimilarity_net
    from deepmds_keras.pipeline import DeepMDS

    model = DeepMDS(51)
    model.autoencoder_, model.dissimilarity_net_ = build_autoencoder(51), build_dissimilarity_net()
    model.front_landmark_, model.history_ = 13, {}
    return model


def load_method(file):
    loaded = type(method()).load(file)
    return loaded.get_params(), loaded.front_landmark_, loaded.autoencoder_.get_weights()


def load_keras2(file):
    network = method().dissimilarity_net_
    read_keras2_weights(network, file)
    return network.get_weights()


def write_photos(folder):
    photo = Image.fromarray(PIXELS)
    exif = Image.Exif()
    exif[0x0112], exif[0x010F] = 6, "a camera"
    write_images(folder, *(f"a.{end}" for end in ("bmp", "gif", "ppm", "tga", "png")))
    photo.save(folder / "a.jpg", exif=exif)
    photo.save(folder / "progressive.jpg", progressive=True, dpi=(72, 72))
    photo.convert("RGBA").save(folder / "alpha.png", exif=exif)
    Image.fromarray(np.uint16(PIXELS[..., 0]) * 257).save(folder / "deep.png")
    photo.save(folder / "raw.tif")
    for compression in ("tiff_lzw", "tiff_adobe_deflate", "jpeg"):
        photo.save(folder / f"{compression}.tif", compression=compression)
    for end, feature in (("webp", "webp"), ("jp2", "jpg_2000"), ("avif", "avif")):
        if features.check(feature):
            photo.save(folder / f"a.{end}")


def write_landmarks(folder):
    for i, (name, content, _) in enumerate(LAYOUTS.values()):
        written(folder, f"{i}{name[1:].lower()}", content)


TARGETS = {
    "BFM 2009": Target(write_bfm2009, load_bfm2009),
    "BFM 2017": Target(write_bfm2017, load_bfm2017),
    "BFM 2017's landmarks": Target(write_head_parts, load_head, n=10),
    "ICT, npz": Target(functools.partial(write_ict, write=write_ict_npz), load_ict),
    "ICT, folder": Target(
        functools.partial(write_ict, write=write_ict_folder),
        lambda file: load_ict(file.parent),
        kept=("identity0[1-9]*",),
    ),
    "FLAME, pickle": Target(
        functools.partial(write_flame, suffix=".pkl"), load_flame, n=200, kept=("flame_static*",)
    ),
    "FLAME, npz": Target(
        functools.partial(write_flame, suffix=".npz"), load_flame, n=200, kept=("flame_static*",)
    ),
    "FLAME's landmarks": Target(
        functools.partial(write_embedding, protocols=(0, 2, 4)), load_embedding
    ),
    "pickles": Target(write_pickles, load_plain_pickle, n=1500),
    "PLY": Target(write_meshes, read_ply, n=800),
    "CoMA": Target(write_coma, load_mesh, n=100),
    "VRML and ASC": Target(
        write_points, lambda f: (read_asc_points if f.suffix == ".asc" else read_vrml_points)(f)
    ),
    "CASIA's index": Target(
        lambda folder: write_index(folder / "index.csv", SCANS),
        lambda file: read_index(file, SCANS),
    ),
    "CASIA's scans": Target(write_scan, lambda file: load_scan(scan_of(file)), memory=1500),
    "CelebA's list": Target(write_celeba, lambda file: find_images(file.parent), kept=("0*.jpg",)),
    "CelebA's images": Target(
        lambda folder: write_images(folder, "a.jpg", "b.png"),
        lambda file: load_image(CelebaImage(file.name, file)),
        memory=1500,
    ),
    "data sets": Target(write_dataset, load_dataset),
    "files of images": Target(
        lambda folder: ImageFiles(folder, 3, 8).save(
            0, PIXELS[:24, :24].reshape(3, 8, 8, 9)[..., :3], np.zeros((3, 5, 2), np.float32)
        ),
        load_image_files,
    ),
    "open head": Target(write_openhead, lambda f: (load_openhead(f), read_openhead(f))),
    "photos": Target(write_photos, open_photo, InputError, n=1500, memory=1500),
    "landmarks": Target(write_landmarks, read_landmarks, InputError, n=1000),
    "tables": Target(
        lambda folder: (folder / "a.csv").write_text("# a\nnumber,name\n1,nose\n2,chin\n"),
        read_table,
        InputError,
    ),
    "weights": Target(write_weights, read_arrays, InputError),
    "Keras 2's weights": Target(
        lambda folder: write_keras2(folder / "a.h5", method().dissimilarity_net_),
        load_keras2,
        InputError,
        memory=1500,
    ),
    "the method": Target(
        lambda folder: method().save(folder / "a.npz"), load_method, InputError, n=40, memory=1500
    ),
}
HEAVY = ("Keras 2's weights", "the method")  # load TensorFlow
# HDF5 asks for what a header of its own claims, fails to read as much, and has touched none of it.
_NO_MEMORY = re.compile(
    "unable to allocate|out of memory|cannot allocate|memory allocation(?!.*on disk image buffer)",
    re.I,
)


class Watched:
    """What the loaders do beside what they return; in the other process only."""

    def __init__(self):
        self.seen: list[str] = []
        self.is_on = False
        sys.addaudithook(self._audit)
        sys.unraisablehook = lambda raised: self.seen.append(f"unraisable {raised.exc_value!r}")

    def _audit(self, event, arguments):
        if self.is_on and event in FORBIDDEN:
            self.seen.append(f"{event} {arguments!r}"[:200])


@functools.cache
def watched() -> Watched:
    return Watched()


def fuzz(name: str, folder: Path, first: int, last: int) -> tuple[Counter, list[str], float]:
    """Loads damaged files, in the other process; where it is stands in the file `at`.

    Returns:
        How many were loaded and refused, a line for each that did anything else, and seconds.
    """
    target = TARGETS[name]
    stderr = os.open(folder / "stderr", os.O_WRONLY | os.O_CREAT | os.O_APPEND)
    os.dup2(stderr, 2)  # C libraries complain there
    faulthandler.enable(stderr)
    whole = folder / "whole"
    if not whole.exists():
        whole.mkdir()
        target.write(whole)
    files = sorted(path for path in whole.rglob("*") if path.is_file())
    contents = {path: path.read_bytes() for path in files}
    chosen = [path for path in files if not any(map(path.match, target.kept))]
    expected = {path: pickle.dumps(target.load(path)) for path in chosen}
    done, faults, began = Counter(), [], time.process_time()
    with bounded(target.memory):
        for i in range(first, last):
            rng = np.random.default_rng([zlib.crc32(name.encode()), i])
            path = chosen[rng.integers(len(chosen))]
            data = damaged(path.name, contents[path], rng)
            path.write_bytes(data)
            (folder / "at").write_text(f"{i} {path.relative_to(whole)}")
            outcome = outcome_of(target, path)
            done[outcome if outcome in FINE else "faults"] += 1
            if outcome not in FINE:
                (folder / f"fault-{i}{path.suffix}").write_bytes(data)
                faults.append(f"{i} {path.relative_to(whole)}, {len(data)} bytes: {outcome}")
            path.write_bytes(contents[path])
    seconds = time.process_time() - began
    for path, value in expected.items():
        if pickle.dumps(target.load(path)) != value:
            faults.append(f"{path.name} is read otherwise after the damaged ones")
    return done, faults, seconds


def outcome_within(memory: int, name: str, path: Path) -> str:
    """What becomes of one file, in the other process."""
    with bounded(memory):
        return outcome_of(TARGETS[name], path)


@contextmanager
def bounded(memory: int):
    """No more address space than there is, and so many MB."""
    bounds = resource.getrlimit(resource.RLIMIT_AS)
    size = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (size + memory * 2**20, bounds[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_AS, bounds)


def outcome_of(target: Target, path: Path) -> str:
    """One of `FINE`, or what went wrong; the process ends if it takes for ever."""
    watch = watched()
    watch.seen.clear()
    signal.signal(signal.SIGALRM, signal.SIG_DFL)
    signal.alarm(SECONDS)
    with warnings.catch_warnings(record=True) as warned:
        warnings.simplefilter("always")
        watch.is_on = True
        try:
            target.load(path)
            outcome = "loaded"
        except BaseException as error:
            outcome = _refusal(target, error, path)
        finally:
            watch.is_on = False
            signal.alarm(0)
    if warned:
        first = warned[0]
        return f"{first.category.__name__}: {first.message} ({first.filename}:{first.lineno})"
    return watch.seen[0] if watch.seen else outcome


def _refusal(target: Target, error: BaseException, path: Path) -> str:
    if type(error) is not target.error:
        where = error.__traceback__
        while where.tb_next:
            where = where.tb_next
        code = where.tb_frame.f_code
        return f"{type(error).__name__}: {str(error)[:200]} ({code.co_filename}:{where.tb_lineno})"
    if not any(str(place) in str(error) for place in (path, path.parent, path.parents[1])):
        return f"an error that does not name the file: {error}"
    if len(str(error)) > 2000:
        return f"an error of {len(str(error))} characters"
    while error is not None:
        if isinstance(error, MemoryError) or _NO_MEMORY.search(str(error)):
            return f"memory without bounds: {error!r}"
        error = error.__cause__ or error.__context__
    return "refused"


class OtherProcess:
    """One that is started anew when a file has ended it."""

    def __init__(self):
        self._pool = None

    def __call__(self, function, *arguments):
        if self._pool is None:
            spawn = multiprocessing.get_context("spawn")
            self._pool = ProcessPoolExecutor(1, mp_context=spawn)
        try:
            return self._pool.submit(function, *arguments).result()
        except BrokenProcessPool:
            self.close()
            raise

    def close(self):
        if self._pool is not None:
            self._pool.shutdown()
            self._pool = None


@pytest.fixture(scope="module")
def elsewhere():
    process = OtherProcess()
    yield process
    process.close()


@pytest.mark.parametrize("name", [*TARGETS])
def test_damaged_files_are_read_or_refused(name, elsewhere, tmp_path):
    n = max(round(TARGETS[name].n * FUZZ), 10)
    try:
        done, faults, seconds = elsewhere(fuzz, name, tmp_path, 0, n)
    except BrokenProcessPool:
        at, said = (tmp_path / "at").read_text(), (tmp_path / "stderr").read_text(errors="replace")
        pytest.fail(f"{tmp_path}: the process ended at file {at} of {name}: {said[:2000]}")
    print(f"{name}: {dict(done)} in {seconds:.1f} s")
    assert not faults, f"{len(faults)} of {n}, kept in {tmp_path}:\n" + "\n".join(faults[:20])
    assert done["loaded"] + done["refused"] == n
    assert done["refused"] > n / 10  # the damage is damage


def claims():
    """Small files that claim to be huge: name of the target, of the file, and its content."""
    for name, shape in {
        "landmarks": "(1000000, 68, 2)",
        "files of images": "(3, 99999, 99999)",
    }.items():
        header = f"{{'descr': '|u1', 'fortran_order': False, 'shape': {shape}, }}\n".encode()
        file = "0000.npy" if name == "files of images" else "a.npy"
        yield name, file, b"\x93NUMPY\x01\x00" + struct.pack("<H", len(header)) + header
    member = io.BytesIO()
    np.lib.format.write_array_header_1_0(
        member, {"descr": "<f8", "fortran_order": False, "shape": (10**9,)}
    )
    stored, pressed = io.BytesIO(), io.BytesIO()
    for archive, kind in ((stored, zipfile.ZIP_STORED), (pressed, zipfile.ZIP_DEFLATED)):
        with zipfile.ZipFile(archive, "w", kind) as opened:
            opened.writestr("mean.npy", member.getvalue() + bytes(1000))
    directory = bytearray(stored.getvalue())
    sizes = directory.rindex(b"PK\x01\x02") + 20
    directory[sizes : sizes + 8] = b"\xfe\xff\xff\xff" * 2  # of the member, packed and not
    for name in ("ICT, npz", "FLAME, npz", "data sets", "open head", "weights"):
        for content in (stored.getvalue(), pressed.getvalue(), bytes(directory)):
            yield name, "a.npz", content
    yield from (("pickles", "a.pkl", content) for content in LYING.values())
    nested = b"\x85" * 1_000_000, b"2\x86" * 60  # a tuple in a tuple in …, or twice in one
    yield from (("pickles", "a.pkl", b"\x80\x02})" + tuples + b"K\x01s.") for tuples in nested)
    for kind, body in (("ascii", b"1 2 3\n"), ("binary_little_endian", bytes(100))):
        for properties in (b"property float x\nproperty float y\nproperty float z\n", b""):
            header = f"ply\nformat {kind} 1.0\nelement vertex 4000000000\n".encode() + properties
            faces = b"element face 4000000000\nproperty list uchar int vertex_indices\n"
            yield "PLY", "a.ply", header + faces + b"end_header\n" + body
    for group in ({}, {"chunks": True}, {"chunks": True, "compression": "gzip"}):
        with h5py.File(io.BytesIO(), "w") as file:
            file.create_dataset("shape/model/mean", (2 * 10**9,), np.float32, **group)
            file.flush()
            yield "BFM 2017", "a.h5", file.id.get_file_image()
    flags = struct.pack("<IIII", 6, 8, 6, 0)
    for dimensions in ((2**31 - 1, 1), (2**31 - 1, 2**31 - 1)):
        for kind in (flags, flags.replace(b"\6", b"\1").replace(b"\1", b"\6", 1)):  # cells
            array = kind + struct.pack("<IIii", 5, 8, *dimensions)
            array += struct.pack("<II8s", 1, 7, b"shapeMU") + struct.pack("<IId", 9, 8, 1.5)
            element = struct.pack("<II", 14, len(array)) + array
            packed = zlib.compress(struct.pack("<II", 14, 2**32 - 8) + array)
            for tagged in (element, struct.pack("<II", 15, len(packed)) + packed):
                yield "BFM 2009", "a.mat", b"MATLAB 5.0".ljust(124) + b"\0\1IM" + tagged
    for content in huge_images():
        for name in ("photos", "CelebA's images"):
            yield name, "a.jpg", content
    yield "landmarks", "a.pts", b"version: 1\nn_points: 4000000000\n{\n1 2\n}\n"
    yield "landmarks", "a.csv", b"x,y\n" + b"1,2\n" * 51 + b"," * 100_000
    yield "landmarks", "a.json", b"[" * 100_000


def huge_images():
    """Of 60,000 pixels a side, or 20,000."""
    for kind, place, form in (
        *(("BMP", 18, "<ii"), ("GIF", 6, "<HH"), ("PNG", 16, ">II"), ("TGA", 12, "<HH")),
        *(("JPEG", None, ">HH"), ("PPM", None, "")),
    ):
        for side in (20_000, 60_000):
            written = io.BytesIO()
            Image.fromarray(PIXELS).save(written, kind)
            content = bytearray(written.getvalue())
            if kind == "PPM":
                content = content.replace(b"40 36", b"%d %d" % (side, side))
            else:
                place = content.index(b"\xff\xc0") + 5 if kind == "JPEG" else place
                struct.pack_into(form, content, place, side, side)
            if kind == "PNG":
                struct.pack_into(">I", content, 29, zlib.crc32(content[12:29]))
            yield bytes(content)


def test_a_small_file_that_claims_to_be_huge_is_refused_at_no_cost(elsewhere, tmp_path):
    for i, (name, file, content) in enumerate(claims()):
        path = tmp_path / str(i) / file
        path.parent.mkdir()
        path.write_bytes(content)
        found = elsewhere(outcome_within, 256, name, path)
        assert found == "refused", f"{i}, {name}: {found} {content[:200]}"
    assert i > 60


def test_one_endless_word_costs_its_length_once(elsewhere, tmp_path):
    write_ict(tmp_path, write_ict_folder)
    file = tmp_path / "FaceXModel" / "generic_neutral_mesh.obj"
    for word in ("v 1 2 " + "3" * 300_000, "f 1 2 " + "3" * 300_000):
        file.write_text("v 1 2 3\nf 1 2 3\n" * 3000 + word)
        assert elsewhere(outcome_within, 256, "ICT, folder", file) == "refused"


def hostile(harm):
    """Pickles that make a file or folder when they are run, and what else may run something."""
    calls = (
        Calls(os.system, f"touch {harm}"),
        Calls(os.mkdir, str(harm)),
        Calls(eval, f"__import__('os').mkdir({str(harm)!r})"),
        Calls(functools.partial, os.mkdir, str(harm)),
    )
    for call in calls:
        yield from (pickle.dumps([call], protocol) for protocol in (0, 2, 4))
        array = np.array([call], object)
        written = io.BytesIO()
        np.save(written, array, allow_pickle=True)
        yield written.getvalue()
        names = ("mean", "landmarks", "description", "v_template", "encode_1/kernel")
        written = io.BytesIO()
        np.savez(written, allow_pickle=True, **dict.fromkeys(names, array))
        yield written.getvalue()
    # Python's own way to make an array, given another class or a state that calls.
    system = b"cposix\nsystem\n(X" + struct.pack("<I", 6 + len(str(harm))) + b"touch "
    system += str(harm).encode() + b"tR"
    make = b"\x80\x02cnumpy.core.multiarray\n_reconstruct\n"
    yield make + b"(" + system + b"K\0\x85U\1btR."
    yield make + b"(cnumpy\nndarray\nK\0\x85U\1btR(K\1)" + system + b"\x89U\0tb."
    yield b"\x80\x02ccopyreg\n_reconstructor\n(cposix\nsystem\nc__builtin__\nobject\nNtR" + (
        b"}" + system + b"K\1sb."
    )
    yield b"\x80\x02c__builtin__\nset\n(]" + system + b"atR."
    # Pillow would have Ghostscript run it.
    yield (
        b"%!PS-Adobe-3.0 EPSF-3.0\n%%BoundingBox: 0 0 40 40\n%%EndComments\n"
        b"(" + str(harm).encode() + b") (w) file closefile\nshowpage\n%%EOF\n"
    )


def test_nothing_in_a_file_is_run(elsewhere, tmp_path):
    harm = tmp_path / "harm"
    for name, target in TARGETS.items():
        if name in HEAVY:
            continue
        whole = tmp_path / name
        whole.mkdir()
        target.write(whole)
        (file, *_) = (path for path in sorted(whole.rglob("*")) if path.is_file())
        for content in hostile(harm):
            file.write_bytes(content)
            found = elsewhere(outcome_within, 1000, name, file)
            assert not harm.exists()
            assert found in FINE, f"{name}: {found} {content[:80]}"
    pickle.loads(next(hostile(harm)))
    assert harm.exists()  # they are hostile
