"""The weights that ship with the package: what they are trained on, trained, and measured.

`portraits` draws photos of both open face models and runs the detectors on them; their errors are
what the lifters are trained with (`photo_faces`). `photo_networks` trains; `pretrained` measures.
"""
