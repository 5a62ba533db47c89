"""Has the vehicle changed? The last seconds of a regime, tested against the rest of it under its law.

At the estimate theta, the whitened innovations e and their sensitivities S to the coefficients show how far the
estimate of a window w would lie from that of the rest r. With the trim and the start velocities free in both,

    G = S'S and s = S'e of a window, less what its own trim and start explain,
    u = s_w - G_w (G_w + G_r)^-1 (s_w + s_r),    M = G_w - G_w (G_w + G_r)^-1 G_w,    T = u' M^-1 u

is, to first order, the likelihood ratio of the hypothesis that the window has its own coefficients; wind that rises or
turns enters trim and levels, not T. In the window the filter assumes gusts as strong as those in it (`scores`), in the
rest those of the regime. T is evaluated in the directions of M in which the window is informative, each divided by the
empirical variance of the regime's scores, from their sums over `CHUNK`: gusts, coloured noise and small errors of the
law make that variance larger than the likelihood assumes, and alarms rarer. The variance by which the refit's tests of
the law found a coefficient to depend on command size, speed or method is added.

Wind that comes up at once pushes x and y within the window, where one trim does not follow it. With l_k the likelihood
of a short window of x and y without a shift under strength k of gusts, and j the strength that is likeliest with one,

    T < 2 (max_k l_k - l_j)

says that stronger gusts explain it better than other coefficients do; it is then no contrast.

False alarms: each look has a p-value, and an alarm is raised below (false alarms per hour) / (looks per hour). The
expected number of false alarms per hour is then at most the number asked for, however the looks depend on each other,
because expectations add (Boole's inequality); the bound is as good as the p-values.

Source: A. S. Willsky, H. L. Jones, IEEE Trans. Autom. Control 21 (1976), pp. 108-112 (window-limited generalised
likelihood ratio); T. L. Lai, J. R. Statist. Soc. B 57 (1995), pp. 613-658 (its windows); K.-Y. Liang, S. L. Zeger,
Biometrika 73 (1986), pp. 13-22 (variance from the sums of scores).
"""

import functools
import itertools
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import fdtrc

from rotorfit.core.frames import AXES, Array, Indices
from rotorfit.tracking.instant import FLAT, instants_of, less_what_is_unknown, now_of
from rotorfit.tracking.scores import CHUNK, FADES, LASTS, LEAST_GUST_TIME, WINDOWS, Scores

UNLIKELY = 1e-3
"""A contrast is dropped early if its p-value exceeds this even under white innovations."""

VISIBLE = 1.0
"""Information about a direction above which a window determines it, in units of the expected changes."""

OWN_GUSTS = 2.4
"""Shortest window of z or yaw that determines the strength of its own gusts [s]: in a shorter one a push may come from
a gust or from the vehicle, and the other seconds and axes decide, which set the least strength in longer windows too.
Of all axes a shorter one is tested along the directions of typical changes only, because several directions together
fit a single gust."""

LEAST_CHUNKS = 12
"""Fewest chunks in the rest of a regime for its variance to be known; with fewer nothing is tested."""

NEW, EARLIEST, APART = 2.0, 0.15, 0.1
"""Times of the matched filters [s]: how far back a look tests; age at which a jolt becomes visible; grid spacing."""

MARGIN = 2.0
"""Factor on the variance of jolts: a gust that is 40 % larger than any before is still a gust."""

RARE, RARE_OF_NORMAL = 0.99, 6.63
"""The variance of jolts is also taken from the 99 % quantile of their squares so far, divided by that of a squared
standard normal variable (the second number): air and poses have more outliers than a normal distribution."""

BEFORE, CALM_BEFORE, CALM_AFTER = 5.0, 3.0, 2.0
"""Time before a change that is checked for calm [s]; largest excess of the mean squared innovation there over that of
the regime, in standard errors; largest mean squared innovation after the change, over that of the regime."""

SURE = 1e-10
"""p-value below which no calm is required after a change."""

HEARD = 0.25
"""Distance of the instants at which x and y may have changed while z or yaw is pushed [s]."""

CORRELATED = 0.5
"""Power to which the likelihood of a strength of gusts is taken: innovations in rising gusts are correlated."""

TOGETHER = 0.5
"""Changes of several axes within this time count as one [s]."""

SHARED = (("delay", AXES), ("input", ("x", "y")), ("input", ("x", "y", "z")), ("input", AXES))
"""Coefficients, and the axes that one cause shifts alike: a radio or a clock delays all, a limit of tilt or speed
scales x and y, and a mode of the autopilot z, or z and yaw, with them."""

LEAST_WINDOW = WINDOWS[0]
"""Shortest window that tells which coefficients shifted [s]: a shorter one takes one shift for another."""

PAUSE = 2.0
"""Time without poses that counts as a pause of the log [s]."""

STEP = 0.2
"""Grid spacing of the time of a change [s]."""


@dataclass(frozen=True)
class Contrast:
    """A window against the rest of its regime.

    Attributes:
        since: Start of the window [s].
        shift: Coefficients of the window minus those of the rest, in units of `scores.EXPECTED`, shape (P,).
        precision: Inverse covariance of the shift, shape (P, P); zero along what the window does not determine.
        statistic: Sum over the directions of T over the variance of the scores.
        directions: Number of directions.
        p_value: Probability of so large a statistic without a change.
        freedom: Degrees of freedom of the variance of the scores.
        jolt: Whether it is a push that fades rather than coefficients of the window.
        begun: Whether the shifts begin at the start of the window, from the motion as it is then.
    """

    since: float
    shift: Array
    precision: Array
    statistic: float
    directions: int
    p_value: float
    freedom: float
    jolt: bool = False
    begun: bool = False


def contrast(scores: Scores, since: float) -> Contrast | None:
    """The window from `since` [s] to the end, against the time before it, in all directions; None if undetermined."""
    compared = _compared(scores, [since])
    return _along(scores, compared[0], np.eye(len(scores.names))) if compared else None


def variance_along(scores: Scores, since: float, way: Array) -> float | None:
    """Variance of a window's scores along a direction, shape (P,), over that of white innovations; None if unknown."""
    compared = _compared(scores, [since])
    found = _along(scores, compared[0], way[:, None]) if compared else None
    return float(way @ compared[0].M @ way) / float(found.precision.max()) if found else None


def begun_at(scores: Scores, instant: float) -> Contrast | None:
    """The contrast of shifts that begin at an instant [s], from the motion as it is then; None if undetermined."""
    at = int(np.searchsorted(scores.time, instant))
    if scores.chunks_before(at) < LEAST_CHUNKS or at >= scores.time.size:
        return None
    now = now_of(scores)
    begun, P = now.begun(instant, 0.0)[at:], len(scores.names)
    across, normal = begun.T @ now.rows[at:], now.products[1:, 1:]
    inverse = _inverse(normal[None], FLAT)[0]
    u = across[:, 0] - across[:, 1:] @ inverse @ now.products[1:, 0]
    M = begun.T @ begun - across[:, 1:] @ inverse @ across[:, 1:].T
    shift = _inverse(M[None], 1e-10)[0] @ u
    left = now.innovation - now.rows[:, 1:] @ (inverse @ (now.products[1:, 0] - across[:, 1:].T @ shift))
    left[at:] -= begun @ shift
    noise = max(1.0, float(np.sum(left[at:] ** 2)) / max(scores.time.size - at - P, 1))
    found = _along(scores, _Compared(instant, at, u, 0.5 * (M + M.T), noise), np.eye(P))
    return found and replace(found, begun=True)


def begun_within(scores: Scores, since: tuple[float, float]) -> list[Contrast]:
    """The contrasts of shifts that begin at each instant within an interval [s]."""
    return [one for t in instants_of(scores, since) if (one := begun_at(scores, float(t)))]


def likeliest_begun(begun: Sequence[Contrast]) -> Contrast | None:
    """The contrast, of those at several instants, that shows a change best; None of none."""
    return max(begun, key=lambda one: one.statistic - 2 * one.directions, default=None)


@dataclass(frozen=True)
class _Compared:
    """A window against the rest, under one strength of gusts in the window.

    Attributes:
        since: Start of the window [s].
        at: Its first row.
        u, M: See the module, shapes (P,) and (P, P).
        noise: Mean squared innovation of the window after the shift, at least 1.
        wind: What T must exceed: how much better another strength of gusts explains a short window of x and y.
    """

    since: float
    at: int
    u: Array
    M: Array
    noise: float
    wind: float = 0.0


def _starts(scores: Scores, begins: Sequence[float]) -> list[tuple[float, int]]:
    """The times, of those given, with enough of the regime before them to be compared, and their first rows."""
    return [
        (since, int(at))
        for since, at in zip(begins, np.searchsorted(scores.time, begins), strict=True)
        if at < scores.time.size and scores.chunks_before(int(at)) >= LEAST_CHUNKS
    ]


def _compared(scores: Scores, begins: Sequence[float]) -> list[_Compared]:
    """The comparison of each window, by its start [s], without those of which either part is too short.

    It is made under the strength of gusts in the window. A window of x and y determines it, and a long one of z and
    yaw: by its likelihood with coefficients, trims and start velocities of its own.
    """
    starts = _starts(scores, begins)
    if not starts:
        return []
    pushed, now = scores.trimmed, scores.gusts
    short = [pushed and bool(scores.time[-1] - since < OWN_GUSTS) for since, _ in starts]
    under = [
        (place, strength)
        for place, brief in enumerate(short)
        for strength in range(now if pushed else 0, (now if brief else len(scores.under_gusts)) + 1)
    ]
    each = (scores, *scores.under_gusts)
    P, products = len(scores.names), np.array([_product(each[strength].rows[starts[w][1] :]) for w, strength in under])
    G, s, still, left = _projected(products, P)
    likely = np.array([scores.gust_likelihood(since) for since, _ in starts])[tuple(np.transpose(under))]
    without, likely = likely + 0.5 * (products[:, 0, 0] - still), likely + 0.5 * (products[:, 0, 0] - left)
    window, own = np.array([w for w, _ in under]), [_product(scores.rows[at:]) for _, at in starts]
    each_window = [np.flatnonzero(window == w) for w in range(len(starts))]
    best = [int(places[np.argmax(likely[places])]) for places in each_window]
    wind = [
        0.0 if pushed or scores.time[-1] - since >= OWN_GUSTS else 2 * float(without[places].max() - without[at])
        for at, places, (since, _) in zip(best, each_window, starts, strict=True)
    ]
    G_w, s_w = G[best], s[best]
    G_r, s_r, *_ = _projected(scores.products - np.array(own), P)
    share = G_w @ _inverse(G_w + G_r, 1e-15)
    u = s_w - (share @ (s_w + s_r)[:, :, None])[:, :, 0]
    M = G_w - share @ G_w
    return [
        _Compared(
            since,
            at,
            u[w],
            0.5 * (M[w] + M[w].T),
            max(float(left[best[w]]) / max(scores.time.size - at - P, 1), 1.0),
            wind[w],
        )
        for w, (since, at) in enumerate(starts)
    ]


def _product(rows: Array) -> Array:
    return np.asarray(rows.T @ rows)


def _likely(scores: Scores, windows: Sequence[_Compared]) -> Iterator[tuple[_Compared, Array]]:
    """The windows and bases that are worth a contrast: even under white innovations the others are not `UNLIKELY`.

    Nor are those of which stronger gusts explain more. The true variance is never below that of white innovations.
    """
    if not windows:
        return
    every, *alone = _bases(scores.names)
    u, M = np.array([one.u for one in windows]), np.array([one.M for one in windows])
    noise = np.array([one.noise for one in windows])
    chunks = np.array([scores.chunks_before(one.at) for one in windows])
    value, vector = np.linalg.eigh(M)
    keep = value > VISIBLE
    along = (u[:, None, :] @ vector)[:, 0]
    told = [(np.where(keep, along**2 / np.where(keep, value, 1.0), 0.0).sum(axis=1) / noise, keep.sum(axis=1))]
    columns = np.hstack(alone)
    value, along = ((M @ columns) * columns).sum(axis=1), u @ columns
    told += zip(
        (along**2 / np.maximum(value, VISIBLE) / noise[:, None]).T, (value > VISIBLE).astype(int).T, strict=True
    )
    rare = [_p_value(T, np.maximum(n, 1), chunks) <= UNLIKELY for T, n in told]
    for w, one in enumerate(windows):
        brief = scores.time[-1] - one.since < OWN_GUSTS
        for b, basis in enumerate([every, *alone]):
            windy = told[b][0][w] * one.noise < one.wind
            if rare[b][w] and told[b][1][w] and not (windy or (brief and b == 0)):
                yield one, basis


def _along(scores: Scores, one: _Compared, basis: Array) -> Contrast | None:
    """The contrast within a subspace of the shifts, with a basis of shape (P, k); None if nothing is visible there."""
    inner = basis.T @ one.M @ basis
    value, vector = np.linalg.eigh(inner) if len(inner) > 1 else (inner[0], np.eye(1))
    keep = value > VISIBLE
    if not keep.any():
        return None
    value, vector = value[keep], basis @ vector[:, keep]
    along, directions = one.u @ vector, value.size
    excess, freedom = _excess(scores, one.at, vector)
    variance = one.noise * excess + value * (scores.doubt**2 @ vector**2)
    statistic = float((along**2 / (value * variance)).sum())
    return Contrast(
        one.since,
        vector @ (along / value),
        (vector * (value / variance)) @ vector.T,
        statistic,
        directions,
        float(_p_value(statistic, directions, freedom)),
        freedom,
    )


def _excess(scores: Scores, at: int, along: Array) -> tuple[Array, float]:
    """Variance of the rest's scores along some directions, over that of white innovations, and its degrees of freedom.

    Directions `along`, shape (P, k), give k variances, each at least 1.
    """
    sums, products = scores.before(at)
    excess, values = _spread(sums @ along, np.einsum("ik,ij,jk->k", along, products, along))
    return np.maximum(excess, 1.0), values


def _spread(sums: Array, expected: Array) -> tuple[Array, float]:
    """Sum of squares of the columns over the expected one, and the equivalent number of normal samples behind it.

    A variance is poorly determined by seconds in which hardly anything was commanded, or if one second outweighs all
    others: the fourth moments show how poorly. Shape (C, k) gives (k,), and the smallest of k numbers of samples.
    """
    square, fourth = (sums**2).sum(axis=0), (sums**4).sum(axis=0)
    told = 3.0 * square**2 / np.maximum(fourth, 1e-300)
    return square / np.maximum(expected, 1e-300), float(min(np.min(told, initial=np.inf), len(sums)))


def _p_value(statistic: Array | float, directions: Array | int, chunks: Array | float) -> Array:
    """p-value of Hotelling's T squared, with the number of chunks behind its variance as degrees of freedom."""
    return np.asarray(fdtrc(directions, np.maximum(chunks - directions, 1), statistic / directions))


def _projected(products: Array, P: int) -> tuple[Array, Array, Array, Array]:
    """Information and score of windows less their trims and starts, and sums of squares without and with shifts.

    Args:
        products: Products of their rows, see `Scores.rows`, shape (W, 1 + P + Q, 1 + P + Q).
        P: Number of tested parameters.
    """
    inverse = _inverse(products[:, 1 + P :, 1 + P :], 1e-10)
    across = products[:, : 1 + P, 1 + P :]
    left = products[:, : 1 + P, : 1 + P] - across @ inverse @ across.transpose(0, 2, 1)
    G, s = left[:, 1:, 1:], left[:, 1:, 0]
    explained = (s[:, None] @ _inverse(G, 1e-10) @ s[:, :, None])[:, 0, 0]
    return G, s, left[:, 0, 0], np.maximum(left[:, 0, 0] - explained, 0.0)


def _inverse(products: Array, least: float) -> Array:
    """Pseudo-inverses of symmetric matrices, cut off at a share of the largest eigenvalue; ten times as fast as pinv.

    Args:
        products: The matrices, shape (W, n, n).
        least: The share.
    """
    value, vector = np.linalg.eigh(products)
    keep = value > least * np.maximum(value.max(axis=1, keepdims=True, initial=0.0), 0.0)
    return np.asarray((vector * (keep / np.where(keep, value, 1.0))[:, None]) @ vector.transpose(0, 2, 1))


def _windows(scores: Scores, lengths: Sequence[float]) -> list[_Compared]:
    """The comparisons of the windows of some lengths [s], of at most half the regime."""
    return _compared(scores, _begins(scores, lengths))


def _begins(scores: Scores, lengths: Sequence[float]) -> list[float]:
    """When windows of some lengths [s] begin, without those that are longer than half the regime [s]."""
    now, begin = float(scores.time[-1]), float(scores.time[0])
    return [now - w for w in lengths if w < 0.5 * (now - begin)]


def compares(scores: Scores, lengths: Sequence[float] = WINDOWS) -> bool:
    """Whether a look can compare a window of some length [s] with what was before."""
    return bool(_starts(scores, _begins(scores, lengths)))


def _looked_for(scores: Scores, windows: Sequence[_Compared], jolts: "_Jolts | None") -> list[Contrast]:
    """The contrasts of the windows, along `_bases`, and the likeliest jolt."""
    found = [each for one, basis in _likely(scores, windows) if (each := _along(scores, one, basis))]
    return [*found, *_jolted([scores], [jolts]).values()]


def looks(scores: Scores, lengths: Sequence[float] = WINDOWS, back: float = NEW) -> int:
    """Number of contrasts that a look at these scores tests, with windows of some lengths and jolts so far back [s]."""
    long = sum(window >= OWN_GUSTS for window in lengths)
    return len(lengths) * (len(_bases(scores.names)) - 1) + long + _instants(scores, back)


def looked_together(
    scored: Sequence[Scores], lengths: Sequence[float] = WINDOWS, back: float = NEW
) -> tuple[dict[tuple[str, ...], list[Contrast]], int]:
    """The contrasts of all likelihoods, each by itself and together, and the number of tests of a look.

    Together: simultaneous jolts of two axes, and a shift that axes share, see `SHARED`.

    Args:
        scored: Scores of each likelihood.
        lengths: Lengths of the windows that are tested [s].
        back: How far back jolts are tested [s].
    """
    windows = {scores.names: _windows(scores, lengths) for scores in scored}
    jolts = {scores.names: _jolts_of(scores, back) for scores in scored}
    looked = {scores.names: _looked_for(scores, windows[scores.names], jolts[scores.names]) for scores in scored}
    pairs = list(itertools.combinations([scores for scores in scored if scores.jolts.size], 2))
    for pair in pairs:
        for names, one in _jolted(pair, [jolts[scores.names] for scores in pair]).items():
            looked[names].append(one)
    for names, one in _shared(scored, windows):
        looked[names].append(one)
    count = sum(looks(scores, lengths, back) for scores in scored) + sum(_instants(pair[0], back) for pair in pairs)
    return looked, count + (len(SHARED) * len(lengths) if len(scored) > 1 else 0)


def pushes(names: Sequence[str], one: Contrast) -> bool:
    """Whether a shift pushes by itself, as a gust does; that of a gain or delay shows only in answers to commands."""
    return any(shift != 0.0 for name, shift in zip(names, one.shift, strict=True) if name.endswith(".trim"))


def in_any_air(
    names: tuple[str, ...], under: Sequence[Sequence[Scores]], lengths: Sequence[float], back: float = NEW
) -> float:
    """Smallest p-value of the pushes of z or yaw, averaged over the strengths that the gusts may have now.

    A few seconds hardly tell twice the power from that of the regime, and under twice the power the same push is a
    thousand times less rare. The strengths are weighed by the calmest parts of all axes, and stronger ones by what x
    and y show in the present seconds, too: wind that comes up at once pushes all.

    Source: X.-L. Meng, Ann. Statist. 22 (1994), pp. 1142-1160 (p-values averaged over a nuisance parameter).

    Args:
        names: Names of the scores of the axis.
        under: The scores of all likelihoods under each strength.
        lengths: As for `looked_together`, like `back`.
        back: Likewise.
    """
    air = next(scores.air for scores in under[0] if scores.names == names)
    heard = np.array([sum(_heard(one, k) for one in scored if not one.trimmed) for k, scored in enumerate(under)])
    air = air + np.maximum(heard - heard[0], 0.0)
    weight, least = np.exp(CORRELATED * (air - air.max())), []
    for scored in under:
        found = [one.p_value for one in looked_together(scored, lengths, back)[0][names] if pushes(names, one)]
        least.append(min(found, default=1.0))
    return float(weight @ least / weight.sum())


def _heard(scores: Scores, strength: int) -> float:
    """Log-evidence of a strength of gusts in the last seconds of x and y, if their coefficients shift at some instant.

    A payload or a loss of thrust only shifts them.
    """
    now, explained = now_of(scores), []
    for since in scores.time[-1] - np.arange(HEARD, LEAST_GUST_TIME + HEARD, HEARD):
        at = int(np.searchsorted(scores.time, since))
        shapes = now.begun(since, 0.0)[at:]
        across, normal = shapes.T @ now.innovation[at:], shapes.T @ shapes + np.eye(shapes.shape[1])
        explained.append(across @ np.linalg.solve(normal, across) - np.linalg.slogdet(normal)[1])
    return float(scores.gust_likelihood(scores.time[-1] - LEAST_GUST_TIME)[strength] + 0.5 * max(explained))


def _shared(
    scored: Sequence[Scores], windows: Mapping[tuple[str, ...], Sequence[_Compared]]
) -> Iterator[tuple[tuple[str, ...], Contrast]]:
    """For each window, one shift of a coefficient that axes share, as a contrast of the likelihood that shows it best.

    Its variance comes from the scores of all these axes together: on a flight of single steps each axis answers in a
    few seconds only, and what a few seconds tell of a variance makes the rarest p-values of one axis useless.
    """
    for kind, axes in SHARED:
        along = {scores.names: _alike(scores.names, kind, axes) for scores in scored}
        there = [scores for scores in scored if along[scores.names].any()]
        begins = dict.fromkeys(one.since for each in windows.values() for one in each)
        for since in begins if len(there) > 1 else ():
            seen = [
                (each, one, along[each.names]) for each in there for one in windows[each.names] if one.since == since
            ]
            most = sum(_squared(*each[1:]) for each in seen)  # by the Cauchy-Schwarz inequality
            if not seen or _p_value(most, 1, max(each.chunks_before(one.at) for each, one, _ in seen)) > UNLIKELY:
                continue
            found = [(each, one, told) for each, one, way in seen if (told := _along(each, one, way))]
            if len(found) < 2:
                continue
            names, best = max(((each.names, told) for each, _, told in found), key=lambda each: each[1].statistic)
            yield names, replace(best, p_value=_p_value_of_all(found, along))


def _p_value_of_all(
    found: Sequence[tuple[Scores, _Compared, Contrast]], along: Mapping[tuple[str, ...], Array]
) -> float:
    """p-value of one shift of several likelihoods, each with its contrast in that direction.

    Each score is weighted by the inverse of its variance. The variance of their sum over a chunk is at least that of
    independent scores, and larger as far as the chunks show that they move together.
    """
    score = precision = expected = 0.0
    sums: dict[float, float] = {}
    for scores, one, told in found:
        way = along[scores.names][:, 0]
        value, known = float(way @ one.M @ way), float(told.precision.max())  # of the shift: without, with the variance
        weight = known / value
        score += weight * float(one.u @ way)
        precision += known
        chunks, products = scores.before(one.at)
        own = weight * (chunks @ way)
        expected += max(float(own @ own), weight**2 * float(way @ products @ way))
        for second, value in zip(scores.seconds(own.size), own, strict=True):
            sums[second] = sums.get(second, 0.0) + value
    excess, freedom = _spread(np.array([*sums.values()])[:, None], np.array([expected]))
    return float(_p_value(score**2 / precision / max(float(excess[0]), 1.0), 1, freedom))


def _squared(one: _Compared, along: Array) -> float:
    """T along one direction, shape (P, 1), over the variance of white innovations: the true one is never below."""
    value = float((along.T @ one.M @ along)[0, 0])
    return float((one.u @ along)[0]) ** 2 / value / one.noise if value > VISIBLE else 0.0


def _instants(scores: Scores, back: float) -> int:
    """Number of jolts that a look at these scores tests."""
    return round(back / APART) if scores.jolts.size else 0


@dataclass(frozen=True)
class _Jolts:
    """Tests for a sudden acceleration of one axis that fades, at n instants.

    Attributes:
        time: Instants, shape (n,) [s].
        product, power: Inner product of the jolt's shape with the innovations, and with itself, less what the
            coefficients of the regime explain, shape (n,).
        wrong: Largest square that a wrong pose would explain instead, at any block since the first instant.
        variance: Variance of the filter's normalised output, from its past.
        freedom: Degrees of freedom of that variance.
    """

    time: Array
    product: Array
    power: Array
    wrong: float
    variance: float
    freedom: float


def _jolts_of(scores: Scores, back: float) -> _Jolts | None:
    """A matched filter at every new instant; its variance comes from its output before."""
    begin, now = float(scores.time[0]), float(scores.time[-1])
    chunks = int((now - back - LASTS - begin) / CHUNK)
    if not scores.jolts.size or chunks < LEAST_CHUNKS:
        return None
    first, end = (int(np.searchsorted(scores.time, now - ago)) for ago in (LASTS, LASTS / 2))
    new = np.unique(np.searchsorted(scores.time, np.arange(now - EARLIEST, now - EARLIEST - back, -APART)))
    if not scores.jolts[first:end].any(axis=0).all():  # a gap in the poses
        return None
    under = now_of(scores)
    h, *wrongs = under.jolts[first:end].T
    product, power = _matched(under, h, new)
    since = np.arange(new[0], scores.time.size)  # a wrong pose may be the last one: a jolt takes longer to be visible
    wrong = [_matched(under, each, since) for each in wrongs]
    h, before = scores.jolts[first:end, 0], scores.innovation[: new[0]]
    usual = np.correlate(before, h, "valid") ** 2 / float(h @ h)
    freedom = chunks * min(3.0 * float(usual.mean() ** 2 / max(np.mean(usual**2), 1e-300)), 1.0)
    largest = float(np.quantile(usual, RARE)) / RARE_OF_NORMAL
    variance = MARGIN * max(float(usual.mean()), largest, 1.0)
    most = max(float((p**2 / np.maximum(q, 1e-300)).max()) for p, q in wrong)
    seen = power > VISIBLE  # all else is not tested, or is what unknown coefficients do
    product, power = seen * product, np.where(seen, power, 1e-300)
    return _Jolts(scores.time[new], product, power, most, variance, freedom)


def _jolted(scored: Sequence[Scores], jolts: Sequence[_Jolts | None]) -> dict[tuple[str, ...], Contrast]:
    """The likeliest jolt: a sudden acceleration that fades, as when the autopilot learns to carry a payload.

    It may hit several axes at one instant: a weak rotor makes the vehicle sink and turn. Empty if wrong poses explain
    more.
    """
    found = [one for one in jolts if one]
    if len(found) < len(scored) or any(not np.array_equal(one.time, found[0].time) for one in found):
        return {}
    gain = np.array([one.product**2 / one.power for one in found])
    told = (gain / np.array([[one.variance] for one in found])).sum(axis=0)
    best = int(np.argmax(told))
    if gain[:, best].sum() < sum(one.wrong for one in found):
        return {}
    p_value = float(_p_value(float(told[best]), len(found), min(one.freedom for one in found)))
    out = {}
    for scores, one in zip(scored, found, strict=True):
        size, power = float(one.product[best] / one.power[best]), float(one.power[best]) / one.variance
        trim = np.array([name.endswith(".trim") for name in scores.names])
        statistic = size**2 * power
        out[scores.names] = Contrast(
            float(one.time[best]), trim * size, np.diag(trim * power), statistic, 1, p_value, one.freedom, jolt=True
        )  # fmt: skip
    return out


def _matched(scores: Scores, h: Array, at: Indices) -> tuple[Array, Array]:
    """Inner products of a shape from each of some rows on with the innovations, and with itself, shape (n,) each.

    What the coefficients of the regime explain is taken off: an axis whose commands have only just begun answers by
    coefficients that nobody knows yet, and its answer is no jolt.
    """
    first = int(at.min())
    later = np.vstack([scores.rows[first : int(at.max()) + h.size], np.zeros((h.size, scores.rows.shape[1]))])
    across = np.array([np.correlate(column, h, "valid")[at - first] for column in later.T])
    rows = np.minimum(scores.time.size - at, h.size)
    return less_what_is_unknown(scores, across, np.cumsum(h**2)[rows - 1])


@functools.cache
def _bases(names: tuple[str, ...]) -> list[Array]:
    """Bases of the shifts: all directions; each trim that belongs to the vehicle; a common factor; a common delay."""
    every = np.eye(len(names))
    alone = [every[:, [i]] for i, name in enumerate(names) if name.endswith(".trim")]
    return [every, *alone, _alike(names, "input"), _alike(names, "delay")]


def _alike(names: Sequence[str], kind: str, axes: Sequence[str] = AXES) -> Array:
    """The direction in which one coefficient of each of some axes shifts by the same amount, shape (P, 1)."""
    return np.array([[float(name in [f"{axis}.{kind}" for axis in axes])] for name in names])


def calm(scores: Scores, before: float, since: float, p_value: float) -> bool:
    """Whether the air around a change is as calm as in the rest of the regime, apart from the change itself.

    Rising gusts make the innovations too large for seconds. A change of the vehicle leaves the innovations before it
    as they were, and those after it too once its shifts, or its jolt, are subtracted. With a p-value below `SURE` the
    calm after the change is not required.

    Args:
        scores: Those of the likelihood that shows the change.
        before: Time before which it certainly had not come [s]: the innovations until then are of the old vehicle.
        since: Its probable time [s].
        p_value: That of the change.
    """
    time, e, begin = scores.time, scores.innovation, _flown_before(scores, before, BEFORE)
    usual = max(float(np.mean(e[time < begin] ** 2)) if time[0] < begin else 1.0, 1.0)
    last = e[(time >= begin) & (time < before)]
    after, compared = e[time > since + FADES], _compared(scores, [since])
    left = min(float(np.mean(after**2)) if after.size else np.inf, compared[0].noise if compared else np.inf)
    return (
        last.size > 0
        and float(np.mean(last**2)) < (1 + CALM_BEFORE * np.sqrt(2 / last.size)) * usual
        and (left < CALM_AFTER * usual or p_value < SURE)
    )


def at_once(scores: Scores, looked: Sequence[Contrast], change: Contrast) -> Contrast | None:
    """The contrast of other axes at the time of a change, however small: axes that stayed tell of the cause, too.

    Of the kind of the change: the jolt nearest to it where it is one, else shifts that begin then, or the window since;
    None if undetermined. A choice by significance would take the chance of several tests for a shift.
    """
    if change.begun:
        return begun_at(scores, change.since)
    jolts = [one for one in looked if one.jolt and abs(one.since - change.since) < TOGETHER] if change.jolt else []
    nearest = min(jolts, key=lambda one: abs(one.since - change.since), default=None)
    return nearest or contrast(scores, change.since)


def likeliest(scores: Scores, found: Contrast, looked: Sequence[Contrast]) -> Contrast:
    """The contrast that shows a change best: its window begins when the vehicle changed, or it is a push.

    A contrast along the direction of another typical change tells nothing of the others: it would name its own cause.

    Args:
        scores: Those of the likelihood that shows the change.
        found: The contrast that found it.
        looked: The contrasts of the present look.
    """
    now = float(scores.time[-1])
    end = now - LEAST_WINDOW + STEP
    begins = np.arange(earliest(scores, found), end, STEP)
    _, distinct = np.unique(np.searchsorted(scores.time, begins), return_index=True)  # a pause holds a single one
    tried = [one for t in begins[distinct] if (one := contrast(scores, float(t)))]
    near = [one for one in (found, *looked) if abs(one.since - found.since) < TOGETHER and pushes(scores.names, one)]
    return max((*tried, *near) or (found,), key=lambda one: one.statistic - 2 * one.directions)


def earliest(scores: Scores, found: Contrast) -> float:
    """Earliest instant at which the change that a contrast shows may have come [s]."""
    return max(_flown_before(scores, found.since, WINDOWS[-1] / 4), float(scores.time[0]))


def _flown_before(scores: Scores, instant: float, seconds: float) -> float:
    """The instant from which on some seconds were flown until another instant [s]: pauses of the log do not count.

    Where the vehicle may have been another one after a pause, the pause belongs to the interval.
    """
    time = np.append(scores.time[scores.time < instant], instant)
    begin = instant - seconds
    for last in np.flatnonzero(np.diff(time) > PAUSE)[::-1]:
        if time[last + 1] <= begin:
            break
        begin -= float(time[last + 1] - time[last])
    return begin
