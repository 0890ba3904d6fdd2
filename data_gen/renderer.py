"""Renders faces with VTK off-screen; also frames, and the visible part of a model."""

import ctypes.util
import os
import sys
from dataclasses import dataclass
from itertools import cycle

import numpy as np
import vtkmodules.vtkRenderingOpenGL2  # noqa: F401 (what the classes below are drawn by)
from vtkmodules.util.numpy_support import numpy_to_vtk, numpy_to_vtkIdTypeArray, vtk_to_numpy
from vtkmodules.vtkCommonCore import vtkPoints, vtkUnsignedCharArray
from vtkmodules.vtkCommonDataModel import vtkCellArray, vtkPolyData
from vtkmodules.vtkRenderingCore import vtkActor, vtkPolyDataMapper, vtkRenderer, vtkRenderWindow

from data_gen.appearance import Lights
from data_gen.models.mesh import triangle_corners, vertex_normals
from data_gen.models.morphable_model import MorphableModel
from deepmds_keras.errors import InputError
from deepmds_keras.geometry.views import Cameras, pose_and_project

MARGIN = 1.4  # side of a square image, relative to the landmarks' box
BACKGROUND = 255  # white, as in the authors' images
_OVERSAMPLING = 2  # pixels are means of so many by so many
# By which system library VTK draws without a display, the preferred first.
_WINDOWS = {"EGL": "vtkEGLRenderWindow", "OSMesa": "vtkOSOpenGLRenderWindow"}
# Views in which a model is searched for what is seen, a little beyond those of the data sets.
_YAWS, _PITCHES = (-50.0, -25.0, 0.0, 25.0, 50.0), (-35.0, -15.0, 0.0, 10.0)
_FACES_PER_VIEW, _PIXELS = 3, 512


@dataclass(frozen=True, eq=False)
class Frames:
    """Section of the view plane in each of `n` images.

    Attributes:
        low: `(n, 2)` millimetres, the lower left corner, y up.
        extent: `(n, 2)` millimetres, width and height.
        size: Width and height in pixels.
    """

    low: np.ndarray
    extent: np.ndarray
    size: int

    def pixels(self, views: np.ndarray) -> np.ndarray:
        """Pixel positions of points of the views: `(n, L, 2)` → `(n, L, 2)`, x right and y down.

        The upper left corner of the image is (0, 0), the middle of its first pixel (0.5, 0.5).
        """
        inside = (views - self.low[:, None]) / self.extent[:, None]
        inside[..., 1] = 1 - inside[..., 1]
        return inside * self.size


def square_frames(views: np.ndarray, size: int, margin: float = MARGIN) -> Frames:
    """Squares around landmarks `(n, L, 2)`, millimetres, as a face detector would cut them out.

    `margin` is the side, relative to the landmarks' box.
    """
    low, high = views.min(1), views.max(1)
    side = margin * (high - low).max(1, keepdims=True)
    return Frames((low + high - side) / 2, np.repeat(side, 2, axis=1), size)


def stretched_frames(views: np.ndarray, size: int) -> Frames:
    """Bounding boxes of `(n, V, 2)` points, mm, stretched to squares, like the authors' images."""
    low, high = views.min(1), views.max(1)
    return Frames(low, high - low, size)


def frames_of(
    landmarks: np.ndarray, vertices: np.ndarray, size: int, margin: float | None
) -> Frames:
    """`square_frames` of landmarks; without a margin `stretched_frames` of vertices `(n, V, 3)`."""
    if margin is None:
        return stretched_frames(vertices[..., :2], size)
    return square_frames(landmarks, size, margin)


class Renderer:
    """Draws lit faces of one morphable model.

    Args:
        size: Width and height of the images in pixels.

    Raises:
        InputError: The system library that draws is missing.
    """

    def __init__(self, model: MorphableModel, size: int):
        self.size = size
        self._triangles = model.triangles
        self._corners = triangle_corners(model.n_vertices, model.triangles)
        self._rasteriser = Rasteriser(model.n_vertices, model.triangles, size * _OVERSAMPLING)

    def draw(
        self,
        vertices: np.ndarray,
        posed: np.ndarray,
        albedo: np.ndarray,
        frames: Frames,
        lights: Lights,
        backgrounds: np.ndarray | None = None,
    ) -> np.ndarray:
        """Images of faces.

        Args:
            vertices: `(n, V, 3)` projected, see `views.pose_and_project`.
            posed: `(n, V, 3)` the same in the frame of the camera, for the light.
            albedo: `(n, V, 3)` sRGB in [0, 1].
            backgrounds: `(n, size, size, 3)` uint8, behind the faces; white by default.

        Returns:
            `(n, size, size, 3)` uint8.
        """
        images = np.empty((len(vertices), self.size, self.size, 3), np.uint8)
        places = frames.pixels(vertices[..., :2]) * _OVERSAMPLING
        for i, image in enumerate(images):
            normals = vertex_normals(posed[i], self._triangles, self._corners)
            lamp = (normals @ lights.direction[i]).clip(0)
            light = lights.ambient[i] + (1 - lights.ambient[i]) * lamp
            colours = (albedo[i] * light[:, None] * lights.colour[i]).clip(0, 1)
            colours = np.uint8(np.rint(255 * colours))
            wide = self._rasteriser.draw(places[i], vertices[i, :, 2], colours)
            # Sums over slices equal `mean` over reshaped axes, and are many times faster.
            cells = (wide[k::_OVERSAMPLING, j::_OVERSAMPLING] for k, j in np.ndindex(2, 2))
            means = sum(np.uint16(cell) for cell in cells) / _OVERSAMPLING**2
            drawn = means[..., :3]
            if backgrounds is not None:
                share_behind = 1 - means[..., 3:] / 255
                drawn = drawn + share_behind * (backgrounds[i] - float(BACKGROUND))
            image[:] = np.rint(drawn)
        return images

    def close(self) -> None:
        """As `Rasteriser.close`."""
        self._rasteriser.close()


class Rasteriser:
    """Draws coloured meshes, all with the same triangles.

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
        (mesh.GetCellData() if by_triangle else mesh.GetPointData()).SetScalars(self._vtk_colours)
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
        """One image, `(pixels, pixels, 4)` uint8: RGB, and 255 where the mesh is seen, else 0.

        Args:
            places: `(V, 2)` pixels, x right and y down.
            depth: `(V,)`, growing towards the viewer.
            colours: `(V, 3)` or, by triangle, `(T, 3)` uint8.
        """
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
        """Number of the visible triangle in each pixel, `(pixels, pixels)`; T or more for none.

        Arguments are those of `draw`.
        """
        # Numbers are encoded as colours; that of the background is larger than any of a mesh.
        numbers = np.arange(len(self._colours), dtype="<u4")[:, None]
        image = self.draw(places, depth, numbers.view(np.uint8)[:, :3])
        return image[..., :3] @ np.array([1, 256, 65536])

    def close(self) -> None:
        """Free the window, whose memory the process would otherwise keep."""
        self._window.Finalize()


def _choose_window() -> None:
    """Tell VTK not to look for a display, which on Linux it does first."""
    if sys.platform != "linux":
        return
    if "tensorflow" in sys.modules:
        # Each brings its LLVM, and Mesa's calls would end up in TensorFlow's.
        raise InputError(
            "Rendering must be done in a process that has not loaded TensorFlow. "
            "Received one that has, in which Mesa's drawing would crash."
        )
    windows = [window for library, window in _WINDOWS.items() if ctypes.util.find_library(library)]
    if not windows:
        raise InputError(
            "Rendering needs the system library libEGL or libOSMesa (Debian: libegl1 with "
            "libgl1-mesa-dri). Found neither; MOBILEFACE=no does not need it."
        )
    os.environ.setdefault("VTK_DEFAULT_OPENGL_WINDOW", windows[0])


def seen_vertices(
    model: MorphableModel,
    scheme: str,
    *,
    margin: float | None = MARGIN,
    expressions: np.ndarray | None = None,
) -> np.ndarray:
    """Sorted numbers of the vertices of all triangles visible on random faces, and of neighbours.

    Args:
        scheme: Landmark scheme by which images are framed.
        margin: As for `frames_of`.
        expressions: `(m, E)` weights of expressions that the faces take in turn, including those
            that show what a neutral face hides, such as the teeth; None for neutral faces.
    """
    yaw, pitch = (angles.ravel() for angles in np.meshgrid(_YAWS, _PITCHES))
    level, landmarks = np.zeros(len(yaw)), model.landmarks[scheme]
    cameras = Cameras(level.astype(int), yaw, pitch, level, level)
    rasteriser = Rasteriser(model.n_vertices, model.triangles, _PIXELS, by_triangle=True)
    seen = np.zeros(len(model.triangles) + 1, bool)
    rng = np.random.default_rng(0)
    expression = cycle([None] if expressions is None else expressions)
    for _ in range(_FACES_PER_VIEW):
        identity = rng.standard_normal((len(yaw), model.n_identity))
        for k, coefficients in enumerate(identity):
            shape = model.shape(coefficients, next(expression))[None]
            _, points = pose_and_project(shape, shape[:, landmarks], cameras[k : k + 1])
            views = points[..., :2]
            frame = frames_of(views[:, landmarks], points, _PIXELS, margin)
            numbers = rasteriser.draw_numbers(frame.pixels(views)[0], points[0, :, 2])
            seen[np.minimum(numbers, len(model.triangles))] = True
    rasteriser.close()
    touched = np.unique(model.triangles[seen[:-1]])
    neighbours = np.isin(model.triangles, touched).any(1)
    return np.unique(model.triangles[neighbours])


def part_of(model: MorphableModel, vertices: np.ndarray) -> MorphableModel:
    """The model restricted to these sorted vertices, and to the triangles wholly among them."""
    within = np.isin(model.triangles, vertices).all(1)
    return model.restrict(vertices, np.searchsorted(vertices, model.triangles[within]))
