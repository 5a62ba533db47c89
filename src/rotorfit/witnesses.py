"""Log + Card -> what bears witness of one motion on two clocks: poses on one; onboard motion or commands on another."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from rotorfit.card import Card, Channel, column, split_source
from rotorfit.clock import MISSING_STAMP, Stamps, fresh, increasing, stamps_of
from rotorfit.frames import AXES, Array, heading_from_world, yaw_from_quaternion
from rotorfit.lag_search import Seen, Witness
from rotorfit.log import Log
from rotorfit.stream import Stream

HALF_WIDTH = 0.15
"""Half the window of the local polynomials that give the velocity [s]."""

WIDE = 0.3
"""Half the window of those that give the acceleration [s]."""

STEP = 0.025
"""Step of the motion's grid [s]."""

COMMAND_STEP = 0.02
"""Step at which held commands are sampled [s]."""

_VX, _VY, _VZ, _RATE, _YAW, _FORWARD, _LEFT = range(7)
_A_FORWARD, _A_LEFT, _A_UP, _A_YAW, _AX, _AY = range(7, 13)

FEWEST = 50
"""Values below which a series is no witness."""


def seen_by(poses: Stream) -> Seen:
    """The motion of the poses: velocity, heading and acceleration by local cubics, on the clock of the poses.

    Args:
        poses: Fresh, in order; its stamps are counted from the first.

    Returns:
        Columns: world velocity, yaw rate, yaw; velocity forward and left; acceleration forward, left, up, of yaw, and
        along the world's x and y.
    """
    from rotorfit.derivative import local_polynomial

    time = (poses.stamps - poses.stamps[0]) / 1e9
    value = np.column_stack([poses.values[:, :3], np.unwrap(poses.values[:, 3])])
    period = float(np.median(np.diff(time)))
    grid = np.arange(0.0, float(time[-1]), STEP)
    near = local_polynomial(time, value, grid, max(HALF_WIDTH, 4 * period), 3)
    wide = local_polynomial(time, value, grid, max(WIDE, 6 * period), 3)
    yaw, rate = near.value[:, 3], wide.velocity[:, 3]
    forward, speed, pull, push = (
        heading_from_world(part[:, :2], yaw)
        for part in (near.velocity, wide.velocity, wide.acceleration, near.acceleration)
    )
    # d/dt (R^T v) = R^T a - rate (e_z x R^T v)
    turned = pull + rate[:, None] * np.column_stack([speed[:, 1], -speed[:, 0]])
    jerk = np.gradient(np.column_stack([pull, wide.acceleration[:, [2, 3, 0, 1]]]), STEP, axis=0)
    columns = np.column_stack([near.velocity, yaw, forward, push, near.acceleration[:, [2, 3, 0, 1]]])
    slopes = np.column_stack([wide.acceleration, rate, turned, jerk])
    valid = near.centred & wide.centred & np.all(np.isfinite(columns), axis=1) & np.all(np.isfinite(slopes), axis=1)
    known = valid[:, None]
    return Seen(0.0, STEP, np.where(known, columns, 0.0), np.where(known, slopes, 0.0), valid)


def onboard(log: Log, card: Card, origin: int) -> list[Witness]:
    """The vehicle's own velocity and heading, where the card names them.

    Args:
        log: As recorded.
        card: Which column is what.
        origin: Stamp from which the times of the witnesses are counted [ns].

    Raises:
        CardError: A column is not there, or nothing tells its time.
    """
    level = (_VX, _VY) if card.velocity_frame == "world" else (_FORWARD, _LEFT)
    along: dict[str, tuple[int, ...]] = {"x": level, "y": level, "z": (_VZ,), "yaw": (_RATE,)}
    found = []
    channels = {axis: channel for axis, channel in card.velocity.items() if isinstance(channel.source, str)}
    if channels:
        stamps, values = _series(log, velocity_clock(card), channels)
        names = {axis: f"velocity {axis}" if axis != "yaw" else "yaw rate" for axis in AXES}
        found += [_witness(names[axis], stamps, values[axis], along[axis], origin) for axis in channels]
    if card.attitude:
        stamps, values = _series(log, attitude_clock(card), card.attitude)
        yaw = values["yaw"] if "yaw" in values else yaw_from_quaternion(*(values[f"q{part}"] for part in "wxyz"))
        there = np.isfinite(yaw)
        one = _witness("heading", stamps[there], np.unwrap(yaw[there]), (_YAW,), origin)
        found.append(replace(one, angle=True, rate=_RATE))
    return [one for one in found if one.time.size >= FEWEST and np.ptp(one.value) > 0]


def commanded(commands: Stream, axes: tuple[str, ...], world: bool) -> list[Witness]:
    """The commands as witnesses of the acceleration that they cause.

    Args:
        commands: In order; the times of the witnesses are counted from the first.
        axes: The commanded ones.
        world: Whether they are along the axes of the world.
    """
    time = (commands.stamps - commands.stamps[0]) / 1e9
    grid = np.arange(0.0, (int(commands.until[-1]) - int(commands.stamps[0])) / 1e9, COMMAND_STEP)
    row = np.maximum(np.searchsorted(time, grid, side="right") - 1, 0)
    acting = grid <= (commands.until[row] - commands.stamps[0]) / 1e9
    along = {"x": (_A_FORWARD, _FORWARD), "y": (_A_LEFT, _LEFT), "z": (_A_UP, _VZ), "yaw": (_A_YAW, _RATE)}
    if world:
        along |= {"x": (_AX, _VX), "y": (_AY, _VY)}
    values = commands.values[row][acting]
    found = [Witness(f"command {axis}", grid[acting], values[:, AXES.index(axis)], along[axis]) for axis in axes]
    return [one for one in found if one.time.size >= FEWEST and np.ptp(one.value) > 0]


def velocity_clock(card: Card) -> Channel:
    """The clock of the onboard velocity."""
    named = [channel for channel in card.velocity.values() if isinstance(channel.source, str)]
    return card.velocity_time or _beside(card, named[0])


def attitude_clock(card: Card) -> Channel:
    """The clock of the onboard heading."""
    return card.attitude_time or _beside(card, next(iter(card.attitude.values())))


def _beside(card: Card, channel: Channel) -> Channel:
    """The clock of the table that a column stands in: that of the commands there, or named as it is."""
    table, clock = split_source(channel.source)[0], split_source(card.command_time.source)
    return replace(card.command_time, source=f"{table}:{clock[1]}" if table else clock[1])


def _series(log: Log, time: Channel, channels: Mapping[str, Channel]) -> tuple[Stamps, dict[str, Array]]:
    """Stamps and values of the rows that are in order and fresh, NaN where a value is none."""
    stamps = stamps_of(log, time)
    values = {name: column(log, channel, len(stamps)) for name, channel in channels.items()}
    shared = min(len(stamps), *(len(one) for one in values.values()))
    table = np.column_stack([one[:shared] for one in values.values()])
    rows = np.flatnonzero((stamps[:shared] != MISSING_STAMP) & np.any(np.isfinite(table), axis=1))
    rows = rows[increasing(stamps[rows])] if rows.size else rows
    rows = rows[fresh(table[rows])] if rows.size else rows
    return stamps[rows], {name: one[rows] for name, one in values.items()}


def _witness(name: str, stamps: Stamps, values: Array, columns: tuple[int, ...], origin: int) -> Witness:
    there = np.isfinite(values)
    return Witness(name, (stamps[there] - origin) / 1e9, values[there], columns)
