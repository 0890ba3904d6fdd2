"""Points in two and three dimensions: units, alignment, cameras, orientation, classical scaling."""
