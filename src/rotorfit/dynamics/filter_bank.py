"""A bank of disturbance filters that adapts to the levels of the filtered flight, causally.

The levels of a calm flight mislead in a gusty one: the filter follows the gusts too slowly. So filters with other
levels, the members, run beside the one with the model's own levels, and their estimates are averaged, axis by axis,
with weights from the past alone:

    log w = log w_0 + eta log L - n / 2 log E

E is the mean square of a member's prediction errors 0.5 s ahead, over n such stretches; L is the likelihood of its
innovations; the past is forgotten with `MEMORY`. E dominates because prediction is the purpose: with a slightly wrong
law, or pose noise that is not white, the one-step likelihood prefers levels that predict worse. The likelihood has a
small weight (eta), but reacts at once to levels that are far off, and to an error caused by a single false pose.

A member knows its levels up to one scale sigma^2 per axis, which it learns from its innovations. The scale enters the
likelihood and the predicted error, not the prediction. Call `start_bank`, then for each stamp `move`, `judge`, `take`
and `probe`: the state only moves forwards in time.

Source: D. T. Magill, IEEE Trans. Automatic Control 10 (1965), pp. 434-439, for the bank; A. E. Raftery, M. Karny,
P. Ettler, Technometrics 52 (2010), pp. 52-66, for forgetting; J. Geweke, G. Amisano, J. Econometrics 164 (2011), pp.
130-141, for weights by past predictions where every member is wrong; M. West, J. Harrison, Bayesian Forecasting and
Dynamic Models (1997), ch. 10.8, for the scale.
"""

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from rotorfit.core.frames import Array, Mask
from rotorfit.dynamics.compiled import inner, kernel
from rotorfit.dynamics.disturbance import (
    axis_start,
    discretize,
    fill_step_tables,
    predict_covariance,
    update_covariance,
    update_rate,
)
from rotorfit.dynamics.general_step import COLUMNS, P, V

POWERS = 8.0 ** np.array([0, -1, 1, -2, 2, -3, 3, -4, 4])
"""Factors on the power of the wind at equal pose noise."""

RATES = np.array([1.0, 0.4, 2.5])
"""Factors on the damping of the wind; the power scales with their square, as it does over recorded flights."""

MEMORY = 20.0
"""Time after which the weight of the past has decayed to 1/e [s]."""

OWN_SHARE = 0.5
"""Prior weight of the model's own levels."""

AHEAD = 0.5
"""Horizon at which members are judged [s]; at longer ones there are too few errors in a minute to learn from."""

EVERY = 0.1
"""Time between the predictions that are judged [s]."""

PENDING = 8
"""Largest number of predictions waiting to be judged."""

SHARPNESS = 2.0
"""Number of independent errors that a stretch of `AHEAD` counts as: members err alike, so differences are surer."""

TEMPER = 0.02
"""eta."""

SCALE_FREEDOM = 30.0
"""Number of innovations that the scale of the model's own levels counts as (prior degrees of freedom)."""


class Bank(NamedTuple):
    """M members before the next stamp; arrays are changed in place.

    Attributes:
        covariance: Covariance of the disturbance, at the member's levels, shape (M, 3, 3, 3).
        state: Filtered data minus driven response, two unit trims and two unit start velocities, shape (M, 5, 6).
        known: Estimates of trims (heading frame) and start velocities (world), shape (M, 4).
        spread: Their covariance, at the member's levels, shape (M, 4, 4).
        squares: Sum of squares of the scale of each axis, shape (M, 2).
        freedom: Number of squares, shape (M, 2).
        likelihood: Logarithm of L for each axis, shape (M, 2).
        error: Sum of the squared errors of E, shape (M, 2).
        errors: Number of those errors, shape (2,).
        waiting: Disturbance now, as predicted by the predictions that wait to be judged, shape (PENDING, M, 6).
        believed: `known` at the time of prediction, shape (PENDING, M, 4).
        due: Time of judgement, shape (PENDING,) [s].
        judged: Whether it has been judged on each axis, shape (PENDING, 2).
        probed: Time of the last prediction, shape (1,) [s].
    """

    covariance: Array
    state: Array
    known: Array
    spread: Array
    squares: Array
    freedom: Array
    likelihood: Array
    error: Array
    errors: Array
    waiting: Array
    believed: Array
    due: Array
    judged: Mask
    probed: Array


def bank_levels(levels: Array, adapt: bool) -> Array:
    """Levels of the members, grouped in classes of equal wind damping, the model's own first.

    Args:
        levels: q, r, alpha, kappa of two axes, shape (2, 4).
        adapt: False for only the model's own levels.

    Returns:
        Shape (A, G, 2, 4): A classes of G members.
    """
    if not adapt:
        return levels[None, None].copy()
    out: Array = np.tile(levels, (RATES.size, POWERS.size, 1, 1))
    out[..., 0] *= POWERS[None, :, None] * RATES[:, None, None] ** 2
    out[..., 2] *= RATES[:, None, None]
    return out


def start_bank(levels: Array, prior: Array) -> Bank:
    """A bank before the first stamp. Arrays are allocated in Python: in a kernel each takes time to compile.

    Args:
        levels: From `bank_levels`, shape (A, G, 2, 4).
        prior: Variances of two trims and two start velocities, shape (4,).
    """
    A, G = levels.shape[:2]
    M = A * G
    covariance = np.zeros((M, 3, 3, 3))
    for m, a in np.ndindex(M, 2):
        axis_start(covariance[m, a], levels[m // G, m % G, a])
    return Bank(
        covariance=covariance,
        state=np.zeros((M, 5, 6)),
        known=np.zeros((M, 4)),
        spread=np.tile(np.diag(prior), (M, 1, 1)),
        squares=np.full((M, 2), SCALE_FREEDOM),
        freedom=np.full((M, 2), SCALE_FREEDOM),
        likelihood=np.zeros((M, 2)),
        error=np.zeros((M, 2)),
        errors=np.zeros(2),
        waiting=np.zeros((PENDING, M, 6)),
        believed=np.zeros((PENDING, M, 4)),
        due=np.zeros(PENDING),
        judged=np.ones((PENDING, 2), np.bool_),
        probed=np.full(1, -np.inf),
    )


def bank_tables(steps: Array, levels: Array) -> tuple[Array, Array]:
    """Transitions and unit-power covariances of every class, axis and distinct step: two arrays (A, 2, U, 3, 3)."""
    A = levels.shape[0]
    F, Q = np.zeros((2, A, 2, steps.size, 3, 3))
    for g, a in np.ndindex(A, 2):
        fill_step_tables(steps, levels[g, 0, a, 2], levels[g, 0, a, 3], F[g, a], Q[g, a])
    return F, Q


@inner()
def fade(z: Array, row: int, column: int, F: Array, g: int, k: int, c: float, s: float) -> None:
    """Propagates the disturbance z[row, column] (6,) of class g by step k of F; c and s are for half the turn."""
    n, v, w = z[row, column, 0], z[row, column, 1], z[row, column, 2]
    N, V, W = z[row, column, 3], z[row, column, 4], z[row, column, 5]
    if s != 0.0:
        n, N = c * n + s * N, c * N - s * n
        v, V = c * v + s * V, c * V - s * v
        w, W = c * w + s * W, c * W - s * w
    n += F[g, 0, k, 0, 1] * v + F[g, 0, k, 0, 2] * w
    v, w = F[g, 0, k, 1, 1] * v + F[g, 0, k, 1, 2] * w, F[g, 0, k, 2, 1] * v + F[g, 0, k, 2, 2] * w
    N += F[g, 1, k, 0, 1] * V + F[g, 1, k, 0, 2] * W
    V, W = F[g, 1, k, 1, 1] * V + F[g, 1, k, 1, 2] * W, F[g, 1, k, 2, 1] * V + F[g, 1, k, 2, 2] * W
    if s != 0.0:
        n, N = c * n + s * N, c * N - s * n
        v, V = c * v + s * V, c * V - s * v
        w, W = c * w + s * W, c * W - s * w
    z[row, column, 0], z[row, column, 1], z[row, column, 2] = n, v, w
    z[row, column, 3], z[row, column, 4], z[row, column, 5] = N, V, W


@inner(fastmath={"contract"})
def move(bank: Any, levels: Array, F: Array, Q: Array, k: int, turn: float, dt: float) -> None:
    """Propagates a bank by one step of dt [s], index k in the tables, while the heading turns by `turn` [rad]."""
    G = levels.shape[1]
    M = levels.shape[0] * G
    covariance, state, waiting, judged = bank.covariance, bank.state, bank.waiting, bank.judged
    squares, freedom, likelihood, error = bank.squares, bank.freedom, bank.likelihood, bank.error
    c, s = np.cos(0.5 * turn), np.sin(0.5 * turn)
    kept = np.exp(-dt / MEMORY)
    for m in range(M):
        g = m // G
        predict_covariance(covariance, m, F, Q, g, k, levels[g, m % G, 0, 0], levels[g, m % G, 1, 0], c, s)
        for j in range(5):
            fade(state, m, j, F, g, k, c, s)
        for i in range(PENDING):
            if not (judged[i, 0] and judged[i, 1]):
                fade(waiting, i, m, F, g, k, c, s)
        for a in range(2):
            squares[m, a] = SCALE_FREEDOM + kept * (squares[m, a] - SCALE_FREEDOM)
            freedom[m, a] = SCALE_FREEDOM + kept * (freedom[m, a] - SCALE_FREEDOM)
            likelihood[m, a] *= kept
            error[m, a] *= kept
    for a in range(2):
        bank.errors[a] *= kept


@inner(fastmath={"contract"})
def judge(bank: Any, axis: int, rate: Any, measured: Array, t: float) -> None:
    """Compares predictions that are due at time t [s] with the measurement; arguments as for `take`."""
    at = 3 * axis + (1 if rate else 0)
    judged, due, waiting, believed, error = bank.judged, bank.due, bank.waiting, bank.believed, bank.error
    for i in range(PENDING):
        if judged[i, axis] or t < due[i]:
            continue
        judged[i, axis] = True
        bank.errors[axis] += 1.0
        for m in range(error.shape[0]):
            e = measured[0] - waiting[i, m, at]
            for j in range(4):
                e -= believed[i, m, j] * measured[1 + j]
            error[m, axis] += e * e


@inner(fastmath={"contract"})
def take(bank: Any, levels: Array, axis: int, rate: Any, measured: Array, gain: Array, e: Array, along: Array) -> None:
    """Updates all members with a measurement of one axis.

    Args:
        bank: Changed in place.
        levels: Shape (A, G, 2, 4).
        axis: 0 or 1.
        rate: Whether a velocity was measured, else a position.
        measured: Along the axis: data minus driven response, then the response to two unit trims and two unit start
            velocities, shape (5,).
        gain: Work space, shape (6,).
        e: Work space, shape (5,).
        along: Work space, shape (4,).
    """
    G = levels.shape[1]
    at = 3 * axis + (1 if rate else 0)
    covariance, state, known, spread = bank.covariance, bank.state, bank.known, bank.spread
    freedom, squares, likelihood = bank.freedom, bank.squares, bank.likelihood
    for m in range(known.shape[0]):
        noise = levels[m // G, m % G, axis, 1]
        if rate:
            variance = update_rate(covariance, m, axis, noise, gain)
        else:
            variance = update_covariance(covariance, m, axis, noise, gain)
        for j in range(5):
            e[j] = measured[j] - state[m, j, at]
            if e[j] != 0.0:  # a trim or start velocity of the other axis, where the two do not turn
                for i in range(6):
                    state[m, j, i] += gain[i] * e[j]
        innovation = e[0]
        for j in range(4):
            innovation -= known[m, j] * e[1 + j]
            along[j] = 0.0
            for i in range(4):
                along[j] += spread[m, j, i] * e[1 + i]
            variance += along[j] * e[1 + j]
        for j in range(4):
            share = along[j] / variance
            if share != 0.0:
                known[m, j] += share * innovation
                for i in range(4):
                    spread[m, j, i] -= share * along[i]
        square, n = innovation * innovation / variance, freedom[m, axis]
        scale = squares[m, axis] / n
        # Student's t with n degrees of freedom; the difference of its normalisation from a Gaussian's is common to all.
        likelihood[m, axis] -= 0.5 * np.log(variance * scale) + 0.5 * (n + 1) * np.log1p(square / (n * scale))
        squares[m, axis] += square
        freedom[m, axis] += 1.0


@inner()
def probe(bank: Any, t: float) -> None:
    """Stores every member's prediction, to be judged after `AHEAD`; does nothing with a single member."""
    if bank.known.shape[0] == 1 or t < bank.probed[0] + EVERY:
        return
    oldest = 0
    for i in range(PENDING):
        if bank.judged[i, 0] and bank.judged[i, 1]:
            oldest = i
            break
        if bank.due[i] < bank.due[oldest]:
            oldest = i
    bank.probed[0] = t
    bank.due[oldest] = t + AHEAD
    bank.judged[oldest, 0] = bank.judged[oldest, 1] = False
    state, known, waiting, believed = bank.state, bank.known, bank.waiting, bank.believed
    for m in range(known.shape[0]):
        for j in range(4):
            believed[oldest, m, j] = known[m, j]
        for i in range(6):
            waiting[oldest, m, i] = disturbance(state, known, m, i)


@inner()
def disturbance(state: Array, known: Array, m: int, i: int) -> float:
    """Element i of the disturbance of one member, minus the share explained by trims and start velocities."""
    z = state[m, 0, i]
    for j in range(4):
        z -= known[m, j] * state[m, 1 + j, i]
    return z  # type: ignore[no-any-return]


def weights(bank: Bank) -> Array:
    """Weights of the members for each axis, shape (M, 2)."""
    out: Array = np.empty((len(bank.known), 2))
    fill_weights(bank, out)
    return out


@kernel()
def fill_weights(bank: Any, out: Array) -> None:
    """Fills the weights, shape (M, 2)."""
    M = bank.known.shape[0]
    for a in range(2):
        least = bank.error[0, a]
        for m in range(M):
            least = min(least, bank.error[m, a])
        counted = bank.errors[a] if least > 0 else 0.0
        for m in range(M):
            out[m, a] = TEMPER * bank.likelihood[m, a]
            if counted > 0:
                out[m, a] -= 0.5 * SHARPNESS * counted * (EVERY / AHEAD) * np.log(bank.error[m, a])
        if M > 1:
            out[0, a] += np.log((M - 1) * OWN_SHARE / (1 - OWN_SHARE))
        top, total = out[0, a], 0.0
        for m in range(M):
            top = max(top, out[m, a])
        for m in range(M):
            out[m, a] = np.exp(out[m, a] - top)
            total += out[m, a]
        for m in range(M):
            out[m, a] /= total


STRAIGHT = 1e-6
"""Damping below which the motion is treated as undamped [1/s]."""


@dataclass(frozen=True)
class StartState:
    """States at S starts, for K axes along the heading of the start, in A classes of equal wind damping.

    A state has six elements: the contributions of trims and start velocities to the position and velocity of the axis,
    its trim, and n, s, s' of the disturbance.

    Attributes:
        share: Weight of each class, shape (S, A, K).
        mean: Mean state of each class, shape (S, A, K, 6).
        covariance: Covariance of the state, shape (S, A, K, 6, 6).
        power: Power q of the wind in each class, shape (S, A, K).
        noise: Variance of one measurement, shape (S, K).
        rates: Damping alpha and overlap kappa of each class, shape (A, K, 2).
        damping: b, shape (K,) [1/s].
    """

    share: Array
    mean: Array
    covariance: Array
    power: Array
    noise: Array
    rates: Array
    damping: Array

    def variance(self, ahead: float) -> Array:
        """Predicted variance of position and velocity, shape (S, 2, K), given the law and its coefficients.

        Args:
            ahead: Time after the start [s].
        """
        A, K = self.share.shape[1:]
        ways, Q = np.empty((A, K, 2, 6)), np.empty((A, K, 3, 3))
        b = np.where(np.abs(self.damping) < STRAIGHT, STRAIGHT, self.damping)
        decay, reach = np.exp(-b * ahead), -np.expm1(-b * ahead) / b
        ways[..., :3] = np.stack([
            np.stack([np.ones(K), reach, (ahead - reach) / b], axis=-1),
            np.stack([np.zeros(K), decay, reach], axis=-1),
        ], axis=1)  # fmt: skip
        for g, k in np.ndindex(A, K):
            (alpha, kappa), F = self.rates[g, k], np.empty((3, 3))
            discretize(alpha, 0.25 * kappa * alpha**2, ahead, F, Q[g, k])
            ways[g, k, :, 3:] = F[:2]
        moved = np.einsum("gkij,sgkj->sgki", ways, self.mean)
        spread = np.einsum("gkij,sgkjl,gkil->sgki", ways, self.covariance, ways)
        spread += self.power[..., None] * np.einsum("gkii->gki", Q)[..., :2]
        mean = np.einsum("sgk,sgki->ski", self.share, moved)
        variance: Array = np.einsum("sgk,sgki->sik", self.share, spread + (moved - mean[:, None]) ** 2)
        return variance


def start_state_from_rows(rows: Array, levels: Array, damping: Array) -> StartState:
    """The states at S starts from the rows filled by `sum_bank`.

    Args:
        rows: Shape (S, `row_size(A)`).
        levels: Levels of the members, shape (A, G, 2, 4).
        damping: b, shape (2,) [1/s].
    """
    A = levels.shape[0]
    shapes = ((A, 2), (A, 2, 6), (A, 2, 6, 6), (A, 2), (2,))
    ends = np.cumsum([int(np.prod(shape)) for shape in shapes])[:-1]
    parts = zip(np.split(rows, ends, axis=1), shapes, strict=True)
    share, mean, covariance, power, noise = (part.reshape(len(rows), *shape) for part, shape in parts)
    return StartState(share, mean, covariance, power, noise, levels[:, 0, :, 2:], damping)


def row_size(A: int) -> int:
    """Length of a row: share, mean, covariance and power of A classes for two axes, and the noise."""
    return 2 * A * (1 + 6 + 36 + 1) + 2


class Sum(NamedTuple):
    """Combined estimate of the M members of a bank, and work space. Filled in place.

    Attributes:
        known: Trims and start velocities by the weights of each axis, shape (2, 4).
        add: Their contribution to the world position and velocity, shape (4,).
        parts: The disturbance, as contributions of the classes that sum up, shape (A, 1, 6).
        weight: Weights of the members for each axis, shape (M, 2).
        effect: Work space: effect of a unit trim or start velocity on the six elements of a state, shape (4, 6).
        half: Work space, shape (4, 6).
        means: Work space: mean states of the members, shape (M, 6).
    """

    known: Array
    add: Array
    parts: Array
    weight: Array
    effect: Array
    half: Array
    means: Array


def empty_sum(levels: Array) -> Sum:
    """An empty result for `sum_bank`, for members with levels (A, G, 2, 4)."""
    A, G = levels.shape[:2]
    work = np.zeros((4, 6)), np.zeros((4, 6)), np.zeros((A * G, 6))
    return Sum(np.zeros((2, 4)), np.zeros(4), np.zeros((A, 1, 6)), np.zeros((A * G, 2)), *work)


@inner()
def sum_bank(bank: Any, levels: Array, driven: Array, c: float, s: float, both: Any, rows: Array, row: int) -> None:
    """Combines the estimates of the members of a bank, each axis of the heading frame with its own weights.

    Args:
        bank: The bank.
        levels: Levels of its members, shape (A, G, 2, 4).
        driven: State of the motion, of two unit trims and of two unit start velocities; see `general_step.P`.
        c: Cosine of the heading.
        s: Its sine.
        both: A `Sum`, filled.
        rows: Zeros, shape (S, `row_size(A)`); one row is filled, for `start_state_from_rows`.
        row: Index of that row.
    """
    A, G = levels.shape[0], levels.shape[1]
    M = A * G
    known, add, z, weight, effect, half, means = both
    state, believed, spread, covariance = bank.state, bank.known, bank.spread, bank.covariance
    squares, freedom = bank.squares, bank.freedom
    fill_weights(bank, weight)
    # the row holds share, mean, covariance, power and noise, starting at these indices
    second, third, fourth, fifth = 2 * A, 14 * A, 86 * A, 88 * A
    for i in range(4):
        add[i] = 0.0
    for a in range(2):
        for j in range(4):
            known[a, j] = 0.0
            for i in range(2):
                at = (P if i == 0 else V) + 1 + j
                x, y = driven[at], driven[at + COLUMNS]
                effect[j, i] = c * x + s * y if a == 0 else c * y - s * x
            effect[j, 2] = 1.0 if j == a else 0.0
        for m in range(M):
            w, g = weight[m, a], m // G
            rows[row, 2 * g + a] += w
            for j in range(4):
                known[a, j] += w * believed[m, j]
            for i in range(6):
                if i < 3:
                    means[m, i] = 0.0
                    for j in range(4):
                        means[m, i] += believed[m, j] * effect[j, i]
                else:
                    means[m, i] = disturbance(state, believed, m, 3 * a + i - 3)
                rows[row, second + 12 * g + 6 * a + i] += w * means[m, i]
        for i in range(2):
            along = 0.0
            for g in range(A):
                along += rows[row, second + 12 * g + 6 * a + i]
            add[2 * i] += along * (c if a == 0 else -s)
            add[2 * i + 1] += along * (s if a == 0 else c)
        for g in range(A):
            share = max(rows[row, 2 * g + a], 1e-300)
            for i in range(6):
                at = second + 12 * g + 6 * a + i
                if i >= 3:
                    z[g, 0, 3 * a + i - 3] = rows[row, at]
                rows[row, at] /= share
        for m in range(M):
            w, g, scale = weight[m, a], m // G, squares[m, a] / freedom[m, a]
            part = w / max(rows[row, 2 * g + a], 1e-300)
            for j in range(4):
                for i in range(3):  # ... and on the disturbance
                    effect[j, 3 + i] = -state[m, 1 + j, 3 * a + i]
            mean = second + 12 * g + 6 * a
            for i in range(6):
                for j in range(4):
                    half[j, i] = 0.0
                    for n in range(4):
                        half[j, i] += spread[m, j, n] * effect[n, i]
            at = third + 72 * g + 36 * a
            for i in range(6):
                off = means[m, i] - rows[row, mean + i]
                for j in range(6):
                    total = 0.0
                    for n in range(4):
                        total += effect[n, i] * half[n, j]
                    if i >= 3 and j >= 3:
                        total += covariance[m, a, i - 3, j - 3]
                    rows[row, at + 6 * i + j] += part * (scale * total + off * (means[m, j] - rows[row, mean + j]))
            rows[row, fourth + 2 * g + a] += part * scale * levels[g, m % G, a, 0]
            rows[row, fifth + a] += w * scale * levels[g, m % G, a, 1]
