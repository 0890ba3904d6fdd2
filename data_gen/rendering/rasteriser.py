"""Draws coloured triangles with VTK, off-screen, without a display or a GPU."""

from __future__ import annotations

import ctypes.util
import os
import sys

import numpy as np
import vtkmodules.vtkRenderingOpenGL2  # noqa: F401 (what the classes below are drawn by)
from vtkmodules.util.numpy_support import numpy_to_vtk, numpy_to_vtkIdTypeArray, vtk_to_numpy
from vtkmodules.vtkCommonCore import vtkPoints, vtkUnsignedCharArray
from vtkmodules.vtkCommonDataModel import vtkCellArray, vtkPolyData
from vtkmodules.vtkRenderingCore import (
    vtkActor,
    vtkPolyDataMapper,
    vtkRenderer,
    vtkRenderWindow,
)

from deepmds_keras.errors import InputError

BACKGROUND = 255  # white, as in the authors' images
# By which system library VTK draws without a display, the preferred first.
_WINDOWS = {"EGL": "vtkEGLRenderWindow", "OSMesa": "vtkOSOpenGLRenderWindow"}


class Rasteriser:
    """Draws one coloured mesh after the other, all of the same triangles.

    Args:
        n_vertices: V.
        triangles: `(T, 3)` int, 0-based.
        pixels: Width and height of the images.
        by_triangle: Whether colours are those of triangles instead of vertices; `draw_numbers`
            needs it.

    Raises:
        InputError: The system library that draws is missing.
    """

    def __init__(
        self, n_vertices: int, triangles: np.ndarray, pixels: int, *, by_triangle: bool = False
    ):
        _choose_window()
        self._pixels = pixels
        self._points = np.zeros((n_vertices, 3), np.float32)
        self._colours = np.zeros((len(triangles) if by_triangle else n_vertices, 3), np.uint8)
        # VTK reads these arrays in place.
        self._vtk_points, self._vtk_colours = vtkPoints(), numpy_to_vtk(self._colours)
        self._vtk_points.SetData(numpy_to_vtk(self._points))
        cells = vtkCellArray()
        cells.SetData(3, numpy_to_vtkIdTypeArray(np.array(triangles, np.int64).ravel(), deep=True))
        mesh = vtkPolyData()
        mesh.SetPoints(self._vtk_points)
        mesh.SetPolys(cells)
        data = mesh.GetCellData() if by_triangle else mesh.GetPointData()
        data.SetScalars(self._vtk_colours)
        mapper = vtkPolyDataMapper()
        mapper.SetInputData(mesh)
        actor = vtkActor()
        actor.SetMapper(mapper)
        actor.GetProperty().LightingOff()  # the colours are lit already
        renderer = vtkRenderer()
        renderer.SetBackground([BACKGROUND / 255] * 3)
        renderer.AddActor(actor)
        self._camera = renderer.GetActiveCamera()
        self._camera.ParallelProjectionOn()
        self._camera.SetParallelScale(pixels / 2)
        self._window = vtkRenderWindow()
        self._window.SetOffScreenRendering(True)
        self._window.SetMultiSamples(0)
        self._window.SetSize(pixels, pixels)
        self._window.AddRenderer(renderer)
        self._image = vtkUnsignedCharArray()

    def draw(self, places: np.ndarray, depth: np.ndarray, colours: np.ndarray) -> np.ndarray:
        """One image.

        Args:
            places: `(V, 2)` pixels, x right and y down.
            depth: `(V,)`, growing towards the viewer.
            colours: `(V, 3)` or, by triangle, `(T, 3)` uint8.

        Returns:
            `(pixels, pixels, 3)` uint8.
        """
        return self.draw_cut_out(places, depth, colours)[..., :3]

    def draw_cut_out(
        self, places: np.ndarray, depth: np.ndarray, colours: np.ndarray
    ) -> np.ndarray:
        """As `draw`, `(pixels, pixels, 4)`: the last is 255 where the mesh is seen, 0 elsewhere."""
        self._points[:] = np.column_stack([places * (1, -1), depth])
        self._colours[:] = colours
        self._vtk_points.Modified()
        self._vtk_colours.Modified()
        middle, near, far = self._pixels / 2, depth.max() + 1, depth.min() - 1
        self._camera.SetFocalPoint(middle, -middle, far)
        self._camera.SetPosition(middle, -middle, near)
        self._camera.SetClippingRange(0.01, near - far)
        self._window.Render()
        last = self._pixels - 1
        self._window.GetRGBACharPixelData(0, 0, last, last, 0, self._image)
        image = vtk_to_numpy(self._image).reshape(self._pixels, self._pixels, 4)
        return image[::-1]  # VTK begins below

    def draw_numbers(self, places: np.ndarray, depth: np.ndarray) -> np.ndarray:
        """Index of the triangle that is seen in each pixel.

        Args:
            places, depth: As for `draw`.

        Returns:
            `(pixels, pixels)` uint32 triangle numbers; T or more where none is seen.
        """
        # A number, written as a colour; that of the background is larger than any of a mesh.
        numbers = np.arange(len(self._colours), dtype="<u4")[:, None]
        image = self.draw(places, depth, numbers.view(np.uint8)[:, :3])
        found = np.zeros((*image.shape[:2], 4), np.uint8)
        found[..., :3] = image
        return found.view("<u4")[..., 0]

    def close(self) -> None:
        """Free the window; without it, its memory is held as long as the process lives."""
        self._window.Finalize()


def _choose_window() -> None:
    """Tell VTK not to look for a display, which on Linux it does first."""
    if sys.platform != "linux":
        return
    if "tensorflow" in sys.modules:
        # Each brings an LLVM of its own, and Mesa's calls would end up in TensorFlow's.
        raise InputError(
            "Rendering must be done in a process that has not loaded TensorFlow. "
            "Received one that has, in which Mesa's drawing would crash."
        )
    found = [window for library, window in _WINDOWS.items() if ctypes.util.find_library(library)]
    if not found:
        raise InputError(
            "Rendering needs the system library libEGL or libOSMesa (Debian: libegl1 with "
            "libgl1-mesa-dri). Received a machine with neither; MOBILEFACE=no goes without."
        )
    os.environ.setdefault("VTK_DEFAULT_OPENGL_WINDOW", found[0])
