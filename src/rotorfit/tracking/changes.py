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

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

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

RISEN = 2.0
"""Ratio of the variance lately to that of the regime beyond which the air is another: then the few values of lately
count, and make alarms rare until the levels have followed."""

LEAST_CHUNKS = 12
"""Chunks of the rest of a regime below which its variance is not known and nothing is asked."""

EXPECTED = {"input": 0.3, "damping": 0.5, "delay": 0.05, "lag": 0.5, "trim": 0.5}
"""Sizes of changes that are looked for: as a share of the input, of logarithms, of the delay [s], of the trim [m/s^2,
rad/s^2]. A direction in which a
window knows less than this is left out."""

OTHERWISE = 0.5
"""The same of any other parameter of a law, in the estimator's coordinate."""

FADES = 0.7
"""Time constant with which an autopilot learns a new weight or torque [s]."""

LASTS, NEW, EARLIEST, APART = 4.0, 2.0, 0.15, 0.1
"""Of the matched filters [s]: twice their length; how far back a look asks; what a jolt needs to be seen; the grid."""

TRIMMED = ("z", "yaw")
"""Axes whose trim is the vehicle's: thrust against weight, torque. On x and y it is wind, which is no change."""

LATEST = 3.84
"""Fall of T from its largest to the ends of the 95 % interval of the time of a change."""

MARGIN = 2.0
"""Factor on the variance of jolts: a gust that is four tenths larger than any before is still a gust."""

RARE, RARE_OF_NORMAL = 0.99, 6.63
"""Jolts are measured by the largest hundredth of what came before, too: air and poses have more outliers than a normal
distribution, whose squared 99 % quantile is the second."""

BEFORE, CALM_BEFORE, CALM_AFTER = 5.0, 1.25, 2.0
"""Over so long before a change [s], and after it, squared innovations may be so many times those of the regime."""

SURE = 1e-12
"""p-value below which the calm after a change is not asked for."""

TOGETHER = 0.5
"""Changes of several axes so near to each other are one [s]."""

STEP = 0.2
"""Grid of the time of a change [s]."""


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
        jolts: Whitened positions of an axis of `TRIMMED` after an acceleration, and of poses that are wrong, see
            `_jolts`, shape (N, 3); none of other axes.
    """

    time: Array
    innovation: Array
    tested: Array
    free: Array
    names: tuple[str, ...]
    scale: Array
    doubt: Array
    jolts: Array

    @cached_property
    def rows(self) -> Array:
        """Innovations, what is tested and what is free side by side, shape (N, 1 + P + Q)."""
        return np.column_stack([self.innovation, self.tested, self.free])

    @cached_property
    def products(self) -> Array:
        """Of all rows with each other, summed, shape (1 + P + Q, 1 + P + Q)."""
        return np.asarray(self.rows.T @ self.rows)


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
    """Positions after an acceleration that fades as an autopilot learns it, at one pose alone, after a step: (B, 3, K).

    All begin `LASTS` before the end; v' = -b v + a exp(-t / `FADES`). The last two are what a pose that is wrong does.
    """
    axis, estimate = estimates[0]
    t = rec.block_time - (rec.block_time[-1] - LASTS)
    if axis not in TRIMMED or t[0] > -LASTS:
        return np.empty((rec.count.size, 0, len(rec.axes)))
    b, fade = float(np.exp(estimate.optimum.point.log_damping[estimate.place])), 1.001 / FADES
    later = np.maximum(t, 0.0)
    rise = (-np.expm1(-fade * later) / fade + np.expm1(-b * later) / b) / (b - fade)
    first = int(np.searchsorted(t, 0.0))
    columns = np.column_stack([EXPECTED["trim"] * rise, np.arange(t.size) == first, np.arange(t.size) >= first])
    return np.asarray(columns[:, :, None])


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
    own, P = scores.rows[at:].T @ scores.rows[at:], len(scores.names)
    G_w, s_w, left = _projected(own, P)
    G_r, s_r, _ = _projected(scores.products - own, P)
    share = G_w @ _inverse(G_w + G_r, 1e-15)
    u, M = s_w - share @ (s_w + s_r), G_w - share @ G_w
    noise = max(left / max(scores.time.size - at - u.size, 1), 1.0)
    M = 0.5 * (M + M.T)
    return _Compared(since, at, u, M, noise, _inverse(M, 1e-6) @ u)


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
    excess, freedom = _excess(scores, compared, scores.tested @ vector)
    variance = compared.noise * excess + value * (scores.doubt**2 @ vector**2)
    statistic = float((along**2 / (value * variance)).sum())
    p_value = _p_value(statistic, directions, freedom)
    return Contrast(
        compared.since,
        vector @ (along / value),
        (vector * (value / variance)) @ vector.T,
        statistic,
        directions,
        p_value,
    )


def _excess(scores: Scores, compared: _Compared, along: Array) -> tuple[Array, float]:
    """Variance of the scores along some directions over what white innovations would give, and values behind it.

    Lately is the window with what came before it, its own shift taken off: gusts that rise colour the innovations of a
    filter that still believes in calm air.
    """
    before = along[: compared.at] * scores.innovation[: compared.at, None]
    late = slice(int(np.searchsorted(scores.time, scores.time[-1] - LATELY)), None)
    innovation = scores.innovation.copy()
    innovation[compared.at :] -= scores.tested[compared.at :] @ compared.shift
    lately = along[late] * innovation[late, None]
    (long, values), (now, few) = (
        _spread(np.add.reduceat(z, _chunks(t), axis=0), (z**2).sum(axis=0))
        for z, t in ((before, scores.time[: compared.at]), (lately, scores.time[late]))
    )
    variance, freedom = _usual(long, now, values, few)
    return np.maximum(variance, 1.0), freedom


def _spread(sums: Array, expected: Array) -> tuple[Array, float]:
    """Mean square of some sums over what was expected of all of them, and how many equal normal ones tell as much.

    Sums of seconds in which hardly anything was commanded, or one second's that outweighs all others, tell a variance
    badly: their fourth moments say how badly. Shape (C, k) to (k,), and the least of the k.
    """
    square, fourth = (sums**2).sum(axis=0), (sums**4).sum(axis=0)
    told = 3.0 * square**2 / np.maximum(fourth, 1e-300)
    return square / np.maximum(expected, 1e-300), float(min(np.min(told, initial=np.inf), len(sums)))


def _usual(before: Array, lately: Array, values: float, late: float) -> tuple[Array, float]:
    """The variance to be expected, and how many independent values tell it: the long one, unless it has risen."""
    risen = lately > RISEN * before
    return np.where(risen, lately, before), min(late, values) if risen.any() else values


def _p_value(statistic: float, directions: int, chunks: float) -> float:
    """Of Hotelling's T squared with as many degrees of freedom as there are chunks behind its variance."""
    from scipy.special import fdtrc

    return float(fdtrc(directions, max(chunks - directions, 1), statistic / directions))


def _chunks(time: Array) -> Indices:
    """Where each chunk of time begins."""
    return np.flatnonzero(np.diff(np.floor(time / CHUNK), prepend=-1.0)) if time.size else np.empty(0, int)


def _projected(products: Array, P: int) -> tuple[Array, Array, float]:
    """Information and score of a window less what its own trims and starts explain, and the sum of squares left.

    Args:
        products: Of its rows, see `Scores.rows`.
        P: Number of parameters that are tested.
    """
    free, tested = slice(1 + P, None), slice(1, 1 + P)
    inverse = _inverse(products[free, free], 1e-10)
    left = products[: 1 + P, : 1 + P] - products[: 1 + P, free] @ inverse @ products[free, : 1 + P]
    G, s = left[tested, tested], left[tested, 0]
    return G, s, max(float(left[0, 0]) - float(s @ _inverse(G, 1e-10) @ s), 0.0)


def _inverse(products: Array, least: float) -> Array:
    """Of a symmetric matrix, zero along what is below a share of its largest eigenvalue: ten times as fast as pinv."""
    value, vector = np.linalg.eigh(products)
    keep = value > least * max(value[-1], 0.0) if value.size else np.zeros(0, bool)
    return np.asarray((vector[:, keep] / value[keep]) @ vector[:, keep].T)


def looked_for(scores: Scores) -> list[Contrast]:
    """The contrasts of all windows that are not longer than what was before them, in all directions and in each alone
    that changes have, and the likeliest jolt.
    """
    now, begin = float(scores.time[-1]), float(scores.time[0])
    windows = (now - w for w in WINDOWS if w < 0.5 * (now - begin))
    compared = [one for since in windows if (one := _compared(scores, since))]
    found = [each for one in compared for basis in _bases(scores) if (each := _along(scores, one, basis))]
    return [*found, *_jolted([scores]).values()]


def looks(scores: Scores) -> int:
    """How many contrasts a look at these scores is, a second after the last."""
    return len(WINDOWS) * len(_bases(scores)) + _instants(scores)


def looked_together(scored: Sequence[Scores]) -> tuple[dict[tuple[str, ...], list[Contrast]], int]:
    """The contrasts of all likelihoods, each alone and jolts of two axes at one instant, and how many a look is."""
    looked = {scores.names: looked_for(scores) for scores in scored}
    pairs = list(itertools.combinations([scores for scores in scored if scores.jolts.size], 2))
    for pair in pairs:
        for names, one in _jolted(pair).items():
            looked[names].append(one)
    return looked, sum(map(looks, scored)) + sum(_instants(pair[0]) for pair in pairs)


def _instants(scores: Scores) -> int:
    """How many jolts a look at these scores asks for."""
    return round(NEW / APART) if scores.jolts.size else 0


@dataclass(frozen=True)
class _Jolts:
    """Accelerations of one axis that come at once and fade, at n instants.

    Attributes:
        time: Of each, shape (n,) [s].
        product, power: Of their shape with the innovations, and with itself, shape (n,).
        wrong: What poses that are wrong would explain there, as squares of normal variables, shape (n,).
        variance: That the explained squares have.
        freedom: So many values tell it.
    """

    time: Array
    product: Array
    power: Array
    wrong: Array
    variance: float
    freedom: float


def _jolts_of(scores: Scores) -> _Jolts | None:
    """A matched filter at every instant that is new; its variance is what it has given before."""
    begin, now = float(scores.time[0]), float(scores.time[-1])
    chunks = int((now - NEW - LASTS - begin) / CHUNK)
    if not scores.jolts.size or chunks < LEAST_CHUNKS:
        return None
    first, end = (int(np.searchsorted(scores.time, now - back)) for back in (LASTS, LASTS / 2))
    shapes = scores.jolts[first:end]
    new = np.unique(np.searchsorted(scores.time, np.arange(now - EARLIEST, now - EARLIEST - NEW, -APART)))
    if not shapes.any(axis=0).all():  # a gap in the poses
        return None
    matched = np.array([_matched(scores.innovation, h, new) for h in shapes.T])
    gain = matched[:, 0] ** 2 / matched[:, 1]
    h, before = shapes[:, 0], scores.innovation[: new[0]]
    usual = np.correlate(before, h, "valid") ** 2 / float(h @ h)
    late = usual[-int(LATELY / (now - begin) * scores.time.size) :]
    told = [
        min(share * 3.0 * float(one.mean() ** 2 / max(np.mean(one**2), 1e-300)), share)
        for one, share in ((usual, chunks), (late, int(LATELY / CHUNK)))
    ]
    found, freedom = _usual(usual.mean()[None], late.mean()[None], *told)
    largest = float(np.quantile(usual, RARE)) / RARE_OF_NORMAL
    variance = MARGIN * max(float(found[0]), largest, 1.0)
    product, power = matched[0]
    return _Jolts(scores.time[new], product, power, gain[1:].max(axis=0), variance, freedom)


def _jolted(scored: Sequence[Scores]) -> dict[tuple[str, ...], Contrast]:
    """The likeliest acceleration that came at once and fades, as of a payload that the autopilot then carries.

    On some axes together: a weak rotor sinks and turns the vehicle at the same instant. Where poses that are wrong
    explain more, nothing is said.
    """
    found = [one for scores in scored if (one := _jolts_of(scores))]
    if len(found) < len(scored) or any(not np.array_equal(one.time, found[0].time) for one in found):
        return {}
    gain = np.array([one.product**2 / one.power for one in found])
    told = (gain / np.array([[one.variance] for one in found])).sum(axis=0)
    best = int(np.argmax(told))
    if gain[:, best].sum() < np.max([one.wrong for one in found], axis=1).sum():
        return {}
    p_value = _p_value(float(told[best]), len(found), min(one.freedom for one in found))
    out = {}
    for scores, one in zip(scored, found, strict=True):
        size, power = float(one.product[best] / one.power[best]), float(one.power[best]) / one.variance
        trim = np.array([name.endswith(".trim") for name in scores.names])
        statistic = size**2 * power
        out[scores.names] = Contrast(
            float(one.time[best]), trim * size, np.diag(trim * power), statistic, 1, p_value
        )  # fmt: skip
    return out


def _matched(innovation: Array, h: Array, at: Indices) -> Array:
    """Products of a shape with the innovations from some places on, and its own power as far as they go, (2, n)."""
    out = np.empty((2, at.size))
    for n, i in enumerate(at):
        part = innovation[i : i + h.size]
        out[:, n] = part @ h[: part.size], h[: part.size] @ h[: part.size]
    return out


def _bases(scores: Scores) -> list[Array]:
    """All directions; the trims that are the vehicle's; one factor of all gains; one step of all delays."""
    kind = np.array([name.split(".")[1] for name in scores.names])
    alone = [np.eye(kind.size)[:, [i]] for i in np.flatnonzero(kind == "trim")]
    alike = [(kind == name)[:, None].astype(float) for name in ("input", "delay")]
    return [np.eye(kind.size), *alone, *alike]


def calm(scores: Scores, since: float, p_value: float) -> bool:
    """Whether the air around a change is that of the regime: before it, and after it but for the change itself.

    Gusts that rise fill seconds with innovations that are too large. A vehicle that changes leaves those before it as
    they were; those after it are again as they were once the shifts of its coefficients, or its jolt, are taken off.
    What is beyond all doubt need not leave such calm behind it.
    """
    time, e = scores.time, scores.innovation
    usual = max(float(np.mean(e[time < since - BEFORE] ** 2)) if time[0] < since - BEFORE else 1.0, 1.0)
    before = e[(time >= since - BEFORE) & (time < since)]
    after, compared = e[time > since + FADES], _compared(scores, since)
    left = min(
        float(np.mean(after**2)) if after.size else np.inf,
        compared.noise if compared else np.inf,
    )
    return (
        before.size > 0
        and float(np.mean(before**2)) < CALM_BEFORE * usual
        and (left < CALM_AFTER * usual or p_value < SURE)
    )


def at_once(scores: Scores, looked: Sequence[Contrast], since: float) -> Contrast | None:
    """What other axes show of a change at an instant: the window from there, or a jolt at that time."""
    near = [one for one in looked if abs(one.since - since) < TOGETHER]
    window = contrast(scores, since)
    return min((*near, *([window] if window else ())), key=lambda one: one.p_value, default=None)


def since_when(scores: Scores, found: Contrast) -> tuple[Contrast, tuple[float, float]]:
    """The likeliest time of a change that was found, and its 95 % interval."""
    now, begin = float(scores.time[-1]), float(scores.time[0])
    low = max(found.since - WINDOWS[-1] / 4, begin)
    tried = [one for t in np.arange(low, now - STEP, STEP) if (one := contrast(scores, float(t)))]
    best = max((*tried, found), key=lambda one: one.statistic - 2 * one.directions)
    near = [one.since for one in (*tried, best) if one.statistic >= best.statistic - LATEST]
    return best, (min(near) - STEP / 2, min(max(near) + STEP / 2, now))
