"""Covariance of estimates with autocorrelated residuals: the sandwich with the estimator of Newey and West."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from rotorfit.core.frames import Array
from rotorfit.estimation.regression.paper import bartlett_lag, newey_west


@dataclass(frozen=True)
class Sandwich:
    """Uncertainty of P parameters.

    Attributes:
        covariance: Shape (P, P).
        lag: Longest lag of the autocorrelation that enters it [s].
        quantile: Half width of a 95 % interval in standard errors.
    """

    covariance: Array
    lag: float
    quantile: float


def sandwich(times: Sequence[Array], scores: Sequence[Array], slope: Array, memory: float) -> Sandwich | None:
    """Covariance of the root of sum over rows of score = 0.

    Args:
        times: Stamps of the rows, shape (N,) [s] for each stretch.
        scores: Contribution of each row to the estimating equations, shape (N, P) for each stretch.
        slope: Minus the derivative of their sum with respect to the parameters, shape (P, P).
        memory: Time over which the errors of rows are dependent by construction [s].

    Returns:
        The covariance; None where the slope is singular, or where the scores of a parameter are all zero or not finite.

    Source: W. K. Newey, K. D. West, Econometrica 55 (1987), pp. 703-708; for the quantile see `fixed_b_quantile`.
    """
    size = np.sqrt(np.abs(np.diag(slope)))
    moves = all(np.isfinite(g).all() for g in scores) and (np.sum([np.sum(g**2, axis=0) for g in scores], axis=0) > 0)
    if not (size > 0).all() or not np.isfinite(slope).all() or not np.all(moves):
        return None
    bread = slope / np.outer(size, size)
    if np.linalg.svd(bread, compute_uv=False)[-1] < SINGULAR:
        return None
    inverse = np.linalg.inv(bread) / np.outer(size, size)
    lag = bartlett_lag(times, scores, memory)
    middle = np.sum([newey_west(t, g, lag) for t, g in zip(times, scores, strict=True)], axis=0)
    duration = sum(float(np.ptp(t)) for t in times)
    return Sandwich(inverse @ middle @ inverse.T, lag, fixed_b_quantile(min(1.0, lag / duration)))


SINGULAR = 1e-8
"""Smallest singular value, columns scaled, below which parameters are not identifiable separately."""


def fixed_b_quantile(share: float) -> float:
    """97.5 % point of the t statistic when the lag of the Bartlett kernel is not a negligible share of the data.

    The scores of an estimate sum to zero, which shrinks a variance with a long lag; the normal quantile 1.96 would be
    too small.

    Args:
        share: Lag of the kernel over the length of the data, from 0 to 1.

    Source: N. M. Kiefer, T. J. Vogelsang, Econometric Theory 21 (2005), pp. 1130-1164, table 1, Bartlett kernel.
    """
    return 1.96 + share * (2.9694 + share * (0.4160 - 0.5324 * share))
