"""Streams: the commands and poses of a log, each on its own clock and in order; every repair noted."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from rotorfit.core.card import Card, Channel
from rotorfit.core.display import counted
from rotorfit.core.errors import CardError, FlightError
from rotorfit.core.flight_data import Note
from rotorfit.core.frames import AXES, Array, Mask, yaw_from_quaternion
from rotorfit.core.log import Log
from rotorfit.flights.columns import column, split_source
from rotorfit.flights.command_window import conditions, idle_ends, resets
from rotorfit.flights.other_tables import (
    held_beside,
    interpolate,
    is_beside,
    rows_of_others,
    sample_rows,
    sampled,
    sound_samples,
    state_samples,
    whole_rows,
)
from rotorfit.flights.stamps import (
    GAP_PERIODS,
    MISSING_STAMP,
    ClockDrift,
    Stamps,
    coarse,
    degrees_for_radians,
    drift,
    fresh,
    held,
    increasing,
    median_period,
    rounded_repeats,
    rows_of_slower,
    set_back,
    stamps_of,
    stray,
)
from rotorfit.flights.wild_poses import RARE, unwrapped, wild

SLOWEST_COMMANDS = 5.0
"""Median period of the commands [s] above which the unit of their clock is taken to be missing."""

LARGEST = 1e12
"""Magnitude in metres, radians or commands above which a value is invalid: its square would lose all precision."""

BRIDGED = 10_000_000
"""Time beyond its hold [ns] for which a command still acts until the next: anything else acting so briefly moves
nothing measurable, and splitting the flight there costs the 0.6 s that a segment needs to start."""

NEVER = np.int64(2**62)
"""End time of a sample that acts until the next one [ns]."""

OTHER = 0.01
"""Share of the samples with a stamp of an earlier one that must differ from it: commands seldom change within a step of
the clock, poses always do."""

_STRETCHED = 1.15
"""Ratio of the longest to the shortest of the common lengths of a quaternion, above which it is none."""


@dataclass(frozen=True)
class Stream:
    """Commands, poses or velocities on their own clock, with their repairs.

    Attributes:
        what: `command`, `pose` or `velocity`.
        stamps: Shape (N,) [ns].
        values: Shape (N, 4): x, y, z, yaw.
        until: Time until which a command acts without a successor, shape (N,) [ns].
        notes: Repairs so far.
        step: Step of the clock where most samples share a stamp [s]; 0 where it tells them apart.
        repeating: Period of rows that each hold the latest of slower poses [s]; 0 where poses have their own.
    """

    what: str
    stamps: Stamps
    values: Array
    until: Stamps
    notes: tuple[Note, ...] = ()
    step: float = 0.0
    repeating: float = 0.0


def commands_of(log: Log, card: Card) -> tuple[Stream, tuple[str, ...], int]:
    """Takes the commands from a log according to the card, and repairs them.

    Args:
        log: As recorded.
        card: The meaning of each column.

    Returns:
        The commands, 0 where not commanded; the commanded axes in the order of `AXES`; and the stamp of the first
        command [ns], which starts the common window even where that command is dropped as garbage.

    Raises:
        CardError: A column is missing, or its length does not match its stamps.
        FlightError: No commands, a clock that runs backwards or lacks its unit, a window that is never open.
    """
    stamps, series, notes = read_series(log, card.command_time, card.command, "command")
    series, silent = _commanded(series)
    values = np.stack([series.get(axis, np.zeros(len(stamps))) for axis in AXES], axis=1)
    stream = Stream("command", stamps, values, np.full(len(stamps), NEVER), (*notes, *silent))
    silence = ~np.all(np.isfinite(values), axis=1) & (stamps != MISSING_STAMP)
    if split_source(card.command_time.source)[0] != split_source(card.pose_time.source)[0]:
        # a message without a number ends the command before it; in a table shared with poses it is a blank
        stream = closed(stream, stamps[silence & ~rows_of_others(log, card)[: len(stamps)]])
    stream = _inside_window(in_order(numbers(stream, log), log), log, card)
    origin = int(stream.stamps[0])
    stream = _without_idle_ends(_without_garbage_start(stream))
    return _held(stream, log, card), tuple(series), origin


def poses_of(log: Log, card: Card) -> Stream:
    """Takes the poses from a log according to the card, and repairs them.

    Args:
        log: As recorded.
        card: The meaning of each column.

    Returns:
        The fresh poses, world frame, z up [m, rad]; yaw still wrapped; 0 for axes that have only a velocity.

    Raises:
        CardError: A column is missing, or its length does not match its stamps.
        FlightError: No poses, one that never changes, a clock that runs backwards, yaw in degrees taken for radians.
    """
    stamps, series, notes = read_series(log, card.pose_time, card.pose, "pose")
    x, y, z = (series.get(axis, np.zeros(len(stamps))) for axis in AXES[:3])
    yaw = series["yaw"] if "yaw" in series else _heading(log, *(series[f"q{part}"] for part in "wxyz"))
    yaw = yaw + card.heading_offset
    drawn_ = {axis for axis, channel in card.pose.items() if is_beside(card.pose_time, channel)}
    own = [axis in ("x", "y", "z", "yaw") and axis not in drawn_ for axis in AXES]
    own[3] = own[3] and "qw" not in drawn_
    if card.frame == "NED":
        x, y, z, yaw, own = y, x, -z, np.pi / 2 - yaw, [own[1], own[0], *own[2:]]
    values = np.stack([x, y, z, yaw], axis=1)
    stream = in_order(numbers(Stream("pose", stamps, values, np.full(len(stamps), NEVER), notes), log), log)
    seen = stream.values[:, own] if any(own) else stream.values  # values interpolated from other tables are never stale
    if not (coarse(seen) if card.velocity_only else rounded_repeats(seen)):  # else what is left would lead the motion
        stream = replace(stream, repeating=rows_of_slower(stream.stamps, ~fresh(seen)))
        stream = keep_samples(stream, fresh(seen), "stale_poses", "repeat the pose before with a fresh stamp: dropped")
    if len(stream.stamps) < 2 or not (card.velocity_only or np.any(np.ptp(seen, axis=0))):
        raise FlightError(f"{log.path}: the pose never changes; is [pose] of the card the flown vehicle?")
    if "yaw" in series and degrees_for_radians(stream.stamps, stream.values[:, 3]):
        raise FlightError(
            f"{log.path}: yaw jumps or turns as no vehicle can: degrees taken for radians? Write yaw = {{ from = "
            f'"{card.pose["yaw"].source}", unit = "deg" }} in [pose] of the card'
        )
    return _without_wild_poses(stream)


def _without_wild_poses(stream: Stream) -> Stream:
    """The poses without the wild ones; all of them, with a note, where these are not rare."""
    strays = wild((stream.stamps - stream.stamps[0]) / 1e9, stream.values)
    why = "lie where no vehicle can be a moment later"
    if np.mean(strays) <= RARE:
        return keep_samples(stream, ~strays, "wild_poses", f"{why}: left out")
    count = int(np.sum(strays))
    text = f"{count} of {len(strays)} poses {why}: too many to be left out; check units, or --method robust"
    return replace(stream, notes=(*stream.notes, Note("wild_poses_kept", text, count)))


def recorder_clock(log: Log, time: Channel, channels: Mapping[str, Channel]) -> ClockDrift | None:
    """The recorder's `log_time` against the `header.stamp` of a stream's samples; None where one of them is missing.

    Args:
        log: As recorded.
        time: The stream's clock; both stamps are looked up in its table.
        channels: The stream's channels.

    Raises:
        CardError: A column is missing.
    """
    name = split_source(time.source)[0]
    table = log.tables.get(name) or (next(iter(log.tables.values())) if len(log.tables) == 1 else None)
    if table is None or not {"header.stamp", "log_time"} <= table.columns.keys():
        return None
    prefix = f"{table.name}:" if len(log.tables) > 1 else ""
    rows = sample_rows(log, time, channels)
    header, recorded = (stamps_of(log, Channel(prefix + column)) for column in ("header.stamp", "log_time"))
    return drift(header[rows], recorded[rows])


def read_series(
    log: Log, time: Channel, channels: Mapping[str, Channel], what: str
) -> tuple[Stamps, dict[str, Array], tuple[Note, ...]]:
    """Stamps and series of equal length; series in other tables are held or interpolated onto the stamps."""
    stamps, series, notes = _own(log, time, channels, what)
    others = {name: channel for name, channel in channels.items() if is_beside(time, channel)}
    if not others:
        return stamps, series, notes
    if what == "command":
        series |= {axis: held_beside(log, time, channel, stamps) for axis, channel in others.items()}
    else:
        found = {axis: sampled(log, time, channel) for axis, channel in others.items() if axis in AXES}
        if "qw" in others:
            clock, parts = whole_rows(log, time, [others[f"q{part}"] for part in "wxyz"])
            found["yaw"] = sound_samples(clock, _heading(log, *parts))
        if "yaw" in found:
            clock, headings = found["yaw"]
            found["yaw"] = clock, unwrapped((clock - clock[:1]) / 1e9, headings)
        series |= {axis: interpolate(clock, values, stamps) for axis, (clock, values) in found.items()}
    names = list(dict.fromkeys("quaternion" if name.startswith("q") else name for name in others))
    return stamps, series, (*notes, joined_note(what, names, len(stamps)))


def joined_note(what: str, names: Sequence[str], count: int) -> Note:
    """That some series of a stream come from another table than its time."""
    how = "held" if what == "command" else "drawn between samples"
    kind = "velocities" if what == "velocity" else f"{what}s"
    text = f"{', '.join(names)} of {count} {kind} come from another table than its time: {how}"
    return Note(f"joined_{what}", text, count)


def _own(
    log: Log, time: Channel, channels: Mapping[str, Channel], what: str
) -> tuple[Stamps, dict[str, Array], tuple[Note, ...]]:
    """Stamps and series of one table; a surplus last sample is dropped: dropping the first would add a delay."""
    stamps = stamps_of(log, time)
    own = {name: channel for name, channel in channels.items() if not is_beside(time, channel)}
    series = {name: column(log, channel, len(stamps)) for name, channel in own.items()}
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


def _commanded(series: dict[str, Array]) -> tuple[dict[str, Array], tuple[Note, ...]]:
    """Drops axes that are rarely or never commanded while the others are: autopilots mark them with NaN."""
    notes: list[Note] = []
    for axis in list(series):
        others = [values for name, values in series.items() if name != axis]
        rest = np.all(np.isfinite(others), axis=0) if others else np.zeros(0, dtype=np.bool_)
        missing = int(np.sum(rest & ~np.isfinite(series[axis]))) if others else 0
        if missing > np.sum(rest) / 2 or (others and not np.any(np.isfinite(series[axis]))):
            series = {name: values for name, values in series.items() if name != axis}
            text = f"the command of {axis} is never a number: taken as not commanded"
            if missing and missing < np.sum(rest):
                text = f"the command of {axis} is a number in {np.sum(rest) - missing} of {np.sum(rest)} commands"
                text += " of the other axes: taken as not commanded"
            notes.append(Note("axis_never_commanded", text, missing or len(rest)))
    return series, tuple(notes)


def _heading(log: Log, w: Array, x: Array, y: Array, z: Array) -> Array:
    """Yaw of quaternions, NaN where there is none: mocap bridges write zeros while the body is occluded.

    Raises:
        FlightError: Their length varies: the four columns belong to different things.
    """
    parts = np.array([w, x, y, z])
    size = np.max(np.abs(parts), axis=0)
    there = (size > 1e-3) & (size < 1e6)
    shortest, longest = np.quantile(np.linalg.norm(parts[:, there], axis=0), [0.05, 0.95]) if any(there) else (1.0, 1.0)
    if longest > _STRETCHED * shortest:
        raise FlightError(
            f"{log.path}: the four columns of the quaternion are no rotation: their length varies from {shortest:.3g} "
            f"to {longest:.3g}. Name w, x, y, z of one orientation in [pose] of the card"
        )
    return np.where(there, yaw_from_quaternion(*np.where(there, parts, 0.0)), np.nan)


def keep_samples(stream: Stream, keep: Mask, code: str, why: str) -> Stream:
    """Keeps the samples in a mask, shape (N,), with a note if any are dropped: `COUNT of N WHATs WHY`."""
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


def numbers(stream: Stream, log: Log) -> Stream:
    """Drops samples without a number or a stamp: they count as absent.

    Raises:
        FlightError: No sample is left.
    """
    stamped = stream.stamps != MISSING_STAMP
    complete = np.all(np.abs(stream.values) <= LARGEST, axis=1)
    if np.any(complete) and not np.any(complete & stamped):
        raise FlightError(
            f"{log.path}: none of {np.sum(complete)} {stream.what}s has a stamp; check time in [{stream.what}] of the "
            "card"
        )
    stream = keep_samples(stream, stamped, f"{stream.what}_stamps_missing", "have no stamp: dropped")
    finite = np.abs(stream.values) <= LARGEST
    if not np.any(np.all(finite, axis=1)):
        never = [axis for axis, some in zip(AXES, np.any(finite, axis=0), strict=True) if not some]
        which = f" ({', '.join(never)} always missing)" if never else ""
        raise FlightError(f"{log.path}: no {stream.what} is complete{which}; check [{stream.what}] of the card")
    whole = np.all(finite, axis=1)
    numbers, absent = keep_samples(stream, whole, f"nan_{stream.what}s", ""), int(np.sum(~whole))
    if not absent:
        return stream
    text = f"{absent} of {len(whole)} rows hold no {stream.what} (blank, NaN or beyond {LARGEST:g}): absent samples"
    return replace(numbers, notes=(*stream.notes, Note(f"nan_{stream.what}s", text, absent)))


def in_order(stream: Stream, log: Log) -> Stream:
    """Sorts samples by their stamps; drops those with a stray one, those that no sorting can place, and repeats.

    Raises:
        FlightError: The clock runs backwards or stands still.
    """
    stream = keep_samples(
        stream, ~stray(stream.stamps), f"{stream.what}_stamps_stray", "are stamped far from their neighbours: dropped"
    )
    steps = np.diff(stream.stamps)
    back = set_back(stream.stamps)
    if np.sum(steps < 0) > np.sum(steps > 0) or np.sum(back) > len(back) / 2:
        raise FlightError(
            f"{log.path}: the clock of the {stream.what}s runs backwards ({np.sum(steps < 0)} of {len(steps)} steps); "
            f"is `time` of [{stream.what}] the right column?"
        )
    if len(back) > 1 and not np.any(steps):
        raise FlightError(
            f"{log.path}: the clock of the {stream.what}s stands still; is `time` of [{stream.what}] the right column "
            "(a header that nobody filled? try log_time)?"
        )
    stream = keep_samples(
        stream, ~back, f"{stream.what}_stamps_reversed", "are stamped before their predecessors: dropped"
    )
    stream = _sorted(stream)
    stream = replace(stream, step=_step(stream.stamps, stream.values))
    return keep_samples(stream, increasing(stream.stamps), f"{stream.what}_stamps_repeated", "repeat a stamp: dropped")


def _step(stamps: Stamps, values: Array) -> float:
    """Step of a clock that most samples share a stamp of [s]; 0 where it tells them apart.

    Copies do not count: a command that stands with its own stamp in several rows of poses is the same sample.

    Args:
        stamps: Not decreasing, shape (N,) [ns].
        values: Shape (N, K).
    """
    first = increasing(stamps)
    rows = np.flatnonzero(~first)
    if not 1 < np.sum(first) < rows.size:
        return 0.0
    kept = np.flatnonzero(first)[np.cumsum(first)[rows] - 1]
    other = np.any(values[rows] != values[kept], axis=1)
    return float(np.median(np.diff(stamps[first]))) / 1e9 if np.mean(other) > OTHER else 0.0


def _sorted(stream: Stream) -> Stream:
    """Puts samples that were written late where their stamps belong."""
    late = int(np.sum(stream.stamps < np.maximum.accumulate(stream.stamps)))
    if not late:
        return stream
    order = np.argsort(stream.stamps, kind="stable")
    text = f"{late} of {len(order)} {stream.what}s are written after later ones: sorted by their stamps"
    return replace(
        stream,
        stamps=stream.stamps[order],
        values=stream.values[order],
        until=stream.until[order],
        notes=(*stream.notes, Note(f"{stream.what}_stamps_sorted", text, late)),
    )


def _inside_window(stream: Stream, log: Log, card: Card) -> Stream:
    """Commands while the card's window is open; the last one before it closes acts only until then."""
    stamps = stream.stamps
    for why, open_ in conditions(log, card, stamps):
        if not np.any(open_[np.isin(stamps, stream.stamps)]):
            raise FlightError(f"{log.path}: the window is never open: during all remaining commands {why}")
        stream = closed(stream, stamps[~open_])
        stream = keep_samples(
            stream, open_[np.isin(stamps, stream.stamps)], "commands_outside_window", f"lie where {why}: dropped"
        )
    steps = resets(log, card, stamps)
    if not steps.size:
        return stream
    note = Note(
        "pose_resets",
        f"{counted(steps.size, 'step')} in the pose, made by the estimator: the flight is split there",
        steps.size,
    )
    return replace(closed(stream, steps - 1), notes=(*stream.notes, note))  # also where a command bears that stamp


def closed(stream: Stream, stamps: Stamps) -> Stream:
    """A stream whose samples act no longer than until the next of these stamps, shape (M,) [ns]."""
    closing = np.append(np.sort(stamps), NEVER)
    until = closing[np.searchsorted(closing, stream.stamps, side="right")]
    return replace(stream, until=np.minimum(stream.until, until))


def reference_of(log: Log, card: Card, stamps: Stamps) -> Array | None:
    """The setpoint of a position controller, held onto stamps.

    Args:
        log: As recorded.
        card: The meaning of each column; its reference is in the frame of the pose.
        stamps: Where it is evaluated, shape (M,) [ns].

    Returns:
        x, y, z, yaw, z up, shape (M, 4) [m, rad], NaN where unknown; None where the card names no reference.

    Raises:
        CardError: A column is missing, or has no clock.
    """
    if not card.reference:
        return None
    values = np.full((stamps.size, len(AXES)), np.nan)
    for axis, channel in card.reference.items():
        if not isinstance(channel.source, str):
            values[:, AXES.index(axis)] = column(log, channel)[0]
            continue
        clock, series = state_samples(log, card, channel, "reference")
        values[:, AXES.index(axis)] = held(clock, series, stamps)
    if card.frame == "NED":
        values = np.stack([values[:, 1], values[:, 0], -values[:, 2], np.pi / 2 - values[:, 3]], axis=1)
    return values


def _without_garbage_start(stream: Stream) -> Stream:
    """Drops a first command that is an outlier against the rest of the flight.

    Loggers that start before the controller write uninitialised memory. Such a sample fulfils all of: ten robust
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
    return keep_samples(stream, keep, "garbage_first_command", why)


def _without_idle_ends(stream: Stream) -> Stream:
    """Drops the first and last commands that were logged while a continuously changing controller was not running."""
    idle = idle_ends(stream.stamps, stream.values)
    stream = closed(stream, stream.stamps[idle])
    return keep_samples(
        stream, ~idle, "idle_commands", "are constant at the ends but change all the time in between: dropped"
    )


def _held(stream: Stream, log: Log, card: Card) -> Stream:
    """Sets how long each command acts: for its hold, or to the next where that comes at most milliseconds after it.

    Raises:
        FlightError: A single command without a hold in the card, or commands too slow for their clock's unit.
    """
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
    timed_out = stream.until[:-1] >= stream.stamps[1:]  # nothing but time has ended the command
    until[:-1] += np.where(timed_out & (late > 0) & (late <= BRIDGED), late, 0)
    return replace(stream, until=until)
