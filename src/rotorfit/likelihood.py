"""The grey-box likelihood: commands -> exact response -> residual -> whitening filter, with gradients and information.

Source: the Kalman likelihood of the model (5) with delay, trim and a slow disturbance; the mean and all its
sensitivities pass through the gains of one filter, so the gradient costs one pass. Coefficients enter as
(g, log b, tau), so the damping is positive by construction.
"""

import functools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from rotorfit.disturbance import whiten_axis, whiten_plane
from rotorfit.frames import Array, Mask
from rotorfit.record import DELAY_RANGE, Record
from rotorfit.response import axis_response, plane_response

DAMPING_RANGE = (1e-3, 100.0)
"""Damping that is searched [1/s]."""

LEVEL_RANGE = np.log(np.array([[1e-10, 1e4], [1e-13, 1e-2], [1e-3, 60.0], [1e-3, 100.0]]))
"""Logarithmic bounds of the disturbance levels q, r, mu, lambda."""

START_LEVELS = np.log(np.array([0.1, 1e-7, 0.5, 2.0]))
"""Where the levels start."""


@dataclass(frozen=True)
class Point:
    """A point of the parameter space of K axes and F flights.

    Attributes:
        gain: g, shape (K,).
        log_damping: log b, shape (K,).
        delay: tau, shape (K,) [s].
        trim: c in the heading frame, shape (F, K).
        levels: log of q, r, mu, lambda, shape (K, 4).
    """

    gain: Array
    log_damping: Array
    delay: Array
    trim: Array
    levels: Array

    def flat(self) -> Array:
        """g of all axes, log b, tau, trims, levels: shape (3 K + F K + 4 K,)."""
        return np.concatenate([self.gain, self.log_damping, self.delay, self.trim.ravel(), self.levels.ravel()])

    def bounds(self) -> tuple[Array, Array]:
        """Lower and upper ends of the searched ranges, in the order of `flat`."""
        return _bounds(self.gain.size, len(self.trim))

    def moved(self, step: Array) -> "Point":
        """The point plus a step in the order of `flat`, kept inside the searched ranges."""
        return self.with_flat(np.clip(self.flat() + step, *self.bounds()))

    def reach(self, step: Array) -> float:
        """Largest share, at most 1, of a step that stays inside the searched ranges."""
        value, (low, high) = self.flat(), self.bounds()
        room = np.where(step > 0, high - value, value - low)
        with np.errstate(divide="ignore", invalid="ignore"):
            share = np.where((step != 0) & (room > 0), room / np.abs(step), np.inf)
        return float(min(1.0, share.min()))

    def with_flat(self, values: Array) -> "Point":
        """The point with all parameters replaced, in the order of `flat`."""
        K = self.gain.size
        gain, log_damping, delay, trim, levels = np.split(values, [K, 2 * K, 3 * K, values.size - 4 * K])
        return Point(gain, log_damping, delay, trim.reshape(self.trim.shape), levels.reshape(K, 4))


@functools.cache
def _bounds(K: int, F: int) -> tuple[Array, Array]:
    """Bounds of a point of K axes and F flights."""
    low, high = (
        np.concatenate(
            [
                np.full(K, sign * np.inf),
                np.full(K, np.log(DAMPING_RANGE)[end]),
                np.full(K, DELAY_RANGE[end]),
                np.full(F * K, sign * np.inf),
                np.tile(LEVEL_RANGE[:, end], K),
            ]
        )
        for end, sign in ((0, -1.0), (1, 1.0))
    )
    return low, high


def response(rec: Record, point: Point, flight: int) -> tuple[Array, Array]:
    """Position of the blocks as the commands explain it, and its sensitivities.

    Returns:
        World position (B, K), and d/d(g, log b, tau, c) in the order g, log b, tau, c with K columns each, (B, 4 K, K).
    """
    common = (rec.starts, rec.pose_range, rec.command_range, rec.pose_time, rec.block, rec.command_time)
    weight = 1.0 / rec.count
    damping, trim, K = np.exp(point.log_damping), point.trim[flight], len(rec.axes)
    if K == 1:
        out = axis_response(*common, rec.command[:, 0], weight, point.gain[0], trim[0], damping[0], point.delay[0])
        mean = point.gain[0] * out[:, 0] + trim[0] * out[:, 1]
    else:
        out = plane_response(*common, rec.command, weight, rec.yaw, point.gain, trim, damping, point.delay)
        mean = np.einsum("j,bjk->bk", np.concatenate([point.gain, trim]), out[:, :4])
    gain, trim_columns, damping_columns, delay_columns = np.split(out, 4, axis=1)
    damping_columns = damping_columns * damping[None, :, None]
    return mean, np.concatenate([gain, damping_columns, delay_columns, trim_columns], axis=1)


def whiten(rec: Record, columns: Array, levels: Array) -> tuple[Array, Array]:
    """Passes columns (B, C, K) through the filter: rows (B, C, K), x, y in the heading frame, log variances (B, K)."""
    values = np.exp(levels)
    if len(rec.axes) == 2:
        return whiten_plane(rec.steps, rec.step, rec.count, rec.fresh, rec.block_yaw, columns, values)  # type: ignore[no-any-return]
    rows, log_variance = whiten_axis(rec.steps, rec.step, rec.count, rec.fresh, columns[:, :, 0], values[0])
    return rows[:, :, None], log_variance[:, None]


@dataclass(frozen=True)
class Score:
    """The likelihood at a point, over (g, log b, tau, trims, levels); n = 3 K + F K of them before the levels.

    Attributes:
        log_likelihood: Of all flights together.
        adjustment: What restricted likelihood adds: less half the log determinant of the coefficients' information.
        gradient: Shape (n + 4 K,); the levels' part is that of both together.
        information: Expected; block diagonal between the coefficients with the trims and the levels.
        slopes: Derivative of the coefficients' information by each level, shape (4 K, n, n).
        innovations: Per flight, standardised, heading frame, shape (B, K).
    """

    log_likelihood: float
    adjustment: float
    gradient: Array
    information: Array
    slopes: Array
    innovations: tuple[Array, ...]

    @property
    def objective(self) -> float:
        """What is maximised."""
        return self.log_likelihood + self.adjustment


LEVEL_STEP = 1e-6
"""Step of the differences by the logarithm of a level."""


def score(records: Sequence[Record], point: Point, adjusted: Mask | None = None) -> Score:
    """Log-likelihood with gradient and information in one pass over the flights.

    The levels are those of the restricted likelihood: the coefficients that are fitted take up part of the disturbance,
    and plain likelihood would take what is left for all of it. The coefficients' own gradient is that of the plain one.

    Args:
        records: The flights.
        point: Where.
        adjusted: Coefficients and trims that are being fitted, shape (n,); None leaves out everything about the levels.

    Source: H. D. Patterson, R. Thompson, Biometrika 58 (1971), pp. 545-554; D. R. Cox, N. Reid, J. R. Statist. Soc.
    B 49 (1987), pp. 1-39.
    """
    K, n = point.gain.size, 3 * point.gain.size + point.trim.size
    information, gradient, slopes = np.zeros((n + 4 * K, n + 4 * K)), np.zeros(n + 4 * K), np.zeros((4 * K, n, n))
    log_likelihood, innovations = 0.0, []
    for j, rec in enumerate(records):
        mean, sensitivity = response(rec, point, j)
        columns = np.concatenate([(rec.position - mean)[:, None, :], sensitivity], axis=1)
        e, J, log_variance = _rows(rec, columns, point.levels)
        where = np.r_[: 3 * K, 3 * K + j * K : 3 * K + (j + 1) * K]
        square = J @ J.T
        information[np.ix_(where, where)] += square
        gradient[where] += J @ e
        log_likelihood -= 0.5 * float(e @ e + log_variance.sum() + e.size * np.log(2 * np.pi))
        innovations.append(e.reshape(-1, K))
        if adjusted is None:
            continue
        d_innovation, d_log_variance = np.empty((4 * K, e.size)), np.empty((4 * K, e.size))
        for i in range(4 * K):
            levels = point.levels.copy()
            levels.ravel()[i] += LEVEL_STEP
            e1, J1, log_variance1 = _rows(rec, columns, levels)
            d_innovation[i], d_log_variance[i] = e1 - e, log_variance1 - log_variance
            slopes[i][np.ix_(where, where)] += (J1 @ J1.T - square) / LEVEL_STEP
        d_innovation /= LEVEL_STEP
        d_log_variance /= LEVEL_STEP
        raw = d_innovation + 0.5 * e * d_log_variance
        information[n:, n:] += raw @ raw.T + 0.5 * d_log_variance @ d_log_variance.T
        gradient[n:] -= d_innovation @ e + 0.5 * d_log_variance.sum(axis=1)
    adjustment = 0.0
    if adjusted is not None:
        covariance = inverted(information[:n, :n], adjusted)
        gradient[n:] -= 0.5 * np.einsum("ij,kij->k", covariance, slopes)
        adjustment = _adjustment(information[:n, :n], point, adjusted)
    return Score(log_likelihood, adjustment, gradient, information, slopes, tuple(innovations))


def _rows(rec: Record, columns: Array, levels: Array) -> tuple[Array, Array, Array]:
    """Innovations (B K,), whitened sensitivities (4 K, B K) and log variances (B K,)."""
    rows, log_variance = whiten(rec, columns, levels)
    flat = np.ascontiguousarray(rows.transpose(1, 0, 2)).reshape(columns.shape[1], -1)
    return flat[0], flat[1:], log_variance.ravel()


def _adjustment(information: Array, point: Point, adjusted: Mask) -> float:
    """Less half the log determinant, per unit of the gain so that it does not reward small gains."""
    K, index = point.gain.size, np.flatnonzero(adjusted)
    scale = np.ones(len(information))
    scale[K : 3 * K] = 1 / np.tile(np.maximum(np.abs(point.gain), 1e-9), 2)
    block = information[np.ix_(index, index)] * np.outer(scale[index], scale[index])
    size = np.sqrt(np.maximum(np.diag(block), 1e-300))
    return float(
        -0.5 * np.linalg.slogdet(block / np.outer(size, size) + 1e-10 * np.eye(index.size))[1] - np.log(size).sum()
    )


def degrees_of_freedom(score_: Score, free: Mask, direction: Array) -> float:
    """How many the levels leave for the variance of a combination of coefficients.

    Args:
        score_: With the levels' part.
        free: True for the parameters that were fitted, shape (n + 4 K,).
        direction: Of the combination, shape (n,).

    Source: F. E. Satterthwaite, Biometrics Bulletin 2 (1946), pp. 110-114, as used for restricted likelihood by
    M. G. Kenward and J. H. Roger, Biometrics 53 (1997), pp. 983-997.
    """
    n = direction.size
    along = inverted(score_.information[:n, :n], free[:n]) @ direction
    slope = -np.einsum("i,kij,j->k", along, score_.slopes, along) / float(direction @ along)
    spread = float(slope @ inverted(score_.information[n:, n:], free[n:]) @ slope)
    return max(2.0 / max(spread, 1e-9), 3.0)


def inverted(information: Array, active: Mask) -> Array:
    """Inverse of the information over the active parameters, zero elsewhere."""
    out = np.zeros_like(information)
    index = np.flatnonzero(active)
    block = information[np.ix_(index, index)]
    scale = 1 / np.sqrt(np.maximum(np.diag(block), 1e-12))
    inverse = np.linalg.inv(block * np.outer(scale, scale) + 1e-10 * np.eye(index.size))
    out[np.ix_(index, index)] = inverse * np.outer(scale, scale)
    return out
