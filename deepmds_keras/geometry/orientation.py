"""Orientation of an embedding, which distances leave open: front to the viewer, nose ahead."""

import numpy as np

from deepmds_keras.geometry.camera import orthographic_cameras


def front_landmark(shapes: np.ndarray) -> int:
    """0-based number of the landmark that is farthest in front on average: `(n, L, 3)` → int."""
    return int(shapes[..., 2].mean(0).argmax())


def resolve_orientation(shapes: np.ndarray, frontal: np.ndarray, front_landmark: int) -> np.ndarray:
    """Rotate shapes onto their frontal views, with the front landmark towards the viewer.

    The rotation is that of the scaled orthographic camera fitted to the view.

    Args:
        shapes: `(n, L, 3)` shapes in any orientation, mirrored or not.
        frontal: `(n, L, 2)` landmarks as seen from the front.
        front_landmark: 0-based number of a landmark in front of the others' mean.

    Returns:
        `(n, L, 3)` rotated shapes: x, y centred on the frontal view, mean z 0.
    """
    rotation = orthographic_cameras(frontal, shapes).rotation
    turned = (shapes - shapes.mean(1, keepdims=True)) @ np.swapaxes(rotation, 1, 2)
    turned[..., 2] *= np.where(turned[:, front_landmark, 2] < 0, -1, 1)[:, None]
    turned[..., :2] += frontal.mean(1, keepdims=True)
    return turned
