"""Morphable models of faces: their files, their landmarks, their meshes."""
