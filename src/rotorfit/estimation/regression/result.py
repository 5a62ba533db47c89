"""What a rung of the ladder between the paper and the likelihood finds out, and what may be said of it."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from rotorfit.core.frames import Array
from rotorfit.core.laws import DELAY_RANGE
from rotorfit.core.model import COEFFICIENTS, Axis, Combination, Interval, Predictor, unknown_axis
from rotorfit.estimation.identifiability import NORMAL, WIDEST_DELAY, WIDEST_INPUT

FASTEST = 100.0
"""Damping beyond which an estimate has run away [1/s]."""

WIDEST_DAMPING = 0.7
"""Half width of the damping's interval over the damping, beyond which it is not identifiable if it also exceeds..."""

LEAST_DAMPING = 0.5
"""... this [1/s]: a rung whose damping may have any sign needs a measure that does not end at 0."""

AT_BOUND = 1e-3
"""A delay this close to an end of the searched range is cut off by it [s]."""


@dataclass(frozen=True)
class MethodResult:
    """Coefficients by one rung: K axes that it took together (x with y, or one), F flights.

    Attributes:
        method: `svf`, `weak`, `iv` or `oe`.
        axes: Names of the K axes.
        gain: g, shape (K,); NaN where there is no number.
        damping: b, shape (K,) [1/s].
        delay: tau, shape (K,) [s].
        trim: Constant acceleration in the heading frame, shape (F, K).
        covariance: Of g of all axes, b of all, tau of all, shape (3 K, 3 K).
        quantile: Half width of a 95 % interval in standard errors.
        failed: Axis to its status and the reason, one sentence, for axes without numbers.
        remark: Axis to what else must be known of its numbers: which instrument was used, and whether it is valid.
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
    """A rung that found nothing, and why, axis by axis."""
    K = len(axes)
    nothing = np.full(K, np.nan)
    return MethodResult(
        method, axes, nothing, nothing, nothing, np.full((flights, K), np.nan), np.full((3 * K, 3 * K), np.nan),
        failed=failed,
    )  # fmt: skip


def axis_of_rung(rung: MethodResult, axis: str) -> tuple[Axis, str]:
    """What may be said of an axis, without the disturbance levels, and the reason where a status is not `ok`.

    The input gain's interval must not hold 0, and no interval be so wide that its middle is an accident; nothing that
    ran away is printed as a number.

    Args:
        rung: The rung.
        axis: One of its axes.
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
        return unknown_axis("diverged"), f"the damping ran away, beyond {FASTEST:g} 1/s"
    error = {name: float(np.sqrt(v)) for name, v in zip(COEFFICIENTS, variance, strict=True)}
    half = {name: rung.quantile * error[name] for name in COEFFICIENTS}
    ends: dict[str, Interval] = {name: (value[name] - half[name], value[name] + half[name]) for name in COEFFICIENTS}
    if half["input"] >= abs(value["input"]):
        low, high = ends["input"]
        return unknown_axis("not_excited"), f"the interval of the input gain, {low:.2g} to {high:.2g}, holds 0"
    status, reason = _statuses(value, half)
    return Axis(
        input=value["input"] if status["input"] == "ok" else None,
        damping=value["damping"] if status["damping"] == "ok" else None,
        delay=value["delay"] if status["delay"] == "ok" else None,
        stderr={name: error[name] if status[name] == "ok" else None for name in COEFFICIENTS},
        ci95={name: ends[name] if _bounded(name, value) else (None, None) for name in COEFFICIENTS},
        status=status,
        predictor=Predictor(value["input"], value["damping"], value["delay"]),
        combinations=_combinations(rung, k),
    ), reason


def _combinations(rung: MethodResult, k: int) -> dict[str, Combination]:
    """Steady gain and total lag by the delta method; open where the damping may be zero."""
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


def _bounded(name: str, value: Mapping[str, float]) -> bool:
    """Whether the interval of a coefficient is its own: a delay at the end of its range takes the damping's with it."""
    low, high = DELAY_RANGE
    return name == "input" or low + AT_BOUND < value["delay"] < high - AT_BOUND


_WORDS = {"input": "input gain", "damping": "damping", "delay": "delay"}


def _statuses(value: Mapping[str, float], half: Mapping[str, float]) -> tuple[dict[str, str], str]:
    """Status of each coefficient, and the first reason against one of them."""
    share = half["input"] / abs(value["input"])
    wide = {
        "input": (1 + share) / (1 - share) >= WIDEST_INPUT,
        "damping": half["damping"] > max(WIDEST_DAMPING * abs(value["damping"]), LEAST_DAMPING),
        "delay": 2 * half["delay"] > WIDEST_DELAY,
    }
    reasons = {name: f"the interval of the {_WORDS[name]} is too wide" if wide[name] else "" for name in COEFFICIENTS}
    if not _bounded("delay", value):
        reasons["delay"] = reasons["damping"] = f"the delay ended at {value['delay']:.2f} s, the end of its range"
    status = {name: "not_identifiable" if reason else "ok" for name, reason in reasons.items()}
    return status, next((reason for reason in reasons.values() if reason), "")
