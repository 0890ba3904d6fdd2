"""Reads the embedded open head model, built from CC0 MakeHuman assets by `build_openhead`."""

from pathlib import Path

import numpy as np

from data_gen.landmarks import load_vertices
from data_gen.models.morphable_model import BLENDSHAPE_SD, MorphableModel, model_of
from deepmds_keras.files import read_npz, sha256_of

OPENHEAD = Path(__file__).parents[1] / "assets" / "openhead.npz"
_KIND = "an open head model (python -m data_gen.build_openhead makes one)"


def load_openhead(path: Path = OPENHEAD) -> MorphableModel:
    """The open head: 3,765 vertices, 199 identity components, 51 expressions, mm.

    Its nose tip is at (0, 4.4, 131) mm, as in the Basel Face Model.

    Raises:
        InputError: The file is missing or damaged.
    """
    arrays = read_openhead(path)
    of_ibug = arrays["landmarks68"].astype(int)
    return model_of(
        path,
        name="openhead",
        mean=arrays["mean"].astype(float),
        identity_basis_times_sd=arrays["identity_basis_times_sd"].astype(float),
        triangles=arrays["triangles"].astype(int),
        landmarks={
            "bfm72": arrays["landmarks72"].astype(int),
            "ibug68": of_ibug,
            "ibug51": of_ibug[np.array(load_vertices("ibug51").numbers) - 1],
        },
        expression_basis=arrays["expression_basis"].astype(float),
        expression_names=tuple(arrays["expression_names"].tolist()),
        expression_sd=BLENDSHAPE_SD,
        sha256=sha256_of([path]),
    )


def read_openhead(path: Path = OPENHEAD) -> dict[str, np.ndarray]:
    """All arrays of the file, for what the shape model leaves out.

    `part` `(V,)` is 0 skin, 1 and 2 right and left eye, 3 and 4 upper and lower teeth; `mask_lips`,
    `mask_face`, `mask_ears`, `mask_eyelids` and `mask_inside_mouth` `(V,)` are 0 to 255. Nothing
    here reads `mirror` `(V,)`, the vertex on the other side, `uv` `(V, 2)` and `base_vertex`
    `(V,)`, the vertex of MakeHuman's base.obj (-1 and -2: right and left pupil, which it lacks).

    Raises:
        InputError: The file is missing or damaged.
    """
    return read_npz(path, _KIND)
