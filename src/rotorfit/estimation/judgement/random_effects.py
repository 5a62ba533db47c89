"""Estimates from several flights -> the vehicle's value: random effects with a prior on the spread between flights.

Flight i gives y_i with standard error s_i; the vehicle on that day was mu + d_i with d_i ~ N(0, tau^2), so

    y_i ~ N(mu, s_i^2 + tau^2)

tau is unknown, and two to six flights hardly identify it. Its restricted likelihood is therefore combined with a prior,
a half Student's t whose scale comes from recorded vehicles (`spread_prior`), and the distributions of mu and of the
next flight are averaged over the posterior of tau. One flight carries no information about tau: the posterior is the
prior. The prior of several has a small part far wider, so that flights that differ much overrule it. The spread by
restricted maximum likelihood, without the prior, is given in addition.

Where tests found errors of the law, flights may differ by as much without any spread: for tau they count as a part of
s_i.

Source: R. DerSimonian, N. Laird, Controlled Clinical Trials 7 (1986), pp. 177-188; A. Gelman, Bayesian Analysis 1
(2006), pp. 515-533 (half t and half Cauchy for few groups); A. O'Hagan, L. Pericchi, Braz. J. Probab. Stat. 26 (2012),
pp. 372-401 (mixtures that give way to the data); J. P. T. Higgins, S. G. Thompson, D. J. Spiegelhalter, J. R. Statist.
Soc. A 172 (2009), pp. 137-159 (next flight).
"""

from dataclasses import dataclass

import numpy as np

from rotorfit.core.frames import Array
from rotorfit.core.model import NORMAL

TAIL = 3.0
"""Degrees of freedom of the half t: heavy tails, but a finite variance."""

GRID = np.concatenate([[0.0], np.geomspace(0.01, 40.0, 79), np.geomspace(44.5, 40_000.0, 65)])
"""Values of the spread that are averaged over, in units of the scale of its prior. The last are for flights that are
precise and differ by a thousand of their standard errors."""

WIDE_SHARE, WIDE_SCALE = 0.05, 10.0
"""Share of the prior of several flights that is a half Cauchy, and its scale in that of the half t."""

EDGES = np.concatenate([[0.0], 0.5 * (GRID[1:] + GRID[:-1]), [GRID[-1]]])
"""Ends of the cells around these values."""

ONE_FLIGHT = (1 + GRID**2 / TAIL) ** (-0.5 * (TAIL + 1))
"""Prior density of the spread at these values: a half t, relative to its density at 0."""

SEVERAL_FLIGHTS = (1 - WIDE_SHARE) * ONE_FLIGHT + WIDE_SHARE * np.sqrt(TAIL) / 2 / WIDE_SCALE / (
    1 + (GRID / WIDE_SCALE) ** 2
)
"""The same of several flights, which can overrule the half t: sqrt(TAIL) / 2 is the ratio of the densities of a half
Cauchy and a half t with three degrees of freedom at 0."""


@dataclass(frozen=True)
class RandomEffects:
    """Combined result of several flights, on the scale of their estimates.

    Attributes:
        mean: Posterior mean of the vehicle's value mu.
        sd: Half width of the 95 % interval of mu, divided by 1.96.
        next_sd: The same for the value on the next flight.
        spread: Posterior median of the spread tau.
        reml: Spread by restricted maximum likelihood, without the prior; None for one flight.
        p_value: Probability of a larger Cochran's Q under zero spread; None for one flight.
    """

    mean: float
    sd: float
    next_sd: float
    spread: float
    reml: float | None
    p_value: float | None


def random_effects(value: Array, error: Array, scale: float, law: float = 0.0) -> RandomEffects:
    """Mean and spread of the estimates of one quantity from several flights.

    Args:
        value: Estimate from each flight, shape (F,).
        error: Standard errors, shape (F,).
        scale: Scale of the half t of the spread, in the unit of the estimates.
        law: Standard deviation that errors of the law give to each estimate, likewise.
    """
    tau = np.maximum(scale, 1e-12) * GRID
    _, mean, total, misfit = _restricted(value, error, tau)
    restricted = _restricted(value, np.hypot(error, law), tau)[0]
    share = posterior(restricted, SEVERAL_FLIGHTS if len(value) > 1 else ONE_FLIGHT)
    center = float(share @ mean)
    # the mean depends on the spread, too: its deviation is added to the variance at each spread
    spread = 1 / total + (mean - center) ** 2
    alone = len(value) > 1
    return RandomEffects(
        mean=center,
        sd=mixed_half_width(spread, share) / NORMAL,
        next_sd=mixed_half_width(spread + tau**2, share) / NORMAL,
        spread=max(scale, 1e-12) * float(np.interp(0.5, np.cumsum([0.0, *share]), EDGES)),
        reml=_reml(value, error) if alone else None,
        p_value=_chi_squared(float(misfit[0]), len(value) - 1) if alone else None,
    )


def excess_spread(apart: Array, error: Array, scale: float) -> float:
    """Spread between parts of the data in excess of that expected from the prior, in standard errors of the whole.

    Prior and posterior are compared by the half width of the interval of a quantity whose standard error is 1.

    Args:
        apart: Independent differences between parts, shape (N,), in standard errors of the whole.
        error: Their standard errors, shape (N,), likewise; the spread adds to each variance once.
        scale: Scale of the half t of the spread, likewise.
    """
    tau = np.maximum(scale, 1e-12) * GRID
    variance = error[:, None] ** 2 + tau**2
    restricted = -0.5 * (np.log(variance) + apart[:, None] ** 2 / variance).sum(axis=0)
    after = mixed_half_width(1 + tau**2, posterior(restricted))
    before = mixed_half_width(1 + tau**2, posterior(np.zeros(tau.size)))
    return float(np.sqrt(max(after**2 - before**2, 0.0))) / NORMAL


def _restricted(value: Array, error: Array, tau: Array) -> tuple[Array, Array, Array, Array]:
    """Restricted log-likelihood of spreads tau (S,); mean, total weight and Cochran's Q at each, all of shape (S,)."""
    variance = error[:, None] ** 2 + tau**2
    weight = 1 / variance
    total = weight.sum(axis=0)
    mean = (weight * value[:, None]).sum(axis=0) / total
    misfit = (weight * (value[:, None] - mean) ** 2).sum(axis=0)
    return -0.5 * (np.log(variance).sum(axis=0) + np.log(total) + misfit), mean, total, misfit


def posterior(log_likelihood: Array, prior: Array = ONE_FLIGHT) -> Array:
    """Posterior probability of each cell of `GRID`, from its log-likelihood, the prior and the width of the cell."""
    share = prior * np.diff(EDGES) * np.exp(log_likelihood - log_likelihood.max())
    return np.asarray(share / share.sum())


def mixed_half_width(variance: Array, share: Array) -> float:
    """Half width that contains 95 % of a mixture of normal distributions with a common mean.

    By Newton's method from the half width of the narrowest of them: from there it approaches from below, as the
    probability outside is convex.
    """
    from scipy.special import ndtr

    sd = np.sqrt(variance)
    half = NORMAL * float(sd.min())
    for _ in range(60):
        z = half / sd
        density = float(share @ (np.exp(-0.5 * z**2) / sd)) / np.sqrt(2 * np.pi)
        step = (float(share @ ndtr(-z)) - 0.025) / density
        half += step
        if abs(step) < 1e-14 * half:
            break
    return half


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


def _chi_squared(statistic: float, freedom: int) -> float:
    from scipy.special import chdtrc

    return float(chdtrc(freedom, statistic))
