"""Step: writes the head of `deepmds predict --mesh`, and measures the errors of its meshes."""

from collections.abc import Iterator

import numpy as np
import pandas as pd
from vtkmodules.util.numpy_support import numpy_to_vtk, numpy_to_vtkIdTypeArray, vtk_to_numpy
from vtkmodules.vtkCommonCore import vtkDoubleArray, vtkPoints
from vtkmodules.vtkCommonDataModel import vtkCellArray, vtkPolyData
from vtkmodules.vtkFiltersCore import vtkImplicitPolyDataDistance

from data_gen.build_openhead.components import write_surface
from data_gen.models.morphable_model import MorphableModel
from data_gen.models.openhead import read_openhead
from data_gen.models.registry import OPEN, TITLES, load_model, open_models
from data_gen.views import sample_expressive, sample_photo_cameras
from deepmds_keras.errors import InputError
from deepmds_keras.geometry.alignment import align, procrustes
from deepmds_keras.geometry.views import project
from deepmds_keras.lifting.lifter import LandmarkLifter
from deepmds_keras.tool.predict.mesh import FILE, fit_surfaces, surface_landmarks
from experiments.progress import counted
from experiments.run import Run
from experiments.streams import Stream
from experiments.studies.study_results import write_results

_SCHEME, _N_FACES, _SEED = "ibug51", 200, 0
_ERROR_MM, _VIEW_ERROR_MM = 2, 3  # of each coordinate of landmarks, and of those in a view
_FRONT = 30  # mm from the axis of the head
_HALF = 127  # of a mask


def main(run: Run) -> dict:
    missing = open_models(run.data)[1]
    if missing:
        raise InputError(
            f"DATA must be a folder with {', '.join(missing)}, see docs/data.md: the table has "
            f"rows for both open face models. Received {run.data or 'nothing'}."
        )
    write_surface(FILE)
    table = pd.DataFrame(
        {"faces": name} | row
        for name in counted("face model", OPEN, len(OPEN))
        for row in measure(load_model(name, run.data))
    )
    cells = table.assign(faces=table["faces"].map(TITLES)).set_index(["faces", "landmarks"])
    cells = cells.map("{:.2f}".format).rename(columns=lambda name: name.replace("_", " "))
    return write_results(run, "surface", {"table": table}, cells)


def measure(model: MorphableModel, n: int = _N_FACES) -> Iterator[dict]:
    """Measure heads that are fitted to the landmarks of random faces, mean distances in mm.

    Yields:
        The kind of landmarks; the distance of the face's vertices, without the eyes and the inside
        of the mouth, from the true surface, for the aligned mean head and for the fitted ones; and
        the distance of the latter from the given landmarks.
    """
    rng = np.random.default_rng([_SEED, Stream.SURFACES])
    true = model.shape(*sample_expressive(model, n, rng))
    head, vertices = read_openhead(), surface_landmarks(_SCHEME)
    mean, skin = head["mean"], (head["part"] == 0) & (head["mask_inside_mouth"] == 0)
    face = skin & (head["mask_face"] > _HALF) & (mean[:, 2] > _FRONT)
    for kind, given in _given(true[:, model.landmarks[_SCHEME]], rng):
        fitted = fit_surfaces(given, _SCHEME)
        landmarks = np.tile(mean[vertices], (n, 1, 1))
        rotation, scale, shift = procrustes(landmarks, given, reflection=False)
        means = scale[:, None, None] * (mean @ rotation) + shift[:, None]
        yield {
            "landmarks": kind,
            "mean_head_to_surface": _distance(means[:, face], true, model.triangles),
            "mesh_to_surface": _distance(fitted[:, face], true, model.triangles),
            "mesh_to_landmarks": np.linalg.norm(fitted[:, vertices] - given, axis=2).mean(),
        }


def _given(true: np.ndarray, rng: np.random.Generator) -> Iterator[tuple[str, np.ndarray]]:
    """Landmarks `(n, L, 3)` of several kinds, from the true ones, with their description."""
    yield "exact", true
    yield f"off by {_ERROR_MM} mm a coordinate", true + rng.normal(0, _ERROR_MM, true.shape)
    views = project(true, sample_photo_cameras(len(true), rng))
    lifter = LandmarkLifter.pretrained(_SCHEME)
    yield "lifted from exact views", align(lifter.predict(views, landmark_sd=0), true)
    views = views + rng.normal(0, _VIEW_ERROR_MM, views.shape)
    shapes = align(lifter.predict(views, landmark_sd=_VIEW_ERROR_MM), true)
    yield f"lifted from views off by {_VIEW_ERROR_MM} mm a coordinate", shapes


def _distance(points: np.ndarray, surfaces: np.ndarray, triangles: np.ndarray) -> float:
    """Mean distance of points `(n, P, 3)` from the surfaces `(n, V, 3)`."""
    distances = []
    for some, vertices in zip(points, surfaces, strict=True):
        surface, corners, cells = vtkPolyData(), vtkPoints(), vtkCellArray()
        corners.SetData(numpy_to_vtk(np.ascontiguousarray(vertices)))
        starts = numpy_to_vtkIdTypeArray(np.arange(0, triangles.size + 1, 3))
        cells.SetData(starts, numpy_to_vtkIdTypeArray(np.ascontiguousarray(triangles.ravel())))
        surface.SetPoints(corners), surface.SetPolys(cells)
        measured, distance = vtkDoubleArray(), vtkImplicitPolyDataDistance()
        distance.SetInput(surface)
        distance.FunctionValue(numpy_to_vtk(np.ascontiguousarray(some, float)), measured)
        distances.append(np.abs(vtk_to_numpy(measured)).mean())
    return float(np.mean(distances))
