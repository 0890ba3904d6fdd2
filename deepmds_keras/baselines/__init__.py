"""The methods that the paper compares with, and the simplest possible ones: one module each.

All are scikit-learn style estimators: `fit` where they learn, `predict(views)` from `(n, L, 2)` to
`(n, L, 3)`, `n_parameters`. Only `zhao` imports TensorFlow, so import from the modules.
"""
