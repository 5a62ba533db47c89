"""Several recordings in one file, as of a logger that appends, or of two boots: the longest is taken.

Their clocks start again, so that without a cut halves of two flights would become one.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np

from rotorfit.core.card import Card, Channel
from rotorfit.core.errors import FlightError
from rotorfit.core.flight_data import Note
from rotorfit.core.frames import Indices
from rotorfit.core.log import Column, Log, Table
from rotorfit.flights.columns import column, table_of
from rotorfit.flights.other_tables import is_beside, own_clock
from rotorfit.flights.stamps import MISSING_STAMP, Stamps, restarts, stamps_of


def longest_recording(log: Log, card: Card) -> tuple[Log, tuple[Note, ...]]:
    """Cuts the tables that a card names to one recording, where their clocks start again.

    A sender's clock beside the recorder's may start again within a recording.

    Args:
        log: As recorded.
        card: The meaning of each column.

    Returns:
        The log, unchanged where it is one recording; and a note on which rows were taken.

    Raises:
        CardError: A column is missing.
        FlightError: Commands and poses do not start again together.
    """
    log, ordered = _in_order(log, card)
    clocks = {(table.name, len(stamps)): stamps for table, stamps in _clocks(log, card)}
    cuts = {clock: (stamps, starts) for clock, stamps in clocks.items() if (starts := restarts(stamps))}
    commands, poses = (
        len(cuts.get((table_of(log, str(time.source))[0].name, len(stamps_of(log, time))), ((), ()))[1])
        for time in (card.command_time, card.pose_time)
    )
    if not commands:
        return log, ordered  # what poses saw before the first command is dropped as out of order
    if commands != poses:
        raise FlightError(
            f"{log.path}: the clock starts again, among the commands {commands} times and among the poses {poses} "
            "times: several recordings in one file; split it"
        )
    parts = {clock: _parts(stamps, starts) for clock, (stamps, starts) in cuts.items() if len(starts) == commands}
    lengths = [[_length(cuts[clock][0][part]) for part in each] for clock, each in parts.items()]
    taken = int(np.argmax(np.min(lengths, axis=0)))
    tables = dict(log.tables)
    for (name, count), each in parts.items():
        tables[name] = _cut(tables[name], each[taken], count)
    (name, _), each = next(iter(parts.items()))
    text = (
        f"the clock of {name} starts again after row {', '.join(str(one.stop) for one in each[:-1])}: "
        f"{len(each)} recordings in one file, of which rows {each[taken].start + 1} to {each[taken].stop} are used"
    )
    return replace(log, tables=tables), (Note("clock_restarts", text, len(each)),)


def _in_order(log: Log, card: Card) -> tuple[Log, tuple[Note, ...]]:
    """The log sorted by time where the rows of its commands stand before or after those of its poses; and a note.

    That is how tables of commands and of poses are joined end to end.
    """
    if card.pose_time.source != card.command_time.source:
        return log, ()
    table, clock = table_of(log, str(card.command_time.source))
    stamps = stamps_of(log, card.command_time)
    parts = _parts(stamps, restarts(stamps))
    if len(parts) < 2 or not _are_apart(log, card, stamps, parts):
        return log, ()
    order = np.argsort(stamps, kind="stable")
    columns = {name: _rows(column, order, len(stamps)) for name, column in table.columns.items()}
    text = (
        f"{table.name}: after row {', '.join(str(part.stop) for part in parts[:-1])} the time starts again, and no "
        f"part has both commands and poses: its {len(stamps)} rows were sorted by {clock}"
    )
    note = Note("rows_sorted", text, len(stamps))
    return replace(log, tables={**log.tables, table.name: replace(table, columns=columns)}), (note,)


def _are_apart(log: Log, card: Card, stamps: Stamps, parts: Sequence[slice]) -> bool:
    """Whether no part has both commands and poses, and those of one kind follow each other, as of one flight."""
    ended = dict[bool, int]()
    for part in parts:
        commands = not _are_blank(log, card.command, part)
        if commands and not _are_blank(log, {**card.velocity, **card.pose}, part):
            return False
        there = stamps[part][stamps[part] != MISSING_STAMP]
        if there.size and there.min() < ended.get(commands, there.min()):
            return False
        ended[commands] = int(there.max(initial=0))
    return True


def _are_blank(log: Log, channels: Mapping[str, Channel], part: slice) -> bool:
    """Whether none of the channels has a number in these rows."""
    return not any(np.any(np.isfinite(column(log, channel)[part])) for channel in channels.values())


def _clocks(log: Log, card: Card) -> Iterator[tuple[Table, Stamps]]:
    """The tables whose rows are stamped by a clock of their recording, with its stamps."""
    known = set()
    for time in dict.fromkeys((card.command_time, card.pose_time)):
        table, name = table_of(log, str(time.source))
        known.add(table.name)
        if not (name == "header.stamp" and "log_time" in table.columns):
            yield table, stamps_of(log, time)
    parts = (
        (card.command_time, [*card.command.values(), *card.reference.values(), *(one.channel for one in card.window)]),
        (card.pose_time, card.pose.values()),
        (card.velocity_time or card.command_time, card.velocity.values()),
        (card.attitude_time or card.command_time, card.attitude.values()),
    )
    for time, channel in ((time, channel) for time, channels in parts for channel in channels):
        if is_beside(card.command_time, channel):
            table, _ = table_of(log, str(channel.source))
            if table.name not in known:
                known.add(table.name)
                yield table, own_clock(log, time, channel)


def _parts(stamps: Stamps, starts: list[int]) -> list[slice]:
    return [slice(start, end) for start, end in zip([0, *starts], [*starts, len(stamps)], strict=True)]


def _length(stamps: Stamps) -> int:
    there = stamps[stamps != MISSING_STAMP]
    return int(np.ptp(there)) if there.size else 0


def _cut(table: Table, part: slice, count: int) -> Table:
    """A table with some of its rows; columns of another length have another clock."""
    return replace(table, columns={name: _rows(column, part, count) for name, column in table.columns.items()})


def _rows(values: Column, which: slice | Indices, count: int) -> Column:
    """Some rows of a column of `count` rows; the column itself where it has another length."""
    if len(values) == count:
        return values[which]
    return values[:, which] if values.ndim == 2 and values.shape[1] == count else values
