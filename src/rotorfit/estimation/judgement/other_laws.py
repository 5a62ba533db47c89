"""Steady gain and total lag under laws that an axis may obey as well, but that models do not have.

A law with one lag has real poles, one of which stands for the whole inner loop. The attitude loops of multirotors are
of the second order, and a velocity loop around one has complex poles that do not overshoot. A flight tells such laws
apart from one lag by a few units of the log-likelihood, while their steady gain and total lag differ by more than the
errors under either. So two are fitted beside a law with a lag: one whose commands pass the lag twice, and a second
order in velocity. The interval of the vehicle contains that of the mean over all three, weighted by their
probabilities.

Source: J. A. Hoeting et al., Statistical Science 14 (1999), pp. 382-417 (mean and variance between models); H. Akaike,
Biometrika 66 (1979), pp. 237-242 (the weight of a model by its likelihood and number of parameters).
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np

from rotorfit.core.laws import STRUCTURES, Structure
from rotorfit.estimation.likelihood.axis_estimate import Estimate, free_of
from rotorfit.estimation.likelihood.estimand import Estimand, estimands
from rotorfit.estimation.likelihood.extra_parameters import structure_at
from rotorfit.estimation.likelihood.fisher_scoring import Optimum, maximise
from rotorfit.estimation.likelihood.law_selection import effective_samples
from rotorfit.estimation.likelihood.parameters import Point

SECOND_ORDER = STRUCTURES["second_order"]

TWICE = 0.6
"""Start of the lag that is passed twice, as a share of the one that is passed once."""

CLIMBED, MOST = 0.01, 50
"""Expected gain in log-likelihood at which a climb ends, and its largest number of passes."""

SAME_EVERYWHERE = ("steady_gain", "total_lag")
"""Quantities that mean the same under every law."""

SAME_WITH_LAG = ("input", "damping", *SAME_EVERYWHERE)
"""Those that mean the same under a law whose commands pass the lag once or twice."""


@dataclass(frozen=True)
class OtherLaw:
    """A law fitted beside that of an estimate.

    Attributes:
        optimum: Its maximum.
        gained: Its log-likelihood less that of the estimate, scaled to independent innovations.
        probability: Among the laws fitted, that of the estimate included, all of which have as many parameters.
    """

    optimum: Optimum
    gained: float
    probability: float

    @property
    def twice(self) -> bool:
        """Whether commands pass the lag twice; else the velocity is of the second order."""
        return _twice(self.optimum.point)


@dataclass(frozen=True)
class BetweenLaws:
    """What other laws say of one axis.

    Attributes:
        twice: Whether the likelier of them is that whose commands pass the lag twice.
        gained: Its log-likelihood less that of the estimate, as of `OtherLaw`.
        total_lag: Under it [s].
        shift: Quantity to its mean over all laws less the estimate, on its scale.
        factor: Quantity to its standard deviation over all laws, errors included, over its standard error; at least 1.
        apart: Quantity to its root mean square difference from the estimate, on its scale.
    """

    twice: bool
    gained: float
    total_lag: float
    shift: Mapping[str, float]
    factor: Mapping[str, float]
    apart: Mapping[str, float]

    @property
    def p_value(self) -> float:
        """About the probability of so large a ratio of likelihoods under the law of the estimate, for two other laws.

        Source: Markov's inequality: the mean of such a ratio is 1 there, if coefficients are not chosen by the data.
        """
        return float(min(1.0, 2 * np.exp(-self.gained)))


def other_laws(estimate: Estimate) -> tuple[OtherLaw, ...]:
    """The laws beside that of an estimate; none where it has no lag on the input."""
    share = effective_samples(estimate)[1]
    found = [_climbed(estimate, start) for start in _starts(estimate)]
    gained = np.array([0.0, *(share * more for _, more in found)])
    weight = np.exp(gained - gained.max())
    weight /= weight.sum()
    told = zip(found, gained[1:].tolist(), weight[1:].tolist(), strict=True)
    return tuple(OtherLaw(optimum, more, likely) for (optimum, _), more, likely in told)


def _climbed(estimate: Estimate, start: Point) -> tuple[Optimum, float]:
    """The maximum of a law, and its log-likelihood less that of the estimate.

    A second order starts at the motion of one lag. What its likelihood differs by there is due to the acceleration that
    each law assumes at the start of a segment, and does not count.
    """
    records, prior, there = estimate.records, estimate.optimum.prior, estimate.optimum.score.log_likelihood
    free = free_of(records, [bool(one) for one in estimate.optimum.free[: start.gain.size]], start.structures)
    if not _twice(start):
        others = free & (np.arange(free.size) >= start.coefficients)
        held = maximise(records, start, others, tolerance=CLIMBED, most=MOST, prior=prior)
        start, there = held.point, held.score.log_likelihood
    top = maximise(records, start, free, tolerance=CLIMBED, most=MOST, prior=prior)
    return top, top.score.log_likelihood - there


def _starts(estimate: Estimate) -> Iterator[Point]:
    """Where the climbs begin: at nearly, or exactly, the motion under the law with one lag."""
    point = estimate.optimum.point
    lagged = [_lagged(one) for one in point.structures]
    if not any(lagged) or not all(one.linear for one in point.structures):
        return
    lag = np.where(lagged, np.exp(point.extra[0]), 0.0)
    twice = tuple(replace(one, twice=True) if _lagged(one) else one for one in point.structures)
    later = np.where([one.delayed for one in point.structures], (1 - 2 * TWICE) * lag, 0.0)
    extra = point.extra.copy()
    extra[0] += np.where(lagged, np.log(TWICE), 0.0)
    yield replace(point, structures=twice, extra=extra, delay=point.delay + later)
    second = tuple(
        replace(SECOND_ORDER, world=one.world, delayed=one.delayed) if _lagged(one) else one for one in point.structures
    )
    slower = np.log1p(lag * np.exp(point.log_damping))  # the same poles
    extra = point.extra.copy()
    extra[0] -= slower
    yield replace(
        point,
        structures=second,
        gain=point.gain * np.exp(-slower),
        log_damping=point.log_damping - slower,
        extra=extra,
    )


def _lagged(structure: Structure) -> bool:
    return structure.order == 1


def _twice(point: Point) -> bool:
    return any(one.twice for one in point.structures)


def between_laws(
    beside: tuple[OtherLaw, ...], estimate: Estimate, wanted: Mapping[str, Estimand]
) -> BetweenLaws | None:
    """What other laws say of the axis of an estimate; None without another, or where its own law has no lag.

    Args:
        beside: From `other_laws`, of the estimate or of another axis with the same optimum.
        estimate: Estimate by the likelihood.
        wanted: Its quantities by name.
    """
    k = estimate.place
    if not beside or not _lagged(structure_at(estimate.optimum, k)):
        return None
    told = [(one, estimands(one.optimum, k)) for one in beside]
    shift, factor, apart = {}, {}, {}
    for name in (name for name in SAME_WITH_LAG if name in wanted):
        own = wanted[name]
        others = [
            (law.probability, values[name].scaled() - own.scaled(), values[name].error(law.optimum))
            for law, values in told
            if law.twice or name in SAME_EVERYWHERE
        ]
        error, rest = own.error(estimate.optimum), 1 - sum(likely for likely, _, _ in others)
        shift[name] = sum(likely * off for likely, off, _ in others)
        apart[name] = float(np.sqrt(sum(likely * off**2 for likely, off, _ in others)))
        variance = rest * error**2 + sum(likely * known**2 for likely, _, known in others)
        factor[name] = max(1.0, float(np.sqrt(variance + apart[name] ** 2 - shift[name] ** 2)) / error)
    best, values = max(told, key=lambda one: one[0].gained)
    return BetweenLaws(best.twice, best.gained, values["total_lag"].value, shift, factor, apart)
