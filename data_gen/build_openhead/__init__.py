"""Builds `data_gen/assets/openhead.npz`, the embedded head model, from CC0 MakeHuman assets.

Run `python -m data_gen.build_openhead`; LICENSE-openhead.md beside the asset tells what it is.
"""
