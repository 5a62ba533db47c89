"""Log + Card -> signals of one motion on two clocks: poses on one, onboard motion or commands on the other."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from rotorfit.core.card import Card, Channel
from rotorfit.core.frames import AXES, Array, heading_from_world, yaw_from_quaternion
from rotorfit.core.log import Log
from rotorfit.flights.clocks.lag_search import GriddedMotion, Witness
from rotorfit.flights.columns import column, split_source
from rotorfit.flights.other_tables import is_beside, own_clock
from rotorfit.flights.stamps import MISSING_STAMP, Stamps, fresh, in_time, stamps_of
from rotorfit.flights.streams import Stream
from rotorfit.flights.wild_poses import unwrapped

HALF_WIDTH = 0.15
"""Half width of the local polynomial window for the velocity [s]."""

WIDE = 0.3
"""Half width of the local polynomial window for the acceleration [s]."""

STEP = 0.025
"""Step of the motion's grid [s]."""

ANSWER_STEP = 0.01
"""Step of the grid of responses to commands [s]."""

DAMPINGS = (0.05, 0.1, 0.2, 0.4, 0.8, 1.6, 3.2, 6.4)
"""Dampings of the responses to commands that are compared with the motion [1/s]; vehicles have 0.05 to 5."""

_VX, _VY, _VZ, _RATE, _YAW, _FORWARD, _LEFT = range(7)

FEWEST = 50
"""Least number of values of a witness."""


def seen_by(poses: Stream) -> GriddedMotion:
    """The motion from the poses: velocity and heading by local cubics, on the clock of the poses.

    Args:
        poses: Fresh, in order; times are counted from the first stamp.

    Returns:
        Columns: world velocity x, y, z, yaw rate, yaw, velocity forward and left [m/s, rad/s, rad].
    """
    from rotorfit.dynamics.kinematics import local_polynomial

    time = (poses.stamps - poses.stamps[0]) / 1e9
    value = np.column_stack([poses.values[:, :3], unwrapped(time, poses.values[:, 3])])
    period = float(np.median(np.diff(time)))
    grid = np.arange(0.0, float(time[-1]), STEP)
    # a window whose middle is a hole would extrapolate from both sides
    near, wide = (
        local_polynomial(time, value, grid, half, 3, max_gap=half)
        for half in (max(HALF_WIDTH, 4 * period), max(WIDE, 6 * period))
    )
    yaw, rate = near.value[:, 3], wide.velocity[:, 3]
    level, speed, pull = (
        heading_from_world(part[:, :2], yaw) for part in (near.velocity, wide.velocity, wide.acceleration)
    )
    # d/dt (R^T v) = R^T a - rate (e_z x R^T v)
    turned = pull + rate[:, None] * np.column_stack([speed[:, 1], -speed[:, 0]])
    columns = np.column_stack([near.velocity, yaw, level])
    slopes = np.column_stack([wide.acceleration, rate, turned])
    valid = near.centred & wide.centred & np.all(np.isfinite(columns), axis=1) & np.all(np.isfinite(slopes), axis=1)
    known = valid[:, None]
    return GriddedMotion(0.0, STEP, np.where(known, columns, 0.0), np.where(known, slopes, 0.0), valid)


def onboard(log: Log, card: Card, origin: int) -> list[Witness]:
    """The onboard velocity and heading as witnesses, where the card names them.

    Args:
        log: As recorded.
        card: The meaning of each column.
        origin: Stamp from which the times of the witnesses are counted [ns].

    Raises:
        CardError: A column is missing, or has no clock.
    """
    level = (_VX, _VY) if card.velocity_frame == "world" else (_FORWARD, _LEFT)
    along: dict[str, tuple[int, ...]] = {"x": level, "y": level, "z": (_VZ,), "yaw": (_RATE,)}
    found = []
    channels = {axis: channel for axis, channel in card.velocity.items() if isinstance(channel.source, str)}
    if channels:
        clock, tables = velocity_clock(card), dict[str, dict[str, Channel]]()
        for axis, channel in channels.items():
            tables.setdefault(split_source(channel.source)[0], {})[axis] = channel
        names = {axis: f"velocity {axis}" if axis != "yaw" else "yaw rate" for axis in AXES}
        sensors = {"x": "level velocity", "y": "level velocity", "z": "vertical velocity", "yaw": "yaw rate"}
        for some in tables.values():
            first = next(iter(some.values()))
            own = own_clock(log, clock, first) if is_beside(clock, first) else stamps_of(log, clock)
            stamps, values = _series(log, own, some)
            found += [
                replace(_witness(names[axis], stamps, values[axis], along[axis], origin), sensor=sensors[axis])
                for axis in some
            ]
    if card.attitude:
        stamps, values = _series(log, stamps_of(log, attitude_clock(card)), card.attitude)
        yaw = values["yaw"] if "yaw" in values else yaw_from_quaternion(*(values[f"q{part}"] for part in "wxyz"))
        there = np.isfinite(yaw)
        one = _witness("heading", stamps[there], np.unwrap(yaw[there]), (_YAW,), origin)
        found.append(replace(one, by_rate=True, sensor="heading"))
    return [one for one in found if one.time.size >= FEWEST and np.ptp(one.value) > 0]


def moved(seen: GriddedMotion, axes: tuple[str, ...], world: bool) -> list[Witness]:
    """The motion from the poses as a witness of the response to the commands, to be matched with `answers`.

    Args:
        seen: From `seen_by`.
        axes: The commanded axes.
        world: Whether commands are along the world axes.
    """
    time: Array = seen.start + seen.step * np.arange(seen.valid.size, dtype=np.float64)
    found = []
    for axis in axes:
        k = AXES.index(axis) * len(DAMPINGS)
        each = tuple((k + j,) for j in range(len(DAMPINGS)))
        values = seen.value[seen.valid, motion_column(axis, world)]
        found.append(Witness(f"answer of {axis}", time[seen.valid], values, each[0], by_rate=True, instead=each[1:]))
    return [one for one in found if one.time.size >= FEWEST and np.ptp(one.value) > 0]


def motion_column(axis: str, world: bool) -> int:
    """Column of `seen_by` with the velocity driven by an axis's commands, along the world or the heading."""
    column = {"x": _VX, "y": _VY} if world else {"x": _FORWARD, "y": _LEFT}
    return (column | {"z": _VZ, "yaw": _RATE})[axis]


def answers(commands: Stream) -> GriddedMotion:
    """Velocity response to the commands without delay: v' = u - b v, for each of `DAMPINGS`.

    Returns:
        On the clock of the commands, counted from the first: one column for each axis and damping, the dampings of x
        first. Valid where commands act; the vehicle is assumed to hover at the first command.
    """
    time = (commands.stamps - commands.stamps[0]) / 1e9
    until = (commands.until - commands.stamps[0]) / 1e9
    grid = np.arange(0.0, float(until[-1]), ANSWER_STEP)
    row = np.maximum(np.searchsorted(time, grid, side="right") - 1, 0)
    acting = grid < until[row]
    command = np.where(acting[:, None], commands.values[row], 0.0)
    value = np.empty((grid.size, len(AXES) * len(DAMPINGS)))
    slope = np.empty_like(value)
    for a in range(len(AXES)):
        for j, b in enumerate(DAMPINGS):
            at = a * len(DAMPINGS) + j
            value[:, at] = _held_answer(command[:, a], b)
            slope[:, at] = command[:, a] - b * value[:, at]
    return GriddedMotion(0.0, ANSWER_STEP, value, slope, acting)


def _held_answer(command: Array, b: float) -> Array:
    """Solves v' = u - b v from rest, exact for commands that are held over a grid step.

    Sums the contributions of all earlier steps by doubling (1, 2, 4 ... steps): importing a filter would take longer.
    """
    kept = np.exp(-b * ANSWER_STEP)
    value: Array = (1 - kept) / b * np.append(0.0, command[:-1])
    steps = 1
    while steps < value.size and kept**steps > np.finfo(float).eps ** 2:
        value[steps:] += kept**steps * value[:-steps]
        steps *= 2
    return value


def velocity_clock(card: Card) -> Channel:
    """The clock of the onboard velocity."""
    named = [channel for channel in card.velocity.values() if isinstance(channel.source, str)]
    return card.velocity_time or _beside(card, named[0])


def attitude_clock(card: Card) -> Channel:
    """The clock of the onboard heading."""
    return card.attitude_time or _beside(card, next(iter(card.attitude.values())))


def _beside(card: Card, channel: Channel) -> Channel:
    """The clock of the table that holds a column: the column with the name of the commands' clock."""
    table, clock = split_source(channel.source)[0], split_source(card.command_time.source)
    return replace(card.command_time, source=f"{table}:{clock[1]}" if table else clock[1])


def _series(log: Log, stamps: Stamps, channels: Mapping[str, Channel]) -> tuple[Stamps, dict[str, Array]]:
    """Stamps and values of the rows that are in order and fresh, NaN where a value is missing."""
    values = {name: column(log, channel, len(stamps)) for name, channel in channels.items()}
    shared = min(len(stamps), *(len(one) for one in values.values()))
    table = np.column_stack([one[:shared] for one in values.values()])
    rows = np.flatnonzero((stamps[:shared] != MISSING_STAMP) & np.any(np.isfinite(table), axis=1))
    rows = rows[in_time(stamps[rows])] if rows.size else rows
    rows = rows[fresh(table[rows])] if rows.size else rows
    return stamps[rows], {name: one[rows] for name, one in values.items()}


def _witness(name: str, stamps: Stamps, values: Array, columns: tuple[int, ...], origin: int) -> Witness:
    there = np.isfinite(values)
    return Witness(name, (stamps[there] - origin) / 1e9, values[there], columns)
