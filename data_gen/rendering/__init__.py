"""Meshes and colours into images."""
