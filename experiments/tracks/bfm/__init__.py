"""The paper's first table: neutral faces of a morphable model."""
