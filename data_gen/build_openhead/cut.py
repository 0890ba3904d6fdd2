"""Cuts the head out of MakeHuman's body: triangles, parts, regions, landmarks, pupils.

`kept_faces.csv` lists the faces that stay. It was made once by rendering every face of body, eyes
and teeth above base y = 590 mm (without the shoulders: |x| > 44 mm below y = 622 mm) in a separate
colour, from many directions and with six expressions. A face stays if it covered three pixels or
more, its mirror image did or it touches one that did; so do all faces above y = 752 mm, body faces
behind z = 20 mm and all teeth, or the crown would have holes. The upper mouth vestibule goes,
because it pokes through the base of the nose at 1.5 s.d.: inside the mouth, above y = 680 mm and in
front of z = 110 mm on the average adult. The list is data, not code, so that the build gives the
same vertices on every graphics driver.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from data_gen.build_openhead.makehuman import MakeHumanAssets
from deepmds_keras.files import read_table

KEPT_FACES, LANDMARKS = (Path(__file__).parent / f"{n}.csv" for n in ("kept_faces", "landmarks"))
# base.obj closes the front of each eyeball by a flat octagon without a centre.
RIGHT_PUPIL_RING = np.arange(14670, 14734, 9)
LEFT_PUPIL_RING = np.arange(14598, 14662, 9)
RIGHT_PUPIL, LEFT_PUPIL = -1, -2  # their names in landmarks.csv
# By number of the part.
PARTS = ("body", "helper-r-eye", "helper-l-eye", "helper-upper-teeth", "helper-lower-teeth")
MASKS = ("lips", "face", "ears", "eyelids", "inside-mouth")


@dataclass(frozen=True, eq=False)
class Head:
    """Part of the base mesh that stays; V vertices, the last two being the right and left pupil.

    Attributes:
        base_vertex: `(V,)` int, vertex of base.obj, or RIGHT_PUPIL and LEFT_PUPIL.
        triangles: `(T, 3)` int, counter-clockwise seen from outside.
        part: `(V,)` int, index into PARTS.
        mirror: `(V,)` int, the vertex on the other side.
        uv: `(V, 2)` float, texture coordinates; zero at the pupils.
        masks: Region name to `(V,)` float in [0, 1], mirror-symmetric.
        landmarks: Scheme name to `(L,)` int vertices.
    """

    base_vertex: np.ndarray
    triangles: np.ndarray
    part: np.ndarray
    mirror: np.ndarray
    uv: np.ndarray
    masks: dict[str, np.ndarray]
    landmarks: dict[str, np.ndarray]

    def restrict(self, field: np.ndarray) -> np.ndarray:
        """`(V_base, 3)` positions or offsets of the body → `(V, 3)` of the head.

        A pupil is the mean of its ring; being linear, this holds under every target.
        """
        pupils = [field[RIGHT_PUPIL_RING].mean(0), field[LEFT_PUPIL_RING].mean(0)]
        return np.vstack([field[self.base_vertex[:-2]], pupils])

    def reflect(self, vertices: np.ndarray) -> np.ndarray:
        """The mirror images of `(..., V, 3)` heads."""
        return vertices[..., self.mirror, :] * np.array([-1, 1, 1], vertices.dtype)


def average_adult(assets: MakeHumanAssets) -> np.ndarray:
    """`(V_base, 3)`: the mean of MakeHuman's young adults of both sexes and three origins."""
    average = assets.vertices.copy()
    for sex in ("female", "male"):
        for origin in ("african", "asian", "caucasian"):
            average += assets.target(f"macrodetails/{origin}-{sex}-young") / 6
        build = f"macrodetails/universal-{sex}-young-averagemuscle-averageweight"
        average += assets.target(build) / 2
    return average


def cut_head(assets: MakeHumanAssets) -> Head:
    """The head of the base mesh, its pupils added and its quads split."""
    runs = [(int(row["first"]), int(row["last"])) for row in read_table(KEPT_FACES)]
    kept = np.concatenate([np.arange(first, last + 1) for first, last in runs])
    quads, groups = assets.faces[kept], assets.groups[kept]
    base_vertex = np.unique(quads)
    n = len(base_vertex)
    number = np.full(len(assets.vertices), -1)
    number[base_vertex] = np.arange(n)

    average = average_adult(assets)
    triangles = [
        number[split_quads(quads, average)],
        pupil_fan(number[RIGHT_PUPIL_RING], n, average[RIGHT_PUPIL_RING]),
        pupil_fan(number[LEFT_PUPIL_RING], n + 1, average[LEFT_PUPIL_RING]),
    ]
    part = np.array([*np.zeros(n, int), *(PARTS.index(f"helper-{side}-eye") for side in "rl")])
    for code, group in enumerate(PARTS):
        part[number[quads[groups == group]]] = code

    mirror = np.append(number[assets.mirror[base_vertex]], [n + 1, n])
    uv = np.zeros((len(assets.vertices), 2))
    uv[assets.faces.ravel()] = assets.uv[assets.face_uv.ravel()]
    masks = {}
    for name in MASKS:
        mask = np.append(assets.mask(name)[base_vertex], [0.0, 0.0])
        masks[name.replace("-", "_")] = (mask + mask[mirror]) / 2
    landmarks: dict[str, list[int]] = {}
    with_pupils = np.append(number, [n + 1, n])  # at RIGHT_PUPIL and LEFT_PUPIL
    for row in read_table(LANDMARKS):
        landmarks.setdefault(row["scheme"], []).append(with_pupils[int(row["base_vertex"])])
    return Head(
        base_vertex=np.append(base_vertex, [RIGHT_PUPIL, LEFT_PUPIL]),
        triangles=np.vstack(triangles),
        part=part,
        mirror=mirror,
        uv=np.vstack([uv[base_vertex], np.zeros((2, 2))]),
        masks=masks,
        landmarks={scheme: np.array(vertices) for scheme, vertices in landmarks.items()},
    )


def split_quads(quads: np.ndarray, vertices: np.ndarray) -> np.ndarray:
    """`(F, 4)` quads → `(2F, 3)` triangles along the shorter diagonal."""
    a, b, c, d = np.moveaxis(vertices[quads], 1, 0)
    along_ac = ((a - c) ** 2).sum(1) <= ((b - d) ** 2).sum(1)
    pairs = np.where(
        along_ac[:, None, None], quads[:, [[0, 1, 2], [0, 2, 3]]], quads[:, [[0, 1, 3], [1, 2, 3]]]
    )
    return pairs.reshape(-1, 3)


def pupil_fan(ring: np.ndarray, centre: int, positions: np.ndarray) -> np.ndarray:
    """`(8, 3)` triangles from a ring of vertices to a new centre, facing +z.

    `ring` `(8,)` has vertex numbers in order around the pupil, at `positions` `(8, 3)`.
    """
    x, y = (positions - positions.mean(0))[:, :2].T
    area = (x * np.roll(y, -1) - np.roll(x, -1) * y).sum()
    following = np.roll(ring, -1)
    first, second = (ring, following) if area > 0 else (following, ring)
    return np.column_stack([first, second, np.full(len(ring), centre)])
