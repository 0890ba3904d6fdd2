"""The methods that the paper compares with, and the simplest possible ones.

All are scikit-learn style estimators with `predict` and `n_parameters`, and `fit` where they learn.
Only `closed_form`, `eos_fit` and `map_fit` do without TensorFlow, so import from the modules.
"""
