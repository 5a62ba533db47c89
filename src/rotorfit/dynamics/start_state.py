"""The state from which a prediction starts: the estimates of the members of a bank, combined.

Each axis of the heading frame has weights of its own. Members of equal wind damping form a class, whose states fade
alike, so the mixture of a class is one mean and one covariance.
"""

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from rotorfit.core.compiled import inner
from rotorfit.core.frames import Array
from rotorfit.dynamics.disturbance import discretize
from rotorfit.dynamics.filter_bank import AXIS, KNOWN, ROWS, SPREAD, SQUARES, UPPER, disturbance, fill_weights
from rotorfit.dynamics.general_step import COLUMNS, P, V

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
        weight: Weights of the members for each axis, shape (M, 2).
        effect: Work space: effect of a unit trim or start velocity on the six elements of a state, shape (4, 6).
        half: Work space, shape (4, 6).
        means: Work space: mean states of the members, shape (M, 6).
    """

    known: Array
    add: Array
    weight: Array
    effect: Array
    half: Array
    means: Array


def empty_sum(levels: Array) -> Sum:
    """An empty result for `sum_bank`, for members with levels (A, G, 2, 4)."""
    A, G = levels.shape[:2]
    work = np.zeros((4, 6)), np.zeros((4, 6)), np.zeros((A * G, 6))
    return Sum(np.zeros((2, 4)), np.zeros(4), np.zeros((A * G, 2)), *work)


@inner()
def sum_bank(
    bank: Any, levels: Array, driven: Array, c: float, s: float, both: Any, parts: Array, rows: Array, row: int
) -> None:
    """Combines the estimates of the members of a bank, each axis of the heading frame with its own weights.

    Args:
        bank: The bank.
        levels: Levels of its members, shape (A, G, 2, 4).
        driven: State of the motion, of two unit trims and of two unit start velocities; see `general_step.P`.
        c: Cosine of the heading.
        s: Its sine.
        both: A `Sum`, filled.
        parts: The disturbance, as contributions of the classes that sum up, shape (S, A, 6); one row is filled.
        rows: Zeros, shape (S, `row_size(A)`); one row is filled, for `start_state_from_rows`.
        row: Index of those rows.
    """
    A, G = levels.shape[0], levels.shape[1]
    M = A * G
    known, add, weight, effect, half, means = both
    slots, wind = bank.slots, bank.wind
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
                known[a, j] += w * slots[KNOWN + j, m]
            for i in range(6):
                if i < 3:
                    means[m, i] = 0.0
                    for j in range(4):
                        means[m, i] += slots[KNOWN + j, m] * effect[j, i]
                else:
                    means[m, i] = disturbance(bank, m, 3 * a + i - 3)
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
                    parts[row, g, 3 * a + i - 3] = rows[row, at]
                rows[row, at] /= share
        for m in range(M):
            w, g, scale = weight[m, a], m // G, slots[AXIS * a + SQUARES, m] / bank.freedom[a]
            part = w / max(rows[row, 2 * g + a], 1e-300)
            for j in range(4):
                for i in range(3):  # ... and on the disturbance
                    effect[j, 3 + i] = -wind[1 + j, 3 * a + i, m]
            mean = second + 12 * g + 6 * a
            for i in range(6):
                for j in range(4):
                    half[j, i] = 0.0
                    for n in range(4):
                        half[j, i] += slots[SPREAD + UPPER[j, n], m] * effect[n, i]
            at = third + 72 * g + 36 * a
            for i in range(6):
                off = means[m, i] - rows[row, mean + i]
                for j in range(6):
                    total = 0.0
                    for n in range(4):
                        total += effect[n, i] * half[n, j]
                    if i >= 3 and j >= 3:
                        total += slots[ROWS[3 * a + i - 3, 3 * a + j - 3], m]
                    rows[row, at + 6 * i + j] += part * (scale * total + off * (means[m, j] - rows[row, mean + j]))
            rows[row, fourth + 2 * g + a] += part * scale * levels[g, m % G, a, 0]
            rows[row, fifth + a] += w * scale * levels[g, m % G, a, 1]
