"""Which way an embedding faces: distances alone know neither rotation nor mirror image."""

from __future__ import annotations

import numpy as np


def front_landmark(shapes: np.ndarray) -> int:
    """0-based number of the landmark that is on average most in front: `(n, L, 3)` → int."""
    return int(shapes[..., 2].mean(0).argmax())


def face_front(shapes: np.ndarray, frontal: np.ndarray, front_landmark: int) -> np.ndarray:
    """Turn shapes over their frontal views, the front landmark towards the viewer.

    The rotation is the scaled-orthographic pose: least squares of the affine camera, whose two
    rows are then made orthonormal.

    Args:
        shapes: `(n, L, 3)` shapes in any orientation, mirrored or not.
        frontal: `(n, L, 2)` where the landmarks lie when seen from the front.
        front_landmark: 0-based number of a landmark in front of the others' mean.

    Returns:
        `(n, L, 3)` turned shapes: x, y centred on the frontal view, mean z 0.
    """
    centre = frontal.mean(1, keepdims=True)
    shapes = shapes - shapes.mean(1, keepdims=True)
    camera = np.linalg.pinv(shapes) @ (frontal - centre)
    u, _, vt = np.linalg.svd(camera, full_matrices=False)
    right_up = np.swapaxes(u @ vt, 1, 2)
    forward = np.cross(right_up[:, 0], right_up[:, 1])
    axes = np.concatenate([right_up, forward[:, None]], axis=1)
    turned = shapes @ np.swapaxes(axes, 1, 2)
    turned[..., 2] *= np.where(turned[:, front_landmark, 2] < 0, -1, 1)[:, None]
    turned[..., :2] += centre
    return turned
