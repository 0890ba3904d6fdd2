"""The estimator: scikit-learn's conventions, a face that faces the front, files, and errors."""

import h5py
import numpy as np
import pytest
from sklearn.base import clone
from writers.keras2 import write_keras2

from data_gen.datasets.dataset import make_dataset
from data_gen.models.openhead import load_openhead
from deepmds_keras import DeepMDS, InputError, align, metrics, normalise
from deepmds_keras.alignment import is_mirrored
from deepmds_keras.baselines.zhao import Zhao, build_zhao_net
from deepmds_keras.files import read_arrays, write_arrays
from deepmds_keras.networks import build_autoencoder, build_dissimilarity_net
from deepmds_keras.orientation import front_landmark, resolve_orientation


@pytest.fixture(scope="module")
def test_faces():
    return make_dataset(load_openhead(), 200, np.random.default_rng(1))


@pytest.fixture(scope="module")
def shipped():
    return DeepMDS.pretrained("deepmds-bfm72")


@pytest.fixture(scope="module")
def kept(tmp_path_factory):
    """Folder with the networks of `small`, which nobody may write to."""
    return tmp_path_factory.mktemp("kept")


@pytest.fixture(scope="module")
def small(kept):
    """A network of 8 landmarks that is trained in a few seconds, and what it was trained on."""
    rng = np.random.default_rng(0)
    shapes = rng.random((1, 8, 3)) + 0.05 * rng.normal(size=(48, 8, 3))
    model = DeepMDS(8, autoencoder_epochs=2, dissimilarity_epochs=1, dissimilarity_steps=53, seed=3)
    return model.fit(shapes[..., :2], shapes, checkpoint=kept), shapes


def test_shipped_weights_recover_unseen_faces(shipped, test_faces):
    truth = normalise(test_faces.landmarks)
    shapes = shipped.predict(test_faces.views)
    assert shapes.shape == (200, 72, 3)
    mse = metrics.mse(align(shapes, truth), truth).mean()
    flat = truth * [1, 1, 0]
    assert mse < 0.1 * metrics.mse(align(flat, truth), truth).mean()
    assert not is_mirrored(shapes, truth).any()


def test_shipped_weights_tell_faces_apart(shipped, test_faces):
    truth = normalise(test_faces.landmarks)
    shapes = shipped.predict(test_faces.views)
    others = np.roll(truth, 1, axis=0)
    own = metrics.mse(align(shapes, truth), truth)
    assert (own < metrics.mse(align(shapes, others), others)).mean() > 0.55


def test_prediction_does_not_see_scale_and_place_of_a_view(shipped, test_faces):
    views = test_faces.views[:3]
    assert np.allclose(
        shipped.predict(views[:4]), shipped.predict(17 * views + [400, -90]), atol=1e-3
    )


def test_prediction_lies_over_the_frontal_view_with_the_nose_in_front(shipped, test_faces):
    shapes = shipped.predict(test_faces.views[:20])
    assert np.abs(shapes[..., :2] - shipped.frontalise(test_faces.views[:20])).mean() < 0.02
    assert np.allclose(shapes[..., 2].mean(1), 0)
    assert (shapes[:, shipped.front_landmark_, 2] > 0.05).all()


def test_dissimilarities_are_symmetric(shipped, test_faces):
    matrices = shipped.dissimilarities(test_faces.views[:3])
    assert matrices.shape == (3, 72, 72)
    assert np.array_equal(matrices, np.swapaxes(matrices, 1, 2))


def test_one_face_and_a_batch_give_the_same(shipped, test_faces):
    batch = shipped.predict(test_faces.views[:2])
    assert np.allclose(shipped.predict(test_faces.views[0])[0], batch[0], atol=1e-4)


def test_a_mirrored_embedding_is_turned_to_the_front():
    rng = np.random.default_rng(0)
    shapes = normalise(rng.random((6, 9, 3)))
    front = front_landmark(shapes)
    shapes[:, front, 2] += 1
    for mirror in (1, -1):
        turned = resolve_orientation(shapes @ np.diag([1, 1, mirror]), shapes[..., :2], front)
        assert np.allclose(turned - turned.mean(1, keepdims=True),
                           shapes - shapes.mean(1, keepdims=True))  # fmt: skip


def test_saved_and_loaded_predict_the_same(small, tmp_path):
    model, shapes = small
    model.save(tmp_path / "model.npz")
    loaded = DeepMDS.load(tmp_path / "model.npz")
    assert loaded.get_params() == model.get_params()
    assert loaded.history_ == model.history_
    assert np.array_equal(loaded.predict(shapes[:4, :, :2]), model.predict(shapes[:4, :, :2]))
    assert [path.name for path in tmp_path.iterdir()] == ["model.npz"]


def test_clone_has_the_parameters_and_no_weights(small):
    copy = clone(small[0])
    assert copy.get_params() == small[0].get_params()
    assert not hasattr(copy, "autoencoder_")
    assert DeepMDS().get_params()["variant"] == "paper"


@pytest.mark.slow
def test_same_seed_same_prediction(small):
    model, shapes = small
    again = clone(model).fit(shapes[..., :2], shapes)
    assert np.array_equal(again.predict(shapes[:4, :, :2]), model.predict(shapes[:4, :, :2]))


@pytest.mark.slow
def test_a_fit_goes_on_from_its_folder_and_is_restored_from_it(small, tmp_path):
    model, shapes = small
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
    resumed = fresh().fit(views, shapes, checkpoint=tmp_path)
    assert np.array_equal(resumed.predict(views[:4]), model.predict(views[:4]))
    assert resumed.history_ == model.history_

    written = {path: path.stat().st_mtime_ns for path in tmp_path.iterdir()}
    restored = fresh().restore(tmp_path, shapes)
    assert np.array_equal(restored.predict(views[:4]), model.predict(views[:4]))
    assert restored.history_ == model.history_
    assert restored.front_landmark_ == model.front_landmark_
    # The other variant has the same autoencoder, which is not trained again.
    fresh(variant="released").fit(views, shapes, checkpoint=tmp_path)
    assert {path: path.stat().st_mtime_ns for path in written} == written
    assert {path.name for path in tmp_path.iterdir()} == {
        "autoencoder-constant.npz",
        "dissimilarity-paper-constant.npz",
        "dissimilarity-released-constant.npz",
    }


@pytest.mark.parametrize(
    ("parameters", "problem"),
    [
        ({"dissimilarity_epochs": 2}, "is of another run"),
        ({"seed": 4}, "autoencoder-constant.npz is of another run; delete it"),
        ({"dissimilarity_steps": 10}, "dissimilarity-paper-constant.npz is of another run"),
        ({"schedule": "cosine"}, "autoencoder-cosine.npz does not exist"),
        ({"n_landmarks": 7}, "is of another run"),
    ],
)
def test_only_what_this_model_would_have_trained_is_restored(small, kept, parameters, problem):
    model, shapes = small
    with pytest.raises(InputError, match=problem):
        clone(model).set_params(**parameters).restore(kept, shapes)


@pytest.mark.slow
def test_a_training_that_was_stopped_is_not_restored(small, tmp_path):
    model, shapes = small

    def stop(network, losses):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        clone(model).fit(shapes[..., :2], shapes, checkpoint=tmp_path, progress=stop)
    with pytest.raises(InputError, match="not trained to the end. Received 1 of 2 epochs"):
        clone(model).restore(tmp_path, shapes)


def test_n_parameters_are_the_trainable_ones(shipped):
    assert shipped.n_parameters == 24_880 + 2443


def test_damaged_files_are_refused(small, tmp_path):
    model, _ = small
    path = tmp_path / "model.npz"
    model.save(path)
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) // 2])
    with pytest.raises(InputError, match="model.npz must be an npz written by save"):
        DeepMDS.load(path)
    np.savez(path, description=np.array("{}"))
    with pytest.raises(InputError, match="was not written by DeepMDS.save"):
        DeepMDS.load(path)
    np.savez(path, description=np.array([{}], dtype=object))
    with pytest.raises(InputError, match="must be an npz written by save"):
        DeepMDS.load(path)
    with pytest.raises(InputError, match="none.npz does not exist"):
        DeepMDS.load(tmp_path / "none.npz")


def test_a_flipped_byte_is_refused_or_harmless(small, tmp_path):
    path = tmp_path / "model.npz"
    small[0].save(path)
    whole = path.read_bytes()
    refused = 0
    for position in np.random.default_rng(0).integers(0, len(whole), 40):
        damaged = bytearray(whole)
        damaged[position] ^= 0xFF
        path.write_bytes(damaged)
        try:
            DeepMDS.load(path)
        except InputError:
            refused += 1
    assert refused > 20


def test_foreign_keras_files_are_refused(tmp_path):
    text = tmp_path / "text.h5"
    text.write_text("no HDF5")
    with pytest.raises(InputError, match="text.h5 must be a Keras 2 weight file"):
        DeepMDS.from_released(text, text)
    foreign = tmp_path / "foreign.h5"
    with h5py.File(foreign, "w") as file:
        file.attrs["layer_names"] = ["dense"]
        group = file.create_group("dense")
        group.attrs["weight_names"] = ["kernel"]
        group["kernel"] = np.zeros((4, 4))
    with pytest.raises(InputError, match="foreign.h5 does not fit the network autoencoder_72"):
        DeepMDS.from_released(foreign, foreign)


@pytest.mark.parametrize(("n_landmarks", "nose_tip"), [(72, 28), (68, 30), (51, 13)])
def test_released_files_of_any_scheme_are_read(tmp_path, n_landmarks, nose_tip):
    networks = build_autoencoder(n_landmarks), build_dissimilarity_net("released")
    files = [write_keras2(tmp_path / f"{network.name}.h5", network) for network in networks]
    model = DeepMDS.from_released(*files, n_landmarks=n_landmarks)
    assert model.front_landmark_ == nose_tip
    assert np.array_equal(model.autoencoder_.get_weights()[0], networks[0].get_weights()[0])
    with h5py.File(files[0], "r+") as file:
        file["decode_1/decode_1/bias:0"][3] = np.nan
    with pytest.raises(InputError, match="autoencoder_.*.h5: layer decode_1 .* must be finite"):
        DeepMDS.from_released(*files, n_landmarks=n_landmarks)


@pytest.mark.parametrize("n_landmarks", [0, -1, 2, 51.0, "51", None])
def test_impossible_numbers_of_landmarks_are_refused(n_landmarks):
    message = f"n_landmarks must be a whole number of at least 3. Received {n_landmarks!r}"
    for build in (build_autoencoder, build_zhao_net):
        with pytest.raises(InputError, match=message):
            build(n_landmarks)
    shapes = np.random.default_rng(0).random((2, 3, 3))
    for fit, data in ((DeepMDS(n_landmarks).fit, (shapes[..., :2], shapes)),
                      (Zhao(n_landmarks).fit, (shapes,))):  # fmt: skip
        with pytest.raises(InputError, match=message):
            fit(*data)
    with pytest.raises(InputError):
        DeepMDS.from_released("a.h5", "b.h5", n_landmarks=n_landmarks)


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_weights_that_are_not_finite_are_refused_with_their_name(small, tmp_path, bad):
    path = tmp_path / "model.npz"
    small[0].save(path)
    arrays, described = read_arrays(path)
    arrays["dissimilarity_net/hidden_2/kernel"][3, 4] = bad
    write_arrays(path, arrays, described)
    with pytest.raises(InputError, match="model.npz: hidden_2/kernel of .* must be finite"):
        DeepMDS.load(path)


def test_a_folder_is_not_written_over(small, tmp_path):
    with pytest.raises(InputError, match="must be a file to write. Received a folder"):
        small[0].save(tmp_path)
    assert not list(tmp_path.iterdir())


def test_bad_input_is_named(shipped, test_faces):
    views = test_faces.views[:4].copy()
    with pytest.raises(InputError, match="views must have 72 landmarks a face. Received 71"):
        shipped.predict(views[:, 1:])
    with pytest.raises(InputError, match=r"shape \(faces >= 1, landmarks >= 3, 2\)"):
        shipped.predict(np.zeros((4, 72, 3)))
    views[1, 5] = np.nan
    with pytest.raises(InputError, match="NaN or infinity in face 1"):
        shipped.predict(views[:4])
    with pytest.raises(InputError, match="deepmds-bfm72, deepmds-ibug51, .*Received 'bfm'"):
        DeepMDS.pretrained("bfm")
    with pytest.raises(InputError, match="4 views and 3 shapes"):
        DeepMDS().fit(test_faces.views[:4], test_faces.landmarks[:3])
    with pytest.raises(InputError, match="not trained"):
        DeepMDS().predict(test_faces.views[:1])
