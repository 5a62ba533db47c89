"""Log + Card -> Flight: commands and poses, each on its own clock, SI, one frame, every repair noted.

Commands that a vehicle on the ground does not follow, climb before take-off or descent after landing, are dropped.
"""

import math
from collections.abc import Iterator
from itertools import pairwise

import numpy as np

from rotorfit.core.card import Card
from rotorfit.core.display import counted
from rotorfit.core.errors import FlightError
from rotorfit.core.flight_data import ANSWER, MIN_DURATION, SLOWEST_POSES, Clocks, Flight, Note, Segment
from rotorfit.core.frames import AXES, Array, Indices, Mask, heading_from_world
from rotorfit.core.log import Log
from rotorfit.files.cards import refuse_shared
from rotorfit.flights.clocks.arrival import with_sound_stamps
from rotorfit.flights.clocks.sender_drift import on_the_recorders_clock
from rotorfit.flights.clocks.two_clocks import ANSWER_HALF, on_one_clock
from rotorfit.flights.columns import unit_note
from rotorfit.flights.command_hold import with_judged_hold
from rotorfit.flights.drawn_lines import period_of_lines
from rotorfit.flights.low_pass import without_low_pass
from rotorfit.flights.onboard_velocity import in_the_world, velocities_of, with_travel
from rotorfit.flights.other_tables import sample_rows
from rotorfit.flights.recordings import longest_recording
from rotorfit.flights.several_files import bound
from rotorfit.flights.stamps import Stamps, median_period, stamps_of
from rotorfit.flights.streams import Stream, closed, commands_of, keep_samples, poses_of, reference_of
from rotorfit.flights.wild_poses import unwrapped

LEAST = 1.0
"""Time for which a command must have no response [s]: delays of velocity-commanded vehicles are below half of it."""

ASKED = 0.3
"""Climb or descent commanded in that time [m]."""

STILL = 0.05
"""Change of height in that time that is no response [m]: a loop with a time constant of 1 s moves twice as far."""

LEVEL = 0.15
"""Change of height that still counts as standing [m]: onboard heights drift by a tenth of a metre in a few seconds."""

LOW = 0.25
"""Share of the flight's height range, from its lowest point, in which the ground may lie: over a minute onboard heights
drift by more than half a metre."""


def airborne(commands: Stream, poses: Stream, card: Card) -> Stream:
    """Drops the commands found by `standing`; keeps all where the card does not give the climb rate in m/s."""
    factor = _climb(card)
    if factor is None:
        return commands
    ground = standing(commands.stamps, factor * commands.values[:, 2], poses.stamps, poses.values[:, 2])
    commands = closed(commands, commands.stamps[ground])
    return keep_samples(
        commands, ~ground, "commands_on_ground", "ask to climb or sink of a vehicle on the ground: dropped"
    )


def _climb(card: Card) -> float | None:
    """Climb rate for a vertical command of 1 [m/s]; None where the card does not say."""
    channel = card.command.get("z")
    if channel is None or channel.meaning not in ("velocity", "vertical_speed"):
        return None
    return 1.0 if channel.full_scale is None else card.limits.get(channel.full_scale)


def standing(command_time: Stamps, climb: Array, pose_time: Stamps, height: Array) -> Mask:
    """Which commands lie before the take-off or after the landing, shape (M,).

    Before take-off: from the first command on the height stays low and within `LEVEL`, then leaves upwards; meanwhile
    the commands ask for a climb of `ASKED` metres in `LEAST` seconds without a response. After landing: the same
    backwards from the end, with commands that ask for a descent. A vehicle in the air would have moved.

    Args:
        command_time: Increasing, shape (M,) [ns].
        climb: Vertical command, up positive, shape (M,) [m/s].
        pose_time: Increasing, shape (N,) [ns].
        height: Shape (N,) [m].
    """
    ground = np.zeros(len(command_time), dtype=np.bool_)
    seen = (pose_time >= command_time[0]) & (pose_time <= command_time[-1])
    if np.sum(seen) < 2:
        return ground
    time, level = pose_time[seen], height[seen]
    for sign in (1, -1):
        index = np.arange(len(time))[::sign]
        stays = _stay(level[index])
        low = level[index[0]] <= np.min(level) + max(LEVEL, LOW * float(np.ptp(level)))
        if stays == len(time) or not low or level[index[stays]] < level[index[0]]:
            continue
        edge = time[index[stays]]
        part = command_time < edge if sign == 1 else command_time > edge
        stood = index[:stays][::sign]
        if _unanswered(command_time[part], sign * climb[part], time[stood], level[stood]):
            ground |= part
    return ground


def _unanswered(command_time: Stamps, climb: Array, time: Stamps, level: Array) -> bool:
    """Whether commands that ask for `ASKED` metres in `LEAST` seconds left the height unchanged."""
    ends = np.searchsorted(command_time, command_time + round(LEAST * 1e9))
    steps = np.diff(command_time, append=command_time[-1:]) / 1e9
    way = np.concatenate([[0.0], np.cumsum(climb * steps)])
    for first, last in enumerate(ends.tolist()):
        if last == len(command_time):
            return False
        if way[last] - way[first] >= ASKED:
            during = level[(time >= command_time[first]) & (time <= command_time[last])]
            if during.size > 1 and np.ptp(during) < STILL:
                return True
    return False


def _stay(level: Array) -> int:
    """Number of heights, from the first on, that stay within `LEVEL` of each other."""
    spread = np.maximum.accumulate(level) - np.minimum.accumulate(level)
    left: Indices = np.flatnonzero(spread > LEVEL)
    return int(left[0]) if left.size else len(level)


SHARED = 0.9
"""Least share of rows that hold both a command and a pose where rows are shared: the first ones may lack what had not
come yet, and cameras lose the vehicle."""

LEADING = 2
"""Least number of rows with a command before the first pose from which on rows are those of the commands: a single pose
may be missing anywhere."""

_TURN = np.radians(0.5)

ACTS_AFTER = 0.15
"""Time after which a command acts [s], 0.05 to 0.3 s on multirotors, for turning it from the world into the heading."""


def flight_from_log(log: Log, card: Card, span: tuple[float | None, float | None] = (None, None)) -> Flight:
    """Takes commands and poses from a log according to the card, repairs them, and cuts them to the common window.

    The common window runs from the first command to the earlier of the last pose and the last command plus its hold.
    A command is held until the next one, but no longer than `card.hold` (by default three median periods, or longer if
    the motion shows it, see `command_hold`): a longer gap starts a new segment. Gaps between poses do not.

    Where commands and poses are from two files, the commands are first brought onto the clock of the poses.

    Args:
        log: As recorded.
        card: The meaning of each column. Commands in the world frame are along the axes of the converted pose (x east,
            y north, z up also for a card in NED), because a card never implies their signs.
        span: Start and end [s] from the start of the common window; None for its ends. Data outside are ignored.

    Returns:
        The flight, each repair noted with its count.

    Raises:
        CardError: A column is missing or read in two roles, or its length does not match its stamps.
        FlightError: No commands, no poses, a pose that never changes, a clock that runs backwards, no common window,
            an empty span, less than two seconds, poses more than a second apart, clocks of two files without a known
            offset, or yaw in degrees taken for radians.
    """
    written, card = card, bound(card, log)
    channels = (("command", card.command), ("pose", card.pose), ("velocity", card.velocity))
    refuse_shared({f"[{part}] {axis}": one for part, known in channels for axis, one in known.items()}, str(log.path))
    units = unit_note(written, card)
    log, chosen = longest_recording(log, card)
    log, stamped, unseen = with_sound_stamps(log, card)
    log, corrected, stamp_error = on_the_recorders_clock(log, card)
    log, clocks = on_one_clock(log, card)
    commands, axes, origin = commands_of(log, card)
    poses, velocities = poses_of(log, card), velocities_of(log, card)
    lead = period_of_lines(commands.stamps, commands.values) / 2 if _on_rows_of_poses(log, card) else 0.0
    commands = with_judged_hold(log, card, commands, axes, poses)
    commands = without_low_pass(commands, axes, poses, card.command_frame == "world")
    commands = airborne(commands, poses, card)
    end = _window_end(log, commands, poses, origin)
    (start, stop), cut = _span(log, span, (end - origin) / 1e9)
    begin, finish = origin + round(start * 1e9), origin + round(stop * 1e9)
    seen = (poses.stamps >= begin) & (poses.stamps <= finish)
    acting = (commands.stamps >= begin) & (commands.stamps < finish)

    pose_time, heading = (poses.stamps[seen] - origin) / 1e9, poses.values[seen, 3]
    yaw = unwrapped(pose_time, heading)
    command_time, command = (commands.stamps[acting] - origin) / 1e9, commands.values[acting]
    command_end = np.minimum((commands.until[acting] - origin) / 1e9, stop)
    segments = _segments(command_time, command_end)
    _check_duration(log, segments, pose_time)
    late, seen_late = _lateness(log, card)
    notes = (
        *([Note("units", units, 1)] if units else []),
        *chosen,
        *stamped,
        *corrected,
        *_clock_notes(clocks, len(commands.stamps)),
        *_error_notes(card),
        *cut,
        *_cut_notes(seen, segments, heading, yaw),
    )
    position, velocity = poses.values[seen, :3], None
    if velocities is not None:
        velocity = in_the_world(velocities, card, origin, pose_time, yaw).between(start, stop)
        position, told = with_travel(log, position, pose_time, velocity)
        notes = (*velocities.notes, *notes, *told)
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
        position=position,
        yaw=yaw,
        segments=segments,
        notes=(*_read_notes(log), *commands.notes, *poses.notes, *notes),
        reference=reference_of(log, card, origin + np.round(command_time * 1e9).astype(np.int64)),
        clocks=clocks,
        velocity=velocity,
        stamp_error=math.hypot(stamp_error, unseen),
        shared_error=math.hypot(card.command_time.error, card.pose_time.error),
        command_lateness=late,
        pose_lateness=poses.repeating or seen_late,
        command_lead=lead,
        stamp_step=max(commands.step, poses.step),
    )


def _error_notes(card: Card) -> Iterator[Note]:
    """What the card states about its stamps."""
    for what, time in (("commands", card.command_time), ("poses", card.pose_time)):
        if time.error:
            known = f"stamps of the {what} are known to +-{1e3 * time.error:.3g} ms (95 %), by the card"
            yield Note("stamp_error", f"{known}: the interval of every delay holds it", 1)


def _rows_with(log: Log, card: Card) -> tuple[Mask, Mask] | None:
    """Which rows of a table hold a command, and which a pose; None where the two have no rows in common."""
    if log.file_of or card.command_time.source != card.pose_time.source:
        return None
    return (
        sample_rows(log, card.command_time, card.command),
        sample_rows(log, card.pose_time, card.pose),
    )


def _on_rows_of_poses(log: Log, card: Card) -> bool:
    """Whether nearly every row with a pose holds a command, so that lines may have been drawn onto them."""
    rows = _rows_with(log, card)
    return rows is not None and bool(np.any(rows[1]) and np.mean(rows[0][rows[1]]) >= SHARED)


def _lateness(log: Log, card: Card) -> tuple[float, float]:
    """How long before its stamp a command may have been sent, and a pose measured [s]: the period of shared rows.

    Rows are shared where nearly each holds a command and a pose; 0 where they are not. Rows with a command that begin
    before the first pose are not those of the poses: each holds the latest one.
    """
    rows = _rows_with(log, card)
    if rows is None or np.sum(rows[0] & rows[1]) < SHARED * np.sum(rows[0] | rows[1]):
        return 0.0, 0.0
    commands, poses = rows
    alone = np.flatnonzero(commands & ~poses)
    looked_up = alone.size >= LEADING and alone[-1] < np.argmax(poses)
    period = (median_period(np.unique(stamps_of(log, card.command_time)[commands])) or 0) / 1e9
    return period, period if looked_up else 0.0


def _read_notes(log: Log) -> Iterator[Note]:
    """Remarks from reading the file, losses first."""
    yield from (Note("damage", text, 1) for text in log.damage)
    yield from (Note("reading", text, 1) for text in log.notes)


def _clock_notes(clocks: Clocks | None, count: int) -> tuple[Note, ...]:
    """How the clocks of two files were treated."""
    if clocks is None:
        return ()
    figures = (
        f"{clocks.offset:+.4f} s (95 %: +-{1e3 * clocks.half_width:.2f} ms), drift {1e6 * clocks.drift:+.0f} "
        f"(+-{1e6 * clocks.drift_half_width:.0f}) us/s"
    )
    if clocks.includes_delay:
        text = (
            f"{count} commands were moved onto the clock of the poses, so that the response comes {ANSWER:g} s "
            f"after them: as stamped, it comes {clocks.with_delay:+.2f} +- {ANSWER_HALF:.2f} s after them, offset and "
            "delay together; the two cannot be separated"
        )
    elif clocks.moved:
        text = f"{count} commands were moved onto the clock of the poses by {figures}, from the vehicle's own motion"
    else:
        seen = "" if clocks.source == "none" else f"; the vehicle's own motion gives {figures}"
        text = (
            f"the stamps of {count} commands stay as they are beside the poses of another file: {clocks.stated}{seen}"
        )
    return (Note("clocks", text, count),)


def _window_end(log: Log, commands: Stream, poses: Stream, origin: int) -> int:
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
    """The span within the common window [s], and a note where it was cut.

    Raises:
        FlightError: The span lies outside the common window.
    """
    start, stop = (default if given is None else given for given, default in zip(span, (0.0, duration), strict=True))
    inside = max(start, 0.0), min(stop, duration)
    if not inside[0] < inside[1]:
        raise FlightError(f"{log.path}: span {start:g}:{stop:g} holds nothing of the common window, 0:{duration:.2f} s")
    if inside == (start, stop):
        return inside, ()
    text = f"the span {start:g}:{stop:g} reaches out of the common window and was cut to it, 0:{duration:.2f} s"
    return inside, (Note("span_cut", text, 1),)


def _segments(command_time: Array, command_end: Array) -> tuple[Segment, ...]:
    """Runs of commands in which each acts until the next one."""
    first = np.ones(len(command_time), dtype=np.bool_)
    first[1:] = command_time[1:] > command_end[:-1]
    last = np.append(first[1:], True)
    runs = zip(command_time[first], command_end[last if len(first) else first], strict=True)
    return tuple(Segment(float(start), float(end)) for start, end in runs)


def _check_duration(log: Log, segments: tuple[Segment, ...], pose_time: Array) -> None:
    period = float(np.median(np.diff(pose_time))) if len(pose_time) > 1 else 0.0
    if period > SLOWEST_POSES:
        raise FlightError(f"{log.path}: poses come every {period:.3g} s; add the unit of `time` to [pose] of the card")
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
    beyond = max((b.start - a.end for a, b in pairwise(segments)), default=0.0)
    turns = int(np.sum(np.abs(np.diff(yaw - heading)) > np.pi))
    split = f"{counted(gaps, 'gap')} in the commands, up to {beyond:.3f} s beyond the hold, split it"
    turned = f"{counted(turns, 'jump')} of yaw by a whole turn {'were' if turns > 1 else 'was'} unwrapped"
    notes = (
        Note("poses_outside", f"{outside} of {len(seen)} poses lie outside the common window or the span", outside),
        Note("command_gaps", split, gaps),
        Note("yaw_unwrapped", turned, turns),
    )
    return tuple(note for note in notes if note.count)


def _in_heading_frame(
    command_time: Array, command: Array, command_end: Array, pose_time: Array, yaw: Array
) -> tuple[Array, Array, Note]:
    """Rotates world commands into the heading frame and adds commands where the vehicle turns while one is held.

    The heading counts when a command acts, not when it is sent.
    """
    yaw = np.interp(pose_time + ACTS_AFTER, pose_time, yaw)
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
    text = f"{len(command)} commands along the axes of the world were turned into the heading frame by the measured yaw"
    if added:
        text += f"; {len(added)} more were added where it turned while a command was held"
    return time, np.hstack([turned, values[:, 2:]]), Note("world_commands", text, len(command))
