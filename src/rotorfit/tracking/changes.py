"""Is it still the same vehicle? The last seconds under the law of the regime against the rest of it.

Under the estimate theta the whitened innovations e and their sensitivities S by the coefficients tell, of any window w,
how far its own estimate would lie from that of the rest r. With the trim and the start velocities free in both,

    G = S'S and s = S'e of a window, less what its own trim and start explain,
    u = s_w - G_w (G_w + G_r)^-1 (s_w + s_r),    M = G_w - G_w (G_w + G_r)^-1 G_w,    T = u' M^-1 u

is the likelihood ratio for coefficients of their own in the window, to first order; wind that comes or turns is trim
and level, and in neither. The window is seen by a filter that expects gusts as strong as they are in it (`scores`),
the rest by that of the regime. T is looked at in the directions of M in which the window knows more than was to be
expected, each over the variance that the scores of the regime really have, from their sums over `CHUNK`: gusts, colour,
and whatever in the law is a little wrong make it larger than the likelihood believes, and alarms rarer. What the
refit's tests of the law found a coefficient to vary by, with the size of commands, the speed or the method, is added.

The promise: each look has a p-value, and the alarm sounds below (false alarms an hour) / (looks an hour). The expected
number of false alarms an hour is then at most what was asked for, however the looks depend on each other, because
expectations add (Boole's inequality); it is as good as the p-values.

Source: A. S. Willsky, H. L. Jones, IEEE Trans. Autom. Control 21 (1976), pp. 108-112 (window-limited generalised
likelihood ratio); T. L. Lai, J. R. Statist. Soc. B 57 (1995), pp. 613-658 (its windows); K.-Y. Liang, S. L. Zeger,
Biometrika 73 (1986), pp. 13-22 (variance from the sums of scores).
"""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from rotorfit.core.frames import Array, Indices
from rotorfit.tracking.scores import FADES, LASTS, WINDOWS, Scores

CHUNK = 1.0
"""Over this time sums of scores are taken as independent of the next [s]."""

UNLIKELY = 1e-3
"""A contrast whose p-value is larger even under white innovations is not looked at further."""

TOLD = 2.4
"""Length of a window that tells by itself how strong gusts are in it [s]: in a shorter one a push may be a gust or the
vehicle, and only what other seconds and axes show decides; for z and yaw, which are pushed by both, in any."""

LEAST_CHUNKS = 12
"""Chunks of the rest of a regime below which its variance is not known and nothing is asked."""

NEW, EARLIEST, APART = 2.0, 0.15, 0.1
"""Of the matched filters [s]: how far back a look asks; what a jolt needs to be seen; the grid."""

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


def contrast(scores: Scores, since: float) -> Contrast | None:
    """The window from an instant to the end against what was before, in all directions; None where either is silent."""
    compared = _compared(scores, since)
    return _along(scores, compared, np.eye(len(scores.names))) if compared else None


@dataclass(frozen=True)
class _Compared:
    """A window against the rest, under gusts of some strength in the window: u, M, the factor of its noise, where it
    begins, and the likelihood of that strength without a change.
    """

    since: float
    at: int
    u: Array
    M: Array
    noise: float
    heard: float


def _compared(scores: Scores, since: float) -> list[_Compared]:
    """Under each strength of gusts that the window may have; nothing where it cannot be compared."""
    at = int(np.searchsorted(scores.time, since))
    if at == scores.time.size or _chunks(scores.time[:at]).size < LEAST_CHUNKS:
        return []
    own, P, heard = scores.rows[at:].T @ scores.rows[at:], len(scores.names), scores.heard(since)
    G_r, s_r, _ = _projected(scores.products - own, P)
    out, short = [], bool(scores.time[-1] - since < TOLD)
    first = scores.gusts if short or scores.jolts.size else 0
    last = scores.gusts if short else len(scores.louder)
    for each, likely in list(zip((scores, *scores.louder), heard, strict=False))[first : last + 1]:
        G_w, s_w, left = _projected(each.rows[at:].T @ each.rows[at:], P)
        share = G_w @ _inverse(G_w + G_r, 1e-15)
        u, M = s_w - share @ (s_w + s_r), G_w - share @ G_w
        noise = max(left / max(scores.time.size - at - u.size, 1), 1.0)
        out.append(_Compared(since, at, u, 0.5 * (M + M.T), noise, float(likely)))
    return out


def _along(scores: Scores, compared: Sequence[_Compared], basis: Array) -> Contrast | None:
    """The contrast inside a subspace of the shifts, shape (P, k); None where it shows nothing.

    Gusts are as strong as makes the window likeliest, with its shifts.
    """
    parts = [part for one in compared if (part := _inside(one, basis))]
    if not parts:
        return None
    likeliest = max(parts, key=lambda part: 2 * part[0].heard + float((part[1] ** 2 / part[3]).sum()))
    one, along, vector, value = likeliest
    directions = value.size
    chunks = _chunks(scores.time[: one.at]).size
    if _p_value(float((along**2 / value).sum()) / one.noise, directions, chunks) > UNLIKELY:
        return None  # the variance can only be larger than that of white innovations
    excess, freedom = _excess(scores, one.at, scores.tested[: one.at] @ vector)
    variance = one.noise * excess + value * (scores.doubt**2 @ vector**2)
    statistic = float((along**2 / (value * variance)).sum())
    p_value = _p_value(statistic, directions, freedom)
    return Contrast(
        one.since,
        vector @ (along / value),
        (vector * (value / variance)) @ vector.T,
        statistic,
        directions,
        p_value,
    )


def _inside(compared: _Compared, basis: Array) -> tuple[_Compared, Array, Array, Array] | None:
    """What a window shows along the directions of a subspace in which it knows enough, these, and their information."""
    value, vector = np.linalg.eigh(basis.T @ compared.M @ basis)
    keep = value > 1.0
    vector = basis @ vector[:, keep]
    return (compared, compared.u @ vector, vector, value[keep]) if keep.any() else None


def _excess(scores: Scores, at: int, along: Array) -> tuple[Array, float]:
    """Variance of the scores of the rest along some directions over what white innovations would give, and values
    behind it.
    """
    before = along * scores.innovation[:at, None]
    excess, values = _spread(np.add.reduceat(before, _chunks(scores.time[:at]), axis=0), (before**2).sum(axis=0))
    return np.maximum(excess, 1.0), values


def _spread(sums: Array, expected: Array) -> tuple[Array, float]:
    """Mean square of some sums over what was expected of all of them, and how many equal normal ones tell as much.

    Sums of seconds in which hardly anything was commanded, or one second's that outweighs all others, tell a variance
    badly: their fourth moments say how badly. Shape (C, k) to (k,), and the least of the k.
    """
    square, fourth = (sums**2).sum(axis=0), (sums**4).sum(axis=0)
    told = 3.0 * square**2 / np.maximum(fourth, 1e-300)
    return square / np.maximum(expected, 1e-300), float(min(np.min(told, initial=np.inf), len(sums)))


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
    new = np.unique(np.searchsorted(scores.time, np.arange(now - EARLIEST, now - EARLIEST - NEW, -APART)))
    if not scores.jolts[first:end].any(axis=0).all():  # a gap in the poses
        return None
    under = (scores, *scores.louder)[scores.gusts]
    matched = np.array([_matched(under.innovation, h, new) for h in under.jolts[first:end].T])
    gain, (product, power) = matched[:, 0] ** 2 / matched[:, 1], matched[0]
    h, before = scores.jolts[first:end, 0], scores.innovation[: new[0]]
    usual = np.correlate(before, h, "valid") ** 2 / float(h @ h)
    freedom = chunks * min(3.0 * float(usual.mean() ** 2 / max(np.mean(usual**2), 1e-300)), 1.0)
    largest = float(np.quantile(usual, RARE)) / RARE_OF_NORMAL
    variance = MARGIN * max(float(usual.mean()), largest, 1.0)
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
        min((one.noise for one in compared), default=np.inf),
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
