"""Face models as texts name them."""

from __future__ import annotations

# Title, and why there may be no results on it.
FACE_MODELS = {
    "openhead": ("the open head", "it is the default"),
    "ict": ("ICT faces", "open, but to be downloaded: ICT-FaceKit, MIT licence"),
    "bfm2009": ("Basel Face Model 2009", "the paper's model; its licence must be asked for"),
    "bfm2017": ("Basel Face Model 2017", "its licence must be asked for"),
    "bfm2019": ("Basel Face Model 2019", "its licence must be asked for"),
    "flame": ("FLAME", "needs registration, and so do CoMA and CASIA-3D, which it is used with"),
}
TITLES = {model: title for model, (title, _) in FACE_MODELS.items()}
