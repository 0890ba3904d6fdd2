"""The data sets of the paper, and the open substitutes for those that are licensed."""
