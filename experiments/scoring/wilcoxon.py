"""The test by which the paper compares methods."""

from itertools import combinations

import numpy as np
import pandas as pd
from scipy.stats import wilcoxon

from deepmds_keras.errors import InputError, brief


def wilcoxon_table(values: dict[str, np.ndarray]) -> pd.DataFrame:
    """Wilcoxon signed-rank test of every two methods, two-sided.

    Args:
        values: Method → `(n,)`: one criterion, for the same faces or subsets in the same order.

    Returns:
        A row for every two methods: `method_a`, `method_b`, `n`, `statistic` (the smaller rank
        sum), `p_value` (exact where SciPy computes it: up to 50 differences), `p_value_normal`
        (normal approximation without continuity correction, as in MATLAB), `median_difference`
        (of a - b). Faces without a difference are not ranked. A probability below about 1e-308,
        which thousands of faces easily give, is rounded to 0.

    Raises:
        InputError: A method's values are not one row of finite numbers.
    """
    arrays = {method: np.asarray(numbers, float) for method, numbers in values.items()}
    for method, array in arrays.items():
        if array.ndim != 1 or not len(array) or not np.isfinite(array).all():
            raise InputError(
                f"values of {method} must be a row of finite numbers. Received {brief(array)}."
            )
    columns = ("method_a", "method_b", "n", "statistic", "p_value", "p_value_normal")
    pairs = combinations(arrays, 2)
    rows = [(a, b, len(arrays[a]), *_signed_rank(arrays[a] - arrays[b])) for a, b in pairs]
    return pd.DataFrame(rows, columns=[*columns, "median_difference"])


def _signed_rank(difference: np.ndarray) -> tuple[float, float, float, float]:
    if not difference.any():
        return 0.0, 1.0, 1.0, 0.0
    nonzero = difference[difference != 0]
    test, normal = wilcoxon(nonzero), wilcoxon(nonzero, method="asymptotic")
    return test.statistic, test.pvalue, normal.pvalue, np.median(difference)
