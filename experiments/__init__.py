"""Files into files: one module for each step, see the Snakefile."""
