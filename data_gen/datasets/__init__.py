"""The data sets of the paper, and the open stand-ins for those that are licensed."""
