"""Cross-check of an estimate by a method with different errors: instrumental variables.

The sensitivities of the simulated response are instruments: in an open loop they are free of wind and noise under any
filter, and sum Z'(y - response) = 0 has the same root. The likelihood uses the filter that is optimal if the models of
wind and law are right. A slower and a faster filter weight other frequencies, so a wrong law gives other estimates. One
step from the root of the likelihood approximates them.

In a feedback loop only the right filter makes innovations uncorrelated with earlier commands. Where they are coloured,
the filter is wrong, and what the loop carries of the disturbance into the command biases the likelihood: the law takes
over what the filter lacks, down to the inverse of the controller. The tones of the command come from outside the loop,
so the sensitivities to them are instruments there too. Their error then replaces that of the likelihood, which counts
the disturbance in the command as excitation.

Source: T. Soderstrom, P. Stoica, System Identification (1989), chapter 8 (instrumental variables with prefilters);
P. M. J. Van den Hof, Annual Reviews in Control 22 (1998), pp. 173-186 (the bias in a loop, and what avoids it);
J. A. Hausman, Econometrica 46 (1978), pp. 1251-1271 (the test by two estimators); W. K. Newey, K. D. West,
Econometrica 55 (1987), pp. 703-708 (the variance of their difference); V. Dalla, L. Giraitis, P. C. B. Phillips,
Econometric Theory 38 (2022), pp. 913-941 (whiteness under unequal variances).
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from rotorfit.core.frames import Array
from rotorfit.dynamics.tones import SOME_TONES, tones_of
from rotorfit.estimation.judgement.refutation import REJECTED, Homogeneity, homogeneity_of
from rotorfit.estimation.judgement.residual_variance import Weighted, weighted_innovations
from rotorfit.estimation.judgement.spread_prior import spread_scale
from rotorfit.estimation.likelihood.axis_estimate import Estimate
from rotorfit.estimation.likelihood.block_response import response
from rotorfit.estimation.likelihood.blocks import Record
from rotorfit.estimation.likelihood.estimand import Estimand
from rotorfit.estimation.likelihood.likelihood import score, segments, whiten
from rotorfit.estimation.likelihood.parameters import Point
from rotorfit.estimation.regression.paper import newey_west

OTHER_FILTERS = (10.0, 0.1)
"""Factors on the filter's variance of the pose noise: it then weights slow motion more, or fast motion."""

MEMORY = 2.0
"""Time over which the contributions to the difference of the estimates are correlated [s]."""

TONE_STEP = 0.1
"""Sampling period of the commands in which tones are searched [s]."""

HIGHEST_TONE = 15.0
"""Highest frequency of a tone [rad/s]."""

SAYS_NOTHING = 5.0
"""Standard error, of a logarithm or else [s], beyond which no larger one is told apart: the quantity is unknown."""

WHITE_OVER = 1.0
"""Lags over which innovations are tested for colour [s]."""


def with_instruments(
    estimate: Estimate, weighted: Sequence[Weighted], wanted: Mapping[str, Estimand], errors: Mapping[str, float]
) -> dict[str, Homogeneity]:
    """Agreement of the likelihood with instrumental variables, by quantity.

    Args:
        estimate: Estimate by the likelihood.
        weighted: Its innovations and weights, in the order of `wanted`.
        wanted: Quantities to compare, by name.
        errors: Their standard errors on their scales, by name.

    Returns:
        In an open loop, for each quantity the comparison with that of the other filters that disagrees most; in a loop,
        that with the tones of the command. Empty in a loop whose innovations are white, or without tones.
    """
    if not estimate.loop.closed:
        return _between_filters(estimate, weighted, wanted, errors)
    return _with_tones(estimate, weighted, wanted, errors) if _coloured(weighted, estimate.place) else {}


def _between_filters(
    estimate: Estimate, weighted: Sequence[Weighted], wanted: Mapping[str, Estimand], errors: Mapping[str, float]
) -> dict[str, Homogeneity]:
    """The comparison with other filters, in an open loop."""
    found: dict[str, Homogeneity] = {}
    for factor in OTHER_FILTERS:
        other = _contributions(estimate, list(wanted.values()), factor, [one.own for one in weighted])
        apart = [theirs - _own(ours) for theirs, ours in zip(other, weighted, strict=True)]
        total = np.sum([part.sum(axis=0) for part in apart], axis=0)
        parts = zip(weighted, apart, strict=True)
        spread = np.sum([newey_west(one.time, part, MEMORY) for one, part in parts], axis=0)
        for q, name in enumerate(wanted):
            half = float(np.sqrt(max(spread[q, q], 0.0) / 2)) / errors[name]
            if not (np.isfinite(total[q]) and half > 0):
                continue
            apart = float(total[q]) / (np.sqrt(2) * errors[name])
            one = homogeneity_of(np.array([apart]), np.array([half]), spread_scale(name))
            if name not in found or one.sd > found[name].sd:
                found[name] = one
    return found


def _own(one: Weighted) -> Array:
    """Contribution of each block to the estimates, shape (B, Q)."""
    return np.asarray(np.einsum("bk,bkq->bq", one.innovation, one.weight))


def _contributions(estimate: Estimate, wanted: Sequence[Estimand], factor: float, own: Sequence[Array]) -> list[Array]:
    """Contribution of each block to the step to the root under another filter, per flight (B, Q).

    Each flight's is from its own parameters, which `own` steps to: flights that differ do not make the filters differ.
    """
    point = estimate.optimum.point
    levels = point.levels.copy()
    levels[:, 1] += np.log(factor)
    moved = replace(point, levels=levels)
    there = score(estimate.records, moved)
    optimum = replace(estimate.optimum, point=moved, score=there)
    seen = weighted_innovations(replace(estimate, optimum=optimum), wanted, own)
    return [_own(one) for one in seen]


def _coloured(weighted: Sequence[Weighted], k: int) -> bool:
    """Whether the innovations of axis k are correlated in time, whatever their variances."""
    from scipy.special import chdtrc

    statistic, freedom = 0.0, 0
    for one in weighted:
        e = one.innovation[:, k]
        lags = min(round(WHITE_OVER / float(np.median(np.diff(one.time)))), e.size // 8)
        products = [e[lag:] * e[:-lag] for lag in range(1, lags + 1)]
        statistic += sum(float(part.sum() ** 2 / (part @ part)) for part in products)
        freedom += lags
    return bool(chdtrc(freedom, statistic) < REJECTED)


def _with_tones(
    estimate: Estimate, weighted: Sequence[Weighted], wanted: Mapping[str, Estimand], errors: Mapping[str, float]
) -> dict[str, Homogeneity]:
    """The comparison with instrumental variables made of the tones of the commands, in a feedback loop.

    What the quantity's spread adds to the error of the likelihood is the excess of the instruments' variance, and of
    the squared difference of the estimates over its variance.
    """
    from scipy.special import chdtrc

    optimum, records, quantities = estimate.optimum, estimate.records, list(wanted.values())
    n = optimum.point.n
    found = [pair for rec in records if (pair := _tonal(rec)) is not None]
    outside, numbers = [rec for rec, _ in found], sum(2 * count for _, count in found)
    if len(outside) < len(records) or numbers < np.count_nonzero(optimum.free[: optimum.point.coefficients]):
        return {}
    own, tonal = _sensitivities(records, optimum.point), _sensitivities(outside, optimum.point)
    free = np.flatnonzero(optimum.free[:n])
    square = free[:, None], free
    known, crossed = optimum.score.information[:n, :n][square], np.zeros((free.size, free.size))
    for x, z in zip(own, tonal, strict=True):
        crossed += np.einsum("bki,bkj->ij", (z - x)[:, :, free], x[:, :, free])
    slopes = np.array([one.slope[free] for one in quantities]).T
    along, beside = _solved((known + crossed).T, known, slopes), _solved(known, known, slopes)
    step, variance, chance = np.zeros((3, len(quantities)))
    for one, x, z in zip(weighted, own, tonal, strict=True):
        ours, theirs = (np.einsum("bk,bki->bi", one.innovation, part[:, :, free]) for part in (x, z))
        step += (theirs - ours).sum(axis=0) @ along
        variance += newey_west(one.time, theirs @ along, MEMORY).diagonal()
        chance += newey_west(one.time, theirs @ along - ours @ beside, MEMORY).diagonal()
    error = np.sqrt(np.minimum(variance + np.maximum(step**2 - chance, 0.0), SAYS_NOTHING**2))
    statistic = step**2 / np.maximum(chance, np.finfo(float).tiny)
    return {
        name: Homogeneity(
            float(statistic[q]),
            1,
            float(chdtrc(1, statistic[q])),
            float(np.sqrt(max((error[q] / errors[name]) ** 2 - 1, 0.0))),
        )
        for q, name in enumerate(wanted)
    }


def _solved(matrix: Array, information: Array, slopes: Array) -> Array:
    """Solution for the slopes (n, Q), scaled by the information, with the ridge of `inverted`."""
    scale = 1 / np.sqrt(np.maximum(information.diagonal(), 1e-12))[:, None]
    return scale * np.linalg.solve(scale * matrix * scale.T + 1e-10 * np.eye(len(matrix)), scale * slopes)


def _tonal(rec: Record) -> tuple[Record, int] | None:
    """The record with the tones of its commands for the commands, and their number; None where they hold too little."""
    t, count = rec.command_time, 0
    grid = np.arange(t[0], t[-1], TONE_STEP)
    held = rec.command[np.searchsorted(t, grid, side="right") - 1]
    command = np.zeros_like(rec.command)
    for k in np.flatnonzero(np.ptp(held, axis=0) > 0):
        tones = tones_of(grid, held[:, k], HIGHEST_TONE)
        if tones.share < SOME_TONES:
            return None
        phase = np.outer(t, tones.frequency)
        command[:, k] = np.cos(phase) @ tones.cosine + np.sin(phase) @ tones.sine
        count += tones.frequency.size
    return replace(rec, command=command), count


def _sensitivities(records: Sequence[Record], point: Point) -> list[Array]:
    """Whitened sensitivities of each flight to all n parameters before the levels, shape (B, K, n)."""
    K, first = point.gain.size, point.coefficients
    out = []
    for j, (rec, at) in enumerate(zip(records, segments(records), strict=True)):
        rows, _ = whiten(rec, response(rec, point, j, point.start[at])[1], point.levels)
        rows = rows.transpose(0, 2, 1)
        whole = np.zeros((*rows.shape[:2], point.n))
        whole[:, :, [*range(first), *range(first + j * K, first + (j + 1) * K)]] = rows[:, :, : first + K]
        starts = first + len(records) * K + (at.start + rec.segment)[:, None] * K + np.arange(K)
        np.put_along_axis(whole, np.repeat(starts[:, None], K, axis=1), rows[:, :, first + K :], axis=2)
        out.append(whole)
    return out
