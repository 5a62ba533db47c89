"""Flight -> Record: one axis, or x with y, in blocks, as input of the likelihood.

Every measurement is linear in the position at certain times. A pose is the position at its stamp; a velocity is the
difference of the positions shortly after and before its stamp, divided by the time between. So one kernel serves both,
and its results for these samples are combined block by block (`observed`).
"""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from rotorfit.core.flight_data import Flight
from rotorfit.core.frames import AXES, Array, Indices, Mask, heading_from_world
from rotorfit.core.laws import DELAY_RANGE, Measured
from rotorfit.dynamics.disturbance import distinct_steps
from rotorfit.dynamics.whitening import turns

BLOCK_RATE = 30.0
"""Rate of the blocks over which poses and their modelled response are averaged [1/s]. At the full rate of a mocap
system the likelihood of real flights can prefer a false delay of a few milliseconds."""

HELD_HEADING = np.radians(10.0)
"""The heading counts as held if its range is below twice this [rad]: in the filter only, never in the response."""

HALF_STEP = 1e-3
"""Half of the time over which a velocity is a difference of positions [s]. The error is 1e-6 of the change of velocity
in a second, and a fraction of one change of acceleration if a command switches inside."""


REST, MOVES = 0.2, 1.0
"""How long after its first command a segment shows that it begins at rest, since an answer has hardly begun, and that
this command moves the vehicle [s]. A command that does not, as in a hover in wind, counts as held before."""

AT_REST = 0.5
"""Share of the upper quartile of what axes move in the first of these times below which they are at rest."""


@dataclass(frozen=True)
class Record:
    """One flight, one axis or the pair x, y, in blocks. M commands, N samples, B blocks, K axes (1 or 2), S segments.

    Samples are poses. Where velocities are measured, the two ends of each velocity's difference are samples, too, and
    the response is computed for G groups of samples, one per block of poses, two per block of velocities.

    Attributes:
        axes: Names of the K axes.
        starts: Where scoring starts in each segment, shape (S,) [s]: late enough for every delay in the range.
        pose_range: First and one past the last sample of each segment, shape (S, 2).
        command_range: The same for the commands, shape (S, 2).
        pose_time: Stamps of the samples, shape (N,) [s].
        yaw: Heading at the samples, shape (N,) [rad].
        block: Block of each pose, shape (N,); the group of each sample where velocities are measured.
        count: Number of poses or velocities in each block, shape (B,).
        block_time: Mean stamp of each block, shape (B,) [s].
        steps: Distinct steps between the blocks, shape (U,) [s].
        step: Index of the step that leads to each block, shape (B,).
        block_yaw: Mean heading of each block, shape (B,) [rad].
        position: Mean pose of each block less the first of its segment, shape (B, K) [m or rad]; the mean velocity for
            a block of velocities [m/s or rad/s]. World frame; x or y alone is along `heading`.
        fresh: True for the first block of a segment, shape (B,).
        command_time: Stamps of the commands, shape (M,) [s].
        command: Commands in the heading frame, shape (M, K).
        rested: Whether the vehicle is at rest at the first command of each segment, and this command moves it, shape
            (S,).
        held: Whether the filter may treat the heading as constant.
        heading: Mean heading [rad].
        rate: True for blocks of velocities, shape (B,); None without velocities.
        groups: Groups of each block, shape (B, 2): that of its poses and none that counts, or those of the ends and
            of the beginnings of its velocities' differences; None likewise.
        size: Number of samples in each group, shape (G,); None likewise.
        rounding: Variance that the rounding adds to a velocity, shape (K,) [m^2/s^2 or rad^2/s^2]; None likewise.
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
    rested: Mask
    held: bool
    heading: float
    rate: Mask | None = None
    groups: Indices | None = None
    size: Array | None = None
    rounding: Array | None = None

    @property
    def measured(self) -> Measured:
        """Kind of measurement in the blocks."""
        if self.rate is None:
            return "position"
        return "velocity" if self.rate.all() else "both"

    @cached_property
    def weight(self) -> Array:
        """Inverse number of samples in each block or group of the response, shape (B,) or (G,)."""
        return 1.0 / (self.count if self.size is None else self.size)

    @cached_property
    def segment(self) -> Indices:
        """Index of the segment of each block, shape (B,)."""
        return np.cumsum(self.fresh) - 1

    @cached_property
    def block_range(self) -> list[tuple[int, int]]:
        """The first block of each segment, and one past its last."""
        ends = np.searchsorted(self.segment, np.arange(self.starts.size + 1)).tolist()
        return list(itertools.pairwise(ends))

    @cached_property
    def turn(self) -> Array:
        """Turns and headings of the blocks, see `whitening.turns`, shape (B, 4)."""
        return turns(self.block_yaw, self.fresh)

    @cached_property
    def switches(self) -> tuple[Array, Array, Indices]:
        """Stamps and values of the commands that differ from the previous one, and their range in each segment.

        Many logs repeat a command until the next one: repetitions do not change the motion, but cost as much time.
        Before the first command of a segment that begins at rest is one of zero: nothing is on its way to the vehicle.
        Elsewhere, what came before is unknown, and the first command counts as held.
        """
        new = np.ones(self.command_time.size, bool)
        new[1:] = np.any(np.diff(self.command, axis=0) != 0, axis=1)
        new[np.minimum(self.command_range[:, 0], new.size - 1)] = True
        place = np.concatenate([[0], np.cumsum(new)])
        time, command = self.command_time[new], np.ascontiguousarray(self.command[new])
        spans = place[self.command_range]
        if not self.rested.any():
            return time, command, spans
        first = np.unique(spans[self.rested, 0])
        inserted = np.searchsorted(first, spans)  # zeros before each
        return np.insert(time, first, time[first]), np.insert(command, first, 0.0, axis=0), spans + inserted

    def observed(self, groups: Array) -> Array:
        """Response as measured by the blocks: from groups of samples (G, ...) to blocks (B, ...)."""
        if self.rate is None or self.groups is None:
            return groups
        out = groups[self.groups[:, 0]]
        out[self.rate] = (out[self.rate] - groups[self.groups[self.rate, 1]]) / (2 * HALF_STEP)
        return out

    def only(self, k: int) -> "Record":
        """The record with only axis k of its commands; its measurements are unchanged."""
        return replace(self, axes=self.axes[k : k + 1], command=np.ascontiguousarray(self.command[:, k : k + 1]))


def measured_by(records: Sequence[Record]) -> Measured:
    """Kind of measurement in all records together; `both` if they differ."""
    kinds = {rec.measured for rec in records}
    return "both" if len(kinds) > 1 else next(iter(kinds), "position")


LEAST_BLOCKS = 4
"""Number of blocks below which a flight has no record: nothing can be said of its noise."""


def record(flight: Flight, axes: Sequence[str], rate: float | None = None) -> Record | None:
    """The record of a flight for the likelihood of these axes; None where no segment is long enough.

    x or y alone is the position along the mean heading, which is valid only where the heading is held.

    Args:
        flight: The flight.
        axes: Names of one axis, or of x and y.
        rate: Blocks per second [1/s], by default `BLOCK_RATE`; infinite gives every pose a block of its own.
    """
    rate = BLOCK_RATE if rate is None else rate
    if flight.velocity is not None and flight.velocity.of(tuple(axes)):
        return _with_velocity(flight, axes, rate)
    column = [AXES.index(axis) for axis in axes]
    pose, heading = [*flight.position.T, flight.yaw], float(np.mean(flight.yaw))
    if len(axes) == 1 and axes[0] in ("x", "y"):
        pose[:2] = heading_from_world(flight.position[:, :2], np.full(flight.yaw.size, heading)).T
    t, command_time = flight.pose_time, flight.command_time
    begins, starts, pose_range, command_range, times, index = [], [], [], [], [], []
    block_count = n = 0
    for segment in flight.segments:
        first, last = np.searchsorted(t, [segment.start + DELAY_RANGE[1], segment.end + DELAY_RANGE[0]])
        if last - first < 4:
            continue
        bins = np.arange(last - first)
        if np.isfinite(rate):
            bins = _numbered(t[first:last], rate)
        begins.append(segment.start)
        starts.append(segment.start + DELAY_RANGE[1])
        pose_range.append((n, n + last - first))
        command_range.append(np.searchsorted(command_time, [segment.start, segment.end]))
        times.append(bins + block_count)
        index.append(slice(first, last))
        n += last - first
        block_count += bins[-1] + 1
    if block_count < LEAST_BLOCKS:
        return None
    alone = len(index) == 1  # a slice of the flight takes no memory
    keep, block = (index[0], times[0]) if alone else (np.r_[tuple(index)], np.concatenate(times))
    count = np.bincount(block).astype(float)
    fresh = np.zeros(block_count, bool)
    fresh[block[[i for i, _ in pose_range]]] = True
    mean = np.column_stack([np.bincount(block, pose[k][keep]) / count for k in column])
    mean -= mean[np.flatnonzero(fresh)][np.cumsum(fresh) - 1]
    pose_time, yaw = (np.require(part[keep], None, ["C", "W"]) for part in (t, flight.yaw))  # as kernels are compiled
    block_yaw = np.bincount(block, yaw) / count
    block_time = np.bincount(block, pose_time) / count
    steps, step = distinct_steps(block_time)
    return Record(
        axes=tuple(axes),
        starts=np.array(starts),
        pose_range=np.array(pose_range),
        command_range=np.array(command_range),
        pose_time=pose_time,
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
        rested=_rested(flight, np.array(begins), column),
        held=("x" not in axes and "y" not in axes) or bool(np.ptp(block_yaw) < 2 * HELD_HEADING),
        heading=heading,
    )


def _rested(flight: Flight, begins: Array, column: Sequence[int]) -> Mask:
    """Whether axes hardly move in the first moment of segments, and then are moved by the first command, shape (S,).

    Args:
        flight: The flight.
        begins: Starts of the segments, shape (S,) [s].
        column: Indices of the axes.
    """
    first = np.minimum(np.searchsorted(flight.command_time, begins), flight.command_time.size - 1)
    commanded: Mask = np.any(flight.command[first][:, column] != 0.0, axis=1)
    if not commanded.any():
        return commanded
    pose = np.column_stack([flight.position, flight.yaw])[:, column]

    def at(time: Array) -> Array:
        return np.column_stack([np.interp(time, flight.pose_time, one) for one in pose.T])

    grid = np.arange(flight.pose_time[0], flight.pose_time[-1], REST)
    usual = np.quantile(np.linalg.norm(np.diff(at(grid), axis=0), axis=1), 0.75)
    moved, away = (np.linalg.norm(at(begins + after) - at(begins), axis=1) for after in (REST, MOVES))
    out: Mask = commanded & (moved < AT_REST * usual) & (away > usual)
    return out


def _numbered(time: Array, rate: float) -> Indices:
    """Number of the block of a rate [1/s] in which each of increasing times [s] lies, without those that are empty."""
    return np.cumsum(np.diff(np.floor((time - time[0]) * rate + 1e-6), prepend=0.0) > 0)


@dataclass(frozen=True)
class _Blocks:
    """Blocks of one segment and of one kind. N samples, B blocks, K axes.

    Attributes:
        time: Stamps of the samples, shape (N,) [s].
        block: Block of each sample, shape (N,).
        value: Mean of each block, shape (B, K).
    """

    time: Array
    block: Indices
    value: Array

    @property
    def count(self) -> Array:
        """Number of samples in each block, shape (B,)."""
        return np.bincount(self.block).astype(float)


def _blocks(time: Array, value: Array, low: float, high: float, rate: float) -> _Blocks:
    """Samples between two times [s] in blocks of a rate [1/s]; `value` has shape (samples, K)."""
    first, last = np.searchsorted(time, [low, high])
    time, value = time[first:last], value[first:last]
    block = np.arange(time.size)
    if np.isfinite(rate) and time.size:
        block = _numbered(time, rate)
    count = np.bincount(block)
    mean = [np.bincount(block, part) / count for part in value.T]
    return _Blocks(time, block, np.column_stack(mean) if time.size else np.empty((0, value.shape[1])))


@dataclass(frozen=True)
class _Fused:
    """Poses and velocities of one segment. N times, G groups of times, B blocks, K axes.

    The block of a velocity has two groups: the times half a step after its samples and half a step before them.

    Attributes:
        start: Start of the segment for the likelihood [s].
        commands: First and last of its commands.
        time: Times, shape (N,), increasing [s].
        group: Group of each time, shape (N,).
        size: Number of times in each group, shape (G,).
        pairs: The group of each block, and of a block of velocities the one that is subtracted from it, shape (B, 2).
        count: Number of samples in each block, shape (B,).
        rate: Whether each block is of velocities, shape (B,).
        stamp: Mean stamp of each block, shape (B,), increasing [s].
        value: Mean of each block, shape (B, K); positions from the first on.
    """

    start: float
    commands: Indices
    time: Array
    group: Indices
    size: Array
    pairs: Indices
    count: Array
    rate: Mask
    stamp: Array
    value: Array


def _fused(start: float, commands: Indices, poses: _Blocks, rates: _Blocks) -> _Fused:
    """Blocks of poses and of velocities in the order of their stamps."""
    B, V = len(poses.value), len(rates.value)
    time = np.concatenate([poses.time, rates.time + HALF_STEP, rates.time - HALF_STEP])
    group = np.concatenate([poses.block, B + rates.block, B + V + rates.block])
    pairs = np.column_stack([np.arange(B + V), np.concatenate([np.full(B, -1), B + V + np.arange(V)])])
    stamp = np.concatenate([np.bincount(b.block, b.time) / b.count for b in (poses, rates)])
    value = np.concatenate([poses.value - poses.value[:1], rates.value])
    order, turn = np.argsort(time, kind="stable"), np.argsort(stamp, kind="stable")
    return _Fused(
        start=start,
        commands=commands,
        time=time[order],
        group=group[order],
        size=np.concatenate([poses.count, rates.count, rates.count]),
        pairs=pairs[turn],
        count=np.concatenate([poses.count, rates.count])[turn],
        rate=(np.arange(B + V) >= B)[turn],
        stamp=stamp[turn],
        value=value[turn],
    )


def _with_velocity(flight: Flight, axes: Sequence[str], rate: float) -> Record | None:
    """The record of axes with a measured velocity, and with their poses where there are any; None likewise."""
    assert flight.velocity is not None
    column, heading = [AXES.index(axis) for axis in axes], float(np.mean(flight.yaw))
    pose, velocity = np.column_stack([flight.position, flight.yaw]), flight.velocity.value
    if len(axes) == 1 and axes[0] in ("x", "y"):
        pose, velocity = (
            np.column_stack([heading_from_world(part[:, :2], np.full(len(part), heading)), part[:, 2:]])
            for part in (pose, velocity)
        )
    pose, velocity = pose[:, column], velocity[:, column]
    alone, rate_time = axes[0] in flight.velocity.alone, flight.velocity.true_time(axes[0])
    begins, parts = [], []
    for segment in flight.segments:
        low, high = segment.start + DELAY_RANGE[1], segment.end + DELAY_RANGE[0]
        poses = _blocks(flight.pose_time, pose, low, low if alone else high, rate)
        rates = _blocks(rate_time, velocity, low + HALF_STEP, high - HALF_STEP, rate)
        if len(poses.value) + len(rates.value) >= 4 and len(rates.value):
            commands = np.searchsorted(flight.command_time, [segment.start, segment.end])
            parts.append(_fused(low, commands, poses, rates))
            begins.append(segment.start)
    if not parts:
        return None
    ends = np.cumsum([part.time.size for part in parts])
    before = np.cumsum([0, *(part.size.size for part in parts)])  # groups
    block_time, pose_time = (np.concatenate([getattr(part, name) for part in parts]) for name in ("stamp", "time"))
    block_yaw = np.interp(block_time, flight.pose_time, flight.yaw)
    steps, step = distinct_steps(block_time)
    return Record(
        axes=tuple(axes),
        starts=np.array([part.start for part in parts]),
        pose_range=np.column_stack([np.concatenate([[0], ends[:-1]]), ends]),
        command_range=np.array([part.commands for part in parts]),
        pose_time=pose_time,
        yaw=np.interp(pose_time, flight.pose_time, flight.yaw),
        block=np.concatenate([part.group + n for part, n in zip(parts, before, strict=False)]),
        count=np.concatenate([part.count for part in parts]),
        block_time=block_time,
        steps=steps,
        step=step,
        block_yaw=block_yaw,
        position=np.concatenate([part.value for part in parts]),
        fresh=np.concatenate([np.arange(part.stamp.size) == 0 for part in parts]),
        command_time=flight.command_time,
        command=np.ascontiguousarray(flight.command[:, column]),
        rested=_rested(flight, np.array(begins), column),
        held=("x" not in axes and "y" not in axes) or bool(np.ptp(block_yaw) < 2 * HELD_HEADING),
        heading=heading,
        rate=np.concatenate([part.rate for part in parts]),
        groups=np.concatenate([part.pairs + n for part, n in zip(parts, before, strict=False)]),
        size=np.concatenate([part.size for part in parts]),
        rounding=flight.velocity.rounding[column],
    )
