"""Deep-MDS: the 3D shape of 2D landmarks from a single image (Kamyab and Azimifar).

Names are loaded when they are first used: to predict with a lifter takes neither Keras nor
TensorFlow nor scikit-learn, and none of them need be installed.
"""

from importlib import import_module
from typing import TYPE_CHECKING

from deepmds_keras.errors import KERAS_BACKENDS, InputError, MissingPackageError, needs

if TYPE_CHECKING:  # for editors and type checkers: the same names as below
    from deepmds_keras import baselines as baselines
    from deepmds_keras import metrics as metrics
    from deepmds_keras.deep_mds import DeepMDS as DeepMDS
    from deepmds_keras.embedding import embed as embed
    from deepmds_keras.geometry.alignment import align as align
    from deepmds_keras.geometry.camera import HeadPose as HeadPose
    from deepmds_keras.geometry.camera import head_pose as head_pose
    from deepmds_keras.geometry.units import normalise as normalise
    from deepmds_keras.geometry.views import sample_views as sample_views
    from deepmds_keras.landmarks import convert as convert
    from deepmds_keras.landmarks import load_scheme as load_scheme
    from deepmds_keras.lifting.lifter import LandmarkLifter as LandmarkLifter
    from deepmds_keras.networks import build_autoencoder as build_autoencoder
    from deepmds_keras.networks import build_dissimilarity_net as build_dissimilarity_net
    from deepmds_keras.proximities import pair_features as pair_features
    from deepmds_keras.tool.predict.face_lifter import FaceLifter as FaceLifter
    from deepmds_keras.tool.predict.face_lifter import predict_landmarks as predict_landmarks
    from deepmds_keras.tool.predict.face_lifter import predict_photo as predict_photo
    from deepmds_keras.tool.predict.faces import Face as Face
    from deepmds_keras.tool.predict.landmark_files import read_landmarks as read_landmarks

_HOME = {
    "DeepMDS": "deep_mds",
    "Face": "tool.predict.faces",
    "FaceLifter": "tool.predict.face_lifter",
    "HeadPose": "geometry.camera",
    "LandmarkLifter": "lifting.lifter",
    "align": "geometry.alignment",
    "build_autoencoder": "networks",
    "build_dissimilarity_net": "networks",
    "convert": "landmarks",
    "embed": "embedding",
    "head_pose": "geometry.camera",
    "load_scheme": "landmarks",
    "normalise": "geometry.units",
    "pair_features": "proximities",
    "predict_landmarks": "tool.predict.face_lifter",
    "predict_photo": "tool.predict.face_lifter",
    "read_landmarks": "tool.predict.landmark_files",
    "sample_views": "geometry.views",
}
_MODULES = ("baselines", "metrics")
_KERAS = ("h5py", "keras", "sklearn", "tensorflow")  # what the extra of that name brings

__all__ = ["InputError", "MissingPackageError", *_HOME, *_MODULES]
__version__ = "0.4.0"


def __getattr__(name):
    if name not in (*_HOME, *_MODULES):
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    module = f"{__name__}.{_HOME.get(name, name)}"
    try:
        value = import_module(module)
    except ModuleNotFoundError as error:
        if str(error.name).partition(".")[0] not in (*_KERAS, *KERAS_BACKENDS):
            raise
        with needs(f"What {name} needs", "keras"):
            raise
    if name in _HOME:
        value = globals()[name] = getattr(value, name)
    return value


def __dir__():
    return sorted({*globals(), *__all__})
