"""Columns beside a stream: those of other streams in the rows of its table, and those of other tables.

The latter are brought onto the stamps of the stream: held, for commands, or interpolated between two samples.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from rotorfit.core.card import Card, Channel
from rotorfit.core.errors import CardError
from rotorfit.core.frames import Array, Mask
from rotorfit.core.log import Log
from rotorfit.files.logs.formats import FORMATS
from rotorfit.files.logs.several import format_of
from rotorfit.flights.columns import column, is_series, split_source, table_of
from rotorfit.flights.stamps import (
    GAP_PERIODS,
    GAP_TOLERANCE,
    MISSING_STAMP,
    Stamps,
    held,
    in_time,
    median_period,
    stamps_of,
    stray,
)

TOGETHER = 0.1
"""Share of a median period by which a command in another table may be later and still belong to the same instant:
autopilots write the messages of one controller step one after the other."""


def is_beside(time: Channel, channel: Channel) -> bool:
    """Whether a channel is in another table than its clock; False where one of them names no table."""
    table, own = split_source(channel.source)[0], split_source(time.source)[0]
    return isinstance(channel.source, str) and bool(table and own) and table != own


def sample_rows(log: Log, time: Channel, channels: Mapping[str, Channel]) -> Mask:
    """Which rows of a stream hold a sample: in a table shared by commands and poses, a row may hold only one of them.

    Args:
        log: As recorded.
        time: The stream's clock.
        channels: The stream's channels.

    Returns:
        Shape (N,), True where any channel is a number; N is the number of stamps.

    Raises:
        CardError: A column is missing.
    """
    stamps = stamps_of(log, time)
    rows = np.zeros(len(stamps), dtype=np.bool_)
    own = [channel for channel in channels.values() if not is_beside(time, channel)]
    for channel in own or channels.values():
        if isinstance(channel.source, str):  # a constant is no sample
            there = np.isfinite(column(log, channel, len(stamps)))[: len(stamps)]
            rows[: len(there)] |= there
    return rows


def rows_of_others(log: Log, card: Card) -> Mask:
    """Which rows of the commands' table hold no command but a number in another column, shape (N,).

    In a file of rows, a row leaves the cells blank that it has no value for, such as those of the commands where only
    an IMU was read. A message is complete: numbers beside its missing command are part of it and carry no information.
    """
    own = sample_rows(log, card.command_time, card.command)
    table, clock = table_of(log, str(card.command_time.source))
    if not _of_rows(log, card.command_time):
        return np.zeros(len(own), dtype=np.bool_)
    taken = {split_source(channel.source)[1] for channel in card.command.values()} | {clock}
    others = [values.ravel() for name, values in table.columns.items() if name not in taken and is_series(values)]
    state_samples = np.zeros(len(own), dtype=np.bool_)
    for values in others:
        state_samples |= np.isfinite(values) if len(values) == len(own) else False
    return ~own & state_samples


def own_clock(log: Log, time: Channel, channel: Channel) -> Stamps:
    """Stamps of a column in another table than its stream's clock.

    They are the column in its own table that has the name of the stream's clock, else `log_time`, else `header.stamp`.

    Args:
        log: As recorded.
        time: Clock of the stream.
        channel: The column.

    Raises:
        CardError: Its table has none of them.
    """
    table, (_, name) = split_source(channel.source)[0], split_source(time.source)
    there = log.tables[table].columns if table in log.tables else {}
    if name in there:
        return stamps_of(log, replace(time, source=f"{table}:{name}", others=()))
    for other in ("log_time", "header.stamp"):
        if other in there:
            return stamps_of(log, Channel(f"{table}:{other}"))
    raise CardError(f"{log.path}: no time stamps for {channel.source}: {table} has no column {name!r}")


def sampled(log: Log, time: Channel, channel: Channel) -> tuple[Stamps, Array]:
    """Stamps and values of a column in another table, in increasing order, without missing stamps and NaN.

    Raises:
        CardError: The column is missing, has no clock, or their lengths differ by more than one.
    """
    clock, (values,) = whole_rows(log, time, [channel])
    return sound_samples(clock, values)


def whole_rows(log: Log, time: Channel, channels: Sequence[Channel]) -> tuple[Stamps, list[Array]]:
    """Stamps and values of columns in another table, row by row as recorded, each of shape (N,).

    Raises:
        CardError: A column is missing, has no clock, or their lengths differ by more than one.
    """
    clock = own_clock(log, time, channels[0])
    columns = [column(log, channel, len(clock)) for channel in channels]
    for channel, values in zip(channels, columns, strict=True):
        if abs(len(clock) - len(values)) > 1:
            raise CardError(f"{log.path}: {channel.source} has {len(values)} values and its clock {len(clock)}")
    shared = min(len(clock), *(len(values) for values in columns))
    return clock[:shared], [values[:shared] for values in columns]


def sound_samples(clock: Stamps, values: Array) -> tuple[Stamps, Array]:
    """The samples in increasing order, without missing or stray stamps and NaN."""
    good = (clock != MISSING_STAMP) & np.isfinite(values)
    clock, values = clock[good], values[good]
    alone = stray(clock)
    clock, values = clock[~alone], values[~alone]
    rows = in_time(clock)
    return clock[rows], values[rows]


def held_beside(log: Log, time: Channel, channel: Channel, stamps: Stamps) -> Array:
    """A command in another table held onto stamps, shape (N,); NaN before its first sample and after a gap."""
    clock, values = sampled(log, time, channel)
    clock = clock - round(TOGETHER * (median_period(clock) or 0))
    return np.where(_reached(clock, stamps), held(clock, values, stamps), np.nan)


def interpolate(clock: Stamps, values: Array, stamps: Stamps) -> Array:
    """Interpolates a continuous quantity linearly between samples, shape (N,).

    NaN where neighbouring samples are further apart than a gap, and outside of all samples.

    Args:
        clock: Increasing, shape (M,) [ns].
        values: Shape (M,).
        stamps: Where it is evaluated, shape (N,) [ns].
    """
    if len(clock) < 2:
        return np.full(len(stamps), np.nan)
    origin = clock[0]
    between = np.interp((stamps - origin) / 1e9, (clock - origin) / 1e9, values, left=np.nan, right=np.nan)
    index = np.clip(np.searchsorted(clock, stamps, side="right"), 1, len(clock) - 1)
    near = clock[index] - clock[index - 1] <= _limit(clock)
    return np.where(near | (stamps == clock[index]) | (stamps == clock[index - 1]), between, np.nan)


def state_samples(log: Log, card: Card, channel: Channel, what: str) -> tuple[Stamps, Array]:
    """Stamps and values of a state in any table, each of shape (N,), with NaN as recorded but without blank cells.

    Its clock is that of the commands or of the poses where it is in their table with as many values, else its own.
    In a file of rows a state is as it was until the next row that holds it, unless it is recorded beside the commands.

    Args:
        log: As recorded.
        card: The meaning of each column.
        channel: The state.
        what: Its name, for the error message.

    Raises:
        CardError: The column is missing, or has no clock.
    """
    table, values = split_source(channel.source)[0], column(log, channel)
    times = [time for time in (card.command_time, card.pose_time) if split_source(time.source)[0] == table]
    clocks = [stamps_of(log, time) for time in times] or [own_clock(log, card.command_time, channel)]
    clock = next((clock for clock in clocks if abs(len(clock) - len(values)) <= 1), None)
    if clock is None:
        raise CardError(f"{log.path}: no time stamps for {what} {channel.source} ({len(values)} values)")
    shared = min(len(clock), len(values))
    told = np.isfinite(values[:shared])
    if not _of_rows(log, channel):
        told[:] = True
    elif table_of(log, str(channel.source))[0] is table_of(log, str(card.command_time.source))[0]:
        own = sample_rows(log, card.command_time, card.command)[:shared]
        if own.size == shared and np.sum(own & told) > np.sum(told) / 2:  # it is recorded beside the commands
            told |= own
    return clock[:shared][told], values[:shared][told]


def _of_rows(log: Log, channel: Channel) -> bool:
    """Whether a channel is in a file of rows, whose cells may be blank."""
    kind = FORMATS.get(format_of(log, table_of(log, str(channel.source))[0].name))
    return kind is not None and kind.rows


def _limit(clock: Stamps) -> float:
    return (GAP_PERIODS + GAP_TOLERANCE) * (median_period(clock) or 0)


def _reached(clock: Stamps, stamps: Stamps) -> Mask:
    """Whether each stamp is at most a gap later than a sample."""
    index = np.searchsorted(clock, stamps, side="right") - 1
    return (index >= 0) & (stamps - clock[np.maximum(index, 0)] <= _limit(clock))
