"""The estimator: scikit-learn's conventions, a face that faces the front, files, and errors."""

import pickle
from copy import copy
from shutil import copytree

import h5py
import numpy as np
import pytest
from sklearn.base import clone
from sklearn.exceptions import NotFittedError
from writers.keras2 import write_keras2

from data_gen.datasets.dataset import make_dataset
from deepmds_keras import DeepMDS, InputError, align, metrics, normalise
from deepmds_keras.baselines.zhao import build_zhao_net
from deepmds_keras.files import read_arrays, write_arrays
from deepmds_keras.geometry.alignment import is_mirrored
from deepmds_keras.networks import build_autoencoder, build_dissimilarity_net


@pytest.fixture(scope="module")
def faces(head):
    return make_dataset(head, 200, np.random.default_rng(1))


@pytest.fixture(scope="module")
def shipped():
    return DeepMDS.pretrained("deepmds-bfm72")


@pytest.fixture(scope="module")
def small(tmp_path_factory):
    """A model of 8 landmarks, what it was trained on, and its folder, which nobody writes to."""
    folder = tmp_path_factory.mktemp("kept")
    rng = np.random.default_rng(0)
    shapes = rng.random((1, 8, 3)) + 0.05 * rng.normal(size=(48, 8, 3))
    model = DeepMDS(8, autoencoder_epochs=2, dissimilarity_epochs=1, dissimilarity_steps=53, seed=3)
    return model.fit(shapes[..., :2], shapes, checkpoint=folder), shapes, folder


def test_shipped_weights_recover_unseen_faces_and_tell_them_apart(shipped, faces):
    truth = normalise(faces.landmarks)
    shapes = shipped.predict(faces.views)
    error, others = metrics.mse(align(shapes, truth), truth), np.roll(truth, 1, axis=0)
    flat = truth * [1, 1, 0]
    assert error.mean() < 0.1 * metrics.mse(align(flat, truth), truth).mean()
    assert (error < metrics.mse(align(shapes, others), others)).mean() > 0.55
    assert not is_mirrored(shapes, truth).any()
    assert np.abs(shapes[..., :2] - shipped.frontalise(faces.views)).mean() < 0.02
    assert np.allclose(shapes[..., 2].mean(1), 0)
    assert (shapes[:, shipped.front_landmark_, 2] > 0.05).all()
    assert np.allclose(shapes[:4], shipped.predict(17 * faces.views[:4] + [400, -90]), atol=1e-3)
    assert np.allclose(shapes[0], shipped.predict(faces.views[0]), atol=1e-4)
    matrices = shipped.dissimilarities(faces.views[:3])
    assert np.array_equal(matrices, np.swapaxes(matrices, 1, 2))


def test_the_score_is_the_share_of_the_variance_explained(shipped, faces):
    views, landmarks = faces.views[:20], faces.landmarks[:20]
    expected = metrics.explained_share(shipped.predict(views), landmarks)
    assert shipped.score(views, landmarks) == expected
    assert np.isfinite(shipped.score(views * [1, -1], landmarks))  # as `fit` takes them


def test_views_of_wrong_orientation_are_refused_unless_that_is_asked_for(shipped, faces):
    views = faces.views[:3] * [1, -1]
    with pytest.raises(InputError, match="y must point up.*check_orientation"):
        shipped.predict(views)
    assert np.isfinite(shipped.predict(views, check_orientation=False)).all()


# Keras itself, of its own variables, when they are pickled.
@pytest.mark.filterwarnings("ignore:__array__ implementation")
def test_saved_and_loaded_predict_the_same_and_a_clone_has_no_weights(small, tmp_path):
    model, shapes, _ = small
    model.save(tmp_path / "model.npz")
    loaded, copy = DeepMDS.load(tmp_path / "model.npz"), clone(model)
    assert loaded.get_params() == model.get_params() == copy.get_params()
    assert loaded.history_ == model.history_
    assert np.array_equal(loaded.predict(shapes[:4, :, :2]), model.predict(shapes[:4, :, :2]))
    unpickled = pickle.loads(pickle.dumps(model))
    assert np.array_equal(unpickled.predict(shapes[:4, :, :2]), model.predict(shapes[:4, :, :2]))
    assert [path.name for path in tmp_path.iterdir()] == ["model.npz"]
    arrays, described = read_arrays(tmp_path / "model.npz")
    described["parameters"]["solver"] = "auto"  # of version 0.3
    write_arrays(tmp_path / "older.npz", arrays, described)
    assert DeepMDS.load(tmp_path / "older.npz").solver == "sklearn"
    for error in (NotFittedError, InputError):
        with pytest.raises(error, match="not trained: call fit, restore, load or pretrained"):
            copy.predict(shapes[:1, :, :2])


@pytest.mark.slow
def test_a_fit_goes_on_from_its_folder_and_is_restored_from_it(small, tmp_path):
    model, shapes, _ = small
    views, calls = shapes[..., :2], []

    def stop(network, losses):
        calls.append(network)
        if len(calls) == 2:
            raise KeyboardInterrupt

    def fresh(**parameters):
        return clone(model).set_params(**parameters)

    with pytest.raises(KeyboardInterrupt):
        fresh().fit(views, shapes, checkpoint=tmp_path, progress=stop)
    with pytest.raises(InputError, match="dissimilarity-paper-constant.npz does not exist"):
        fresh().restore(tmp_path, shapes)
    expected, resumed = model.predict(views[:4]), fresh().fit(views, shapes, checkpoint=tmp_path)
    written = {path: path.stat().st_mtime_ns for path in tmp_path.iterdir()}
    for again in (resumed, fresh().restore(tmp_path, shapes), fresh().fit(views, shapes)):
        assert np.array_equal(again.predict(views[:4]), expected)
        assert again.history_ == model.history_
        assert again.front_landmark_ == model.front_landmark_
    # The other variant has the same autoencoder, which is not trained again.
    fresh(variant="released").fit(views, shapes, checkpoint=tmp_path)
    assert {path: path.stat().st_mtime_ns for path in written} == written


@pytest.mark.parametrize(
    ("parameters", "problem"),
    [
        ({"autoencoder_epochs": 3}, "autoencoder-constant.npz is from another run; delete it"),
        ({"dissimilarity_steps": 10}, "dissimilarity-paper-constant.npz is from another run"),
        ({"schedule": "cosine"}, "autoencoder-cosine.npz does not exist"),
        ({"n_landmarks": 7}, "is from another run"),
        ({"centre_views": True}, "autoencoder-constant.npz is from another run.*'centre_views'"),
    ],
)
def test_only_what_this_model_would_have_trained_is_restored(small, parameters, problem):
    model, shapes, kept = small
    with pytest.raises(InputError, match=problem):
        clone(model).set_params(**parameters).restore(kept, shapes)


def test_networks_of_two_runs_are_no_model_and_those_of_older_versions_are_taken(small, tmp_path):
    model, shapes, kept = small
    views, turned = shapes[..., :2], shapes[..., :2] @ [[0.8, -0.6], [0.6, 0.8]]
    copytree(kept, tmp_path / "mixed", ignore=lambda *_: ["autoencoder-constant.npz"])
    with pytest.raises(InputError, match="dissimilarity.* is from another run"):
        clone(model).fit(turned, shapes, checkpoint=tmp_path / "mixed")
    with pytest.raises(InputError, match="dissimilarity.* is from another run.*Received {'views'"):
        clone(model).restore(tmp_path / "mixed", shapes)
    for file in copytree(kept, tmp_path / "older").iterdir():
        arrays, described = read_arrays(file)
        for key in ("views", "centre_views"):  # which files of version 0.4 lack
            described["label"].pop(key, None)
        write_arrays(file, arrays, described)
    clone(model).fit(views, shapes, checkpoint=tmp_path / "older")
    older = clone(model).set_params(centre_views=True).restore(tmp_path / "older", shapes)
    assert older.history_ == model.history_


def test_a_fit_or_restore_that_fails_leaves_the_model_as_it_was(small, tmp_path):
    model, shapes, kept = small
    views, again = shapes[..., :2], copy(model)
    with pytest.raises(InputError, match="does not exist"):
        again.restore(tmp_path, shapes)
    with pytest.raises(InputError, match="shapes must have shape"):
        again.restore(kept, views)
    with pytest.raises(KeyError, match="dissimilarity_net"):
        again.fit(views, shapes, checkpoint=kept, progress=lambda name, _: {"autoencoder": 0}[name])
    assert vars(again) == vars(model)
    shapes = shapes.copy()
    shapes[0] = 1e3 * np.roll(shapes[0], 1, axis=0)  # large, with another landmark in front
    assert again.restore(kept, shapes).front_landmark_ == model.front_landmark_


@pytest.mark.parametrize(
    ("parameter", "value", "needed"),
    [
        ("variant", "papr", "one of paper, released"),
        ("solver", "nmba", "one of sklearn, numba"),
        ("schedule", "linear", "one of constant, cosine"),
        ("autoencoder_epochs", -1, "a whole number of at least 1"),
        ("dissimilarity_epochs", 1.5, "a whole number of at least 1"),
        ("dissimilarity_steps", "8", "a whole number of at least 1"),
        ("seed", -1, "a whole number of at least 0"),
        ("n_jobs", 0, "a whole number other than 0"),
        ("n_landmarks", True, "a whole number of at least 3"),
    ],
)
def test_parameters_are_checked_before_any_training(small, parameter, value, needed):
    _, shapes, _ = small
    model, epochs = DeepMDS(8).set_params(**{parameter: value}), []
    with pytest.raises(InputError, match=f"{parameter} must be {needed}. Received {value!r}"):
        model.fit(shapes[..., :2], shapes, progress=lambda *report: epochs.append(report))
    assert not epochs


def test_parameters_of_numpy_as_a_grid_search_sets_them_are_taken_and_saved(small, tmp_path):
    names = ("n_landmarks", "seed", "autoencoder_epochs", "dissimilarity_epochs")
    shapes, numbers = small[1], dict(zip(names, np.array([8, 3, 1, 1]), strict=True))
    model = DeepMDS(**numbers, dissimilarity_steps=np.int64(1)).fit(shapes[..., :2], shapes)
    model.save(tmp_path / "model.npz")
    assert DeepMDS.load(tmp_path / "model.npz").get_params() == model.get_params()


@pytest.mark.parametrize(
    ("parameters", "message"),
    [
        ({"n_landmarks": 7}, "n_landmarks must be 8, with which .* Received 7"),
        ({"variant": "released"}, "variant must be paper, with which .* Received 'released'"),
    ],
)
def test_other_networks_than_the_trained_ones_are_refused(small, tmp_path, parameters, message):
    model, shapes, _ = small
    changed = copy(model).set_params(**parameters)
    views = shapes[:, -changed.n_landmarks :, :2]
    for use in (lambda: changed.predict(views), lambda: changed.save(tmp_path / "m")):
        with pytest.raises(InputError, match=message):
            use()


def test_damaged_files_are_refused(small, tmp_path):
    model, path = small[0], tmp_path / "model.npz"
    model.save(path)
    whole, (arrays, described) = path.read_bytes(), read_arrays(path)
    path.write_bytes(whole[: len(whole) // 2])
    with pytest.raises(InputError, match="model.npz must be an npz written by save"):
        DeepMDS.load(path)
    for text in ("{}", '{"parameters": [1]}', '{"parameters": {"n_landmarks": 1e9}}'):
        np.savez(path, description=np.array(text))
        with pytest.raises(InputError, match="was not written by DeepMDS.save"):
            DeepMDS.load(path)
    arrays["dissimilarity_net/hidden_2/kernel"][3, 4] = np.nan
    write_arrays(path, arrays, described)
    with pytest.raises(InputError, match="model.npz: hidden_2/kernel of .* must be finite"):
        DeepMDS.load(path)
    with pytest.raises(InputError, match="must be a file to write. Received a folder"):
        model.save(tmp_path)


@pytest.mark.parametrize(("n_landmarks", "nose_tip"), [(72, 28), (68, 30), (51, 13)])
def test_released_files_of_any_scheme_are_read(tmp_path, n_landmarks, nose_tip):
    networks = build_autoencoder(n_landmarks), build_dissimilarity_net("released")
    files = [write_keras2(tmp_path / f"{network.name}.h5", network) for network in networks]
    model = DeepMDS.from_released(*files, n_landmarks=n_landmarks)
    assert model.front_landmark_ == nose_tip
    for first, second in zip(networks[0].weights, model.autoencoder_.weights, strict=True):
        assert np.array_equal(first, second)
    with h5py.File(files[0], "r+") as file:
        file["decode_1/decode_1/bias:0"][3] = np.nan
    with pytest.raises(InputError, match="autoencoder_.*.h5: decode_1/bias .* must be finite"):
        DeepMDS.from_released(*files, n_landmarks=n_landmarks)


def test_foreign_keras_files_are_refused(tmp_path):
    text, foreign = tmp_path / "text.h5", tmp_path / "foreign.h5"
    text.write_text("no HDF5")
    with pytest.raises(InputError, match="text.h5 must be a Keras 2 weight file"):
        DeepMDS.from_released(text, text)
    with h5py.File(foreign, "w") as file:
        file.attrs["layer_names"] = ["dense"]
        group = file.create_group("dense")
        group.attrs["weight_names"] = ["kernel"]
        group.create_dataset("kernel", (10**9, 10**9), np.float32)  # claims more than memory holds
    with pytest.raises(InputError, match="foreign.h5 must have the 38 weights of autoencoder_72"):
        DeepMDS.from_released(foreign, foreign)


@pytest.mark.parametrize("n_landmarks", [0, 2, 51.0, "51", None])
def test_impossible_numbers_of_landmarks_are_refused(n_landmarks):
    message = f"n_landmarks must be a whole number of at least 3. Received {n_landmarks!r}"
    predict = lambda n: DeepMDS(n).predict(np.eye(3)[:, :2])  # noqa: E731
    for function in (build_autoencoder, build_zhao_net, predict):
        with pytest.raises(InputError, match=message):
            function(n_landmarks)


def test_bad_input_is_named(shipped, faces):
    views = faces.views[:4].copy()
    with pytest.raises(InputError, match="views must have 72 landmarks per face. Received 71"):
        shipped.predict(views[:, 1:])
    views[1, 5] = np.nan
    with pytest.raises(InputError, match="NaN or infinity in face 1"):
        shipped.predict(views)
    with pytest.raises(InputError, match="of deepmds-bfm72, deepmds-ibug51. Received 'lifting-"):
        DeepMDS.pretrained("lifting-ibug51")
    with pytest.raises(InputError, match="same faces .*Received .4, 72, 2. and .3, 72, 3."):
        DeepMDS().fit(faces.views[:4], faces.landmarks[:3])
