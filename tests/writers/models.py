"""Files of face models."""

from __future__ import annotations

import pickle

import h5py
import numpy as np
from scipy.io import savemat
from scipy.sparse import csc_matrix

from data_gen.landmarks import load_vertices
from data_gen.models.ict import KEPT, N_VERTICES


def write_mat(folder, arrays):
    file = folder / "01_MorphableModel.mat"
    savemat(file, arrays, do_compression=True)
    return file


def write_bfm2009(folder, mean):
    """A file of the real size, with landmarks at `(72, 3)` millimetres and little variation."""
    n, vertices = 53490, load_vertices("bfm72").vertices["bfm2009"]
    points, offsets = np.zeros((2, n, 3), np.float32)
    points[vertices] = 1000 * mean
    offsets[vertices] = np.random.default_rng(0).normal(size=(72, 3))
    arrays = {
        "shapeMU": points.reshape(-1, 1),
        "shapePC": offsets.reshape(-1, 1),
        "shapeEV": np.array([[1500.0]]),
        "tl": np.array([[1, 2, n]]),
    }
    arrays |= {f"tex{key[5:]}": arrays[key] for key in ("shapeMU", "shapePC", "shapeEV")}
    return write_mat(folder, arrays)


def write_h5(folder, arrays):
    path = folder / "model2017-1_bfm_nomouth.h5"
    with h5py.File(path, "w") as file:
        for key, value in arrays.items():
            file[key] = value
    return path


def write_ict_folder(folder, arrays):
    """The official layout: all 26,719 vertices, those of gums and shells too."""
    folder = folder / "FaceXModel"
    folder.mkdir()
    faces = [" ".join(f"{i + 1}/{i % 4 + 1}" for i in face) for face in arrays["faces"]]
    names = [f"identity{k:03d}" for k in range(len(arrays["identity"]))]
    offsets = dict(zip(names, arrays["identity"], strict=True))
    offsets |= dict(zip(arrays["expression_names"], arrays["expression"], strict=True))
    for name, offset in {"generic_neutral_mesh": np.zeros((N_VERTICES, 3)), **offsets}.items():
        vertices = (arrays["mean"] + offset).tolist()
        text = [
            "mtllib ICTFaceModelMaterial.mtl",
            *("v {!r} {!r} {!r}".format(*v) for v in vertices),
        ]
        text += ["vt 0.5 0.5"] * 4 + [f"f {face}" for face in faces]
        (folder / f"{name}.obj").write_text("\n".join(text) + "\n")
    return folder


def write_ict_npz(folder, arrays, **changes):
    """The same compiled, without the vertices that are of no use."""
    mean = np.float32(arrays["mean"])
    number = np.full(N_VERTICES, -1)
    number[KEPT] = np.arange(len(KEPT))
    faces = number[np.array(arrays["faces"])]
    faces = faces[(faces >= 0).all(axis=1)]
    fields = {
        "mean": mean[KEPT],
        **{
            k: (np.float32(arrays["mean"] + arrays[k]) - mean)[:, KEPT]
            for k in ("identity", "expression")
        },
        "expression_names": np.array(arrays["expression_names"]),
        "triangles": faces[:, [0, 1, 2, 0, 2, 3]].reshape(-1, 3).astype(np.int32),
        "vertex_index": KEPT.astype(np.int32),
    }
    np.savez(folder / "ict_light.npz", **fields | changes)
    return folder / "ict_light.npz"


def write_3ddfa(folder, face_model):
    """A checkout of 3DDFA with another face model's landmarks and first components.

    Its identity varies as in that model, and its ten expressions are components too.
    """
    n_vertices, landmarks = 53_215, face_model.at_landmarks("ibug68")
    offsets = 1000 * landmarks.identity_basis_times_sd[:50].reshape(50, -1).astype(float)
    configs, weights = folder / "train.configs", folder / "c++" / "weights"
    for place in (configs, weights):
        place.mkdir(parents=True)
    vertices = np.random.default_rng(0).permutation(n_vertices)[: len(landmarks.mean)]
    rows = (3 * vertices[:, None] + np.arange(3)).ravel()
    mean = np.zeros((3 * n_vertices, 1), np.float32)
    mean[rows, 0] = 1000 * landmarks.mean.ravel()
    np.save(configs / "u_shp.npy", mean)
    np.save(configs / "u_exp.npy", np.full_like(mean, 5.0))
    np.save(configs / "keypoints_sim.npy", rows)
    sd = np.linspace(9e5, 1e5, 40)
    np.savetxt(weights / "w_shp_base.txt", (offsets[:40] / sd[:, None]).T)
    np.savetxt(weights / "w_exp_base.txt", offsets[40:].T)
    parameters = {
        "param_mean": np.r_[np.full(52, 7.0), np.full(10, 0.5)].astype(np.float32),
        "param_std": np.r_[np.ones(12), sd, np.full(10, 2.0)].astype(np.float32),
    }
    (configs / "param_whitening.pkl").write_bytes(pickle.dumps(parameters, protocol=2))
    return folder


def flame_arrays(vertices, triangles, **given):
    """Contents of `generic_model.pkl`, of vertices in metres; what is not given moves nothing."""
    n = len(vertices)
    return {
        "v_template": vertices,
        "f": triangles.astype(np.uint32),
        "shapedirs": np.zeros((n, 3, 400)),
        "posedirs": np.zeros((n, 3, 36)),
        "J_regressor": csc_matrix(np.full((5, n), 1 / n)),
        "kintree_table": np.array([[2**32 - 1, 0, 1, 1, 1], range(5)], np.uint32),
        "weights": np.full((n, 5), 0.2),
        "bs_style": "lbs",
    } | given


def corners_of(vertices, triangles):
    """Vertices as FLAME has landmarks: a triangle of each, and the weights of its corners."""
    numbers = np.array([np.flatnonzero((triangles == v).any(1))[0] for v in vertices])
    return numbers, (triangles[numbers] == vertices[:, None]).astype(float)
