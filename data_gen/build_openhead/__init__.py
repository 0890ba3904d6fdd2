"""Builds `data_gen/assets/openhead.npz`, see LICENSE-openhead.md in that folder."""
