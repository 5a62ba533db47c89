"""Log + Card -> Flight: commands and pose, each on its own clock, SI, one frame, every repair noted."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from rotorfit.card import Card, Channel, column
from rotorfit.clock import (
    GAP_PERIODS,
    GAP_TOLERANCE,
    MISSING_STAMP,
    Mask,
    Stamps,
    degrees_for_radians,
    fresh,
    held,
    increasing,
    median_period,
    stamps_of,
)
from rotorfit.errors import CardError, FlightError
from rotorfit.frames import AXES, Array, heading_from_world, yaw_from_quaternion
from rotorfit.log import Log


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
class Segment:
    """A stretch in which the commands are known: from its first command to its last plus its hold [s]."""

    start: float
    end: float


@dataclass(frozen=True)
class Flight:
    """Commands and pose of one flight, ready for estimation. Times are seconds from the start of the common window.

    Attributes:
        path: The log's path as given.
        sha256: Hex digest of the log.
        card: The card that was applied.
        span: Start and end that were asked for, within the common window [s].
        axes: The commanded axes, in the order of `AXES`.
        command_time: Strictly increasing stamps, shape (M,) [s]. A command holds until the next one.
        command: x, y, z, yaw commands in the heading frame after the card's scale, shape (M, 4); 0 where not commanded.
        pose_time: Strictly increasing stamps of the fresh poses, shape (N,) [s].
        position: World x, y, z, shape (N, 3) [m].
        yaw: Unwrapped heading, shape (N,) [rad].
        segments: Where the commands are known, in order, not overlapping.
        notes: Every repair, with its count.
    """

    path: str
    sha256: str
    card: Card
    span: tuple[float, float]
    axes: tuple[str, ...]
    command_time: Array
    command: Array
    pose_time: Array
    position: Array
    yaw: Array
    segments: tuple[Segment, ...]
    notes: tuple[Note, ...] = ()

    @property
    def duration(self) -> float:
        """Length of the segments together [s]."""
        return float(np.sum([segment.end - segment.start for segment in self.segments]))


MIN_DURATION = 2.0
"""Shortest flight [s]: what the prediction protocol gives to the filter before it scores."""

_TURN = np.radians(0.5)
_NEVER = np.int64(2**62)


@dataclass(frozen=True)
class _Stream:
    """Commands or poses on their own clock, with what was repaired.

    Attributes:
        what: `command` or `pose`.
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


def flight_from_log(log: Log, card: Card, span: tuple[float | None, float | None] = (None, None)) -> Flight:
    """Takes commands and poses from a log as the card says, repairs them, and cuts them to the common window.

    The common window runs from the first command to the earlier of the last pose and the last command plus its hold.
    Commands hold until the next one, but no longer than `card.hold` (default: three median periods): a longer gap
    starts a new segment. Gaps between poses do not. Commands in the heading frame are x forward, y left, z up, yaw
    counter-clockwise; in the world frame x and y are those of the converted pose (east and north for a card in NED),
    because a card never implies the signs of commands.

    Args:
        log: As recorded.
        card: Which column is what.
        span: Start and end [s] from the start of the common window; None for its ends. Nothing outside is seen.

    Returns:
        The flight, each repair noted with its count.

    Raises:
        CardError: A column is not there, or its length does not go with its stamps.
        FlightError: No commands, no poses, a pose that never changes, a clock that runs backwards, no common window,
            less than two seconds, or yaw in degrees taken for radians.
    """
    commands, axes, origin = _commands(log, card)
    poses = _poses(log, card)
    end = _window_end(log, commands, poses, origin)
    (start, stop), cut = _span(log, span, (end - origin) / 1e9)
    begin, finish = origin + round(start * 1e9), origin + round(stop * 1e9)
    seen = (poses.stamps >= begin) & (poses.stamps <= finish)
    acting = (commands.stamps >= begin) & (commands.stamps < finish)

    pose_time, heading = (poses.stamps[seen] - origin) / 1e9, poses.values[seen, 3]
    yaw = np.unwrap(heading)
    command_time, command = (commands.stamps[acting] - origin) / 1e9, commands.values[acting]
    command_end = np.minimum((commands.until[acting] - origin) / 1e9, stop)
    segments = _segments(command_time, command_end)
    _check_duration(log, segments, pose_time)
    notes = (*cut, *_cut_notes(seen, segments, heading, yaw))
    if card.command_frame == "world":
        command_time, command, note = _in_heading_frame(command_time, command, command_end, pose_time, yaw)
        notes = (*notes, note)
        if "x" in axes or "y" in axes:  # turned, either of them moves the vehicle along both
            axes = tuple(axis for axis in AXES if axis in {*axes, "x", "y"})
    return Flight(
        path=str(log.path),
        sha256=log.sha256,
        card=card,
        span=(start, stop),
        axes=axes,
        command_time=command_time,
        command=command,
        pose_time=pose_time,
        position=poses.values[seen, :3],
        yaw=yaw,
        segments=segments,
        notes=(*(Note("reading", text, 1) for text in log.notes), *commands.notes, *poses.notes, *notes),
    )


def _commands(log: Log, card: Card) -> tuple[_Stream, tuple[str, ...], int]:
    """Repaired commands, the commanded axes, and the stamp of the first command [ns]."""
    stamps, series, notes = _read(log, card.command_time, card.command, "command")
    silent = [axis for axis, values in series.items() if not np.any(np.isfinite(values))]
    if silent and len(silent) < len(series):
        text = f"the command of {', '.join(silent)} is never a number: taken as not commanded"
        notes = (*notes, Note("axis_never_commanded", text, len(stamps)))
        series = {axis: values for axis, values in series.items() if axis not in silent}
    values = np.stack([series.get(axis, np.zeros(len(stamps))) for axis in AXES], axis=1)
    stream = _in_order(_numbers(_Stream("command", stamps, values, np.full(len(stamps), _NEVER), notes), log), log)
    stream = _inside_window(stream, log, card)
    origin = int(stream.stamps[0])
    return _held(_without_garbage_start(stream), log, card), tuple(series), origin


def _poses(log: Log, card: Card) -> _Stream:
    """Repaired poses in the world frame; yaw still wrapped."""
    stamps, series, notes = _read(log, card.pose_time, card.pose, "pose")
    x, y, z = series["x"], series["y"], series["z"]
    if "yaw" in series:
        yaw = series["yaw"]
    else:
        parts = [series[f"q{part}"] for part in "wxyz"]
        lost = np.sum(np.square(parts), axis=0) < 1e-6  # mocap bridges write zeros while the body is out of sight
        yaw = np.where(lost, np.nan, yaw_from_quaternion(*parts))
    if card.frame == "NED":
        x, y, z, yaw = y, x, -z, np.pi / 2 - yaw
    values = np.stack([x, y, z, yaw], axis=1)
    stream = _in_order(_numbers(_Stream("pose", stamps, values, np.full(len(stamps), _NEVER), notes), log), log)
    stream = _kept(stream, fresh(stream.values), "stale_poses", "repeat the pose before with a fresh stamp: dropped")
    if len(stream.stamps) < 2:
        raise FlightError(f"{log.path}: the pose never changes; is [pose] of the card the flown vehicle?")
    if "yaw" in series and degrees_for_radians(stream.stamps, stream.values[:, 3]):
        raise FlightError(
            f"{log.path}: yaw jumps or turns as no vehicle can: degrees taken for radians? Write yaw = {{ from = "
            f'"{card.pose["yaw"].source}", unit = "deg" }} in [pose] of the card'
        )
    return stream


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


def _kept(stream: _Stream, keep: Mask, code: str, why: str) -> _Stream:
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


def _numbers(stream: _Stream, log: Log) -> _Stream:
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
    return _kept(stream, np.all(finite, axis=1), f"nan_{stream.what}s", "are not numbers: taken as absent")


def _in_order(stream: _Stream, log: Log) -> _Stream:
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


def _inside_window(stream: _Stream, log: Log, card: Card) -> _Stream:
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
    """The window's column held onto the commands' stamps; NaN before its first value.

    Its clock is that of the commands or of the poses where it stands in their table with as many values, else the
    column of its own table that is named as the commands' clock.
    """
    values = column(log, window)
    table, _, _ = str(window.source).rpartition(":")
    name = str(card.command_time.source).rpartition(":")[2]
    own = replace(card.command_time, source=f"{table}:{name}" if table else name)
    beside = [time for time in (card.command_time, card.pose_time) if str(time.source).rpartition(":")[0] == table]
    for time in [*beside, own]:
        clock = stamps_of(log, time)
        if abs(len(clock) - len(values)) <= 1:
            break
    else:
        raise CardError(f"{log.path}: nothing tells the time of window {window.source} ({len(values)} values)")
    shared = min(len(clock), len(values))
    return held(clock[:shared], values[:shared], stamps)


def _without_garbage_start(stream: _Stream) -> _Stream:
    """Without a first command that the rest of the flight disowns.

    Loggers that start before the controller write what the memory held. Such a sample is told by all of: ten robust
    standard deviations from the median of the others, beyond their extremes by more than their whole range, and
    larger than any. It is dropped; the first segment begins with the second command, the common window where it did.
    """
    if len(stream.stamps) < 50:
        return stream
    first, rest = stream.values[0], stream.values[1:]
    median, low, high = np.median(rest, axis=0), np.min(rest, axis=0), np.max(rest, axis=0)
    sigma = 1.4826 * np.median(np.abs(rest - median), axis=0)
    far = np.abs(first - median) > 10 * sigma
    beyond = np.maximum(first - high, low - first) > high - low
    garbage = far & beyond & (np.abs(first) > np.maximum(np.abs(low), np.abs(high)))
    keep = np.ones(len(stream.stamps), dtype=np.bool_)
    keep[0] = not np.any(garbage)
    culprits = ", ".join(f"{axis} = {value:.3g}" for axis, value, bad in zip(AXES, first, garbage, strict=True) if bad)
    why = f"(the first, {culprits}) lie far beyond all others and never recur: dropped"
    return _kept(stream, keep, "garbage_first_command", why)


def _held(stream: _Stream, log: Log, card: Card) -> _Stream:
    """Commands that act for their hold, or until the next where that comes as soon but for the rounding of stamps."""
    period = median_period(stream.stamps)
    if period is None and card.hold is None:
        raise FlightError(f"{log.path}: there is only one command; is [command] of the card the flown stream?")
    period = period or 0
    hold = GAP_PERIODS * period if card.hold is None else round(card.hold * 1e9)
    until = np.minimum(stream.stamps + hold, stream.until)
    late = stream.stamps[1:] - until[:-1]
    until[:-1] += np.where((late > 0) & (late <= GAP_TOLERANCE * period), late, 0)
    return replace(stream, until=until)


def _window_end(log: Log, commands: _Stream, poses: _Stream, origin: int) -> int:
    """End of the common window [ns]."""
    end = min(int(poses.stamps[-1]), int(commands.until[-1]))
    if max(origin, int(poses.stamps[0])) >= end:
        spans = [f"{s.what}s {s.stamps[0] / 1e9:.3f} to {s.stamps[-1] / 1e9:.3f} s" for s in (commands, poses)]
        raise FlightError(
            f"{log.path}: {' and '.join(spans)} have no time in common: two clocks (try log_time in the card), "
            "or a time column without its unit?"
        )
    return end


def _span(
    log: Log, span: tuple[float | None, float | None], duration: float
) -> tuple[tuple[float, float], tuple[Note, ...]]:
    """The span within the common window [s], and a note where it was cut to it."""
    start, stop = (default if given is None else given for given, default in zip(span, (0.0, duration), strict=True))
    inside = max(start, 0.0), min(stop, duration)
    if not inside[0] < inside[1]:
        raise FlightError(f"{log.path}: span {start:g}:{stop:g} holds nothing of the common window, 0:{duration:.2f} s")
    if inside == (start, stop):
        return inside, ()
    text = f"the span {start:g}:{stop:g} reaches out of the common window and was cut to it, 0:{duration:.2f} s"
    return inside, (Note("span_cut", text, 1),)


def _segments(command_time: Array, command_end: Array) -> tuple[Segment, ...]:
    """Runs of commands in which each acts until the next comes."""
    first = np.ones(len(command_time), dtype=np.bool_)
    first[1:] = command_time[1:] > command_end[:-1]
    last = np.append(first[1:], True)
    runs = zip(command_time[first], command_end[last if len(first) else first], strict=True)
    return tuple(Segment(float(start), float(end)) for start, end in runs)


def _check_duration(log: Log, segments: tuple[Segment, ...], pose_time: Array) -> None:
    first, last = (float(pose_time[0]), float(pose_time[-1])) if len(pose_time) else (0.0, 0.0)
    duration = sum(max(0.0, min(part.end, last) - max(part.start, first)) for part in segments)
    if duration < MIN_DURATION:
        raise FlightError(
            f"{log.path}: only {duration:.2f} s with both commands and a moving pose; at least {MIN_DURATION:g} s are "
            "needed (a wider --span? a unit for `time` in the card?)"
        )


def _cut_notes(seen: Mask, segments: tuple[Segment, ...], heading: Array, yaw: Array) -> tuple[Note, ...]:
    """What was cut and unwrapped."""
    outside, gaps = int(np.sum(~seen)), len(segments) - 1
    longest = max((b.start - a.end for a, b in pairwise(segments)), default=0.0)
    turns = int(np.sum(np.abs(np.diff(yaw - heading)) > np.pi))
    notes = (
        Note("poses_outside", f"{outside} of {len(seen)} poses lie outside the common window or the span", outside),
        Note("command_gaps", f"{gaps} gaps in the commands, without any for up to {longest:.3f} s, split it", gaps),
        Note("yaw_unwrapped", f"{turns} jumps of yaw by a whole turn were unwrapped", turns),
    )
    return tuple(note for note in notes if note.count)


def _in_heading_frame(
    command_time: Array, command: Array, command_end: Array, pose_time: Array, yaw: Array
) -> tuple[Array, Array, Note]:
    """World commands resolved in the heading frame, with commands added where the vehicle turns under a held one."""
    held = np.searchsorted(command_time, pose_time, side="right") - 1
    acting = (held >= 0) & (pose_time < command_end[np.maximum(held, 0)])
    at_command = np.interp(command_time, pose_time, yaw).tolist()
    added, last, reference = [], -1, 0.0
    for k, (index, angle) in enumerate(zip(held.tolist(), yaw.tolist(), strict=True)):
        if not acting[k]:
            continue
        if index != last:
            last, reference = index, at_command[index]
        if abs(angle - reference) > _TURN:
            added.append(k)
            reference = angle
    time = np.concatenate([command_time, pose_time[added]])
    order = np.argsort(time, kind="stable")
    time, values = time[order], np.concatenate([command, command[held[added]]])[order]
    turned = heading_from_world(values[:, :2], np.interp(time, pose_time, yaw))
    text = f"{len(command)} world commands were resolved by the measured yaw, {len(added)} added where it turned"
    return time, np.hstack([turned, values[:, 2:]]), Note("world_commands", text, len(added))
