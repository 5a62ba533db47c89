"""Trims of the flights of a fit -> prior variance of the trim of a new flight.

An estimate c with variance v of a trim has the mean square s^2 + v over flights whose trims have the mean square s^2:
the error must not be counted as trim, let alone twice, as in c^2 + v. But c^2 - v of one flight is negative where the
trim is smaller than its error, and a filter that knows of no trim takes it for wind. Hence a hierarchical prior,

    c_i ~ N(0, s^2),   s ~ half Cauchy of scale S,

with S from the class of vehicles, and the variance is their posterior mean square,

    sum_s p(s | c, v) mean_i [(k_i c_i)^2 + k_i v_i],   k_i = s^2 / (s^2 + v_i).

A trim that is well known counts as it is; of one that is not, little more than the class remains; one that is far
outside the class and certain is believed, because the prior has heavy tails.

Source: A. Gelman, Bayesian Analysis 1 (2006), pp. 515-533, for the prior; C. N. Morris, J. Amer. Statist. Assoc. 78
(1983), pp. 47-55, for the posterior mean square of each effect.
"""

import numpy as np

from rotorfit.core.frames import AXES, Array
from rotorfit.core.laws import USUAL_TRIM
from rotorfit.estimation.likelihood.fisher_scoring import Optimum

GRID = np.geomspace(1e-3, 1e4, 201)
"""Values of s that are averaged over, in units of S; they have equal steps of the logarithm."""

LEAST = 1e-12
"""Added to the variance: the filter needs more than 0 [unit^2/s^4]."""


def trims_of(optimum: Optimum) -> tuple[Array, Array]:
    """Trims of the flights and their variances, both of shape (F, K)."""
    trim, first = optimum.point.trim, optimum.point.coefficients
    variance = np.diag(optimum.covariance)
    return trim, variance[first : first + trim.size].reshape(trim.shape)


def new_trim_variance(trim: Array, variance: Array, axis: str) -> float:
    """Prior variance of the trim of a new flight [unit^2/s^4].

    Args:
        trim: Estimates from the flights of a fit, shape (F,) [unit/s^2].
        variance: Their variances, shape (F,).
        axis: Name of the axis, for the scale S.
    """
    square = (USUAL_TRIM[AXES.index(axis)] * GRID[:, None]) ** 2
    total = square + variance
    likelihood = -0.5 * (np.log(total) + trim**2 / total).sum(axis=1)
    share = GRID / (1 + GRID**2) * np.exp(likelihood - likelihood.max())
    kept = square / total
    return float(share @ ((kept * trim) ** 2 + kept * variance).mean(axis=1) / share.sum()) + LEAST
