"""Licences, files and random numbers into arrays: face models, projections, data sets."""
