"""Result of a rung between the paper's regression and the likelihood, and its conversion to an axis with statuses."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from rotorfit.core.frames import Array
from rotorfit.core.laws import DELAY_RANGE
from rotorfit.core.model import COEFFICIENTS, NORMAL, Axis, Combination, Interval, Predictor, unknown_axis
from rotorfit.estimation.identifiability import WIDEST_DELAY, WIDEST_INPUT

FASTEST = 100.0
"""Absolute damping above which an estimate counts as diverged [1/s]."""

WIDEST_DAMPING = 0.7
"""Half width of the damping's interval relative to the damping, above which the damping is not identifiable ..."""

LEAST_DAMPING = 0.5
"""... if the half width also exceeds this [1/s]: the damping of a rung may be near zero and have any sign."""

AT_BOUND = 1e-3
"""A delay this close to an end of the range of the search counts as cut off by it [s]."""


@dataclass(frozen=True)
class MethodResult:
    """Coefficients by one rung: K axes estimated together (x with y, or one), F flights.

    Attributes:
        method: `svf`, `weak`, `iv` or `oe`.
        axes: Names of the K axes.
        gain: g, shape (K,) [m/s^2 or rad/s^2 per unit of the command]; NaN where there is no number.
        damping: b, shape (K,) [1/s].
        delay: tau, shape (K,) [s].
        trim: Constant acceleration in the heading frame, shape (F, K) [m/s^2 or rad/s^2].
        covariance: Covariance of g of all axes, then b of all, then tau of all, shape (3 K, 3 K).
        quantile: Half width of a 95 % interval in standard errors.
        failed: Axis to its status and the reason, one sentence, for axes without numbers.
        remark: Axis to a remark on its numbers: the instrument that was used.
    """

    method: str
    axes: tuple[str, ...]
    gain: Array
    damping: Array
    delay: Array
    trim: Array
    covariance: Array
    quantile: float = NORMAL
    failed: Mapping[str, tuple[str, str]] = field(default_factory=dict)
    remark: Mapping[str, str] = field(default_factory=dict)


def without_numbers(
    method: str, axes: tuple[str, ...], flights: int, failed: Mapping[str, tuple[str, str]]
) -> MethodResult:
    """The result of a rung without numbers, with status and reason of each axis."""
    K = len(axes)
    nothing = np.full(K, np.nan)
    return MethodResult(
        method, axes, nothing, nothing, nothing, np.full((flights, K), np.nan), np.full((3 * K, 3 * K), np.nan),
        failed=failed,
    )  # fmt: skip


def axis_of_rung(rung: MethodResult, axis: str) -> tuple[Axis, str]:
    """The axis as published, without disturbance levels and trims, and the reason where a status is not `ok`.

    The axis has numbers only if the interval of its input gain excludes 0 and the damping has not diverged. A
    coefficient has a number only if its interval is not too wide.

    Args:
        rung: Result of the rung.
        axis: Name of one of its axes.
    """
    if axis in rung.failed:
        failure, reason = rung.failed[axis]
        return unknown_axis(failure), reason
    k, K = rung.axes.index(axis), len(rung.axes)
    value = dict(zip(COEFFICIENTS, (float(rung.gain[k]), float(rung.damping[k]), float(rung.delay[k])), strict=True))
    variance = np.diag(rung.covariance)[[k, K + k, 2 * K + k]]
    if not (np.isfinite([*value.values(), *variance]).all() and (variance > 0).all()):
        return unknown_axis("diverged"), "the estimate or its standard error is not a finite number"
    if abs(value["damping"]) > FASTEST:
        return unknown_axis("diverged"), f"the damping diverged beyond {FASTEST:g} 1/s"
    error = {name: float(np.sqrt(v)) for name, v in zip(COEFFICIENTS, variance, strict=True)}
    half = {name: rung.quantile * error[name] for name in COEFFICIENTS}
    ends: dict[str, Interval] = {name: (value[name] - half[name], value[name] + half[name]) for name in COEFFICIENTS}
    if half["input"] >= abs(value["input"]):
        low, high = ends["input"]
        return unknown_axis("not_excited"), f"the interval of the input gain, {low:.2g} to {high:.2g}, contains 0"
    status, reason = _statuses(value, half)
    return Axis(
        input=value["input"] if status["input"] == "ok" else None,
        damping=value["damping"] if status["damping"] == "ok" else None,
        delay=value["delay"] if status["delay"] == "ok" else None,
        stderr={name: error[name] if status[name] == "ok" else None for name in COEFFICIENTS},
        ci95={name: ends[name] if _inside(value["delay"]) else (None, None) for name in COEFFICIENTS},
        status=status,
        predictor=Predictor(value["input"], value["damping"], value["delay"]),
        combinations=_combinations(rung, k),
    ), reason


def _combinations(rung: MethodResult, k: int) -> dict[str, Combination]:
    """Steady gain and total lag by the delta method; intervals are open where that of the damping contains 0."""
    K, (g, b, tau) = len(rung.axes), (float(values[k]) for values in (rung.gain, rung.damping, rung.delay))
    C = rung.covariance[np.ix_([k, K + k, 2 * K + k], [k, K + k, 2 * K + k])]
    out = {}
    for name, value, slope in (
        ("steady_gain", g / b, np.array([1 / b, -g / b**2, 0.0])),
        ("total_lag", tau + 1 / b, np.array([0.0, -1 / b**2, 1.0])),
    ):
        half = rung.quantile * float(np.sqrt(slope @ C @ slope))
        sure = b > rung.quantile * np.sqrt(C[1, 1])
        out[name] = Combination(value, (value - half, value + half) if sure else (None, None))
    return out


def _inside(delay: float) -> bool:
    """Whether a delay [s] lies inside its range: at an end, no interval is valid, whatever the coefficient."""
    low, high = DELAY_RANGE
    return low + AT_BOUND < delay < high - AT_BOUND


_WORDS = {"input": "input gain", "damping": "damping", "delay": "delay"}


def _statuses(value: Mapping[str, float], half: Mapping[str, float]) -> tuple[dict[str, str], str]:
    """Status of each coefficient, and the first reason for a status other than `ok`."""
    share = half["input"] / abs(value["input"])
    wide = {
        "input": (1 + share) / (1 - share) >= WIDEST_INPUT,
        "damping": half["damping"] > max(WIDEST_DAMPING * abs(value["damping"]), LEAST_DAMPING),
        "delay": 2 * half["delay"] > WIDEST_DELAY,
    }
    reasons = {name: f"the interval of the {_WORDS[name]} is too wide" if wide[name] else "" for name in COEFFICIENTS}
    if not _inside(value["delay"]):
        reasons = dict.fromkeys(COEFFICIENTS, f"the delay ended at {value['delay']:.2f} s, the end of its range")
    status = {name: "not_identifiable" if reason else "ok" for name, reason in reasons.items()}
    return status, next((reason for reason in reasons.values() if reason), "")
