"""Log + Card -> the same log with commands and poses on one clock, where a flight was recorded in several files."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from rotorfit.core.card import Card, Channel
from rotorfit.core.errors import FlightError
from rotorfit.core.flight_data import AGREES, ANSWER, Clocks
from rotorfit.core.frames import AXES
from rotorfit.core.log import Log, Table
from rotorfit.core.model import NORMAL
from rotorfit.flights.clocks.lag_search import GriddedMotion
from rotorfit.flights.clocks.motion_signals import answers, attitude_clock, moved, onboard, seen_by, velocity_clock
from rotorfit.flights.clocks.offset import Offset, clock_offset
from rotorfit.flights.columns import table_of
from rotorfit.flights.stamps import MISSING_STAMP, Stamps, stamps_of
from rotorfit.flights.streams import Stream, commands_of, poses_of

ANSWER_HALF = 0.3
"""Half the 95 % interval of offset plus delay from the response to the commands [s].

Source: `bench/bench_clocks.py`: on twelve recorded flights of two vehicles, cut in two, with a standard deviation of
0.15 s about the mean of the vehicle; on 50 simulated flights off by 55 ms (RMS).
"""

SHARED = 8
"""Number of messages that must be in both files with equal stamps to show that both have one clock."""


def on_one_clock(log: Log, card: Card) -> tuple[Log, Clocks | None]:
    """Moves the stamps of the commands onto the clock of the poses, where the two are from different files.

    The offset follows from the onboard velocity or heading in the file of the commands. Without it, it follows from the
    response to the commands, which cannot separate delay from offset. Where the clocks are stated to be the same,
    nothing is moved.

    Args:
        log: As recorded.
        card: The meaning of each column, with the table of each.

    Returns:
        The log, with the stamps of the commands' file in `retimed`; and the relation of the clocks, None for one file.

    Raises:
        CardError: A column is missing.
        FlightError: Refused by `commands_of` or `poses_of`; or the offset cannot be determined.
    """
    if not log.file_of:
        return log, None
    sender, camera = (log.file_of[table_of(log, str(t.source))[0].name] for t in (card.command_time, card.pose_time))
    if sender == camera:
        return log, None
    poses = poses_of(log, card)
    commands, axes, origin = commands_of(log, card)
    seen, stated, refused = seen_by(poses), _stated(log, card, sender, camera), ""
    middle = (int(commands.stamps[-1]) - origin) / 2e9
    witnesses = onboard(log, _in_file(log, card, sender), origin)
    if witnesses:
        found = clock_offset(witnesses, seen)
        if isinstance(found, Offset):
            base = (int(poses.stamps[0]) - origin) / 1e9
            clocks = _by_sensors(found, base, middle, stated)
            return (log if stated else _moved(log, card, sender, origin, clocks)), clocks
        refused = found
    if stated:
        return log, Clocks("none", stated=stated, refused=refused)
    clocks = _by_answer(log, card, commands, axes, poses, seen, refused)
    return _moved(log, card, sender, int(commands.stamps[0]), clocks), clocks


def _by_sensors(found: Offset, base: float, middle: float, stated: str) -> Clocks:
    """The clocks according to the onboard sensors, at the middle of the commands and for stamps as recorded."""
    offset, error = found.at(middle)
    return Clocks(
        source="onboard",
        offset=base + offset,
        half_width=NORMAL * error,
        drift=found.drift,
        drift_half_width=NORMAL * float(np.sqrt(found.covariance[1, 1])),
        middle=middle,
        moved=not stated,
        stated=stated,
        explained=found.explained,
        later=found.later,
    )


def _by_answer(
    log: Log, card: Card, commands: Stream, axes: tuple[str, ...], poses: Stream, seen: GriddedMotion, refused: str
) -> Clocks:
    """The clocks according to the response to the commands, shifted to where the likelihood searches for the delay."""
    moving = tuple(axis for axis in axes if np.ptp(commands.values[:, AXES.index(axis)]) > 0)
    witnesses = moved(seen, moving, card.command_frame == "world")
    found = clock_offset(witnesses, answers(commands)) if witnesses else "no command moves"
    if not isinstance(found, Offset):
        onboard_too = f"; onboard motion, poses: {refused}" if refused else ""
        raise FlightError(
            f"{log.path}: the clock offset between the two files cannot be determined; commands, poses: {found}"
            f"{onboard_too}; check that [pose] of the card names the vehicle, and its z the axis that points up; else "
            'name the vehicle\'s own velocity in [velocity], or write clock = "one" in it if they are one clock'
        )
    # Here the poses' clock is the first: a pose at s responds to a command at s + offset + drift (s - middle).
    base = (int(poses.stamps[0]) - int(commands.stamps[0])) / 1e9 - ANSWER
    middle = (int(commands.stamps[-1]) - int(commands.stamps[0])) / 2e9
    offset = base - found.offset - found.drift * (middle - found.offset - found.middle)
    return Clocks("command", offset, middle=middle, moved=True, explained=found.explained, refused=refused)


def _in_file(log: Log, card: Card, file: str) -> Card:
    """The card without onboard motion from other files, which do not share the clock of the commands."""

    def from_file(channels: Mapping[str, Channel]) -> bool:
        named = [channel.source for channel in channels.values() if isinstance(channel.source, str)]
        return bool(named) and all(log.file_of[table_of(log, source)[0].name] == file for source in named)

    velocity = card.velocity if from_file(card.velocity) else {}
    return replace(card, velocity=velocity, attitude=card.attitude if from_file(card.attitude) else {})


def _moved(log: Log, card: Card, file: str, origin: int, clocks: Clocks) -> Log:
    """The log with the clocks of one file moved: those of the commands in all its tables, and those of the sensors."""
    name = table_of(log, str(card.command_time.source))[1]
    own = [
        replace(card.command_time, source=f"{table}:{name}")
        for table, from_file in log.file_of.items()
        if from_file == file and name in log.tables[table].columns
    ]
    here = _in_file(log, card, file)
    own += [velocity_clock(here)] if here.velocity else []
    own += [attitude_clock(here)] if here.attitude else []
    retimed = dict(log.retimed)
    for clock in own:
        table, column = table_of(log, str(clock.source))
        retimed[table.name, column] = _mapped(stamps_of(log, clock), origin, clocks)
    return replace(log, retimed=retimed)


def _mapped(stamps: Stamps, origin: int, clocks: Clocks) -> Stamps:
    """Stamps on the clock of the poses; missing stamps stay missing."""
    there = stamps != MISSING_STAMP
    elapsed = np.where(there, stamps - origin, 0) / 1e9 - clocks.middle
    gained = np.round(clocks.drift * elapsed * 1e9).astype(np.int64)
    return np.where(there, stamps + (round(clocks.offset * 1e9) + gained), MISSING_STAMP)


def _stated(log: Log, card: Card, sender: str, camera: str) -> str:
    """Why the stamps of both files are taken to be on one clock, as a clause; empty where they are not."""
    if card.clock == "one":
        return "the card says that they are one"
    clocks = {table_of(log, str(time.source))[1] for time in (card.command_time, card.pose_time)}
    if len(clocks) != 1 or not clocks <= {"header.stamp", "log_time"}:
        return ""
    for name, table in _tables_of(log, sender).items():
        other = _tables_of(log, camera).get(name)
        count = 0 if other is None else _shared(table, other, *clocks)
        if count >= SHARED:
            return f"{count} messages of {name} stand in both files with the same stamps"
    return ""


def _tables_of(log: Log, file: str) -> dict[str, Table]:
    """The tables of one file under the names that they have there, without a leading slash."""
    own = f"{Path(file).stem}/"
    return {
        name.removeprefix(own).lstrip("/"): log.tables[name]
        for name, from_file in log.file_of.items()
        if from_file == file
    }


def _shared(one: Table, other: Table, clock: str) -> int:
    """Number of messages common to two tables, by the sender's stamp; 0 where `clock` differs between them."""
    if not all({"header.stamp", clock} <= table.columns.keys() for table in (one, other)):
        return 0
    _, a, b = np.intersect1d(one.columns["header.stamp"], other.columns["header.stamp"], return_indices=True)
    apart = np.abs(one.columns[clock][a] - other.columns[clock][b])
    return a.size if a.size and float(np.median(apart)) < AGREES * 1e9 else 0
