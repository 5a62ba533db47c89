"""Several recordings in one file, as of a logger that appends, or of two boots: the longest is taken.

Their clocks start again, so that without a cut halves of two flights would become one.
"""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from rotorfit.core.card import Card
from rotorfit.core.errors import FlightError
from rotorfit.core.flight_data import Note
from rotorfit.core.log import Column, Log, Table
from rotorfit.flights.columns import table_of
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
    clocks = {(table.name, len(stamps)): stamps for table, stamps in _clocks(log, card)}
    cuts = {clock: (stamps, starts) for clock, stamps in clocks.items() if (starts := restarts(stamps))}
    commands, poses = (
        len(cuts.get((table_of(log, str(time.source))[0].name, len(stamps_of(log, time))), ((), ()))[1])
        for time in (card.command_time, card.pose_time)
    )
    if not commands:
        return log, ()  # what poses saw before the first command is dropped as out of order
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

    def rows(column: Column) -> Column:
        if len(column) == count:
            return column[part]
        return column[:, part] if column.ndim == 2 and column.shape[1] == count else column

    return replace(table, columns={name: rows(column) for name, column in table.columns.items()})
