"""The FLAME track on files in the layouts of FLAME, CoMA and CASIA-3D, made from the open head."""

import pickle

import numpy as np
import pytest
import runs
from PIL import Image
from writers.models import corners_of, flame_arrays
from writers.scans import vrml, write_ply

from data_gen.datasets.dataset import load_dataset, make_performances
from data_gen.models.registry import load_model
from deepmds_keras.files import read_npz

N_FRAMES, N_SCANS = 40, 4


def run(step, folder, *more):
    options = ("--track", "flame", "--model", "flame", "--data", str(folder / "data"))
    record = work_of(folder) / "records" / f"{step.partition('.')[2]}.json"
    return runs.run(step, folder, *more, *options, "--record", str(record))


def work_of(folder):
    """Folder of the arrays, which says that the data sets were found in `DATA=`."""
    return folder / "build" / "flame" / "flame-tiny-paper-seed0-coma-casia"


def write_flame(folder, model):
    """The open head as `generic_model.pkl`; its expressions take the place of FLAME's."""
    shapedirs = np.zeros((model.n_vertices, 3, 400))
    for start, basis in ((0, model.identity_basis_times_sd), (300, model.expression_basis)):
        shapedirs[..., start : start + len(basis)] = np.moveaxis(basis, 0, -1) / 1e3
    still = np.eye(5)[np.zeros(model.n_vertices, int)]  # nothing follows the jaw
    arrays = flame_arrays(model.mean / 1e3, model.triangles, shapedirs=shapedirs, weights=still)
    (folder / "generic_model.pkl").write_bytes(pickle.dumps(arrays, 2))
    triangles, weights = corners_of(model.landmarks["ibug51"], model.triangles)
    embedding = {"lmk_face_idx": triangles.astype(np.uint32), "lmk_b_coords": weights}
    (folder / "flame_static_embedding.pkl").write_bytes(pickle.dumps(embedding, 0))


def write_coma(folder, model):
    """Frames as PLY meshes; one is cut short."""
    frames = make_performances(model, 1, N_FRAMES, np.random.default_rng(0))
    sequence = folder / "CoMA" / "FaceTalk_170725_00137_TA" / "bareteeth"
    shapes = np.float32(model.shape(*frames) / 1e3)
    files = [
        write_ply(sequence / f"bareteeth.{k:06}.ply", vertices, model.triangles)
        for k, vertices in enumerate(shapes, 1)
    ]
    files[6].write_bytes(files[6].read_bytes()[:5000])


def write_casia(folder, scans):
    """Photos and clouds of points, in the frame of a camera that looks along +z, y down."""
    photos, clouds = (
        folder / "CASIA-3D-FaceV1" / f"3D-Face-{kind}" / "001" for kind in ("BMP", "WRL")
    )
    for scan in scans:
        for place in (photos, clouds):
            place.mkdir(parents=True, exist_ok=True)
        Image.fromarray(scan.image).save(photos / f"{scan.name}.bmp")
        points = scan.points * (1, -1, -1) + (0, 0, 800)
        (clouds / f"{scan.name}.wrl").write_text(vrml(points.round(3)))


def make_scans():
    from data_gen.datasets.scans_substitute import ScansSubstitute

    return ScansSubstitute(load_model("openhead", scheme="ibug51"), 1, N_SCANS, [0, 5]).subject(0)


pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def scans(apart):
    return apart(make_scans)


@pytest.fixture(scope="module")
def folder(tmp_path_factory, scans):
    folder = tmp_path_factory.mktemp("licensed")
    (folder / "data").mkdir()
    model = load_model("openhead", scheme="ibug51")
    write_flame(folder / "data", model)
    write_coma(folder / "data", model)
    write_casia(folder / "data", scans)
    return folder


def test_frames_are_those_of_coma_but_for_the_one_that_is_cut_short(folder):
    done = run("datasets.frames", folder)
    assert done.returncode == 0, done.stderr
    assert "1 meshes skipped" in done.stdout
    work = work_of(folder)
    assert "bareteeth.000007.ply" in (work / "frames-skipped.txt").read_text()
    train = load_dataset(work / "train.npz")
    model = load_model("openhead", scheme="ibug51")
    frames = make_performances(model, 1, N_FRAMES, np.random.default_rng(0))
    landmarks = model.at_landmarks("ibug51")
    expected = np.delete(landmarks.shape(*frames), 6, axis=0)
    assert np.allclose(train.landmarks, expected, atol=1e-3)


def test_scans_are_those_of_casia_that_the_index_names(folder, scans):
    work = work_of(folder)
    done = run("datasets.scans", folder)
    assert done.returncode == 0, done.stderr
    index = work / "casia-index.csv"
    assert f"copy {index.relative_to(folder)} to another folder" in done.stdout
    assert index.read_text().count(",yes,") == N_SCANS
    found = read_npz(work / "scans.npz")
    used = found["status"] == "used"
    assert used.sum() >= N_SCANS - 1 and "truth" not in found
    truth = np.array([scan.truth for scan in scans])[used]
    assert 0.5 < np.linalg.norm(found["landmarks"] - truth, axis=2).mean() < 8

    chosen = folder / "chosen.csv"
    chosen.write_text(index.read_text().replace("001,2,yes", "001,2,no"))
    done = run("datasets.scans", folder, "--casia-index", str(chosen))
    assert done.returncode == 0, done.stderr
    assert [*read_npz(work / "scans.npz")["name"]] == ["001-001", "001-003", "001-004"]
    refused = run("datasets.scans", folder, "--casia-index", "/nowhere.csv")
    assert refused.returncode == 2
    assert "/nowhere.csv" in refused.stderr.splitlines()[-1]


def test_the_licensed_ringnet_is_run_on_the_photos(folder):
    """A graph of its tensors' names and shapes, whose vertices are linear in the mean colours."""
    # Here, since the process that draws imports this module, and may not load TensorFlow.
    from writers.ringnet import write_checkpoint

    prefix = folder / "ring_6_68641"
    write_checkpoint(prefix)
    done = run("tracks.predict", folder, "ringnet_licensed", "--ringnet", str(prefix))
    assert done.returncode == 0, done.stderr
    work = work_of(folder)
    shapes = read_npz(work / "predictions" / "ringnet_licensed.npz")["shapes"]
    assert shapes.shape == (len(load_dataset(work / "test.npz")), 51, 3)
    assert len(np.unique(shapes[:, 0, 0])) == len(shapes)
    nothing = str(folder / "nothing")
    refused = run("tracks.predict", folder, "ringnet_licensed", "--ringnet", nothing)
    assert refused.returncode == 2
    assert "nothing.meta does not exist" in refused.stderr.splitlines()[-1]
