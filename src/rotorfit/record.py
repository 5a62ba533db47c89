"""Flight -> Record: one axis, or x with y, in blocks, as the likelihood needs it."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from rotorfit.disturbance import distinct_steps
from rotorfit.flight import Flight
from rotorfit.frames import AXES, Array, Indices, Mask, heading_from_world

DELAY_RANGE = (-0.1, 0.6)
"""Delays that are searched [s]. Below zero, because a bound at zero biases; a negative optimum is a finding."""

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


def record(flight: Flight, axes: Sequence[str], rate: float | None = None) -> Record | None:
    """Cuts a flight into what the likelihood of these axes needs; None where no segment is long enough.

    x or y alone is the position along the mean heading: right where the heading is held, else take both.

    Args:
        flight: What was flown.
        axes: Names of one axis, or of x and y.
        rate: Blocks per second [1/s], by default `BLOCK_RATE`; infinite gives every pose a block of its own.
    """
    rate = BLOCK_RATE if rate is None else rate
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
        bins = np.arange(last - first)
        if np.isfinite(rate):
            _, bins = np.unique(np.floor((t[first:last] - t[first]) * rate + 1e-6), return_inverse=True)
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
        held=("x" not in axes and "y" not in axes) or bool(np.ptp(block_yaw) < 2 * HELD_HEADING),
        heading=heading,
    )
