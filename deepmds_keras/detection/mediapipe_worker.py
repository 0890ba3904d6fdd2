"""MediaPipe FaceMesh over a list of images, in the virtual environment that has MediaPipe.

    .venv-mediapipe/bin/python -I mediapipe_worker.py REQUEST.json OUTPUT.npz

REQUEST.json is an object: `inputs`, a list of paths, and `max_faces`, how many faces an image may
have at most. The paths are image stacks (`.npy`, uint8 `(n, H, W, 3)` RGB) and image files that
Pillow reads (one image each, as stored: no rotation by EXIF). OUTPUT.npz has `landmarks`,
`(m, 468, 3)` float32 of all faces of all images in order, and `counts`, `(n,)`, how many faces each
image has. x and y are pixels of the image, x right, y down, (0, 0) its left upper corner; z is on
the same scale and grows towards the viewer, from about the middle of the head. While it runs, each
line on stdout is the number of images just done. Exit status 2 says that an input is no such file;
the last line on stdout then names it. On stderr is what the libraries log.

This file imports nothing of the package, which that environment does not have.
"""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np

N_POINTS = 468
UNREADABLE_INPUT = 2
_IMAGES_PER_LINE = 20


def images_of(path: Path) -> Iterator[np.ndarray]:
    """The `(H, W, 3)` uint8 RGB images of one input, one after the other.

    Raises:
        ValueError, OSError: Not a stack of images, or not an image.
    """
    if path.suffix == ".npy":
        stack = np.load(path, mmap_mode="r", allow_pickle=False)
        if stack.ndim != 4 or stack.shape[3] != 3 or stack.dtype != np.uint8:
            raise ValueError(f"{stack.dtype} {stack.shape}")
        yield from map(np.ascontiguousarray, stack)
    else:
        from PIL import Image

        with Image.open(path) as image:
            yield np.asarray(image.convert("RGB"))


def points_of(face_mesh, image: np.ndarray) -> np.ndarray:
    """`(n, 468, 3)` points of the faces in an image."""
    faces = face_mesh.process(image).multi_face_landmarks or []
    height, width = image.shape[:2]
    # FaceMesh gives fractions of the image; its z is one of the width, and smaller when nearer.
    points = np.array([[(p.x, p.y, p.z) for p in face.landmark] for face in faces])
    return np.float32(points.reshape(-1, N_POINTS, 3) * (width, height, -width))


def main(request_path: str, output: str) -> None:
    os.environ["MPLBACKEND"] = "agg"  # MediaPipe loads matplotlib, which refuses a notebook's
    from mediapipe.python.solutions.face_mesh import FaceMesh

    request = json.loads(Path(request_path).read_text(encoding="utf-8"))
    landmarks, told = [], 0
    # Without static_image_mode the search for a face begins where the last image had one.
    with FaceMesh(
        static_image_mode=True,
        max_num_faces=request["max_faces"],
        refine_landmarks=False,
        min_detection_confidence=0.5,
    ) as face_mesh:
        for path in map(Path, request["inputs"]):
            images = images_of(path)
            while (image := next_image(path, images)) is not None:
                landmarks.append(points_of(face_mesh, image))
                if len(landmarks) - told == _IMAGES_PER_LINE:
                    print(_IMAGES_PER_LINE, flush=True)
                    told = len(landmarks)
    partial = f"{output}.partial"
    with open(partial, "wb") as file:
        points = np.concatenate([np.empty((0, N_POINTS, 3), np.float32), *landmarks])
        np.savez(file, landmarks=points, counts=np.array([len(faces) for faces in landmarks], int))
    os.replace(partial, output)
    print(len(landmarks) - told, flush=True)


def next_image(path: Path, images: Iterator[np.ndarray]) -> np.ndarray | None:
    """The next image of an input, None after the last; ends the program where it is no image."""
    try:
        return next(images, None)
    except (OSError, ValueError, EOFError) as error:
        print(
            f"{path} must be images: .npy uint8 (n, H, W, 3), or an image file. Received {error}."
        )
        sys.exit(UNREADABLE_INPUT)


if __name__ == "__main__":
    main(*sys.argv[1:])
