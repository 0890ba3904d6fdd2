"""Deep-MDS: the 3D shape of 2D landmarks from a single image (Kamyab and Azimifar).

Names are loaded when they are first used: to predict with a lifter takes neither Keras nor
TensorFlow, and neither need be installed.
"""

from importlib import import_module

from deepmds_keras.errors import needs

_HOME = {
    "DeepMDS": "pipeline",
    "InputError": "errors",
    "LandmarkLifter": "lifting.lifter",
    "align": "alignment",
    "build_autoencoder": "networks",
    "build_dissimilarity_net": "networks",
    "embed": "embedding",
    "head_pose": "camera",
    "normalise": "normalisation",
    "predict_landmarks": "predict.api",
    "predict_photo": "predict.api",
    "pair_features": "proximities",
    "read_photo": "photos",
}
_MODULES = ("baselines", "metrics")

__all__ = [*_HOME, *_MODULES]
__version__ = "0.2.0"


def __getattr__(name):
    if name not in (*_HOME, *_MODULES):
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    with needs(f"TensorFlow with Keras and scikit-learn, which {name} needs,", "keras"):
        if name in _MODULES:
            return import_module(f"{__name__}.{name}")
        value = getattr(import_module(f"{__name__}.{_HOME[name]}"), name)
    globals()[name] = value
    return value


def __dir__():
    return sorted([*globals(), *__all__])
