"""Cross-check of an estimate by a method with different errors: instrumental variables with other filters.

The sensitivities of the simulated response are instruments: in an open loop they are free of wind and noise under any
filter, and sum Z'(y - response) = 0 has the same root. The likelihood uses the filter that is optimal if the models of
wind and law are right. A slower and a faster filter weight other frequencies, so a wrong law gives other estimates. One
step from the root of the likelihood approximates them.

In a feedback loop only the right filter makes innovations uncorrelated with earlier commands: no comparison is made.

Source: T. Soderstrom, P. Stoica, System Identification (1989), chapter 8 (instrumental variables with prefilters);
J. A. Hausman, Econometrica 46 (1978), pp. 1251-1271 (the test by two estimators); W. K. Newey, K. D. West,
Econometrica 55 (1987), pp. 703-708 (the variance of their difference).
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from rotorfit.core.frames import Array
from rotorfit.estimation.judgement.refutation import Homogeneity, homogeneity_of
from rotorfit.estimation.judgement.residual_variance import Weighted, weighted_innovations
from rotorfit.estimation.judgement.spread_prior import spread_scale
from rotorfit.estimation.likelihood.axis_estimate import Estimate
from rotorfit.estimation.likelihood.estimand import Estimand
from rotorfit.estimation.likelihood.likelihood import score
from rotorfit.estimation.regression.paper import newey_west

OTHER_FILTERS = (10.0, 0.1)
"""Factors on the filter's variance of the pose noise: it then weights slow motion more, or fast motion."""

MEMORY = 2.0
"""Time over which the contributions to the difference of the estimates are correlated [s]."""


def between_filters(
    estimate: Estimate, weighted: Sequence[Weighted], wanted: Mapping[str, Estimand], errors: Mapping[str, float]
) -> dict[str, Homogeneity]:
    """Agreement of the likelihood with instrumental variables, by quantity; empty in a feedback loop.

    Args:
        estimate: Estimate by the likelihood.
        weighted: Its innovations and weights, in the order of `wanted`.
        wanted: Quantities to compare, by name.
        errors: Their standard errors on their scales, by name.

    Returns:
        For each quantity the comparison with that of the other filters that disagrees most.
    """
    if estimate.loop.closed:
        return {}
    found: dict[str, Homogeneity] = {}
    for factor in OTHER_FILTERS:
        other = _contributions(estimate, list(wanted.values()), factor)
        apart = [theirs - _own(ours) for theirs, ours in zip(other, weighted, strict=True)]
        total = np.sum([part.sum(axis=0) for part in apart], axis=0)
        parts = zip(weighted, apart, strict=True)
        spread = np.sum([newey_west(one.time, part, MEMORY) for one, part in parts], axis=0)
        for q, name in enumerate(wanted):
            half = float(np.sqrt(max(spread[q, q], 0.0) / 2)) / errors[name]
            if not (np.isfinite(total[q]) and half > 0):
                continue
            pair = np.array([0.0, float(total[q]) / errors[name]])
            one = homogeneity_of(pair, np.array([half, half]), spread_scale(name))
            if name not in found or one.sd > found[name].sd:
                found[name] = one
    return found


def _own(one: Weighted) -> Array:
    """Contribution of each block to the estimates, shape (B, Q)."""
    return np.asarray(np.einsum("bk,bkq->bq", one.innovation, one.weight))


def _contributions(estimate: Estimate, wanted: Sequence[Estimand], factor: float) -> list[Array]:
    """Contribution of each block to the step to the root under another filter, per flight (B, Q)."""
    point = estimate.optimum.point
    levels = point.levels.copy()
    levels[:, 1] += np.log(factor)
    moved = replace(point, levels=levels)
    there = score(estimate.records, moved)
    optimum = replace(estimate.optimum, point=moved, score=there)
    seen = weighted_innovations(replace(estimate, optimum=optimum), wanted)
    return [_own(one) for one in seen]
