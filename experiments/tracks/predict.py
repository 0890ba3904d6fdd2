"""Step: predictions of one method for the test faces."""

from __future__ import annotations

import numpy as np
from PIL import Image

from data_gen.datasets.image_files import ImageFiles
from deepmds_keras.baselines.images import IMAGE_SIZE
from deepmds_keras.files import write_arrays
from experiments.inputs import load_faces, load_images
from experiments.method import Method
from experiments.methods import load, method_of, predict, views_for
from experiments.progress import Progress
from experiments.run import Run
from experiments.tasks import unordered
from experiments.tracks.train import limit_threads

_FACES_PER_CHUNK = 250  # after which the progress bar moves


def inputs_for(run: Run, method: Method) -> np.ndarray | ImageFiles:
    """Inputs of a method for the test faces of a run.

    Raises:
        InputError: A file is missing or was changed.
    """
    if method.inputs.endswith("views"):
        return views_for(method, load_faces(run, "test"))
    images = load_images(run, "test")
    return shrunk(images) if method.id == "ringnet" and run.ringnet is None else images


def shrunk(photos: ImageFiles) -> np.ndarray:
    """Photos at the size that our RingNet sees, `(n, 96, 96, 3)`."""
    size = (IMAGE_SIZE, IMAGE_SIZE)
    return np.stack(
        [
            np.asarray(Image.fromarray(photo).resize(size, Image.Resampling.BOX))
            for faces in photos.ranges()
            for photo in photos[slice(faces.start, faces.stop)]
        ]
    )


def predictions(run: Run, method: Method, model, inputs) -> np.ndarray:
    """Shapes `(n, L, 3)` of a loaded method; NaN for a face that it does not find."""
    with Progress("face", len(inputs)) as bar:
        if method.deep_mds:  # which shares the work itself
            return predict(model, inputs, progress=bar.update)
        chunks = [slice(k, k + _FACES_PER_CHUNK) for k in range(0, len(inputs), _FACES_PER_CHUNK)]
        tasks = ((model, number, inputs[chunk]) for number, chunk in enumerate(chunks))
        if method.one_by_one:  # several threads would only wait for each other
            results = unordered(run.jobs if len(chunks) > 1 else 1, _predict_chunk, tasks)
        else:  # done at once, or by networks, which stay in this process
            results = (_predict_chunk(*task) for task in tasks)
        shapes = {}
        for number, shape in results:
            shapes[number] = shape
            bar.update(len(shape))
    return np.concatenate([shapes[number] for number in range(len(chunks))])


def _predict_chunk(model, number: int, inputs: np.ndarray) -> tuple[int, np.ndarray]:
    return number, predict(model, inputs)


def main(run: Run, method_id: str) -> dict:
    """Write the method's shapes, and the number of its parameters."""
    method = method_of(method_id)
    limit_threads(method)
    inputs = inputs_for(run, method)  # a damaged file is to be reported before long work
    model = load(run, method_id)
    arrays = {"shapes": predictions(run, method, model, inputs)}
    if method.deep_mds:
        arrays["frontal"] = model.frontalise(inputs)
    described = {"method": method_id}
    if hasattr(model, "n_parameters"):
        described["n_parameters"] = int(model.n_parameters)
    arrays = {name: np.float32(array) for name, array in arrays.items()}
    write_arrays(run.prediction_file(method_id), arrays, described)
    return {"faces": len(inputs), "found": int(np.isfinite(arrays["shapes"]).all((1, 2)).sum())}
