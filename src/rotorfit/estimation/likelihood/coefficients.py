"""Estimate -> Axis: coefficients with intervals, statuses, combinations and optima, as published in the model."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from rotorfit.core.frames import Array
from rotorfit.core.laws import DELAY_RANGE
from rotorfit.core.model import COEFFICIENTS, Axis, Interval, Mode, Predictor, unknown_axis
from rotorfit.estimation.identifiability import WIDEST_DELAY, WIDEST_INPUT
from rotorfit.estimation.likelihood.axis_estimate import Estimate
from rotorfit.estimation.likelihood.blocks import Record
from rotorfit.estimation.likelihood.combinations import combinations
from rotorfit.estimation.likelihood.extra_parameters import (
    bounded_covariance,
    estimated_extras,
    extra_intervals,
    further,
    structure_at,
)
from rotorfit.estimation.likelihood.fisher_scoring import Optimum
from rotorfit.estimation.likelihood.noise_levels import noise_of
from rotorfit.estimation.likelihood.optima import SAME_DELAY, SAME_LOG_DAMPING
from rotorfit.estimation.likelihood.profile import Profile, profile

Blocks = dict[tuple[str, ...], Array]
"""Names of coefficients, such as `x.input`, to their covariance: one block per likelihood."""

WIDEST_DAMPING = 6.0
"""Ratio of the ends of the damping's interval beyond which the damping is not identifiable."""

AT_BOUND = 1e-4
"""Distance from an end of its range below which a delay counts as at the bound [s]."""

DIVERGED = 0.5
"""Expected gain in log-likelihood of one more step above which the climb has not converged."""


def axis_of_estimate(estimate: Estimate, places: Sequence[int | None]) -> Axis:
    """The published axis of an estimate.

    Args:
        estimate: The estimate of the axis.
        places: Row of the trims for each flight of the fit; None for a flight that was not used.
    """
    records, optimum, k = estimate.records, estimate.optimum, estimate.place
    nothing = replace(
        unknown_axis("not_excited" if not estimate.excited else "diverged"),
        noise=noise_of(optimum, k, records[0].axes[k]),
        modes=_modes(estimate),
        trim=tuple(None if place is None else float(optimum.point.trim[place, k]) for place in places),
        structure=structure_at(optimum, k).name,
    )
    if not estimate.excited or unfinished(optimum, k):
        return nothing
    structure, extras = structure_at(optimum, k), estimated_extras(optimum, k)
    index = {name: optimum.point.place(name, k) for name in (*COEFFICIENTS, *(extra.name for extra in extras))}
    profiles: dict[str, Profile] = {}
    for name, i in index.items():
        if structure.delayed or name != "delay":
            profiles[name] = profile(records, optimum, i)
        if holds_zero(profiles["input"].ci95):  # not excited, whatever the other profiles
            return replace(nothing, status=dict.fromkeys(COEFFICIENTS, "not_excited"))
    ends: dict[str, Interval] = {"delay": (0.0, 0.0)} | {name: found.ci95 for name, found in profiles.items()}
    extra_ends = extra_intervals(optimum, k, ends)
    covariance = bounded_covariance(optimum, {k: extra_ends})
    variance, more = np.diag(covariance), further(optimum, k, extra_ends, covariance)
    raw = dict(ends)
    ends["damping"] = _exponential(ends["damping"])
    ends["input"] = _uncut(ends["input"], ends["damping"], float(optimum.point.gain[k]))
    status = statuses(ends) | _too_fast(records, optimum, k)
    if status["delay"] != "ok" and (_at_bound(optimum, k) or estimate.loop.closed):
        status = dict.fromkeys(COEFFICIENTS, "not_identifiable")
        more = replace(
            more,
            extra=dict.fromkeys(more.extra),
            stderr=dict.fromkeys(more.stderr),
            status=dict.fromkeys(more.status, "not_identifiable"),
        )
    point = Predictor(
        input=float(optimum.point.gain[k]),
        damping=float(np.exp(optimum.point.log_damping[k])),
        delay=float(optimum.point.delay[k]),
        extra=optimum.point.extra_values(k),
    )
    error = {n: float(np.sqrt(variance[index[n]])) * (point.damping if n == "damping" else 1.0) for n in COEFFICIENTS}
    published = {name: getattr(point, name) if status[name] == "ok" else None for name in COEFFICIENTS}
    return replace(
        nothing,
        input=published["input"],
        damping=published["damping"],
        delay=published["delay"],
        stderr={name: error[name] if status[name] == "ok" else None for name in COEFFICIENTS} | dict(more.stderr),
        ci95={name: ends[name] for name in COEFFICIENTS} | dict(more.ci95),
        status=status | dict(more.status),
        predictor=point,
        combinations=combinations(records, optimum, k, raw),
        profile=profiles["delay"].points if structure.delayed else (),
        profile_fall=profiles["delay"].fall if structure.delayed else None,
        extra=more.extra,
    )


def unfinished(optimum: Optimum, k: int) -> bool:
    """Whether the climb has not converged: one more step has a gain and moves a coefficient of axis k by over 1e-3.

    The change is relative for the gain, and in log b and in seconds for damping and delay.
    """
    K, step = optimum.point.gain.size, optimum.inverse @ optimum.score.gradient
    moved = (step[k] / max(abs(optimum.point.gain[k]), 1e-9), step[K + k], step[2 * K + k])
    return bool(optimum.gain > DIVERGED and np.abs(moved).max() > 1e-3)


def _too_fast(records: Sequence[Record], optimum: Optimum, k: int) -> dict[str, str]:
    """Statuses of input and damping of an axis whose time constant is below the sampling period: not identifiable."""
    if np.exp(-optimum.point.log_damping[k]) >= sample_time(records):
        return {}
    return dict.fromkeys(("input", "damping"), "not_identifiable")


def sample_time(records: Sequence[Record]) -> float:
    """Sampling period of the motion [s]: the longest of the medians of the flights."""
    stamps = (rec.pose_time if rec.rate is None else rec.block_time[rec.rate] for rec in records)
    return max(float(np.median(np.diff(time))) for time in stamps)


def _at_bound(optimum: Optimum, k: int) -> bool:
    """Whether the delay ended at a bound of its range.

    Then, and where it is not identifiable in a feedback loop, no coefficient is identifiable: such a fit shows a slow
    response to old commands, whatever the vehicle.
    """
    return bool(min(abs(optimum.point.delay[k] - end) for end in DELAY_RANGE) < AT_BOUND)


def _uncut(gain: Interval, damping: Interval, value: float) -> Interval:
    """The interval of the input gain, with its outer end open where the upper end of the damping is.

    Gain and damping of a fast vehicle grow together, so that end of the gain is only due to the bound of the damping.
    """
    low, high = gain
    if damping[1] is not None:
        return gain
    return (low, None) if value > 0 else (None, high)


def _exponential(ends: Interval) -> Interval:
    low, high = (None if end is None else float(np.exp(end)) for end in ends)
    return low, high


def holds_zero(ends: Interval) -> bool:
    """Whether an interval contains 0; an open end is infinite."""
    low, high = ends
    return (low is None or low <= 0) and (high is None or high >= 0)


def statuses(ends: Mapping[str, Interval]) -> dict[str, str]:
    """Status of each coefficient, `ok` or `not_identifiable`, from the intervals alone.

    Where a bound of the search cuts off the delay, the interval of the damping is not valid either.
    """
    early, late = ends["delay"]
    delay = early is not None and late is not None and late - early < WIDEST_DELAY
    low, high = ends["damping"]
    damping = None not in ends["delay"] and low is not None and high is not None and high / low < WIDEST_DAMPING
    least, most = ends["input"]
    gain = least is not None and most is not None and max(least / most, most / least) < WIDEST_INPUT
    return {
        name: "ok" if good else "not_identifiable"
        for name, good in zip(COEFFICIENTS, (gain, damping, delay), strict=True)
    }


def covariances(group: Sequence[str], estimates: Sequence[Estimate], results: Mapping[str, Axis]) -> Blocks:
    """Covariance of the estimated parameters of the axes with a predictor, one block per likelihood.

    Args:
        group: Names of the axes.
        estimates: Their estimates, in the same order.
        results: The axes by name; only those with a predictor are included.
    """
    blocks: dict[int, list[int]] = {}
    names = [
        (*COEFFICIENTS, *(extra.name for extra in estimated_extras(estimate.optimum, estimate.place)))
        for estimate in estimates
    ]
    for number, (axis, estimate) in enumerate(zip(group, estimates, strict=True)):
        if results[axis].predictor:
            blocks.setdefault(id(estimate.optimum), []).append(number)
    out = {}
    for numbers in blocks.values():
        optimum, places = estimates[numbers[0]].optimum, [estimates[n].place for n in numbers]
        at = [optimum.point.place(name, k) for n, k in zip(numbers, places, strict=True) for name in names[n]]
        scale = np.concatenate([natural_slopes(optimum, k) for k in places])
        C = bounded_covariance(optimum, {k: results[group[n]].ci95 for n, k in zip(numbers, places, strict=True)})[
            np.ix_(at, at)
        ]
        out[tuple(f"{group[n]}.{name}" for n in numbers for name in names[n])] = C * np.outer(scale, scale)
    return out


def natural_slopes(optimum: Optimum, k: int) -> Array:
    """Derivatives of the coefficients and further parameters of axis k with respect to the estimator's coordinates."""
    values = optimum.point.extra_values(k)
    further = [values[extra.name] if extra.logarithmic else 1.0 for extra in estimated_extras(optimum, k)]
    return np.array([1.0, np.exp(optimum.point.log_damping[k]), 1.0, *further])


def block_diagonal(blocks: Blocks) -> tuple[tuple[str, ...], Array]:
    """Names and block-diagonal covariance of all blocks together."""
    names = tuple(name for block in blocks for name in block)
    matrix = np.zeros((len(names), len(names)))
    at = 0
    for block in blocks.values():
        matrix[at : at + len(block), at : at + len(block)] = block
        at += len(block)
    return names, matrix


def _modes(estimate: Estimate) -> tuple[Mode, ...]:
    """The optima of the search on this axis; of two axes searched together, those equal on this one are merged."""
    k, best = estimate.place, max((f.optimum.score.log_likelihood for f in estimate.found), default=0.0)
    modes: list[Mode] = []
    for number, f in enumerate(estimate.found):
        final = number == 0 and estimate.excited
        point = (estimate.optimum if final else f.optimum).point
        at = min(k, point.gain.size - 1)  # an axis that was searched alone may have been climbed with the other one
        rmse = float(f.prediction[min(k, f.prediction.size - 1)])
        mode = Mode(
            delay=float(point.delay[at]),
            damping=float(np.exp(point.log_damping[at])),
            input=float(point.gain[at]),
            log_likelihood=f.optimum.score.log_likelihood - best,
            starts=f.starts,
            prediction=rmse if np.isfinite(rmse) else None,
            chosen=number == 0,
        )
        alike = next((i for i, other in enumerate(modes) if _alike(mode, other)), None)
        if alike is None:
            modes.append(mode)
        else:
            modes[alike] = replace(modes[alike], starts=modes[alike].starts + mode.starts)
    return tuple(modes)


def _alike(one: Mode, other: Mode) -> bool:
    return abs(one.delay - other.delay) < SAME_DELAY and abs(np.log(one.damping / other.damping)) < SAME_LOG_DAMPING
