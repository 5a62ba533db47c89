"""Log + Card -> Flight: commands and pose, each on its own clock, SI, one frame, every repair noted."""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from rotorfit.card import Card
from rotorfit.clock import Mask
from rotorfit.errors import FlightError
from rotorfit.finding import counted
from rotorfit.frames import AXES, Array, heading_from_world
from rotorfit.ground import airborne
from rotorfit.joined import bound
from rotorfit.log import Log
from rotorfit.one_clock import ANSWER, ANSWER_HALF, Clocks, on_one_clock
from rotorfit.stamping import with_sound_stamps
from rotorfit.stream import Note, Stream, commands_of, poses_of, reference_of
from rotorfit.velocity import Velocity, in_the_world, velocities_of, with_travel

__all__ = ["MIN_DURATION", "SLOWEST_POSES", "Flight", "Note", "Segment", "Velocity", "flight_from_log"]


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
        position: World x, y, z, shape (N, 3) [m]; of an axis that has only a velocity, that velocity summed up, for
            drawings and for the methods that look at nothing else.
        yaw: Unwrapped heading, shape (N,) [rad].
        segments: Where the commands are known, in order, not overlapping.
        notes: Every repair, with its count.
        reference: What a position controller was told, held onto the commands' stamps, shape (M, 4), NaN for axes that
            the card does not name and before the first value; None where it names none.
        clocks: How the clock of the commands stood to that of the poses; None where they are from one file.
        velocity: What the vehicle itself measured of its velocity, where the estimator is to use it.
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
    reference: Array | None = None
    clocks: Clocks | None = None
    velocity: Velocity | None = None

    @property
    def velocity_only(self) -> tuple[str, ...]:
        """Axes of which there is a velocity and no position."""
        return self.velocity.alone if self.velocity else ()

    @property
    def duration(self) -> float:
        """Length of the segments together [s]."""
        return float(np.sum([segment.end - segment.start for segment in self.segments]))


MIN_DURATION = 2.0
"""Shortest flight [s]: what the prediction protocol gives to the filter before it scores."""

SLOWEST_POSES = 1.0
"""Median period of the poses [s] beyond which their clock is taken to lack its unit."""

_TURN = np.radians(0.5)


def flight_from_log(log: Log, card: Card, span: tuple[float | None, float | None] = (None, None)) -> Flight:
    """Takes commands and poses from a log as the card says, repairs them, and cuts them to the common window.

    The common window runs from the first command to the earlier of the last pose and the last command plus its hold.
    Commands hold until the next one, but no longer than `card.hold` (default: three median periods): a longer gap
    starts a new segment. Gaps between poses do not.

    Where commands and poses are from two files, the commands are first brought onto the clock of the poses.

    Args:
        log: As recorded.
        card: Which column is what. Commands in the world frame are along the axes of the converted pose (x east, y
            north, z up also for a card in NED), because a card never implies their signs.
        span: Start and end [s] from the start of the common window; None for its ends. Nothing outside is seen.

    Returns:
        The flight, each repair noted with its count.

    Raises:
        CardError: A column is not there, or its length does not go with its stamps.
        FlightError: No commands, no poses, a pose that never changes, a clock that runs backwards, no common window,
            less than two seconds, or yaw in degrees taken for radians.
    """
    card = bound(card, log)
    log, stamped = with_sound_stamps(log, card)
    log, clocks = on_one_clock(log, card)
    commands, axes, origin = commands_of(log, card)
    poses, velocities = poses_of(log, card), velocities_of(log, card)
    commands = airborne(commands, poses, card)
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
    notes = (*stamped, *_clock_notes(clocks, len(commands.stamps)), *cut, *_cut_notes(seen, segments, heading, yaw))
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
    )


def _read_notes(log: Log) -> Iterator[Note]:
    """What was noticed when the file was read, what is lost first."""
    yield from (Note("damage", text, 1) for text in log.damage)
    yield from (Note("reading", text, 1) for text in log.notes)


def _clock_notes(clocks: Clocks | None, count: int) -> tuple[Note, ...]:
    """What was done about the clocks of two files."""
    if clocks is None:
        return ()
    figures = (
        f"{clocks.offset:+.4f} s (95 %: +-{1e3 * clocks.half_width:.2f} ms), drift {1e6 * clocks.drift:+.0f} "
        f"(+-{1e6 * clocks.drift_half_width:.0f}) us/s"
    )
    if clocks.includes_delay:
        text = (
            f"{count} commands were moved onto the clock of the poses, so that their answer comes {ANSWER:g} s after "
            f"them: as stamped, it comes {clocks.with_delay:+.2f} +- {ANSWER_HALF:.2f} s after them, offset and delay "
            "together, and nothing tells the one from the other"
        )
    elif clocks.moved:
        text = f"{count} commands were moved onto the clock of the poses by {figures}, told by the vehicle's own motion"
    else:
        seen = "" if clocks.source == "none" else f"; the vehicle's own motion says {figures}"
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
    text = (
        f"{len(command)} commands along the axes of the world were turned to those of the vehicle by the measured yaw"
    )
    if added:
        text += f"; {len(added)} were added where it turned while a command held"
    return time, np.hstack([turned, values[:, 2:]]), Note("world_commands", text, len(added))
