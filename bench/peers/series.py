"""Data of the peers: uniform samples of one axis, from the past only, and conversion of predictions to the poses.

Every peer requires uniform samples. A piece of a flight becomes a grid that starts with the piece; 0.5 s is a whole
number of its steps, so that every start of the protocol is a sample. A sample of the pose is the last pose,
extrapolated to the instant by the slope of the last poses: a sample contains nothing later than its instant, in the
training data, too, so that models are trained on the same kind of data. The output is the mean velocity over the
previous step, in the heading frame of that step; the input is the mean over the next step of the held command.
"""

from dataclasses import dataclass

import numpy as np

from rotorfit.core.flight_data import Flight, Segment
from rotorfit.core.frames import Array, Indices, heading_from_world
from rotorfit.dynamics.protocol import Predictions

RATES = (30, 20, 10)
"""Rates of the grid that a peer may choose from [Hz]; none far above the fresh poses' own."""

HELD_OVER = 0.3
"""Holes in the commands shorter than this are held over when the peers are trained [s]."""

SLOPE_SPAN = 0.06
"""Time over which the slope of the last poses is taken, widened until it holds three [s]."""


@dataclass(frozen=True)
class Grid:
    """One piece of a flight on a uniform grid. N samples; x, y, z, yaw.

    Attributes:
        start: First instant [s].
        step: Between samples [s].
        pose: World x, y, z, yaw, from poses up to each instant, shape (N, 4).
        velocity: Mean over the step before, x and y in the heading of that step, shape (N, 4); row 0 repeats row 1.
        command: Mean over the step after, shape (N, 4).
    """

    start: float
    step: float
    pose: Array
    velocity: Array
    command: Array


@dataclass(frozen=True, eq=False)
class Series:
    """One axis of a grid: what a peer sees.

    Attributes:
        y: Output, mean velocity over the step before, shape (N,).
        u: Input, the command's mean over the step after, shape (N,): y[k + 1] is the first that u[k] can move.
        step: Between samples [s].
    """

    y: Array
    u: Array
    step: float


def pieces(flight: Flight, over: float = 0.0) -> list[Segment]:
    """The segments of a flight, holes in the commands shorter than `over` held over."""
    out: list[Segment] = []
    for segment in flight.segments:
        if out and segment.start - out[-1].end < over:
            out[-1] = Segment(out[-1].start, segment.end)
        else:
            out.append(segment)
    return out


def grid_of(flight: Flight, segment: Segment, rate: float) -> Grid | None:
    """One piece of a flight on a uniform grid; None where it is shorter than 2 s."""
    time, pose = flight.pose_time, np.column_stack([flight.position, flight.yaw])
    begin = max(segment.start, segment.start + np.ceil((time[0] - segment.start) * rate - 1e-6) / rate)
    at = np.arange(begin, segment.end + 1e-9, 1 / rate)
    if at.size < 2 * rate:
        return None
    past = carried_on(time, pose, at)
    heading = (past[1:, 3] + past[:-1, 3]) / 2
    velocity = np.diff(past, axis=0) * rate
    velocity[:, :2] = heading_from_world(velocity[:, :2], heading)
    return Grid(begin, 1 / rate, past, np.vstack([velocity[:1], velocity]), mean_command(flight, at, 1 / rate))


def carried_on(time: Array, pose: Array, at: Array) -> Array:
    """The last pose at or before each instant, carried on by the slope of the last poses; shape (M, 4)."""
    out = np.empty((at.size, pose.shape[1]))
    last = np.searchsorted(time, at + 1e-9, side="right") - 1
    for m, k in enumerate(last):
        first = max(0, min(int(np.searchsorted(time, time[k] - SLOPE_SPAN)), k - 2))
        t = time[first : k + 1] - time[first : k + 1].mean()
        square = float(t @ t)
        slope = t @ pose[first : k + 1] / square if square > 0 else np.zeros(pose.shape[1])
        out[m] = pose[k] + slope * max(at[m] - time[k], 0.0)
    return out


def mean_command(flight: Flight, at: Array, step: float) -> Array:
    """Mean of the held command over the step after each instant, shape (M, 4)."""
    time, value = flight.command_time, flight.command
    area = np.vstack([np.zeros(4), np.cumsum(value[:-1] * np.diff(time)[:, None], axis=0)])

    def until(t: Array) -> Array:
        k = np.clip(np.searchsorted(time, t, side="right") - 1, 0, None)
        return area[k] + value[k] * (t - time[k])[:, None]

    return (until(at + step) - until(at)) / step


def axis_series(grid: Grid, axis: int) -> Series:
    """One axis of a grid."""
    return Series(grid.velocity[:, axis], grid.command[:, axis], grid.step)


def to_poses(part: Predictions, grid: Grid, axis: int, velocity: Array, direction: Array) -> tuple[Array, Array]:
    """Predicted velocities of one axis on the grid as what they add to the prediction at the poses of a segment.

    Args:
        part: Starts and poses to predict.
        grid: What the peer saw.
        axis: Which.
        velocity: Mean over each of the T steps after each start, along the axis in its own heading, shape (S, T).
        direction: The axis in the world at the middle of the step before each start and of each of the T steps after
            it, shape (S, T + 1, D).

    Returns:
        Displacement since the start and velocity, (S, E, D) each.
    """
    starts = start_samples(part, grid)
    before = grid.velocity[starts, axis]
    moving = np.column_stack([before, velocity])[..., None] * direction  # at -1/2, 1/2, 3/2 .. steps after the start
    path = np.concatenate([np.zeros_like(moving[:, :1]), moving[:, 1:].cumsum(axis=1) * grid.step], axis=1)
    index = np.minimum(part.first[:, None] + np.arange(part.predicted.shape[1]), part.time.size - 1)
    elapsed = (part.time[index] - part.start[:, None]) / grid.step
    return between(path, elapsed), between(moving, elapsed + 0.5)


def between(value: Array, at: Array) -> Array:
    """Linear between samples, carried on beyond the last: value (S, T, D) at (S, E) -> (S, E, D)."""
    low = np.clip(np.floor(at).astype(int), 0, value.shape[1] - 2)
    share = (at - low)[..., None]
    row = np.arange(value.shape[0])[:, None]
    mixed: Array = value[row, low] * (1 - share) + value[row, low + 1] * share
    return mixed


def start_samples(part: Predictions, grid: Grid) -> Indices:
    """The sample that each start of the protocol falls on, shape (S,)."""
    exact = (part.start - grid.start) / grid.step
    samples = np.round(exact).astype(int)
    if np.abs(exact - samples).max() > 1e-3:
        raise ValueError("a start of the protocol falls between samples of the grid")
    return samples
