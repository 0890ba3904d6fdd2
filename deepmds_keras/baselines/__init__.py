"""The methods that the paper compares with, and the simplest possible ones.

All have `predict`, and those that learn `fit`; most are estimators in the style of scikit-learn.
Only `closed_form`, `eos_fit` and `map_fit` do without TensorFlow, so import from the modules.
"""
