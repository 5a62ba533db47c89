"""Streams: the commands and the poses of a log, each on its own clock, put in order; every repair noted."""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from rotorfit.card import Card, Channel, column, split_source
from rotorfit.clock import (
    GAP_PERIODS,
    GAP_TOLERANCE,
    MISSING_STAMP,
    ClockDrift,
    Mask,
    Stamps,
    coarse,
    degrees_for_radians,
    drift,
    fresh,
    held,
    increasing,
    median_period,
    stamps_of,
)
from rotorfit.errors import CardError, FlightError
from rotorfit.frames import AXES, Array, yaw_from_quaternion
from rotorfit.log import Log

SLOWEST_COMMANDS = 5.0
"""Median period of the commands [s] beyond which their clock is taken to lack its unit."""

_NEVER = np.int64(2**62)


@dataclass(frozen=True)
class Note:
    """A repair or a remark on a flight.

    Attributes:
        code: Short stable name, such as `stale_poses`.
        text: One sentence with the count in it.
        count: How many samples it concerns.
    """

    code: str
    text: str
    count: int


@dataclass(frozen=True)
class Stream:
    """Commands, poses or velocities on their own clock, with what was repaired.

    Attributes:
        what: `command`, `pose` or `velocity`.
        stamps: Shape (N,) [ns].
        values: Shape (N, 4): x, y, z, yaw.
        until: Until when a command acts if no other follows, shape (N,) [ns].
        notes: What was repaired so far.
    """

    what: str
    stamps: Stamps
    values: Array
    until: Stamps
    notes: tuple[Note, ...] = ()


def commands_of(log: Log, card: Card) -> tuple[Stream, tuple[str, ...], int]:
    """Takes the commands from a log as the card says and repairs them.

    Args:
        log: As recorded.
        card: Which column is what.

    Returns:
        The commands, 0 where not commanded; the commanded axes in the order of `AXES`; and the stamp of the first
        command [ns], which starts the common window even where that command is dropped as garbage.

    Raises:
        CardError: A column is not there, or its length does not go with its stamps.
        FlightError: No commands, a clock that runs backwards or lacks its unit, a window that is never open.
    """
    stamps, series, notes = _read(log, card.command_time, card.command, "command")
    silent = [axis for axis, values in series.items() if not np.any(np.isfinite(values))]
    if silent and len(silent) < len(series):
        text = f"the command of {', '.join(silent)} is never a number: taken as not commanded"
        notes = (*notes, Note("axis_never_commanded", text, len(stamps)))
        series = {axis: values for axis, values in series.items() if axis not in silent}
    values = np.stack([series.get(axis, np.zeros(len(stamps))) for axis in AXES], axis=1)
    stream = _in_order(_numbers(Stream("command", stamps, values, np.full(len(stamps), _NEVER), notes), log), log)
    stream = _inside_window(stream, log, card)
    origin = int(stream.stamps[0])
    return _held(_without_garbage_start(stream), log, card), tuple(series), origin


def poses_of(log: Log, card: Card) -> Stream:
    """Takes the poses from a log as the card says and repairs them.

    Args:
        log: As recorded.
        card: Which column is what.

    Returns:
        The fresh poses, world frame, z up [m, rad]; yaw still wrapped; 0 for axes of which there is only a velocity.

    Raises:
        CardError: A column is not there, or its length does not go with its stamps.
        FlightError: No poses, one that never changes, a clock that runs backwards, yaw in degrees taken for radians.
    """
    stamps, series, notes = _read(log, card.pose_time, card.pose, "pose")
    x, y, z = (series.get(axis, np.zeros(len(stamps))) for axis in AXES[:3])
    if "yaw" in series:
        yaw = series["yaw"]
    else:
        parts = [series[f"q{part}"] for part in "wxyz"]
        lost = np.sum(np.square(parts), axis=0) < 1e-6  # mocap bridges write zeros while the body is out of sight
        yaw = np.where(lost, np.nan, yaw_from_quaternion(*parts))
    if card.frame == "NED":
        x, y, z, yaw = y, x, -z, np.pi / 2 - yaw
    values = np.stack([x, y, z, yaw], axis=1)
    stream = _in_order(_numbers(Stream("pose", stamps, values, np.full(len(stamps), _NEVER), notes), log), log)
    if not (card.velocity_only and coarse(stream.values)):  # a heading in whole degrees repeats itself in truth
        why = "repeat the pose before with a fresh stamp: dropped"
        stream = _kept(stream, fresh(stream.values), "stale_poses", why)
    if len(stream.stamps) < 2:
        raise FlightError(f"{log.path}: the pose never changes; is [pose] of the card the flown vehicle?")
    if "yaw" in series and degrees_for_radians(stream.stamps, stream.values[:, 3]):
        raise FlightError(
            f"{log.path}: yaw jumps or turns as no vehicle can: degrees taken for radians? Write yaw = {{ from = "
            f'"{card.pose["yaw"].source}", unit = "deg" }} in [pose] of the card'
        )
    return stream


def velocities_of(log: Log, card: Card) -> Stream | None:
    """Takes the vehicle's own velocity from a log as the card says and repairs it.

    Args:
        log: As recorded.
        card: Which column is what.

    Returns:
        Velocities in the card's own frame, z up, NaN for axes that the card does not name [m/s, rad/s]; None where
        nothing needs them: a pose of every axis, and no word that the velocity is independent of it.

    Raises:
        CardError: A column is not there, or nothing tells its time.
        FlightError: No velocities, one that never changes, or a clock that runs backwards.
    """
    wanted = AXES if card.velocity_independent else card.velocity_only
    channels = {axis: channel for axis, channel in card.velocity.items() if axis in wanted}
    if not channels:
        return None
    time = card.velocity_time or _clock_of(log, card, next(iter(channels.values())), "velocity")
    stamps, series, notes = _read(log, time, channels, "velocity")
    values = np.stack([series.get(axis, np.zeros(len(stamps))) for axis in AXES], axis=1)
    stream = _in_order(_numbers(Stream("velocity", stamps, values, np.full(len(stamps), _NEVER), notes), log), log)
    if not np.any(np.ptp(stream.values, axis=0)):
        raise FlightError(f"{log.path}: the velocity never changes; is [velocity] of the card the flown vehicle?")
    if not coarse(stream.values):
        why = "repeat the one before with a fresh stamp: dropped"
        stream = _kept(stream, fresh(stream.values), "stale_velocities", why)
    values = np.where([axis in channels for axis in AXES], stream.values, np.nan)
    if card.frame == "NED" and card.velocity_frame == "world":
        values = np.stack([values[:, 1], values[:, 0], -values[:, 2], -values[:, 3]], axis=1)
    return replace(stream, values=values)


def sample_rows(log: Log, time: Channel, channels: Mapping[str, Channel]) -> Mask:
    """Which rows of a stream hold a sample: where commands and poses share a table, a row may hold one of them only.

    Args:
        log: As recorded.
        time: The stream's clock.
        channels: What it consists of.

    Returns:
        Shape (N,), True where any channel is a number; N is the number of stamps.

    Raises:
        CardError: A column is not there.
    """
    stamps = stamps_of(log, time)
    rows = np.zeros(len(stamps), dtype=np.bool_)
    for channel in channels.values():
        if isinstance(channel.source, str):  # a constant is no sample
            there = np.isfinite(column(log, channel, len(stamps)))[: len(stamps)]
            rows[: len(there)] |= there
    return rows


def recorder_clock(log: Log, time: Channel, channels: Mapping[str, Channel]) -> ClockDrift | None:
    """The recorder's `log_time` against the `header.stamp` of a stream's samples; None where one of them is missing.

    Args:
        log: As recorded.
        time: The stream's clock; the two stamps are looked for in its table.
        channels: What the stream consists of.

    Raises:
        CardError: A column is not there.
    """
    name = split_source(time.source)[0]
    table = log.tables.get(name) or (next(iter(log.tables.values())) if len(log.tables) == 1 else None)
    if table is None or not {"header.stamp", "log_time"} <= table.columns.keys():
        return None
    prefix = f"{table.name}:" if len(log.tables) > 1 else ""
    rows = sample_rows(log, time, channels)
    header, recorded = (stamps_of(log, Channel(prefix + column)) for column in ("header.stamp", "log_time"))
    return drift(header[rows], recorded[rows])


def _read(
    log: Log, time: Channel, channels: Mapping[str, Channel], what: str
) -> tuple[Stamps, dict[str, Array], tuple[Note, ...]]:
    """Stamps and series of one length; the last surplus sample goes, because dropping the first would forge a delay."""
    stamps = stamps_of(log, time)
    series = {name: column(log, channel, len(stamps)) for name, channel in channels.items()}
    counts = {"time": len(stamps)} | {name: len(values) for name, values in series.items()}
    shared, longest = min(counts.values()), max(counts.values())
    if shared == 0:
        raise FlightError(f"{log.path}: there are no {what}s: {time.source} or a column beside it is empty")
    if longest - shared > 1:
        lengths = ", ".join(f"{name} {count}" for name, count in counts.items())
        raise CardError(
            f"{log.path}: lengths of [{what}] do not go together ({lengths}); which columns belong together?"
        )
    if longest == shared:
        return stamps, series, ()
    surplus = ", ".join(name for name, count in counts.items() if count == longest)
    note = Note(f"surplus_{what}", f"1 last sample of {what} {surplus} has no partner: dropped", 1)
    return stamps[:shared], {name: values[:shared] for name, values in series.items()}, (note,)


def _kept(stream: Stream, keep: Mask, code: str, why: str) -> Stream:
    """The samples to keep, and a note where some go."""
    lost = int(np.sum(~keep))
    if not lost:
        return stream
    note = Note(code, f"{lost} of {len(keep)} {stream.what}s {why}", lost)
    return replace(
        stream,
        stamps=stream.stamps[keep],
        values=stream.values[keep],
        until=stream.until[keep],
        notes=(*stream.notes, note),
    )


def _numbers(stream: Stream, log: Log) -> Stream:
    """Without samples that hold NaN or have no stamp: they count as absent."""
    stamped = stream.stamps != MISSING_STAMP
    stream = _kept(stream, stamped, f"{stream.what}_stamps_missing", "have no stamp: dropped")
    finite = np.isfinite(stream.values)
    if not np.any(np.all(finite, axis=1)):
        never = [axis for axis, some in zip(AXES, np.any(finite, axis=0), strict=True) if not some]
        which = f" ({', '.join(never)} never is)" if never else ""
        raise FlightError(
            f"{log.path}: no {stream.what} is a whole set of numbers{which}; check [{stream.what}] of the card"
        )
    whole = np.all(finite, axis=1)
    kept, absent = _kept(stream, whole, f"nan_{stream.what}s", ""), int(np.sum(~whole))
    if not absent:
        return stream
    text = f"{absent} of {len(whole)} rows hold no {stream.what} (blank or NaN): absent samples"
    return replace(kept, notes=(*stream.notes, Note(f"nan_{stream.what}s", text, absent)))


def _in_order(stream: Stream, log: Log) -> Stream:
    """Without samples that are not later than all before them."""
    steps = np.diff(stream.stamps)
    keep = increasing(stream.stamps)
    back = np.zeros(len(keep), dtype=np.bool_)
    back[1:] = stream.stamps[1:] < np.maximum.accumulate(stream.stamps)[:-1]
    if np.sum(steps < 0) > np.sum(steps > 0) or np.sum(back) > len(back) / 2:
        raise FlightError(
            f"{log.path}: the clock of the {stream.what}s runs backwards ({np.sum(steps < 0)} of {len(steps)} steps); "
            f"is `time` of [{stream.what}] the right column?"
        )
    if np.sum(keep) < 2 and len(keep) > 1:
        raise FlightError(
            f"{log.path}: the clock of the {stream.what}s stands still; is `time` of [{stream.what}] the right column "
            "(a header that nobody filled? try log_time)?"
        )
    stream = _kept(stream, ~back, f"{stream.what}_stamps_reversed", "are stamped before their predecessors: dropped")
    return _kept(stream, increasing(stream.stamps), f"{stream.what}_stamps_repeated", "repeat a stamp: dropped")


def _inside_window(stream: Stream, log: Log, card: Card) -> Stream:
    """Commands while the card's window is open; the last one before it closes acts no longer than that."""
    if card.window is None:
        return stream
    values = _window_values(log, card, card.window, stream.stamps)
    open_ = np.nan_to_num(values) != 0
    if not np.any(open_):
        raise FlightError(f"{log.path}: window {card.window.source} is never open during the commands")
    closing = np.append(stream.stamps[~open_], _NEVER)
    until = closing[np.searchsorted(closing, stream.stamps, side="right")]
    why = f"lie where {card.window.source} is zero: dropped"
    return _kept(replace(stream, until=until), open_, "commands_outside_window", why)


def _window_values(log: Log, card: Card, window: Channel, stamps: Stamps) -> Array:
    """The window's column held onto the commands' stamps; NaN before its first value."""
    return _held_onto(log, card, window, stamps, "window")


def reference_of(log: Log, card: Card, stamps: Stamps) -> Array | None:
    """What a position controller was told, held onto stamps.

    Args:
        log: As recorded.
        card: Which column is what; its reference is in the frame of the pose.
        stamps: Where it is wanted, shape (M,) [ns].

    Returns:
        x, y, z, yaw, z up, shape (M, 4), NaN where unknown; None where the card names no reference.

    Raises:
        CardError: A column is not there, or nothing tells its time.
    """
    if not card.reference:
        return None
    values = np.full((stamps.size, len(AXES)), np.nan)
    for axis, channel in card.reference.items():
        values[:, AXES.index(axis)] = _held_onto(log, card, channel, stamps, "reference")
    if card.frame == "NED":
        values = np.stack([values[:, 1], values[:, 0], -values[:, 2], np.pi / 2 - values[:, 3]], axis=1)
    return values


def _held_onto(log: Log, card: Card, channel: Channel, stamps: Stamps, what: str) -> Array:
    """A column held onto the commands' stamps; NaN before its first value."""
    values = column(log, channel)
    if not isinstance(channel.source, str):
        return np.full(stamps.size, values[0])
    clock = stamps_of(log, _clock_of(log, card, channel, what))
    shared = min(len(clock), len(values))
    return held(clock[:shared], values[:shared], stamps)


def _clock_of(log: Log, card: Card, channel: Channel, what: str) -> Channel:
    """Where the stamps of a column are that the card gives no clock.

    They are those of the commands or of the poses where it stands in their table with as many values, else the column
    of its own table that is named as the commands' clock, else `log_time` (messages of autopilots without one).
    """
    count = len(column(log, channel))
    table, (_, name) = split_source(channel.source)[0], split_source(card.command_time.source)
    own = replace(card.command_time, source=f"{table}:{name}" if table else name)
    if table in log.tables and name not in log.tables[table].columns and "log_time" in log.tables[table].columns:
        own = Channel(f"{table}:log_time")
    beside = [time for time in (card.command_time, card.pose_time) if split_source(time.source)[0] == table]
    for time in [*beside, own]:
        if abs(len(stamps_of(log, time)) - count) <= 1:
            return time
    raise CardError(f"{log.path}: nothing tells the time of {what} {channel.source} ({count} values)")


def _without_garbage_start(stream: Stream) -> Stream:
    """Without a first command that the rest of the flight disowns.

    Loggers that start before the controller write what the memory held. Such a sample is told by all of: ten robust
    standard deviations from the median of the others, beyond their extremes by more than their whole range, and more
    than twice as large as any. It is dropped: the first segment begins with the second command, t = 0 stays.
    """
    if len(stream.stamps) < 50:
        return stream
    first, rest = stream.values[0], stream.values[1:]
    median, low, high = np.median(rest, axis=0), np.min(rest, axis=0), np.max(rest, axis=0)
    sigma = 1.4826 * np.median(np.abs(rest - median), axis=0)
    far = np.abs(first - median) > 10 * sigma
    beyond = np.maximum(first - high, low - first) > high - low
    garbage = far & beyond & (np.abs(first) > 2 * np.max(np.abs(rest), axis=0))
    keep = np.ones(len(stream.stamps), dtype=np.bool_)
    keep[0] = not np.any(garbage)
    culprits = ", ".join(f"{axis} = {value:.3g}" for axis, value, bad in zip(AXES, first, garbage, strict=True) if bad)
    why = f"(the first, {culprits}) lie far beyond all others and never recur: dropped"
    return _kept(stream, keep, "garbage_first_command", why)


def _held(stream: Stream, log: Log, card: Card) -> Stream:
    """Commands that act for their hold, or until the next where that comes as soon but for the rounding of stamps."""
    period = median_period(stream.stamps)
    if period is None and card.hold is None:
        raise FlightError(f"{log.path}: there is only one command; is [command] of the card the flown stream?")
    period = period or 0
    if card.hold is None and period > SLOWEST_COMMANDS * 1e9:
        raise FlightError(
            f"{log.path}: commands come every {period / 1e9:.3g} s; add the unit of `time` to [command] of the card, "
            "or `hold` if they do act so long"
        )
    hold = GAP_PERIODS * period if card.hold is None else round(min(card.hold, 1e9) * 1e9)  # int64 ends at 9e18
    until = np.minimum(stream.stamps + hold, stream.until)
    late = stream.stamps[1:] - until[:-1]
    until[:-1] += np.where((late > 0) & (late <= GAP_TOLERANCE * period), late, 0)
    return replace(stream, until=until)
