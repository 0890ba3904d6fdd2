"""File formats of other programs, read without believing a header or running anything."""
