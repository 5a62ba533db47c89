"""Offset and drift between two clocks, from one motion observed by both.

A witness is a series on the first clock that follows the motion: an onboard velocity, a heading, a command. The motion
is that of the poses, on the second clock. An event stamped s by the first clock happens at t(s) by the second:

    t(s) = s + offset + drift (s - middle)
    witness(s) = sum_j gain_j motion_j(t(s)) + bias + noise(s)          noise: autoregressive

Gains and biases are free, so units, signs and rotated axes of a witness do not matter. The search tries every lag at
which the two overlap; the likelihood is maximised from the best ones.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from rotorfit.core.frames import Array, Indices, Mask
from rotorfit.flights.clocks.lag_search import APART, MEMORY, GriddedMotion, Place, Witness, best_lags

LEAST_EXPLAINED = 0.6
"""Share of the best witness's variance that the motion must explain. Onboard sensors reach 0.9 to 1, the best chance
match of two flights 0.3 to 0.6."""

WIDEST = 0.05
"""Standard error of the offset above which it is refused [s]: chance matches of unrelated motions are imprecise."""

LEAST_LEAD = 10.0
"""Lead in log-likelihood that the best lag must have over any other that is at least `APART` away."""

RIVAL = 0.85
"""A lag whose evidence reaches this share of the best one's is a rival: the motion repeats itself."""

ORDER = 12
"""Highest order of the autoregression of the noise."""

OUTLIER = 6.0
"""Residuals beyond this many robust standard deviations and a quarter of the witness's standard deviation are left
out."""

LEAST_ROWS = 4 * ORDER
"""Least number of values of a witness."""

CHANGE = 0.3
"""Interval over which the changes of a wandering series are explained [s]."""

DISAGREE = 0.01
"""p-value below which sensors disagree."""

LEAST_ERROR = 0.001
"""Least standard error of a sensor's offset in that comparison [s]: filters add small delays."""

PASSES = 30

STARTS = 3
"""Number of the best lags that are refined."""


@dataclass(frozen=True)
class Offset:
    """Offset and drift of the second clock against the first.

    Attributes:
        middle: Time by the first clock at which `offset` holds [s].
        offset: Added to a stamp of the first clock at `middle` [s].
        drift: Change of the offset per second.
        covariance: Covariance of offset and drift, shape (2, 2).
        overlap: Time observed by both [s].
        explained: Witness to the share of its variance that the motion explains; of its changes, where it wanders.
        outliers: Number of values that were left out.
        later: Sensor that was left out because it lags the others, to its lag [s].
    """

    middle: float
    offset: float
    drift: float
    covariance: Array
    overlap: float
    explained: Mapping[str, float]
    outliers: int = 0
    later: Mapping[str, float] = field(default_factory=dict)

    def at(self, time: float) -> tuple[float, float]:
        """Offset at a time by the first clock, and its standard error [s]."""
        c = np.array([1.0, time - self.middle])
        return self.offset + self.drift * (time - self.middle), float(np.sqrt(c @ self.covariance @ c))


@dataclass(frozen=True)
class _Equations:
    """Normal equations of one witness for offset and drift, with gains and bias eliminated.

    Attributes:
        log_likelihood: Up to a constant.
        information: Shape (2, 2).
        gradient: Shape (2,).
        explained: Share of its variance that the motion explains.
        gain: Gain in log-likelihood from the motion.
        overlap: Time with values [s].
        far: Which of its rows are outliers.
    """

    log_likelihood: float
    information: Array
    gradient: Array
    explained: float
    gain: float
    overlap: float
    far: Mask


@dataclass
class _Sum:
    """The summed equations of all witnesses at one offset and drift."""

    information: Array = field(default_factory=lambda: np.zeros((2, 2)))
    gradient: Array = field(default_factory=lambda: np.zeros(2))
    explained: dict[str, float] = field(default_factory=dict)
    gain: float = 0.0
    overlap: float = 0.0
    far: dict[str, Mask] = field(default_factory=dict)

    def add(self, name: str, one: _Equations, far: Mask) -> None:
        """Adds the equations of one witness."""
        self.information += one.information
        self.gradient += one.gradient
        self.explained[name], self.far[name] = one.explained, far
        self.gain, self.overlap = self.gain + one.gain, max(self.overlap, one.overlap)


def clock_offset(witnesses: Sequence[Witness], seen: GriddedMotion) -> Offset | str:
    """Offset and drift of the second clock against the first.

    Each sensor may be stamped late by its own latency, but never early: where sensors disagree, those that lag the
    others are left out.

    Args:
        witnesses: Series on the first clock.
        seen: The motion on the second clock.

    Returns:
        The offset; or the reason why there is none, as a clause: too short an overlap, unrelated motion, or ambiguity.

    Source: least squares on prewhitened series, the maximum of a Gaussian likelihood: G. E. P. Box, G. M. Jenkins,
    G. C. Reinsel, Time Series Analysis, 4th ed. (2008), chapters 7 and 12.
    """
    places = best_lags(witnesses, seen)
    if not places:
        return "they have too little time in common at any offset"
    refined = [one for place in places[:STARTS] if (one := _refined(witnesses, seen, place.lag))]
    if not refined:
        return "they have too little motion in common at any offset"
    best = max(refined, key=lambda one: one[1])[0]
    share = max(best.explained.values())
    if share < LEAST_EXPLAINED:
        return f"they do not move alike at any offset: at most {100 * share:.0f} % of one is explained by the other"
    error = float(np.sqrt(best.covariance[0, 0]))
    if error > WIDEST:
        return f"their motions are too little alike: the offset has a standard error of {1e3 * error:.0f} ms"
    return _rival(places, best.offset) or _of_the_promptest(witnesses, seen, best)


def _of_the_promptest(witnesses: Sequence[Witness], seen: GriddedMotion, whole: Offset) -> Offset:
    """The offset from the sensors that agree, with those that lag them left out."""
    alone: dict[str, tuple[float, float]] = {}
    for sensor in dict.fromkeys(witness.sensor for witness in witnesses):
        one = _refined([witness for witness in witnesses if witness.sensor == sensor], seen, whole.offset)
        if one and max(one[0].explained.values()) >= LEAST_EXPLAINED:
            alone[sensor] = one[0].at(whole.middle)
    agreeing = sorted(alone, key=lambda sensor: alone[sensor][0])  # the latest first: latency reduces the offset
    while len(agreeing) > 1 and not _agree([alone[sensor] for sensor in agreeing]):
        agreeing.pop(0)
    if len(agreeing) in (0, len(alone)):
        return whole
    refined = _refined([witness for witness in witnesses if witness.sensor in agreeing], seen, alone[agreeing[-1]][0])
    if refined is None:
        return whole
    offset = refined[0].at(whole.middle)[0]
    return replace(refined[0], later={s: offset - alone[s][0] for s in alone if s not in agreeing})


def _agree(offsets: Sequence[tuple[float, float]]) -> bool:
    """Whether offsets with their standard errors are compatible, by the chi-squared test of their weighted mean."""
    from scipy.special import chdtrc

    value, error = np.array(offsets).T
    weight = 1 / np.maximum(error, LEAST_ERROR) ** 2
    mean = np.sum(weight * value) / np.sum(weight)
    return bool(chdtrc(value.size - 1, np.sum(weight * (value - mean) ** 2)) > DISAGREE)


def _rival(places: Sequence[Place], lag: float) -> str:
    """A clause if another lag is nearly as good; else empty."""
    own = max((place.evidence for place in places if abs(place.lag - lag) < APART), default=places[0].evidence)
    other = max((p for p in places if abs(p.lag - lag) >= APART), key=lambda p: p.evidence, default=None)
    if other is None or (other.evidence < RIVAL * own and own - other.evidence > LEAST_LEAD):
        return ""
    return f"the motion repeats itself: offsets that differ by {abs(other.lag - lag):.1f} s fit about as well"


def _refined(witnesses: Sequence[Witness], seen: GriddedMotion, lag: float) -> tuple[Offset, float] | None:
    """Maximum likelihood near a lag, with its gain in log-likelihood over no motion; None if not converged."""
    from scipy.interpolate import CubicSpline

    grid = seen.start + seen.step * np.arange(seen.valid.size)
    value, slope = (CubicSpline(grid, part) for part in (seen.value, seen.slope))
    heard = np.concatenate([w.time[seen.knows(w.time + lag)] for w in witnesses])
    if heard.size < LEAST_ROWS:
        return None
    middle, offset, drift = float(np.mean(heard)), lag, 0.0
    kept = {witness.name: np.ones(witness.time.size, dtype=np.bool_) for witness in witnesses}
    serving = {witness.name: (witness.columns, *witness.instead) for witness in witnesses}
    for number in range(PASSES):
        total = _Sum()
        for witness in witnesses:
            at = witness.time + offset + drift * (witness.time - middle)
            rows = np.flatnonzero(seen.knows(at) & kept[witness.name])
            if rows.size >= LEAST_ROWS:
                motion, ramp = value(at[rows]), slope(at[rows])
                told = {
                    columns: _equations(witness, rows, motion[:, columns], ramp[:, columns], middle)
                    for columns in serving[witness.name]
                }
                best = max(told, key=lambda columns: told[columns].log_likelihood)
                one = told[best]
                if number == 3:
                    serving[witness.name] = (best,)
                far = np.zeros(witness.time.size, dtype=np.bool_)
                far[rows[one.far]] = True
                total.add(witness.name, one, far)
        if not total.explained or np.linalg.cond(total.information) > 1e14:
            return None
        covariance = np.asarray(np.linalg.inv(total.information), dtype=np.float64)
        step = covariance @ total.gradient
        step *= min(1.0, 0.1 / max(abs(float(step[0])), 1e-12))
        offset, drift = offset + float(step[0]), drift + float(step[1])
        if number == 3:  # near the maximum, once
            kept = {name: kept[name] & ~total.far.get(name, ~kept[name]) for name in kept}
        elif number > 4 and np.all(np.abs(step) < 1e-3 * np.sqrt(np.diag(covariance))):
            break
    if abs(offset - lag) > APART:
        return None
    outliers = sum(int(np.sum(~mask)) for mask in kept.values())
    return Offset(middle, offset, drift, covariance, total.overlap, total.explained, outliers), total.gain


def _equations(witness: Witness, rows: Indices, motion: Array, slope: Array, middle: float) -> _Equations:
    """Normal equations of one witness.

    The slope comes from a wider window than the motion: with the same window its noise would count as information.
    """
    s, y = witness.time[rows], witness.value[rows]
    X = np.column_stack([motion, np.ones(s.size)])
    gains, *_ = np.linalg.lstsq(X, y, rcond=None)
    residual = y - X @ gains
    ramp = slope @ gains[:-1]
    period = float(np.median(np.diff(s)))
    follows = np.concatenate([[False], np.diff(s) <= 2.5 * period])
    white = _whitened(np.column_stack([residual, ramp, ramp * (s - middle), X]), _autoregression(residual), follows)
    free, *_ = np.linalg.lstsq(white[:, 3:], white[:, :3], rcond=None)
    left = white[:, :3] - white[:, 3:] @ free
    e, T = left[:, 0], left[:, 1:]
    variance = max(float(np.mean(e**2)), 1e-12 * float(np.var(y)), 1e-300)
    sigma = 1.4826 * float(np.median(np.abs(residual - np.median(residual))))
    explained = _explained(y, residual, max(1, round(CHANGE / period)) if witness.by_rate else 0)
    return _Equations(
        log_likelihood=-0.5 * e.size * float(np.log(variance)),
        information=T.T @ T / variance,
        gradient=T.T @ e / variance,
        explained=explained,
        gain=-0.5 * s.size * period / MEMORY * float(np.log(max(1 - explained, 1e-9))),
        overlap=float(np.sum(np.minimum(np.diff(s), 4 * period))),
        far=np.abs(residual) > max(OUTLIER * sigma, 0.25 * float(np.std(y))),
    )


def _explained(y: Array, residual: Array, lag: int) -> float:
    """Share of the variance that is explained, of the series or of its differences over a lag."""
    if lag:
        y, residual = y[lag:] - y[:-lag], residual[lag:] - residual[:-lag]
    return max(0.0, 1 - float(np.var(residual)) / max(float(np.var(y)), 1e-300))


def _autoregression(e: Array) -> Array:
    """Coefficients of the autoregression of a series, of the order that minimises Akaike's criterion, shape (p,)."""
    n, e = e.size, e - e.mean()
    r = np.array([np.dot(e[k:], e[: n - k]) / n for k in range(ORDER + 1)])
    a, variance = np.zeros(0), float(r[0])
    best, criterion = a, n * np.log(max(variance, 1e-300))
    for p in range(1, ORDER + 1 if variance > 0 else 1):
        reflection = (r[p] - a @ r[p - 1 : 0 : -1]) / variance
        a = np.append(a - reflection * a[::-1], reflection)
        variance = max(variance * (1 - reflection**2), 1e-300)
        if n * np.log(variance) + 2 * p < criterion:
            best, criterion = a, n * np.log(variance) + 2 * p
    return best


def _whitened(columns: Array, a: Array, follows: Mask) -> Array:
    """Prediction errors of columns under the autoregression; rows with a gap in their past are left out."""
    n, p = len(columns), a.size
    out, whole = columns[p:].copy(), np.ones(n - p, dtype=np.bool_)
    for j in range(1, p + 1):
        out -= a[j - 1] * columns[p - j : n - j]
        whole &= follows[p - j + 1 : n - j + 1]
    return np.asarray(out[whole])
