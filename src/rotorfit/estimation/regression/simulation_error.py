"""The output-space criterion: errors of simulated positions in windows of a few seconds.

The delay must not be chosen by the fit of the acceleration: in a feedback loop that gives a long delay with the signs
of both gain and damping reversed. The criterion is the position that results from the commands alone.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from rotorfit.core.flight_data import Flight
from rotorfit.core.frames import Array, Mask
from rotorfit.dynamics.horizontal_response import plane_response
from rotorfit.dynamics.response import axis_response
from rotorfit.estimation.likelihood.blocks import Record, record

WINDOW = 2.0
"""Length of a simulation [s]. With 5 s, in simulated flights, drift in the wind doubles the scatter of the delay."""

MOST_UNSTABLE = -1.0
"""Damping at and below which nothing is simulated [1/s]: no vehicle that diverges so fast flies for long."""


@dataclass(frozen=True)
class Coefficients:
    """Coefficients of the K axes of one flight: g, b [1/s], tau [s], c, each of shape (K,); b may have any sign."""

    gain: Array
    damping: Array
    delay: Array
    trim: Array


def windowed(flight: Flight, axes: Sequence[str]) -> Record | None:
    """The flight in blocks, with windows of `WINDOW` in place of its segments; None where it is too short."""
    rec = record(flight, axes)
    if rec is None:
        return None
    fresh = rec.fresh.copy()
    for first, last in _ranges(rec.fresh):
        elapsed = np.floor((rec.block_time[first:last] - rec.block_time[first]) / WINDOW)
        fresh[first + 1 : last] |= np.diff(elapsed) > 0
    first_pose = np.searchsorted(rec.block, np.flatnonzero(fresh))
    segment = rec.segment[fresh]
    return replace(
        rec,
        fresh=fresh,
        starts=rec.pose_time[first_pose],
        pose_range=np.column_stack([first_pose, np.append(first_pose[1:], rec.pose_time.size)]),
        command_range=rec.command_range[segment],
        rested=rec.rested[segment],
    )


def _ranges(fresh: Mask) -> list[tuple[int, int]]:
    ends = [*np.flatnonzero(fresh), fresh.size]
    return [(int(first), int(last)) for first, last in pairwise(ends)]


def simulation_errors(rec: Record, point: Coefficients) -> Array:
    """Sum of squared position errors of a simulation over each window of a record, shape (W,) [unit^2].

    Start position and velocity of each window are fitted.

    Args:
        rec: Result of `windowed`.
        point: Coefficients; if they cannot be simulated, every error is infinite.
    """
    K = len(rec.axes)
    if not (point.damping > MOST_UNSTABLE).all():
        return np.full(rec.starts.size, np.inf)
    common = (rec.starts, rec.pose_range, rec.command_range, rec.pose_time, rec.block, rec.command_time)
    weight = 1.0 / rec.count
    if K == 1:
        rest = np.zeros(rec.starts.size)
        out = axis_response(
            *common, rec.command[:, 0], weight, point.gain[0], point.trim[0], point.damping[0], point.delay[0], rest
        )
    else:
        out = plane_response(
            *common, rec.command, weight, rec.yaw, point.gain, point.trim, point.damping, point.delay,
            np.zeros((rec.starts.size, 2)),
        )  # fmt: skip
    driven = np.einsum("j,bjk->bk", point.gain, out[:, :K]) + np.einsum("j,bjk->bk", point.trim, out[:, K : 2 * K])
    left = rec.position - driven
    if not (np.isfinite(left).all() and np.isfinite(out[:, 4 * K :]).all()):
        return np.full(rec.starts.size, np.inf)
    ranges = np.array(_ranges(rec.fresh))
    sizes, errors = np.diff(ranges, axis=1)[:, 0], np.empty(rec.starts.size)
    for size in np.unique(sizes):  # windows with equal numbers of blocks together: calls dominate the time
        alike = np.flatnonzero(sizes == size)
        rows = ranges[alike, :1] + np.arange(size)
        root = np.repeat(np.sqrt(rec.count[rows]), K, axis=1)[..., None]
        start = out[rows, 4 * K :].transpose(0, 1, 3, 2).reshape(alike.size, -1, K)
        offset = np.broadcast_to(np.tile(np.eye(K), (size, 1)), (alike.size, size * K, K))
        basis = np.linalg.qr(np.concatenate([offset, start], axis=2) * root)[0]
        row = left[rows].reshape(alike.size, -1, 1) * root
        taken = basis.transpose(0, 2, 1) @ row
        errors[alike] = np.sum(row**2, axis=(1, 2)) - np.sum(taken**2, axis=(1, 2))
    return errors
