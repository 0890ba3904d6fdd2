"""Files of face models."""

from __future__ import annotations

import h5py
import numpy as np
from scipy.io import savemat


def write_mat(folder, arrays):
    file = folder / "PublicMM1" / "01_MorphableModel.mat"
    file.parent.mkdir(exist_ok=True)
    savemat(file, arrays, do_compression=True)
    return file


def write_h5(folder, arrays, filename="model2017-1_bfm_nomouth.h5"):
    with h5py.File(folder / filename, "w") as file:
        for key, value in arrays.items():
            file[key] = value
    return folder / filename


def write_obj(file, vertices, faces=()):
    text = ["mtllib ICTFaceModelMaterial.mtl"]
    text += ["v {:.6f} {:.6f} {:.6f}".format(*row) for row in vertices]
    text += ["vt 0.5 0.5"] * 4
    text += ["f " + " ".join(f"{i + 1}/{i % 4 + 1}" for i in face) for face in faces]
    file.write_text("\n".join(text) + "\n")


def write_ict_folder(folder, arrays):
    model = folder / "FaceXModel"
    model.mkdir()
    neutral = arrays["mean"]
    write_obj(model / "generic_neutral_mesh.obj", neutral, arrays["quads"])
    for k, offset in enumerate(arrays["identity"]):
        write_obj(model / f"identity{k:03d}.obj", neutral + offset, arrays["quads"])
    for name, offset in zip(arrays["expression_names"], arrays["expression"], strict=True):
        write_obj(model / f"{name}.obj", neutral + offset, arrays["quads"])
    return model


def write_ict_npz(folder, arrays, **changes):
    quads = np.array(arrays["quads"])
    fields = {
        "mean": arrays["mean"].astype(np.float32),
        "identity": arrays["identity"].astype(np.float32),
        "expression": arrays["expression"].astype(np.float32),
        "expression_names": np.array(arrays["expression_names"]),
        "triangles": quads[:, [0, 1, 2, 0, 2, 3]].reshape(-1, 3).astype(np.int32),
        "vertex_index": np.arange(len(arrays["mean"]), dtype=np.int32),
    } | changes
    np.savez(folder / "ict_light.npz", **fields)
    return folder / "ict_light.npz"
