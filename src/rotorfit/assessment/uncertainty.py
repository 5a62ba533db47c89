"""Flight-to-flight scatter: the estimate of each flight alone, and whether the flights agree.

Source: W. G. Cochran, Biometrics 10 (1954), pp. 101-129 (Q); J. P. T. Higgins, S. G. Thompson, Statistics in Medicine
21 (2002), pp. 1539-1558 (I^2); R. T. Birge, Physical Review 40 (1932), pp. 207-227 (the factor, of one coefficient);
K.-Y. Liang, S. L. Zeger, Biometrika 73 (1986), pp. 13-22 (the same for several: a sandwich over flights).

Fit -> the accuracy table: five standard errors of every coefficient, and the pairs that cannot be separated.

Source of the table: M. B. Tischler, R. K. Remple, Aircraft and Rotorcraft System Identification, 2nd ed., AIAA (2012),
chapter 12 (Cramer-Rao bound and insensitivity in per cent, their limits of 20 and 10). Sandwich: H. White, Econometrica
50 (1982), pp. 1-25; W. K. Newey, K. D. West, Econometrica 55 (1987), pp. 703-708.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from rotorfit.assessment.bootstrap import BLOCK_TIME, COUNT, SEED, bootstrap
from rotorfit.core.accuracy import (
    CORRELATION_LIMIT,
    Accuracy,
    AxisAccuracy,
    FlightEstimate,
    Inseparable,
    Scatter,
    Uncertainty,
)
from rotorfit.core.frames import Array
from rotorfit.core.model import COEFFICIENTS, Combination
from rotorfit.core.progress import Progress
from rotorfit.core.results import Fit
from rotorfit.estimation.likelihood.axis_estimate import Estimate
from rotorfit.estimation.likelihood.block_response import response
from rotorfit.estimation.likelihood.blocks import Record
from rotorfit.estimation.likelihood.coefficients import natural_slopes
from rotorfit.estimation.likelihood.extra_parameters import estimated_extras
from rotorfit.estimation.likelihood.fisher_scoring import EDGE, Optimum, at_bound, maximise
from rotorfit.estimation.likelihood.likelihood import inverted, score, segments, whiten
from rotorfit.estimation.likelihood.prior import with_prior
from rotorfit.estimation.regression.paper import newey_west

TOLERANCE = 1e-3
"""Expected gain in log-likelihood below which a search ends."""


def scatter(estimate: Estimate, serving: Sequence[int]) -> Scatter | None:
    """How well the flights of an axis agree; None for fewer than two flights, or if the axis is not excited.

    The disturbance levels are held at those of all flights together; trim and start velocity are each flight's own in
    any case. With two axes in one likelihood, the other one's coefficients are held.

    Args:
        estimate: Estimate of the axis, from all flights.
        serving: Indices of its flights among all flights, for the result.
    """
    from scipy.special import chdtrc

    if len(estimate.records) < 2 or not estimate.excited:
        return None
    k, K = estimate.place, estimate.optimum.point.gain.size
    own = [k, K + k, 2 * K + k]
    common = _settled(estimate.records, estimate.optimum, own)
    alone, height, filling = [], 0.0, np.zeros((3, 3))
    for rec, at, trim in zip(estimate.records, segments(estimate.records), common.point.trim, strict=True):
        part = replace(common, point=replace(common.point, trim=trim[None], start=common.point.start[at]))
        slope = score([rec], part.point).gradient[own]
        filling += np.outer(slope, slope)
        alone.append(_settled([rec], part, own))
        height += alone[-1].score.log_likelihood
    ratio = max(2 * (height - common.score.log_likelihood), 0.0)
    values = np.array([optimum.point.flat()[own] for optimum in alone])
    covariance = [inverted(o.score.information, o.free)[np.ix_(own, own)] for o in alone]
    variance = np.array([np.diag(one) for one in covariance])
    (q, mean), freedom = _cochran(values, variance), len(alone) - 1
    together = {} if estimate.optimum.point.structures else _combined(values, covariance)
    cochran = _named(q) | {name: float(_cochran(*parts)[0]) for name, parts in together.items()}
    bread = inverted(common.score.information, common.free)[np.ix_(own, own)]
    among = np.diag(bread @ filling @ bread) * len(alone) / freedom
    flights = [
        FlightEstimate(
            place,
            _named(_plain(values[i])) | {name: float(value[i]) for name, (value, _) in together.items()},
            _named(np.sqrt(variance[i]) * [1.0, np.exp(values[i][1]), 1.0])
            | {name: float(np.sqrt(spread[i])) for name, (_, spread) in together.items()},
        )
        for i, place in enumerate(serving)
    ]
    return Scatter(
        flights=tuple(flights),
        mean=_named(_plain(mean)),
        cochran=cochran,
        i_squared={name: max(1 - freedom / max(one, 1e-300), 0.0) for name, one in cochran.items()},
        factor=_named(np.sqrt(np.maximum(among / np.diag(bread), 1.0))),
        ratio=ratio,
        freedom=len(own) * freedom,
        p_value=float(chdtrc(len(own) * freedom, ratio)),
    )


def _cochran(values: Array, variance: Array) -> tuple[Array, Array]:
    """Cochran's Q and the weighted mean over the flights, which are the rows."""
    weight = 1 / np.maximum(variance, 1e-300)
    mean = np.sum(weight * values, axis=0) / np.sum(weight, axis=0)
    return np.sum(weight * (values - mean) ** 2, axis=0), mean


def _combined(values: Array, covariance: Sequence[Array]) -> dict[str, tuple[Array, Array]]:
    """Steady gain and total lag of each flight, and their variances: known even where their parts are not."""
    gain, damping, delay = values[:, 0], np.exp(values[:, 1]), values[:, 2]
    zero, one = np.zeros(len(values)), np.ones(len(values))
    parts = {
        "steady_gain": (gain / damping, np.stack([1 / damping, -gain / damping, zero], axis=1)),
        "total_lag": (delay + 1 / damping, np.stack([zero, -1 / damping, one], axis=1)),
    }
    return {name: (told, np.einsum("fi,fij,fj->f", by, np.array(covariance), by)) for name, (told, by) in parts.items()}


def _settled(records: Sequence[Record], near: Optimum, own: Sequence[int]) -> Optimum:
    """The maximum over the coefficients of one axis, trims and start velocities, at the given levels."""
    point = near.point
    free = np.zeros(point.flat().size, bool)
    free[list(own)] = True
    free[point.n - point.trim.size - point.start.size : point.n] = True
    return maximise(records, point, free, tolerance=TOLERANCE)


def _plain(values: Array) -> Array:
    """Input, damping, delay from input, log damping, delay."""
    return np.array([values[0], np.exp(values[1]), values[2]])


def _named(values: Array) -> dict[str, float]:
    return {name: float(value) for name, value in zip(COEFFICIENTS, values, strict=True)}


OBSERVED_STEP = 0.5
"""Step of the finite differences of the score, in expected standard errors."""

OTHER_STEPS = (0.1, 2.0)
"""Steps for comparison: if they give another standard error, the observed information is ragged."""

RAGGED = 0.1
"""Relative difference above which it is ragged."""

LEVEL_STEP = 0.1
"""Largest step in the logarithm of a disturbance level."""

LAG = 2.0
"""Lag up to which the contributions to the score count as correlated [s]."""

MOST_AT_BOUND = 0.05
"""Share of the bootstrap's estimates at a bound of the search above which their scatter is that of the bound."""

SHARPER = 0.5
"""A combination is reported for a pair if its relative error is below this share of the pair's smaller one."""

_COMBINED = {("input", "damping"): "steady_gain", ("damping", "delay"): "total_lag", ("delay", "lag"): "delay_plus_lag"}


def with_uncertainty(fit: Fit, progress: Progress | None = None, flights: int = COUNT, seed: int = SEED) -> Fit:
    """Adds the accuracy table to the model of a fit.

    Args:
        fit: A fit by the likelihood; any other is returned without a table.
        progress: Called with a fraction and a text; raising in it cancels.
        flights: Number of flights that the bootstrap draws.
        seed: Seed of the draws.
    """
    report = progress or (lambda _fraction, _text: None)
    if not fit.estimates:
        return fit
    known = {name: e for name, e in fit.estimates.items() if fit.model.axes[name].predictor}
    spread: dict[int, Array] = {}
    axes = {}
    for number, (name, estimate) in enumerate(known.items()):
        report(number / len(known), f"five standard errors of {name}")
        if id(estimate.optimum) not in spread:
            drawn = bootstrap(estimate.records, estimate.optimum, flights, seed)
            low, high = estimate.optimum.point.bounds()
            stuck = ((drawn <= low + EDGE) | (drawn >= high - EDGE)).mean(axis=0) > MOST_AT_BOUND
            spread[id(estimate.optimum)] = np.where(stuck, np.nan, drawn.std(axis=0, ddof=1))
        serving = serving_flights(fit, estimate)
        combinations = fit.model.axes[name].combinations
        axes[name] = _axis(estimate, spread[id(estimate.optimum)], scatter(estimate, serving), combinations)
    table = Uncertainty(axes, OBSERVED_STEP, flights, seed, BLOCK_TIME, LAG)
    return replace(fit, model=replace(fit.model, uncertainty=table))


def serving_flights(fit: Fit, estimate: Estimate) -> list[int]:
    """Indices of the fit's flights from which the records of an estimate come, found by their stamps."""
    at = [[i for i, f in enumerate(fit.flights) if f.command_time is rec.command_time] for rec in estimate.records]
    return [places[0] for places in at]


def _axis(
    estimate: Estimate, drawn: Array, scattered: Scatter | None, combinations: Mapping[str, Combination]
) -> AxisAccuracy:
    """The table of one axis; `drawn` are the bootstrap's standard errors of all parameters, NaN for none."""
    records, optimum, k = estimate.records, estimate.optimum, estimate.place
    point, further = optimum.point, [extra.name for extra in estimated_extras(optimum, k)]
    names = [*COEFFICIENTS, *further]
    at = [point.place(name, k) for name in names]
    extra = point.extra_values(k)
    values = [point.gain[k], np.exp(point.log_damping[k]), point.delay[k], *(extra[name] for name in further)]
    scale = natural_slopes(optimum, k)
    covariance = optimum.covariance
    expected = _errors(covariance, at) * scale
    seen, *others = (observed_covariance(records, optimum, step) for step in (OBSERVED_STEP, *OTHER_STEPS))
    robust = _errors(sandwich_covariance(records, optimum), at) * scale
    alone = scale / np.sqrt(np.maximum(np.diag(optimum.score.information)[at], 1e-300))
    varied = (optimum.free & ~at_bound(point, optimum.score.gradient))[at]
    rows = {}
    for i, name in enumerate(names):
        observed, *again = (
            None if C is None or not varied[i] else float(_errors(C, at)[i] * scale[i]) for C in (seen, *others)
        )
        size = abs(float(values[i]))
        rows[name] = Accuracy(
            value=float(values[i]),
            expected=float(expected[i]),
            observed=observed,
            ragged=observed is None
            or not varied[optimum.free[at]].all()
            or any(o is None or abs(o - observed) > RAGGED * observed for o in again),
            sandwich=float(robust[i]),
            bootstrap=float(drawn[at[i]] * scale[i]) if varied[i] and np.isfinite(drawn[at[i]]) else None,
            scatter=float(expected[i]) * scattered.factor[name] if scattered and name in scattered.factor else None,
            percent=100 * float(expected[i]) / size if size else None,
            insensitivity=100 * float(alone[i]) / size if size else None,
            disturbance=None if seen is None or observed is None else _with_levels(seen, at[i], point.n),
        )
    correlation = _correlation(covariance)[np.ix_(at, at)]
    together = _inseparable(correlation, rows, combinations)
    return AxisAccuracy(rows, tuple(tuple(map(float, row)) for row in correlation), together, scattered)


def observed_covariance(records: Sequence[Record], optimum: Optimum, step: float) -> Array | None:
    """Inverse of the observed information of all parameters, including levels.

    From central differences of the score. The response to held commands has a kink in the delay whenever a switch
    passes a pose, so its second derivative is a sum of spikes: the result for the delay depends on the step.

    Args:
        records: The flights.
        optimum: The maximum of their likelihood.
        step: Step in expected standard errors of each parameter.

    Returns:
        Shape (n + 4 K, n + 4 K), zero for parameters that are held or at a bound; None if the information is not
        positive definite.
    """
    point, free = optimum.point, optimum.free & ~at_bound(optimum.point, optimum.score.gradient)
    error = np.sqrt(np.diag(inverted(optimum.score.information, free)))
    hessian = np.zeros((free.size, free.size))
    for i in np.flatnonzero(free):
        move = np.zeros(free.size)
        move[i] = step * error[i] if i < point.n else min(step * error[i], LEVEL_STEP)
        sides = [point.with_flat(point.flat() + side * move) for side in (1, -1)]
        ahead, behind = (with_prior(score(records, p, optimum.restricted), p, optimum.prior).gradient for p in sides)
        hessian[i] = (behind - ahead) / (2 * move[i])
    block = 0.5 * (hessian + hessian.T)[np.ix_(free, free)]
    if not np.isfinite(block).all() or np.linalg.eigvalsh(block)[0] <= 0:
        return None
    return inverted(0.5 * (hessian + hessian.T), free)


def sandwich_covariance(records: Sequence[Record], optimum: Optimum) -> Array:
    """Covariance of coefficients, trims and start velocities that trusts the response but not the disturbance model.

    The bread is the expected information, the filling the sum over lags of the products of the blocks' contributions to
    the score, with Bartlett's weights.

    Args:
        records: The flights.
        optimum: The maximum of their likelihood.

    Returns:
        Shape (n, n).
    """
    point, n, K, F = optimum.point, optimum.point.n, optimum.point.gain.size, len(records)
    first = n - point.trim.size - point.start.size  # index of the first trim
    filling = np.zeros((n, n))
    for j, (rec, at) in enumerate(zip(records, segments(records), strict=True)):
        mean, sensitivity = response(rec, point, j, point.start[at])
        columns = np.concatenate([(rec.position - mean)[:, None, :], sensitivity], axis=1)
        rows, _ = whiten(rec, columns, point.levels)
        parts = np.einsum("bck,bk->bc", rows[:, 1:], rows[:, 0])
        contribution = np.zeros((len(parts), n))
        contribution[:, :first] = parts[:, :first]
        contribution[:, first + j * K : first + (j + 1) * K] = parts[:, first : first + K]
        segment = at.start + rec.segment
        for k in range(K):
            contribution[np.arange(len(parts)), first + F * K + segment * K + k] = parts[:, first + K + k]
        filling += newey_west(rec.block_time, contribution, LAG)
    if optimum.prior is not None:  # the prior is uncertain, too
        believed = np.arange(optimum.prior.mean.size)
        filling[believed, believed] += optimum.prior.precision
    bread = inverted(optimum.score.information[:n, :n], optimum.free[:n])
    return bread @ filling @ bread


def _errors(covariance: Array, at: Sequence[int]) -> Array:
    return np.sqrt(np.maximum(np.diag(covariance)[list(at)], 0.0))


def _correlation(covariance: Array) -> Array:
    size = np.sqrt(np.maximum(np.diag(covariance), 1e-300))
    scaled: Array = covariance / np.outer(size, size)
    return scaled


def _with_levels(covariance: Array, i: int, n: int) -> float:
    """Largest correlation of a coefficient with a disturbance level."""
    return float(np.abs(_correlation(covariance)[i, n:]).max())


def _inseparable(
    correlation: Array, rows: Mapping[str, Accuracy], combinations: Mapping[str, Combination]
) -> tuple[Inseparable, ...]:
    """Pairs whose correlation exceeds the limit, each with the combination that the data do determine."""
    found = []
    for i, one in enumerate(rows):
        for j, other in enumerate(list(rows)[:i]):
            if abs(correlation[i, j]) > CORRELATION_LIMIT:
                pair = Inseparable((other, one), float(correlation[i, j]))
                name = _COMBINED.get(pair.pair)
                told = combinations.get(name) if name else None
                low, high = told.ci95 if told else (None, None)
                if told and low is not None and high is not None:
                    error = 100 * (high - low) / 4 / abs(told.value)
                    if all(error < SHARPER * (rows[part].percent or np.inf) for part in pair.pair):
                        pair = replace(pair, combination=name, value=told.value, ci95=(low, high))
                found.append(pair)
    return tuple(found)
