"""Face models, projections and data sets, read from files or sampled."""
