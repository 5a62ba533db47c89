"""Estimates of several flights -> what the vehicle is: random effects with a prior on the spread between flights.

Flight i gives y_i with standard error s_i; the vehicle on that day was mu + d_i with d_i ~ N(0, tau^2), so

    y_i ~ N(mu, s_i^2 + tau^2)

tau is not known, and two or six flights hardly tell it. Its restricted likelihood is therefore weighed with a prior, a
half Student's t whose scale is made from recorded vehicles (`spread_prior`), and what is said of mu and of the next
flight is averaged over what is left of tau. One flight says nothing of tau: then the prior alone speaks. What the
flights say by themselves, tau by restricted maximum likelihood and the interval of Hartung and Knapp, stands beside.

Source: R. DerSimonian, N. Laird, Controlled Clinical Trials 7 (1986), pp. 177-188; J. Hartung, G. Knapp, Statistics in
Medicine 20 (2001), pp. 3875-3889; A. Gelman, Bayesian Analysis 1 (2006), pp. 515-533 (half t for few groups);
J. P. T. Higgins, S. G. Thompson, D. J. Spiegelhalter, J. R. Statist. Soc. A 172 (2009), pp. 137-159 (next flight).
"""

from dataclasses import dataclass

import numpy as np

from rotorfit.core.frames import Array
from rotorfit.core.results import student_quantile

NORMAL = 1.959963984540054
"""97.5 % point of the normal distribution."""

TAIL = 3.0
"""Degrees of freedom of the half t: heavy, but with a variance."""

GRID = np.concatenate([[0.0], np.geomspace(0.01, 40.0, 79)])
"""Values of the spread that are averaged over, in scales of its prior."""


@dataclass(frozen=True)
class RandomEffects:
    """What some flights say together, on the scale of their estimates.

    Attributes:
        mean: Of the vehicle, averaged over the spread.
        common: Weighted mean of flights that do not differ.
        sd: Standard deviation of the mean such that +-1.96 of it are the 95 % interval.
        next_sd: The same for the coefficient on the next flight.
        spread: Median of the spread between flights, after the data.
        reml: Spread by restricted maximum likelihood, the flights alone; None for one flight.
        knapp_hartung: 95 % interval of the mean, the flights alone; None for one flight.
        p_value: Of a larger Cochran's Q from flights that do not differ; None for one flight.
    """

    mean: float
    common: float
    sd: float
    next_sd: float
    spread: float
    reml: float | None
    knapp_hartung: tuple[float, float] | None
    p_value: float | None


def random_effects(value: Array, error: Array, scale: float) -> RandomEffects:
    """Mean and spread of what flights say of one coefficient.

    Args:
        value: Of each flight, shape (F,).
        error: Standard errors, shape (F,).
        scale: Of the half t of the spread.
    """
    tau = np.maximum(scale, 1e-12) * GRID
    restricted, mean, total, misfit = _restricted(value, error, tau)
    share = posterior(restricted)
    center = float(share @ mean)
    # what the spread may be moves the mean, too: that is added to the variance at each spread
    spread = 1 / total + (mean - center) ** 2
    alone = len(value) > 1
    return RandomEffects(
        mean=center,
        common=float(mean[0]),
        sd=mixed_half_width(spread, share) / NORMAL,
        next_sd=mixed_half_width(spread + tau**2, share) / NORMAL,
        spread=float(np.interp(0.5, np.cumsum(share), tau)),
        reml=_reml(value, error) if alone else None,
        knapp_hartung=_knapp_hartung(value, error) if alone else None,
        p_value=_chi_squared(float(misfit[0]), len(value) - 1) if alone else None,
    )


def excess_spread(apart: Array, error: Array, scale: float) -> float:
    """Spread of parts of one flight beyond what the prior alone makes one expect, in the unit of the errors.

    Both are taken as what they add to the half width of an interval whose error is 1.

    Args:
        apart: What each part says, shape (M,).
        error: Standard errors, shape (M,), in units of that of the whole.
        scale: Of the half t of the spread.
    """
    tau = np.maximum(scale, 1e-12) * GRID
    after = mixed_half_width(1 + tau**2, posterior(_restricted(apart, error, tau)[0]))
    before = mixed_half_width(1 + tau**2, posterior(np.zeros(tau.size)))
    return float(np.sqrt(max(after**2 - before**2, 0.0))) / NORMAL


def _restricted(value: Array, error: Array, tau: Array) -> tuple[Array, Array, Array, Array]:
    """Restricted log-likelihood of spreads (S,), with the mean, the weight and the misfit at each."""
    variance = error[:, None] ** 2 + tau**2
    weight = 1 / variance
    total = weight.sum(axis=0)
    mean = (weight * value[:, None]).sum(axis=0) / total
    misfit = (weight * (value[:, None] - mean) ** 2).sum(axis=0)
    return -0.5 * (np.log(variance).sum(axis=0) + np.log(total) + misfit), mean, total, misfit


def posterior(log_likelihood: Array) -> Array:
    """Shares of the values of the spread, prior and the width of each cell of the grid counted."""
    prior = (1 + GRID**2 / TAIL) ** (-0.5 * (TAIL + 1))
    edges = np.concatenate([[0.0], 0.5 * (GRID[1:] + GRID[:-1]), [GRID[-1]]])
    share = prior * np.diff(edges) * np.exp(log_likelihood - log_likelihood.max())
    return np.asarray(share / share.sum())


def mixed_half_width(variance: Array, share: Array) -> float:
    """Half width that holds 95 % of a mixture of normal distributions of one mean."""
    from scipy.special import ndtr

    sd, low, high = np.sqrt(variance), 0.0, 0.0
    high = float(NORMAL * 20 * sd.max())
    for _ in range(60):
        middle = 0.5 * (low + high)
        outside = float(share @ ndtr(-middle / np.maximum(sd, 1e-300)))
        low, high = (middle, high) if outside > 0.025 else (low, middle)
    return high


def _reml(value: Array, error: Array) -> float:
    """Spread that maximises the restricted likelihood.

    Source: W. Viechtbauer, J. Educ. Behav. Stat. 30 (2005), pp. 261-293, eq. (14).
    """
    from scipy.optimize import minimize_scalar

    def loss(tau: float) -> float:
        variance = error**2 + tau**2
        weight = 1 / variance
        mean = weight @ value / weight.sum()
        return float(np.log(variance).sum() + np.log(weight.sum()) + weight @ (value - mean) ** 2)

    best = minimize_scalar(loss, bounds=(0.0, 3 * float(np.ptp(value)) + 1e-12), method="bounded")
    return float(best.x) if best.fun < loss(0.0) else 0.0


def _knapp_hartung(value: Array, error: Array) -> tuple[float, float]:
    """Interval of the mean by Hartung and Knapp, never narrower than without their factor."""
    weight = 1 / (error**2 + _reml(value, error) ** 2)
    mean, freedom = float(weight @ value / weight.sum()), len(value) - 1
    factor = max(float(weight @ (value - mean) ** 2) / freedom, 1.0)
    half = student_quantile(freedom) * float(np.sqrt(factor / weight.sum()))
    return mean - half, mean + half


def _chi_squared(statistic: float, freedom: int) -> float:
    from scipy.special import chdtrc

    return float(chdtrc(freedom, statistic))
