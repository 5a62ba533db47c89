"""The grey-box likelihood: commands -> exact response -> residual -> whitening filter, with gradients and information.

Source: the Kalman likelihood of the model (5) with delay, trim and a slow disturbance; the mean and all its
sensitivities pass through the gains of one filter, so the gradient costs one pass. Coefficients enter as
(g, log b, tau), so the damping is positive by construction.
"""

import functools
from collections.abc import Sequence
from dataclasses import dataclass, replace
import numpy as np

from rotorfit.disturbance import distinct_steps, whiten_axis, whiten_plane
from rotorfit.flight import Flight
from rotorfit.frames import AXES, Array, Indices, Mask, heading_from_world
from rotorfit.response import axis_response, plane_response

DELAY_RANGE = (-0.1, 0.6)
"""Delays that are searched [s]. Below zero, because a bound at zero biases; a negative optimum is a finding."""

DAMPING_RANGE = (1e-3, 100.0)
"""Damping that is searched [1/s]."""

LEVEL_RANGE = np.log(np.array([[1e-10, 1e4], [1e-13, 1e-2], [1e-3, 60.0], [1e-3, 100.0]]))
"""Logarithmic bounds of the disturbance levels q, r, mu, lambda."""

START_LEVELS = np.log(np.array([0.1, 1e-7, 0.5, 2.0]))

SECANT_BELOW = 20.0
"""Expected gain in log-likelihood below which the secant correction is kept from pass to pass."""

BLOCK_RATE = 30.0
"""Poses are averaged over blocks to this rate [1/s], with their modelled response alike. At the full rate of a mocap
system the likelihood of real flights can prefer a false delay of a few milliseconds."""

HELD_HEADING = np.radians(10.0)
"""Up to this deviation from its mean the heading counts as held in the filter (never in the response)."""


@dataclass(frozen=True)
class Record:
    """One flight, one axis or the pair x, y, in blocks. M commands, N poses, B blocks, K axes (1 or 2), S segments.

    Attributes:
        axes: Names of the K axes.
        starts: Where scoring starts in each segment, shape (S,) [s]: late enough for every delay in the range.
        pose_range: First and one past the last pose of each segment, shape (S, 2).
        command_range: The same for the commands, shape (S, 2).
        pose_time: Shape (N,) [s].
        yaw: Heading at the poses, shape (N,) [rad].
        block: Block of each pose, shape (N,).
        count: Poses of each block, shape (B,).
        block_time: Mean stamp of each block, shape (B,) [s].
        steps: Distinct steps between the blocks, shape (U,) [s].
        step: Which of them leads to each block, shape (B,).
        block_yaw: Mean heading of each block, shape (B,) [rad].
        position: Mean pose of each block less the first of its segment, world, shape (B, K) [m or rad].
        fresh: True for the first block of a segment, shape (B,).
        command_time: Shape (M,) [s].
        command: Shape (M, K).
        held: Whether the filter may take the heading as constant.
        heading: Mean heading [rad].
    """

    axes: tuple[str, ...]
    starts: Array
    pose_range: Indices
    command_range: Indices
    pose_time: Array
    yaw: Array
    block: Indices
    count: Array
    block_time: Array
    steps: Array
    step: Indices
    block_yaw: Array
    position: Array
    fresh: Mask
    command_time: Array
    command: Array
    held: bool
    heading: float

    def only(self, k: int) -> "Record":
        """The record with one axis of its commands; what it measured is left as it is."""
        return replace(self, axes=self.axes[k : k + 1], command=np.ascontiguousarray(self.command[:, k : k + 1]))


def record(flight: Flight, axes: Sequence[str]) -> Record | None:
    """Cuts a flight into what the likelihood of these axes needs; None where no segment is long enough.

    x or y alone is the position along the mean heading: right where the heading is held, else take both.
    """
    column = [AXES.index(axis) for axis in axes]
    pose = np.column_stack([flight.position, flight.yaw])
    heading = float(np.mean(flight.yaw))
    if len(axes) == 1 and axes[0] in ("x", "y"):
        pose[:, :2] = heading_from_world(pose[:, :2], np.full(len(pose), heading))
    pose = pose[:, column]
    t, command_time = flight.pose_time, flight.command_time
    starts, pose_range, command_range, times, index = [], [], [], [], []
    block_count = n = 0
    for segment in flight.segments:
        first, last = np.searchsorted(t, [segment.start + DELAY_RANGE[1], segment.end + DELAY_RANGE[0]])
        if last - first < 4:
            continue
        bins = np.floor((t[first:last] - t[first]) * BLOCK_RATE + 1e-6).astype(np.int64)
        _, bins = np.unique(bins, return_inverse=True)
        starts.append(segment.start + DELAY_RANGE[1])
        pose_range.append((n, n + last - first))
        command_range.append(np.searchsorted(command_time, [segment.start, segment.end]))
        times.append(bins + block_count)
        index.append(np.arange(first, last))
        n += last - first
        block_count += bins[-1] + 1
    if not starts:
        return None
    keep, block = np.concatenate(index), np.concatenate(times)
    count = np.bincount(block).astype(float)
    fresh = np.zeros(block_count, bool)
    fresh[block[[i for i, _ in pose_range]]] = True
    mean = np.column_stack([np.bincount(block, q) / count for q in pose[keep].T])
    mean -= mean[np.flatnonzero(fresh)][np.cumsum(fresh) - 1]
    yaw = flight.yaw[keep]
    block_yaw = np.bincount(block, yaw) / count
    block_time = np.bincount(block, t[keep]) / count
    steps, step = distinct_steps(block_time)
    return Record(
        axes=tuple(axes),
        starts=np.array(starts),
        pose_range=np.array(pose_range),
        command_range=np.array(command_range),
        pose_time=t[keep],
        yaw=yaw,
        block=block,
        count=count,
        block_time=block_time,
        steps=steps,
        step=step,
        block_yaw=block_yaw,
        position=mean,
        fresh=fresh,
        command_time=command_time,
        command=np.ascontiguousarray(flight.command[:, column]),
        held="x" not in axes and "y" not in axes or bool(np.ptp(block_yaw) < 2 * HELD_HEADING),
        heading=heading,
    )


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
        out = axis_response(
            *common, rec.command[:, 0], weight, point.gain[0], trim[0], damping[0], point.delay[0]
        )
        mean = point.gain[0] * out[:, 0] + trim[0] * out[:, 1]
    else:
        out = plane_response(*common, rec.command, weight, rec.yaw, point.gain, trim, damping, point.delay)
        mean = np.einsum("j,bjk->bk", np.concatenate([point.gain, trim]), out[:, :4])
    gain, trim_columns, damping_columns, delay_columns = np.split(out, 4, axis=1)
    damping_columns = damping_columns * damping[None, :, None]
    return mean, np.concatenate([gain, damping_columns, delay_columns, trim_columns], axis=1)


def whiten(rec: Record, columns: Array, levels: Array) -> tuple[Array, Array]:
    """Passes columns (B, C, K) through the filter: rows (B, C, K), x and y in the heading frame, log variances (B, K)."""
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

    Source: H. D. Patterson, R. Thompson, Biometrika 58 (1971), pp. 545-554; D. R. Cox, N. Reid, J. R. Statist. Soc. B 49
    (1987), pp. 1-39.
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
    """Less half the log determinant, of sensitivities taken per unit of the gain so that it does not reward small gains."""
    K, index = point.gain.size, np.flatnonzero(adjusted)
    scale = np.ones(len(information))
    scale[K : 3 * K] = 1 / np.tile(np.maximum(np.abs(point.gain), 1e-9), 2)
    block = information[np.ix_(index, index)] * np.outer(scale[index], scale[index])
    size = np.sqrt(np.maximum(np.diag(block), 1e-300))
    return float(-0.5 * np.linalg.slogdet(block / np.outer(size, size) + 1e-10 * np.eye(index.size))[1] - np.log(size).sum())


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


@dataclass(frozen=True)
class Optimum:
    """A maximum of the likelihood over the parameters that were free.

    Attributes:
        point: Where.
        score: What it is worth.
        free: True for the parameters that could move, shape (3 K + F K + 4 K,).
        adjusted: Coefficients and trims that the levels account for, shape (3 K + F K,); None where levels were held.
        inverse: Inverse information with the secant corrections of the climb; zero for what could not move.
        gain: Expected gain in log-likelihood of one more step: how far from the top.
        passes: Passes over the flights that it took.
    """

    point: Point
    score: Score
    free: Mask
    adjusted: Mask | None
    inverse: Array
    gain: float
    passes: int


def maximise(
    records: Sequence[Record],
    point: Point,
    free: Mask,
    inverse: Array | None = None,
    adjusted: Mask | None = None,
    tolerance: float = 1e-3,
    most: int = 80,
) -> Optimum:
    """Maximises the likelihood: Fisher scoring, with a secant (BFGS) correction of the information near the top.

    Args:
        records: The flights.
        point: Where to start.
        free: True for the parameters that may move, shape (3 K + F K + 4 K,).
        inverse: Inverse information to start with, where one is known.
        adjusted: Coefficients and trims that the levels account for; those that are free by default.
        tolerance: Expected gain in log-likelihood below which to stop.
        most: Largest number of passes.
    """
    if adjusted is None and free[-1]:
        adjusted = free[: 3 * point.gain.size + point.trim.size]
    best = score(records, point, adjusted)
    passes, active, fresh = 1, free & ~pressed(point, best.gradient), inverse is None
    while True:
        movable = free & ~pressed(point, best.gradient)
        if inverse is None or fresh or not np.array_equal(movable, active):
            inverse, active, fresh = inverted(best.information, movable), movable, True
        step = inverse @ best.gradient
        stuck = pressed(point, step) & active
        if stuck.any():  # at a bound, pushed outwards not by the gradient but by the others
            active = active & ~stuck
            inverse, fresh = inverted(best.information, active), True
            step = inverse @ best.gradient
        gain = 0.5 * float(step @ best.gradient)
        if gain < tolerance or passes >= most:
            break
        step = limited(step, point.gain.size)
        step = point.reach(step) * step
        trial, result, tried = _line_search(records, point, best, step, adjusted)
        passes += tried
        if result.objective <= best.objective:
            if fresh:
                break
            fresh = True
            continue
        fall = np.where(active, best.gradient - result.gradient, 0.0)
        fresh = gain > SECANT_BELOW or passes < 3
        inverse = _secant(inverse, trial.flat() - point.flat(), fall)
        point, best = trial, result
    return Optimum(point, best, free, adjusted, inverse, gain, passes)


def _line_search(
    records: Sequence[Record], point: Point, here: Score, step: Array, adjusted: Mask | None
) -> tuple[Point, Score, int]:
    """Shortens a step until the objective rises; gives up after eight."""
    for tried in range(1, 9):
        trial = point.moved(step)
        result = score(records, trial, adjusted)
        if result.objective > here.objective:
            break
        step = 0.3 * step
    return trial, result, tried


def inverted(information: Array, active: Mask) -> Array:
    """Inverse of the information over the active parameters, zero elsewhere."""
    out = np.zeros_like(information)
    index = np.flatnonzero(active)
    block = information[np.ix_(index, index)]
    scale = 1 / np.sqrt(np.maximum(np.diag(block), 1e-12))
    inverse = np.linalg.inv(block * np.outer(scale, scale) + 1e-10 * np.eye(index.size))
    out[np.ix_(index, index)] = inverse * np.outer(scale, scale)
    return out


def _secant(inverse: Array, step: Array, change: Array) -> Array:
    """BFGS update of an inverse information by a step and the fall of the gradient along it."""
    curvature = float(step @ change)
    if curvature <= 1e-12:
        return inverse
    left = np.eye(step.size) - np.outer(step, change) / curvature
    return left @ inverse @ left.T + np.outer(step, step) / curvature


def pressed(point: Point, gradient: Array) -> Mask:
    """True where a parameter stands at a bound of its range and the gradient pushes it outwards."""
    value, (low, high) = point.flat(), point.bounds()
    return ((value <= low) & (gradient < 0)) | ((value >= high) & (gradient > 0))


def limited(step: Array, K: int) -> Array:
    """Shortens a step that would move log b by more than 1.5, the delay by more than 0.08 s or a level by more than e^2."""
    longest = max(np.abs(step[K : 2 * K]).max() / 1.5, np.abs(step[2 * K : 3 * K]).max() / 0.08, np.abs(step[-4 * K :]).max() / 2)
    return step / max(longest, 1.0)
