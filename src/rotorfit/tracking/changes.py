"""Is it still the same vehicle? The last seconds under the law of the regime against the rest of it.

Under the estimate theta the whitened innovations e and their sensitivities S by the coefficients tell, of any window w,
how far its own estimate would lie from that of the rest r. With the trim and the start velocities free in both,

    G = S'S and s = S'e of a window, less what its own trim and start explain,
    u = s_w - G_w (G_w + G_r)^-1 (s_w + s_r),    M = G_w - G_w (G_w + G_r)^-1 G_w,    T = u' M^-1 u

is the likelihood ratio for coefficients of their own in the window, to first order; wind that comes or turns is trim
and level, and in neither. T is looked at in the directions of M in which the window knows more than was to be expected,
each over the variance that the scores of the regime really have, from their sums over `CHUNK`: gusts, colour, and
whatever in the law is a little wrong make it larger than the likelihood believes, and alarms rarer. What the refit's
tests of the law found a coefficient to vary by, with the size of commands, the speed or the method, is added to it.

The promise: each look has a p-value, and the alarm sounds below (false alarms an hour) / (looks an hour). The expected
number of false alarms an hour is then at most what was asked for, however the looks depend on each other, because
expectations add (Boole's inequality); it is as good as the p-values.

Source: A. S. Willsky, H. L. Jones, IEEE Trans. Autom. Control 21 (1976), pp. 108-112 (window-limited generalised
likelihood ratio); T. L. Lai, J. R. Statist. Soc. B 57 (1995), pp. 613-658 (its windows); K.-Y. Liang, S. L. Zeger,
Biometrika 73 (1986), pp. 13-22 (variance from the sums of scores).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from rotorfit.core.frames import Array, Indices
from rotorfit.estimation.likelihood.axis_estimate import Estimate
from rotorfit.estimation.likelihood.blocks import Record
from rotorfit.estimation.likelihood.extra_parameters import estimated_extras
from rotorfit.estimation.likelihood.likelihood import response, whiten

WINDOWS = (1.0, 1.5, 2.5, 4.0, 6.0, 10.0, 16.0, 25.0, 40.0)
"""Lengths of the windows that are looked at [s]."""

CHUNK = 1.0
"""Over this time sums of scores are taken as independent of the next [s]."""

UNLIKELY = 1e-3
"""A contrast whose p-value is larger even under white innovations is not looked at further."""

LATELY = 12.0
"""Time over which the scores are asked how they vary now [s]."""

LEAST_CHUNKS = 12
"""Chunks of the rest of a regime below which its variance is not known and nothing is asked."""

EXPECTED = {"input": 0.3, "damping": 0.5, "delay": 0.05, "lag": 0.5, "trim": 0.5}
"""Sizes of changes that are looked for: of logarithms, the delay [s], the trim [m/s^2, rad/s^2]. A direction in which a
window knows less than this is left out."""

OTHERWISE = 0.5
"""The same of any other parameter of a law, in the estimator's coordinate."""

FADES = 0.7
"""Time constant with which an autopilot learns a new weight or torque [s]."""

TRIMMED = ("z", "yaw")
"""Axes whose trim is the vehicle's: thrust against weight, torque. On x and y it is wind, which is no change."""

LATEST = 3.84
"""Fall of T from its largest to the ends of the 95 % interval of the time of a change."""

STEP = 0.2
"""Grid of that time [s]."""


@dataclass(frozen=True)
class Scores:
    """Innovations and sensitivities of one likelihood over a regime: N rows in time, P parameters that may change.

    Attributes:
        time: Of each row, shape (N,) [s].
        innovation: Whitened, shape (N,).
        tested: By the parameters that may change, on the scale of `EXPECTED`, shape (N, P).
        free: By trims and start velocities that may be another in every window, shape (N, Q).
        names: `AXIS.QUANTITY` of each that may change.
        scale: What one unit of it is.
        doubt: Standard deviation by which tests of the law found each to vary without a change, on that scale, (P,).
        jolts: Whitened motion after an acceleration of `EXPECTED` that begins `WINDOWS` before the end and fades, of an
            axis of `TRIMMED`, shape (N, windows); none of other axes.
    """

    time: Array
    innovation: Array
    tested: Array
    free: Array
    names: tuple[str, ...]
    scale: Array
    doubt: Array
    jolts: Array


@dataclass(frozen=True)
class Contrast:
    """A window against the rest of its regime.

    Attributes:
        since: Where the window begins [s].
        shift: Coefficients of the window less those of the rest, on the scale of `EXPECTED`, shape (P,).
        precision: Of the shift, shape (P, P); what the window cannot tell has none.
        statistic: T over the scores' variance, over its directions.
        directions: How many.
        p_value: Of no change.
    """

    since: float
    shift: Array
    precision: Array
    statistic: float
    directions: int
    p_value: float


def scores_of(estimates: Sequence[tuple[str, Estimate]], doubts: Mapping[str, Mapping[str, float]]) -> Scores:
    """The scores of the axes of one likelihood.

    Args:
        estimates: Names and estimates of the axes that share an optimum.
        doubts: Axis and quantity to the standard deviation by which the law was found wrong, on its own scale.
    """
    first = estimates[0][1]
    (rec,), point = first.records, first.optimum.point
    K = point.gain.size
    mean, sensitivity = response(rec, point, 0, point.start)
    jolts = _jolts(rec, estimates)
    parts = [(rec.position - mean)[:, None], sensitivity, jolts]
    rows, _ = whiten(rec, np.concatenate(parts, axis=1), point.levels)
    rows = rows.transpose(0, 2, 1).reshape(-1, rows.shape[1])
    innovation, columns = rows[:, 0], rows[:, 1:]
    trim, start = point.coefficients, point.coefficients + K
    tested, names, scale, doubt, own = [], [], [], [], []
    for axis, estimate in estimates:
        k = estimate.place
        for name in ("input", "damping", "delay", *(extra.name for extra in estimated_extras(estimate.optimum, k))):
            size = EXPECTED.get(name, OTHERWISE)
            unit = size * (float(point.gain[k]) if name == "input" else 1.0)
            tested.append(columns[:, point.place(name, k)] * unit)
            names.append(f"{axis}.{name}")
            scale.append(size)
            doubt.append(doubts.get(axis, {}).get(name, 0.0) / size)
        if axis in TRIMMED:
            tested.append(columns[:, trim + k] * EXPECTED["trim"])
            names.append(f"{axis}.trim")
            scale.append(EXPECTED["trim"])
            doubt.append(0.0)
            own.append(k)
    segment = np.repeat(np.cumsum(rec.fresh) - 1, K)
    free = [columns[:, trim + k] for k in range(K) if k not in own]
    free += [columns[:, start + k] * (segment == s) for k in range(K) for s in range(rec.starts.size)]
    time = np.repeat(rec.block_time, K)
    return Scores(
        time, innovation, np.column_stack(tested), np.column_stack(free), tuple(names), np.array(scale),
        np.array(doubt), columns[:, columns.shape[1] - jolts.shape[1] :],
    )  # fmt: skip


def _jolts(rec: Record, estimates: Sequence[tuple[str, Estimate]]) -> Array:
    """Position after an acceleration that fades as an autopilot learns it, from `WINDOWS` before the end, (B, J, K).

    v' = -b v + a exp(-t / `FADES`).
    """
    axis, estimate = estimates[0]
    if axis not in TRIMMED:
        return np.empty((rec.count.size, 0, len(rec.axes)))
    b, fade = float(np.exp(estimate.optimum.point.log_damping[estimate.place])), 1.001 / FADES
    t = np.maximum(rec.block_time[:, None] - (rec.block_time[-1] - np.array(WINDOWS)), 0.0)
    rise = (-np.expm1(-fade * t) / fade + np.expm1(-b * t) / b) / (b - fade)
    return np.asarray(EXPECTED["trim"] * rise[:, :, None])


def contrast(scores: Scores, since: float) -> Contrast | None:
    """The window from an instant to the end against what was before, in all directions; None where either is silent."""
    compared = _compared(scores, since)
    return _along(scores, compared, np.eye(len(scores.names))) if compared else None


@dataclass(frozen=True)
class _Compared:
    """A window against the rest: u, M, the factor of its noise, and where it begins."""

    since: float
    at: int
    u: Array
    M: Array
    noise: float
    shift: Array


def _compared(scores: Scores, since: float) -> _Compared | None:
    at = int(np.searchsorted(scores.time, since))
    if at == scores.time.size or _chunks(scores.time[:at]).size < LEAST_CHUNKS:
        return None
    G_w, s_w, left = _projected(scores, slice(at, None))
    G_r, s_r, _ = _projected(scores, slice(0, at))
    share = G_w @ np.linalg.pinv(G_w + G_r, hermitian=True)
    u, M = s_w - share @ (s_w + s_r), G_w - share @ G_w
    noise = max(left / max(scores.time.size - at - u.size, 1), 1.0)
    return _Compared(since, at, u, 0.5 * (M + M.T), noise, np.linalg.pinv(M, rcond=1e-6, hermitian=True) @ u)


def _along(scores: Scores, compared: _Compared, basis: Array) -> Contrast | None:
    """The contrast inside a subspace of the shifts, shape (P, k); None where it shows nothing."""
    value, vector = np.linalg.eigh(basis.T @ compared.M @ basis)
    keep = value > 1.0
    if not keep.any():
        return None
    vector, value = basis @ vector[:, keep], value[keep]
    along, directions = compared.u @ vector, int(keep.sum())
    chunks = _chunks(scores.time[: compared.at]).size
    if _p_value(float((along**2 / value).sum()) / compared.noise, directions, chunks) > UNLIKELY:
        return None  # the variance can only be larger than that of white innovations
    variance = compared.noise * _excess(scores, compared, scores.tested @ vector)
    variance += value * (scores.doubt**2 @ vector**2)
    statistic = float((along**2 / (value * variance)).sum())
    return Contrast(
        compared.since,
        vector @ (along / value),
        (vector * (value / variance)) @ vector.T,
        statistic,
        directions,
        _p_value(statistic, directions, chunks),
    )


def _excess(scores: Scores, compared: _Compared, along: Array) -> Array:
    """Variance of the scores along some directions over what white innovations would give: before, and lately.

    Lately is the window with what came before it, its own shift taken off: gusts that rise colour the innovations of a
    filter that still believes in calm air.
    """
    before = along[: compared.at] * scores.innovation[: compared.at, None]
    late = slice(int(np.searchsorted(scores.time, scores.time[-1] - LATELY)), None)
    innovation = scores.innovation.copy()
    innovation[compared.at :] -= scores.tested[compared.at :] @ compared.shift
    lately = along[late] * innovation[late, None]
    parts = [
        (np.add.reduceat(z, _chunks(t), axis=0) ** 2).sum(axis=0) / np.maximum((z**2).sum(axis=0), 1e-300)
        for z, t in ((before, scores.time[: compared.at]), (lately, scores.time[late]))
    ]
    return np.asarray(np.maximum(np.max(parts, axis=0), 1.0))


def _p_value(statistic: float, directions: int, chunks: int) -> float:
    """Of Hotelling's T squared with as many degrees of freedom as there are chunks behind its variance."""
    from scipy.special import fdtrc

    return float(fdtrc(directions, max(chunks - directions, 1), statistic / directions))


def _chunks(time: Array) -> Indices:
    """Where each chunk of time begins."""
    return np.flatnonzero(np.diff(np.floor(time / CHUNK), prepend=-1.0)) if time.size else np.empty(0, int)


def _projected(scores: Scores, part: slice) -> tuple[Array, Array, float]:
    """Information and score of a window less what its own trims and starts explain, and the sum of squares left."""
    S, N, e = scores.tested[part], scores.free[part], scores.innovation[part]
    inverse = np.linalg.pinv(N.T @ N, rcond=1e-10, hermitian=True)
    off = inverse @ (N.T @ e)
    cross = N.T @ S
    G = S.T @ S - cross.T @ inverse @ cross
    s = S.T @ e - cross.T @ off
    explained = float(s @ np.linalg.pinv(G, rcond=1e-10, hermitian=True) @ s)
    return G, s, max(float(e @ e) - float((N.T @ e) @ off) - explained, 0.0)


def looked_for(scores: Scores) -> list[Contrast]:
    """The contrasts of all windows that are not longer than what was before them, in all directions and in each alone
    that changes have.
    """
    now, begin = float(scores.time[-1]), float(scores.time[0])
    windows = (now - w for w in WINDOWS if w < 0.5 * (now - begin))
    compared = [one for since in windows if (one := _compared(scores, since))]
    found = [each for one in compared for basis in _bases(scores) if (each := _along(scores, one, basis))]
    return [*found, *_jolted(scores)]


def looks(scores: Scores) -> int:
    """How many contrasts a look at these scores is."""
    return len(WINDOWS) * len(_bases(scores)) + int(scores.jolts.shape[1])


def _jolted(scores: Scores) -> list[Contrast]:
    """An acceleration that came at once and fades, as of a payload that the autopilot then carries, for each window.

    Its variance is what the same filter, matched to it, has given at every instant before.
    """
    out = []
    trim = np.array([name.endswith(".trim") for name in scores.names])
    begin, now = float(scores.time[0]), float(scores.time[-1])
    for window, jolt in zip(WINDOWS, scores.jolts.T, strict=False):
        since = now - window
        at = int(np.searchsorted(scores.time, since))
        h, e, before = jolt[at:], scores.innovation[at:], scores.innovation[:at]
        chunks = (since - begin) / max(window, FADES)
        if chunks < LEAST_CHUNKS or before.size <= h.size:
            continue
        power = float(h @ h)
        usual = np.correlate(before, h, "valid") ** 2 / power
        late = usual[-int(LATELY / (now - begin) * scores.time.size) :]
        variance = max(float(usual.mean()), float(late.mean()), 1.0)
        statistic = float(h @ e) ** 2 / (power * variance)
        shift, precision = trim * float(h @ e) / power, np.diag(trim * power / variance)
        out.append(Contrast(since, shift, precision, statistic, 1, _p_value(statistic, 1, int(chunks))))
    return out


def _bases(scores: Scores) -> list[Array]:
    """All directions; the trims that are the vehicle's; one factor of all gains; one step of all delays."""
    kind = np.array([name.split(".")[1] for name in scores.names])
    alone = [np.eye(kind.size)[:, [i]] for i in np.flatnonzero(kind == "trim")]
    alike = [(kind == name)[:, None].astype(float) for name in ("input", "delay")]
    return [np.eye(kind.size), *alone, *alike]


def since_when(scores: Scores, found: Contrast) -> tuple[Contrast, tuple[float, float]]:
    """The likeliest time of a change that was found, and its 95 % interval."""
    now, begin = float(scores.time[-1]), float(scores.time[0])
    low = max(found.since - WINDOWS[-1] / 4, begin)
    tried = [one for t in np.arange(low, now - STEP, STEP) if (one := contrast(scores, float(t)))]
    if not tried:
        return found, (found.since, now)
    best = max(tried, key=lambda one: one.statistic - 2 * one.directions)
    near = [one.since for one in tried if one.statistic >= best.statistic - LATEST]
    return best, (min(near) - STEP / 2, min(max(near) + STEP / 2, now))
