"""A bank of disturbance filters that learns the levels of the flight that it filters, causally.

The levels of a calm flight mislead in a gusty one: the filter follows the gusts too slowly. So filters with other
levels, the members, run beside the one with the model's own, and what they say is averaged, axis by axis, by weights
from the past alone:

    log w = log w_0 + eta log L - n / 2 log E

E is the mean square of the errors that a member made 0.5 s ahead, over n such stretches; L is the likelihood of its
innovations; the past is forgotten with `MEMORY`. E is the judge: what counts is the prediction, and a law that is a
little wrong, or pose noise that is not white, make the likelihood of one step prefer levels that predict worse. The
likelihood counts little (eta), but knows at once where the levels are far off, and where an error is one false pose.

A member knows its levels up to one scale sigma^2 an axis, which it learns from its innovations. It serves the
likelihood and the predicted error, not the prediction. `start_bank`, then for each stamp `move`, `judge`, `take` and
`probe`: a state that only ever goes forwards.

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
"""Factors on the damping of the wind; the power goes with their square, as it does over recorded flights."""

MEMORY = 20.0
"""Time after which the past counts 1/e [s]."""

OWN_SHARE = 0.5
"""Prior weight of the model's own levels."""

AHEAD = 0.5
"""How far ahead members are judged [s]; further ahead errors are too few to learn from in a minute."""

EVERY = 0.1
"""Time between the predictions that are judged [s]."""

PENDING = 8
"""Predictions that wait for their judgement at the most."""

SHARPNESS = 2.0
"""Independent errors that a stretch of `AHEAD` counts for: members err alike, so that their differences are surer."""

TEMPER = 0.02
"""eta."""

SCALE_FREEDOM = 30.0
"""Innovations that the scale of the model's own levels counts for."""


class Bank(NamedTuple):
    """M members before the next stamp; arrays are changed in place.

    Attributes:
        covariance: Of the disturbance, at the member's levels, shape (M, 3, 3, 3).
        state: Of the data less the driven response, of two unit trims, of two unit start velocities, shape (M, 5, 6).
        known: Trims (heading frame) and start velocities (world), as far as the data tell, shape (M, 4).
        spread: Their covariance, at the member's levels, shape (M, 4, 4).
        squares: Sum of squares behind the scale of each axis, shape (M, 2).
        freedom: How many they are, shape (M, 2).
        likelihood: Logarithm of L, of each axis, shape (M, 2).
        error: Sum of the squared errors behind E, shape (M, 2).
        errors: How many they are, shape (2,).
        waiting: Disturbance as predicted for now by what waits for its judgement, shape (PENDING, M, 6).
        believed: `known` when it was predicted, shape (PENDING, M, 4).
        due: When it is judged, shape (PENDING,) [s].
        judged: Whether it has been, on each axis, shape (PENDING, 2).
        probed: When something was last predicted, shape (1,) [s].
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
    """Levels of the members, class by class of equal wind damping, the model's own first.

    Args:
        levels: q, r, alpha, kappa of two axes, shape (2, 4).
        adapt: False for the model's own only.

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
    """A bank before the first stamp. Made by Python, as all arrays here: in a kernel each takes its time to compile.

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
    """Transitions and unit covariances of every class, axis and distinct step: twice (A, 2, U, 3, 3)."""
    A = levels.shape[0]
    F, Q = np.zeros((2, A, 2, steps.size, 3, 3))
    for g, a in np.ndindex(A, 2):
        fill_step_tables(steps, levels[g, 0, a, 2], levels[g, 0, a, 3], F[g, a], Q[g, a])
    return F, Q


@inner()
def fade(z: Array, row: int, column: int, F: Array, g: int, k: int, c: float, s: float) -> None:
    """Moves the disturbance z[row, column] (6,) of class g by step k of F; c and s belong to half the turn."""
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
    """Moves a bank by one step, number k of the tables, of dt [s] while the heading turns by `turn` [rad]."""
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
    """Compares what was predicted for now, t [s], with what `take` will take; see there."""
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
    """Takes a measurement of one axis into all members.

    Args:
        bank: Changed in place.
        levels: Shape (A, G, 2, 4).
        axis: 0 or 1.
        rate: Whether a velocity was measured, else a position.
        measured: Along the axis: data less the driven response, then the response to two unit trims and two unit start
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
        # Student's t with n degrees of freedom; what its normalisation lacks of a Gaussian's is the same for all.
        likelihood[m, axis] -= 0.5 * np.log(variance * scale) + 0.5 * (n + 1) * np.log1p(square / (n * scale))
        squares[m, axis] += square
        freedom[m, axis] += 1.0


@inner()
def probe(bank: Any, t: float) -> None:
    """Sets down what every member predicts, so that it is judged `AHEAD`; not where there is only one."""
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
    """Number i of the disturbance of one member, less what it takes for trims and start velocities."""
    z = state[m, 0, i]
    for j in range(4):
        z -= known[m, j] * state[m, 1 + j, i]
    return z  # type: ignore[no-any-return]


def weights(bank: Bank) -> Array:
    """Weights of the members, of each axis, shape (M, 2)."""
    out: Array = np.empty((len(bank.known), 2))
    fill_weights(bank, out)
    return out


@kernel()
def fill_weights(bank: Any, out: Array) -> None:
    """Fills them, (M, 2)."""
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
"""Damping below which the motion is taken as undamped [1/s]."""


@dataclass(frozen=True)
class StartState:
    """At S starts, about K axes, each along itself as the heading then is, in A classes of equal wind damping.

    A state has six numbers: what trims and start velocities add to the position and to the velocity of the axis, its
    trim, and n, s, s' of the disturbance.

    Attributes:
        share: Weight of each class, shape (S, A, K).
        mean: Its mean state, shape (S, A, K, 6).
        covariance: Its covariance, shape (S, A, K, 6, 6).
        power: Its power of the wind q, shape (S, A, K).
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
        """Predicted variance of position and velocity, shape (S, 2, K), as if the law and its coefficients were known.

        Args:
            ahead: How long after the start [s].
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
    """The states at S starts.

    Args:
        rows: Of `sum_bank`, shape (S, `row_size(A)`).
        levels: Of the members, shape (A, G, 2, 4).
        damping: b, shape (2,) [1/s].
    """
    A = levels.shape[0]
    shapes = ((A, 2), (A, 2, 6), (A, 2, 6, 6), (A, 2), (2,))
    ends = np.cumsum([int(np.prod(shape)) for shape in shapes])[:-1]
    parts = zip(np.split(rows, ends, axis=1), shapes, strict=True)
    share, mean, covariance, power, noise = (part.reshape(len(rows), *shape) for part, shape in parts)
    return StartState(share, mean, covariance, power, noise, levels[:, 0, :, 2:], damping)


def row_size(A: int) -> int:
    """Numbers of a row: share, mean, covariance and power of A classes, and the noise."""
    return 2 * A * (1 + 6 + 36 + 1) + 2


class Sum(NamedTuple):
    """What the M members of a bank know together, and work space. Filled in place.

    Attributes:
        known: Trims and start velocities as each axis has them, shape (2, 4).
        add: What they add to the world position and velocity, shape (4,).
        parts: The disturbance, in shares of the classes that add up, shape (A, 1, 6).
        weight: Of the members, of each axis, shape (M, 2).
        effect: Work space: of a unit trim or start velocity on the six numbers of a state, shape (4, 6).
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
    """Where `sum_bank` puts its result, for members with levels (A, G, 2, 4)."""
    A, G = levels.shape[:2]
    work = np.zeros((4, 6)), np.zeros((4, 6)), np.zeros((A * G, 6))
    return Sum(np.zeros((2, 4)), np.zeros(4), np.zeros((A, 1, 6)), np.zeros((A * G, 2)), *work)


@inner()
def sum_bank(bank: Any, levels: Array, driven: Array, c: float, s: float, both: Any, rows: Array, row: int) -> None:
    """What the members of a bank know together, each axis of the heading frame by its own weights.

    Args:
        bank: The bank.
        levels: Of its members, shape (A, G, 2, 4).
        driven: State of the motion, of two unit trims and of two unit start velocities; see `general_step.P`.
        c: Cosine of the heading.
        s: Its sine.
        both: A `Sum`, filled.
        rows: For `start_state_from_rows`, zeros, shape (S, `row_size(A)`); one of them is filled.
        row: Which.
    """
    A, G = levels.shape[0], levels.shape[1]
    M = A * G
    known, add, z, weight, effect, half, means = both
    state, believed, spread, covariance = bank.state, bank.known, bank.spread, bank.covariance
    squares, freedom = bank.squares, bank.freedom
    fill_weights(bank, weight)
    # the row holds share, mean, covariance, power and noise, from these places on
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
