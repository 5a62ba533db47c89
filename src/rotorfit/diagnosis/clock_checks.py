"""Checks of the stamps of a flight: gaps, jitter, clocks that drift or disagree, rows that repeat a command.

Also findings on the clocks of a flight whose commands and poses are from two files.
"""

from collections.abc import Iterator, Mapping
from itertools import pairwise

import numpy as np

from rotorfit.core.card import Card, Channel
from rotorfit.core.display import counted
from rotorfit.core.finding import Finding
from rotorfit.core.flight_data import Clocks, Flight
from rotorfit.core.frames import Array
from rotorfit.core.log import Log
from rotorfit.diagnosis.recording import Recording
from rotorfit.flights.clocks.arrival import JITTER_SHARE, LEAST_JITTER
from rotorfit.flights.clocks.two_clocks import ANSWER_HALF
from rotorfit.flights.columns import split_source
from rotorfit.flights.other_tables import sample_rows
from rotorfit.flights.stamps import GAP_PERIODS, GAP_TOLERANCE, ClockDrift, Stamps, in_time, rate, stamps_of
from rotorfit.flights.streams import recorder_clock


def two_files(clocks: Clocks) -> Iterator[Finding]:
    """Findings on the clocks of commands and poses from different files."""
    if clocks.refused:
        yield Finding(
            "clock_source_refused",
            "warning",
            f"the vehicle's own motion does not determine its clock offset from the poses: {clocks.refused}",
            "it is not used",
            "check that both files are of one flight and of one vehicle, and [velocity] and [attitude] of the card",
        )
    if clocks.later:
        late = ", ".join(f"{sensor} by {1e3 * lag:.0f} ms" for sensor, lag in clocks.later.items())
        yield Finding(
            "clock_sensors_disagree",
            "warning",
            f"the vehicle's own sensors do not agree on its clock: late against {', '.join(clocks.explained)}: {late}",
            "the late ones were left out; by as much as the others are late, too, the delay comes out too long",
            "where the latency of a stamp is known, give it as a negative offset of its time in the card",
        )
    if clocks.includes_delay:
        yield _includes_delay(clocks)
    elif clocks.moved:
        yield Finding(
            "clocks_joined",
            "info",
            f"the clock of the poses is offset from that of the commands by {_figures(clocks)}, from "
            f"{_explained(clocks)}",
            f"the commands were moved, and {1e3 * clocks.half_width:.1f} ms went into the delay's interval; by as much "
            "as the vehicle's own motion is stamped late, the delay comes out too long",
            "where the latency of that stamp is known, give it as a negative offset of its time in the card",
        )
    elif clocks.differs:
        yield Finding(
            "clock_offset",
            "warning",
            f"the clocks of the two files are taken as one, since {clocks.stated}, but that of the poses "
            f"is offset from that of the commands by {_figures(clocks)}, from {_explained(clocks)}",
            "unless the vehicle's own motion is stamped that late, the delay of every axis comes out "
            f"{1e3 * abs(clocks.offset):.0f} ms too {'long' if clocks.offset > 0 else 'short'}",
            'if they are two clocks, leave clock = "one" out of the card',
        )
    elif clocks.source == "none":
        yield Finding(
            "clock_unchecked",
            "info",
            f"commands and poses are from two files whose clocks are taken as one, since {clocks.stated}",
            "whatever the clocks differ by is in the delay of every axis",
            "record the vehicle's own velocity or heading beside the commands: it checks the clocks",
        )


def _includes_delay(clocks: Clocks) -> Finding:
    return Finding(
        "clock_includes_delay",
        "warning",
        "commands and poses are from two files, and only the response to the commands gives their clock offset: the "
        f"response is stamped {clocks.with_delay:+.2f} +- {ANSWER_HALF:.2f} s (95 %) after its command, offset and "
        f"delay together, from {_explained(clocks)}",
        "offset and delay cannot be separated, and no delay is published; input gain and damping keep their "
        "values, but for a drift of the clocks",
        "record the vehicle's own velocity or heading beside the commands and name it in the card, or write "
        'clock = "one" there if the clocks are one',
    )


def _figures(clocks: Clocks) -> str:
    return (
        f"{clocks.offset:+.4f} s (95 %: +-{1e3 * clocks.half_width:.1f} ms), drift {1e6 * clocks.drift:+.0f} us/s "
        f"(+-{1e6 * clocks.drift_half_width:.0f})"
    )


def _explained(clocks: Clocks) -> str:
    """The signals that revealed the offset, with the share of each that the poses explain."""
    return ", ".join(f"{name} ({100 * share:.0f} % explained)" for name, share in clocks.explained.items())


SETTLING_LOSS = 0.6
"""Time lost at the start of each segment of commands [s]: the longest delay that is searched."""

LOST_SHARE = 0.05
"""Share of the time lost to gaps above which they are reported."""

LARGE_LOSS = 0.2
"""Share of the time lost to gaps above which they are a warning."""

POSE_HOLE = 0.25
"""Shortest gap in the poses that counts [s]: the half width of the window that differentiates them."""

LONG_HOLE = 0.5
"""A single gap of this length is reported [s]: the vehicle has responded to a command before it is seen again."""

DRIFT_GROWTH = 0.010
"""Relevant drift of two clocks over a flight [s]: about the standard error of a delay."""

CLOCK_OFFSET = 0.05
"""Offset of two clocks in one file that transport does not explain [s]."""

STALE_SHARE = 0.05
"""Share of repeated poses above which they are reported."""

REPEATED_SHARE = 0.6
"""Share of rows that change the command below which rows repeat it; a controller at the rate of the rows changes it in
nearly every row."""

SELDOM = 0.15
"""Median step between commands [s] above which nothing streams them: they are logged when they change."""

LATENESS = 0.002
"""Mean lateness of a change of the command above which it is reported [s]."""


_CORRECTED = ("command_clock_corrected", "pose_clock_corrected")


def clock_findings(recording: Recording) -> Iterator[Finding]:
    """Findings on the stamps of one flight, as its log holds them; none without one."""
    log, card, flight = recording.log, recording.card, recording.flight
    if log is None:
        return
    commands = stamps_of(log, card.command_time)[sample_rows(log, card.command_time, card.command)]
    poses = stamps_of(log, card.pose_time)[sample_rows(log, card.pose_time, card.pose)]
    yield from _several(flight)
    yield from _command_gaps(flight)
    yield from _pose_gaps(flight)
    if flight.command_lead:
        yield _interpolated(flight)
    elif flight.command_lateness:
        yield from _by_row(flight)
    else:
        effect = "if they are stamps of arrival, the delay comes out wide or biased"
        if not _as_they_change(flight):
            yield from _jitter("command", commands, flight, effect)
    yield from _jitter(
        "pose", poses, flight, "if they are stamps of arrival, speed times jitter is added to every pose"
    )
    if flight.clocks is not None:
        yield from two_files(flight.clocks)
    else:
        corrected = any(note.code in _CORRECTED for note in flight.notes)
        yield from _corrected(flight) if corrected else _two_clocks(log, card)
    yield from _coarse(flight)
    yield from _stale(flight)


def _several(flight: Flight) -> Iterator[Finding]:
    """Recordings of a file that were left out."""
    for note in flight.notes:
        if note.code == "clock_restarts":
            yield Finding(
                "clock_restarts",
                "warning",
                note.text,
                "the others are left out: what they hold tells nothing here",
                "split the file where the clock starts again, and fit the flights together",
            )


def _command_gaps(flight: Flight) -> Iterator[Finding]:
    parts = flight.segments
    if len(parts) < 2:
        return
    holes = [b.start - a.end for a, b in pairwise(parts)]
    lost = sum(holes) + sum(min(SETTLING_LOSS, part.end - part.start) for part in parts[1:])
    share = lost / (parts[-1].end - parts[0].start)
    if share > LOST_SHARE:
        yield Finding(
            "command_gaps",
            "warning" if share > LARGE_LOSS else "info",
            f"{counted(len(holes), 'gap')} in the commands, up to {max(holes):.3f} s beyond the hold, taking "
            f"{lost:.1f} s ({100 * share:.0f} % of the flight) with the {SETTLING_LOSS:g} s that each segment needs to "
            "start",
            "all coefficients rest on less data; a segment shorter than 0.7 s contributes nothing",
            "send commands at a steady rate; where the vehicle keeps the last one for longer, say so by hold in the "
            "card",
        )


def _pose_gaps(flight: Flight) -> Iterator[Finding]:
    holes = np.concatenate([_holes(flight, part.start, part.end) for part in flight.segments])
    if not holes.size:
        return
    share, longest = float(np.sum(holes)) / flight.duration, float(np.max(holes))
    if share > LOST_SHARE or longest > LONG_HOLE:
        yield Finding(
            "pose_gaps",
            "warning" if share > LARGE_LOSS or longest > 2 * LONG_HOLE else "info",
            f"{counted(holes.size, 'hole')} in the poses, the longest of {longest:.2f} s, taking "
            f"{np.sum(holes):.1f} s ({100 * share:.0f} % of the flight)",
            "damping and delay lose most: what happens right after a command is not seen; no prediction is scored "
            "across a hole of 1 s",
            "move or add cameras, or fly where the markers are seen throughout",
        )


def _holes(flight: Flight, start: float, end: float) -> Array:
    """Lengths of the gaps in the poses of a segment [s]."""
    time = flight.pose_time[(flight.pose_time >= start) & (flight.pose_time <= end)]
    steps = np.diff(time)
    limit = max(POSE_HOLE, (GAP_PERIODS + GAP_TOLERANCE) * float(np.median(steps))) if steps.size else POSE_HOLE
    return steps[steps > limit]


def _as_they_change(flight: Flight) -> bool:
    """Whether commands were logged when they changed: seldom, and none is like the one before."""
    seldom = flight.command_time.size > 1 and float(np.median(np.diff(flight.command_time))) > SELDOM
    return seldom and float(np.mean(np.any(np.diff(flight.command, axis=0) != 0, axis=1))) > 0.98


def _jitter(what: str, stamps: Stamps, flight: Flight, effect: str) -> Iterator[Finding]:
    if any(note.code == f"{what}_stamps_straightened" for note in flight.notes):
        return
    found = rate(stamps)
    if found.period is None or found.jitter is None:
        return
    spread = found.jitter[1] - found.jitter[0]
    if spread > max(JITTER_SHARE * found.period, LEAST_JITTER):
        yield Finding(
            "stamp_jitter",
            "info",
            f"steps between {what} stamps spread over {1e3 * spread:.0f} ms (5th to 95th percentile), "
            f"{spread / found.period:.1f} times their median of {1e3 * found.period:.0f} ms",
            effect,
            f"stamp each {what} where it is made, not where it is received; of a bag take header.stamp",
        )


def _corrected(flight: Flight) -> Iterator[Finding]:
    """A clock that drifts or steps against the recorder's, and was corrected."""
    told = [note.text for note in flight.notes if note.code in _CORRECTED]
    yield Finding(
        "clock_drift",
        "info",
        "; ".join(told),
        f"none on gain and damping; {1e3 * flight.stamp_error:.1f} ms, the transmission time that no clock shows, "
        "went into the interval of every delay",
        "synchronise the computers (chrony): then the stamps stay as they are",
    )


def _two_clocks(log: Log, card: Card) -> Iterator[Finding]:
    """The clocks of poses and commands, each against the recorder's."""
    command = _against_recorder(log, card.command_time, card.command)
    pose = _against_recorder(log, card.pose_time, card.pose)
    if command is None or pose is None:
        return
    duration = _length(stamps_of(log, card.pose_time))
    growth = (command.drift - pose.drift) * duration
    noise = 0.5 * max(c.spread[1] - c.spread[0] - abs(c.drift) * duration for c in (command, pose))
    if abs(growth) > max(DRIFT_GROWTH, noise):
        yield Finding(
            "clock_drift",
            "warning",
            f"against the recorder's clock, that of the poses gains {1e3 * growth:.0f} ms on that of the commands in "
            f"{duration:.0f} s, {1e6 * growth / duration:.0f} us a second",
            "the delay of every axis changes by as much within the flight, which biases damping and gain",
            "synchronise the computers (chrony), or take log_time for both streams in the card",
        )
    offset = command.offset - pose.offset
    if abs(offset) > CLOCK_OFFSET:
        yield Finding(
            "clock_offset",
            "warning",
            f"poses are stamped {1e3 * abs(offset):.0f} ms {'ahead of' if offset > 0 else 'behind'} the commands, "
            "judged by when both were recorded",
            f"the delay of every axis comes out {1e3 * abs(offset):.0f} ms too {'long' if offset > 0 else 'short'}, "
            "unless transport takes that long; beyond the searched range gain and damping are lost, too",
            "synchronise the computers (chrony), or take log_time for both streams in the card",
        )


def _against_recorder(log: Log, time: Channel, channels: Mapping[str, Channel]) -> ClockDrift | None:
    """The recorder's clock against the one in the card; None if the latter is neither stamp of a message."""
    name = split_source(time.source)[1]
    if name == "log_time":
        return ClockDrift(0.0, (0.0, 0.0), 0.0)
    return recorder_clock(log, time, channels) if name == "header.stamp" else None


def _length(stamps: Stamps) -> float:
    there = stamps[in_time(stamps)]
    return float(there[-1] - there[0]) / 1e9


def _coarse(flight: Flight) -> Iterator[Finding]:
    """Stamps of which most are the same as the one before."""
    for what, time in (("pose", flight.pose_time), ("command", flight.command_time)):
        dropped = sum(note.count for note in flight.notes if note.code == f"{what}_stamps_repeated")
        if flight.stamp_step and dropped > time.size > 1:
            yield Finding(
                "coarse_stamps",
                "warning",
                f"{dropped} of {dropped + time.size} {what}s repeat a stamp: the clock advances in steps of "
                f"{np.median(np.diff(time)):.3g} s",
                f"the first {what} of each step is used and the others are lost; no stamp is known to less than a "
                f"step: delays come out up to {1e3 * flight.stamp_step:.0f} ms too short or too long, and their "
                "intervals reach as much lower and higher",
                f"log stamps in milliseconds or finer, or name a finer column as time of [{what}]",
            )


def _stale(flight: Flight) -> Iterator[Finding]:
    stale = sum(note.count for note in flight.notes if note.code == "stale_poses")
    outside = sum(note.count for note in flight.notes if note.code == "poses_outside")
    share = stale / max(stale + outside + flight.pose_time.size, 1)
    period = f"{1e3 * flight.pose_lateness:.3g} ms"
    late = (
        f"; rows hold the latest of slower poses, up to {period} old when first shown: delays come out up to {period} "
        "too long, and their intervals reach as much lower"
        if flight.pose_lateness
        else ""
    )
    if share > STALE_SHARE:
        yield Finding(
            "stale_poses",
            "info",
            f"{stale} poses ({100 * share:.0f} %) repeat the one before under a fresh stamp",
            f"they were dropped; kept, they would move gain and delay{late}",
            "let the motion capture bridge publish new frames only, each with the time at which it was taken",
        )


def _interpolated(flight: Flight) -> Finding:
    """Commands between which lines were drawn: the log changes before the command that the vehicle held."""
    lead, late = 1e3 * flight.command_lead, 1e3 * flight.command_lateness
    sent = f"up to {late:.0f} ms too short" if late else "right"
    reach = f"; their intervals reach {lead:.0f} ms lower{f' and {late:.0f} ms higher' if late else ''}"
    return Finding(
        "commands_interpolated",
        "info",
        f"commands lie on straight lines between instants about {2 * lead:.0f} ms apart: they were interpolated onto "
        "the rows",
        f"if the vehicle held each command until the next, delays come out {lead:.0f} ms too long; if the lines were "
        f"sent as they stand, {sent}{reach}; gain and damping keep their values",
        "log commands as they were sent, each with its stamp, and leave cells blank where none was",
    )


def _by_row(flight: Flight) -> Iterator[Finding]:
    """Commands in the rows of the poses: sent some time before the stamp of their row."""
    if len(flight.command_time) < 2 or not np.any(np.diff(flight.command, axis=0)):
        return
    changed, period = float(np.mean(np.any(np.diff(flight.command, axis=0) != 0, axis=1))), flight.command_lateness
    if period / 2 <= LATENESS:
        return
    late = f"{1e3 * period:.0f} ms"
    each = f"each row holds a command and a pose; commands change in {100 * changed:.0f} % of the rows"
    short, keeps = f"delays come out up to {late} too short", "gain and damping keep their values"
    effect = f"{short}, and their intervals reach {late} higher; {keeps}"
    remedy = "log commands by themselves, each with the stamp at which it was sent"
    if flight.pose_lateness:
        seen = f"{1e3 * flight.pose_lateness:.0f} ms"
        effect = f"{short}, or up to {seen} too long; their intervals reach {late} higher and {seen} lower; {keeps}"
        remedy = "log commands and poses by themselves, each with a stamp of its own"
    if changed < REPEATED_SHARE:
        evidence = (
            f"{each}: a change bears the stamp of its row, {1e3 * period / 2:.0f} ms late in the mean, {late} at most"
        )
        yield Finding("repeated_commands", "info", evidence, effect, remedy)
    else:
        evidence = f"{each}: a command bears the stamp of its row, and may have been sent up to {late} before"
        if flight.pose_lateness:
            evidence += "; so does the pose, the latest one by then"
        else:
            remedy += (
                "; where each command makes its row and takes the latest pose, delays come out too long by the age of "
                "that pose instead: log poses by themselves, too"
            )
        yield Finding("commands_by_row", "info", evidence, effect, remedy)
