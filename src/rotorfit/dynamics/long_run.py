"""Variance of the mean of an autocorrelated series, from its lowest frequencies, and its t test.

Source: E. Lazarus, D. J. Lewis, J. H. Stock, M. W. Watson, J. Bus. Econ. Stat. 36 (2018), pp. 541-559.
"""

import numpy as np

from rotorfit.core.frames import Array


def frequencies(n: int) -> int:
    """Number of low frequencies used for the variance of the mean of n values: 0.4 n^(2/3), Lazarus et al."""
    return int(0.4 * n ** (2 / 3) + 1e-9)


def variance_of_mean(series: Array, count: int) -> Array:
    """Covariance (m, m) of the mean of an autocorrelated series (n, m), from its `count` >= 1 lowest frequencies.

    It is positive by construction, and a t-ratio with it has Student's distribution with `count` degrees of freedom.

    Source: Lazarus et al. 2018, section 3: the mean square of the first terms of the cosine transform.
    """
    from scipy.fft import dct

    n = len(series)
    terms = dct(series, axis=0, norm="ortho")[1 : count + 1]
    return np.asarray(terms.T @ terms / count / n)


def two_sided(t: float, freedom: float) -> float:
    """Two-sided p-value of a t-ratio."""
    from scipy.special import stdtr

    return float(2 * stdtr(freedom, -abs(t)))
