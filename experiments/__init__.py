"""Files into files: one module for each stage, table or figure of the paper."""
