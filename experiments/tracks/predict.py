"""Step: predictions of one method for the test faces."""

from contextlib import nullcontext

import numpy as np
from PIL import Image

from data_gen.datasets.image_files import ImageFiles
from deepmds_keras.files import write_arrays
from deepmds_keras.geometry.units import normalise
from experiments.inputs import load_faces, load_images
from experiments.method import Method
from experiments.methods import load, method_of, predict
from experiments.progress import Progress
from experiments.run import Run
from experiments.tasks import single_threaded
from experiments.tracks.train import limit_threads

_FACES_PER_CHUNK = 250  # after which the progress bar moves
_COMPARED, _ROUNDING = 50, 1e-6  # shapes of both solvers of the embedding, and their difference


def inputs_for(run: Run, method: Method) -> np.ndarray | ImageFiles:
    """Inputs of a method for the test faces of a run.

    Raises:
        InputError: A file is missing or was changed.
    """
    if not method.sees_images:
        test = load_faces(run, "test")
        return normalise(test.shapes[..., :2]) if method.inputs == "frontal views" else test.views
    images = load_images(run, "test")
    return images if method.image_size in (None, images.size) else shrunk(images, method.image_size)


def shrunk(photos: ImageFiles, side: int) -> np.ndarray:
    """Photos at the size that a method sees, `(n, side, side, 3)`."""
    size = (side, side)
    return np.stack(
        [
            np.asarray(Image.fromarray(photo).resize(size, Image.Resampling.BOX))
            for faces in photos.ranges()
            for photo in photos[slice(faces.start, faces.stop)]
        ]
    )


def predictions(method: Method, model, inputs) -> np.ndarray:
    """Shapes `(n, L, 3)` of a loaded method; NaN for a face that it does not find."""
    with Progress("face", len(inputs)) as bar:
        if method.deep_mds:
            return predict(model, inputs, progress=bar.update)
        shapes = []
        # Several threads would only wait for each other in fits of one face.
        with single_threaded() if method.one_by_one else nullcontext():
            for start in range(0, len(inputs), _FACES_PER_CHUNK):
                shapes.append(predict(model, inputs[start : start + _FACES_PER_CHUNK]))
                bar.update(len(shapes[-1]))
    return np.concatenate(shapes)


def compare_solvers(model, views: np.ndarray, shapes: np.ndarray) -> None:
    """Check that the first shapes are those of scikit-learn's MDS, which takes eight times as long.

    Raises:
        AssertionError: They are not.
    """
    expected = predict(model.set_params(solver="sklearn"), views[:_COMPARED])
    np.testing.assert_allclose(shapes[:_COMPARED], expected, atol=_ROUNDING)


def main(run: Run, method_id: str) -> dict:
    """Write the method's shapes, and the number of its parameters."""
    method = method_of(method_id)
    limit_threads(method.threads)
    inputs = inputs_for(run, method)  # a damaged file is to be reported before long work
    model = load(run, method_id)
    if method.deep_mds:
        model.set_params(solver="numba", n_jobs=run.jobs)
    arrays = {"shapes": predictions(method, model, inputs)}
    if method.deep_mds:
        compare_solvers(model, inputs, arrays["shapes"])
        arrays["frontal"] = model.frontalise(inputs)
    described = {"method": method_id}
    if hasattr(model, "n_parameters"):
        described["n_parameters"] = int(model.n_parameters)
    arrays = {name: np.float32(array) for name, array in arrays.items()}
    write_arrays(run.prediction_file(method_id), arrays, described)
    return {"faces": len(inputs), "found": int(np.isfinite(arrays["shapes"]).all((1, 2)).sum())}
