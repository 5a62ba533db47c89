"""Log + Card -> columns: which cards fit a log, and the values of the columns that a card names.

Also what names and values of columns reveal: which is a series, which a clock, in what unit.
"""

import re
from collections.abc import Mapping
from dataclasses import replace
from fnmatch import fnmatchcase
from itertools import takewhile

import numpy as np

from rotorfit.core.card import KINDS, STAMP_UNITS, Card, Channel
from rotorfit.core.errors import CardError, nearest
from rotorfit.core.frames import POSE_UNITS, Array
from rotorfit.core.limits import COMMAND_UNITS
from rotorfit.core.log import Column, Log, Table
from rotorfit.files.cards import builtin_cards
from rotorfit.files.logs.several import format_of


def tables_of(card: Card) -> frozenset[str] | None:
    """Names of the tables that a card reads; None where it names columns without a table, or tables by a pattern."""
    parts = (card.command, card.pose, card.velocity, card.attitude, card.reference)
    channels = [card.command_time, card.pose_time, *(channel for part in parts for channel in part.values())]
    channels += [each for each in (card.velocity_time, card.attitude_time) if each]
    channels += [*(part.channel for part in card.window), *card.resets]
    channels += [other for channel in channels for other in channel.others]
    tables = {split_source(channel.source)[0] for channel in channels if isinstance(channel.source, str)}
    return None if any(not table or "*" in table for table in tables) else frozenset(tables)


def fitting_cards(log: Log) -> dict[str, Card]:
    """The built-in cards, by name, whose columns are all in the log."""
    return {name: card for name, card in builtin_cards().items() if fits(log, card)}


def card_for(log: Log, card: Card) -> Card:
    """The card with each column under its name in this log, without optional conditions whose column the log lacks.

    Where the log itself states the unit of a column, that unit overrides the card's.

    Args:
        log: Log that holds the columns.
        card: May name alternatives (`yaw = ["new:name", "old:name"]`), and tables by a pattern (`/vicon/*/*`) that
            matches exactly one table.
    """
    log_tables = (*log.tables, *log.skipped)

    only = next(iter(log.tables.values())) if len(log.tables) == 1 else None

    def bare(channel: Channel) -> Channel:
        table, name = split_source(channel.source)
        if table and only and channel.source in only.columns:  # the column's own name has a colon
            return replace(channel, source=f"{only.name}:{channel.source}")
        there = [one for one in log_tables if fnmatchcase(one, table)] if "*" in table else []
        return replace(channel, source=f"{there[0]}:{name}", others=()) if len(there) == 1 else channel

    def named(channel: Channel) -> Channel:
        if not channel.others:
            return bare(channel)
        known = (one for one in map(bare, (channel, *channel.others)) if _holds(log, one.source))
        return replace(next(known, channel), others=())

    def clock(channel: Channel) -> Channel:
        channel = named(channel)
        said = stated_unit(log, channel)
        return replace(channel, unit=said) if said in STAMP_UNITS and _is_plain(channel) else channel

    def all_named(channels: Mapping[str, Channel], units: Mapping[str, str] = _NO_UNITS) -> dict[str, Channel]:
        return {key: _as_logged(log, named(channel), units.get(key)) for key, channel in channels.items()}

    window = [replace(part, channel=named(part.channel)) for part in card.window]
    return replace(
        card,
        command_time=clock(card.command_time),
        command=all_named(
            card.command, {axis: COMMAND_UNITS.get(one.meaning or "", "") for axis, one in card.command.items()}
        ),
        pose_time=clock(card.pose_time),
        pose=all_named(card.pose, POSE_UNITS),
        velocity=all_named(card.velocity, _SPEED),
        velocity_time=clock(card.velocity_time) if card.velocity_time else None,
        attitude=all_named(card.attitude, POSE_UNITS),
        attitude_time=clock(card.attitude_time) if card.attitude_time else None,
        reference=all_named(card.reference),
        window=tuple(part for part in window if not part.optional or _holds(log, part.channel.source)),
        resets=tuple(named(channel) for channel in card.resets),
    )


_NO_UNITS: Mapping[str, str] = {}

_SPEED = {axis: f"{unit}/s" for axis, unit in POSE_UNITS.items()}


def _as_logged(log: Log, channel: Channel, si: str | None) -> Channel:
    """The channel with the unit that the log states for its column; unchanged if it states none, or another quantity.

    Args:
        log: Log that holds the column.
        channel: Under its name in the log.
        si: SI unit of the quantity, used where the card gives no unit.
    """
    said = stated_unit(log, channel)
    own = channel.unit or si
    if said is None or said == own or not _is_plain(channel) or not any(said in kind and own in kind for kind in KINDS):
        return channel
    return replace(channel, unit=said)


def _is_plain(channel: Channel) -> bool:
    """Whether a card takes a column in its own unit: not scaled, and no fraction of a limit."""
    return abs(channel.scale) == 1 and channel.offset == 0 and channel.full_scale is None


def stated_unit(log: Log, channel: Channel) -> str | None:
    """The unit that the log itself states for a column; None where it states none."""
    table, name = split_source(channel.source)
    return log.units.get((table or next(iter(log.tables)), name)) if table or len(log.tables) == 1 else None


def unit_note(before: Card, after: Card) -> str:
    """Describes where the log's units replaced those of the card; empty where they agree.

    Args:
        before: The card as written.
        after: The card from `card_for`.
    """
    clocks = [
        (known, channel)
        for part in ("command_time", "pose_time", "velocity_time", "attitude_time")
        for known, channel in [(getattr(before, part), getattr(after, part))]
        if known is not None and known.unit
    ]
    values = [
        (known[axis], channel)
        for part in ("command", "pose", "velocity", "attitude", "reference")
        for known, found in [(getattr(before, part), getattr(after, part))]
        for axis, channel in found.items()
    ]
    changed = [
        f"{channel.source} is in {channel.unit}, not in {known.unit or 'SI'}"
        for known, channel in [*clocks, *values]
        if channel.unit not in {one.unit for one in (known, *known.others)}
    ]
    return f"by the log's own units, over the card's: {'; '.join(changed)}" if changed else ""


def _holds(log: Log, source: str | float) -> bool:
    """Whether a log has a numeric column of that name; True for constants."""
    if not isinstance(source, str):
        return True
    try:
        raw_column(log, source)
    except CardError:
        return False
    return True


def fits(log: Log, card: Card) -> bool:
    """Whether a log has all columns of a card."""
    card = card_for(log, card)
    others = [*card.velocity.values(), *card.attitude.values(), *card.reference.values()]
    others += [*(part.channel for part in card.window), *card.resets]
    others += [one for one in (card.velocity_time, card.attitude_time) if one]
    try:
        for time, channels in ((card.command_time, card.command), (card.pose_time, card.pose)):
            table, count = split_source(time.source)[0], len(raw_column(log, time.source)[1])
            for channel in channels.values():
                beside = split_source(channel.source)[0] == table
                column(log, channel, count if beside or not isinstance(channel.source, str) else None)
        for channel in others:
            column(log, channel)
    except CardError:
        return False
    return True


def column(log: Log, channel: Channel, count: int | None = None) -> Array:
    """Values of a channel: raw * scale + offset, then converted to SI.

    Args:
        log: Log that holds the columns.
        channel: The column, and how to read it.
        count: Number of stamps; identifies the time axis of a matrix (for `NAME[i]`) and sets the length of a
            constant. None takes the longer axis, and one sample.

    Returns:
        Shape (N,), float64, SI or the fraction defined by the card. N may differ from `count`.

    Raises:
        CardError: Table, column or row is missing (the nearest is named), or the column is not numeric.
    """
    if isinstance(channel.source, str):
        raw = raw_column(log, channel.source, count)[1].astype(np.float64)
    else:
        raw = np.full(1 if count is None else count, float(channel.source))
    if (channel.scale, channel.offset, channel.factor) == (1.0, 0.0, 1.0):
        return raw
    return channel.in_si(raw)


def raw_column(log: Log, source: str | float, count: int | None = None) -> tuple[str, Column]:
    """A column as it was recorded.

    Args:
        log: Log that holds the columns.
        source: `TABLE:COLUMN`, `COLUMN` where the log has one table, or a row `NAME[i]`.
        count: As in `column`.

    Returns:
        The column's name without its table, and its values, shape (N,), of any real type.

    Raises:
        CardError: As `column`.
    """
    if not isinstance(source, str):
        raise CardError(f"{log.path}: a constant ({source:g}) stands where a column is needed")
    table, name = table_of(log, source)
    row = re.fullmatch(r"(.+)\[(\d+)\]", name)
    if name in table.columns:
        values = _vector(table.columns[name], f"{log.path}: {source}")
    elif row and row[1] in table.columns:
        values = _row(table.columns[row[1]], int(row[2]), count, f"{log.path}: {source}")
    else:
        raise CardError(
            f"{log.path}: no column {name!r} in {table.name!r}{nearest(name, table.columns)}{_another_card(log)}"
        )
    if values.dtype.kind not in "biuf":
        raise CardError(f"{log.path}: {source} holds no numbers (type {values.dtype})")
    return name, values


def split_source(source: str | float) -> tuple[str, str]:
    """Splits `TABLE:COLUMN` at the first colon; the table is "" where there is no colon."""
    table, colon, name = str(source).partition(":")
    return (table, name) if colon else ("", table)


def table_of(log: Log, source: str) -> tuple[Table, str]:
    """The table that a source names, and the column's name in it.

    Raises:
        CardError: There is no such table (the nearest is named), or no table is named and there are several.
    """
    only = next(iter(log.tables.values())) if len(log.tables) == 1 else None
    head, tail = split_source(source)
    if only is not None and (not head or source in only.columns):
        return only, source
    if head in log.tables:
        return log.tables[head], tail
    if head in log.skipped:
        raise CardError(f"{log.path}: table {head!r} was not decoded: {log.skipped[head]}")
    if head:
        raise CardError(
            f"{log.path}: no table {head!r}{nearest(head, [*log.tables, *log.skipped])}{_another_card(log)}"
        )
    holders = [table.name for table in log.tables.values() if source in table.columns] or list(log.tables) or ["TABLE"]
    raise CardError(f"{log.path}: {source!r} names no table of the {len(log.tables)}; write '{holders[0]}:{source}'")


def _another_card(log: Log) -> str:
    """Where to find a card for a log that lacks what a card names, to end an error message."""
    info = f"rotorfit info {log.path}"
    return (
        f" (`{info}` lists what is there and names the built-in card that fits; `{info} --draft-card FILE` drafts one)"
    )


def _vector(values: Column, what: str) -> Column:
    """A column that holds one series, shape (N,).

    Raises:
        CardError: It is a matrix.
    """
    if values.ndim == 1 or (values.ndim == 2 and 1 in values.shape):
        return values.ravel()
    raise CardError(f"{what} has the shape {values.shape}, not one series; name a row, as in NAME[0]")


def _row(values: Column, row: int, count: int | None, what: str) -> Column:
    """Row `row` of a matrix; its time axis is the one whose length matches `count` within one sample.

    Raises:
        CardError: No axis matches, or there is no such row.
    """
    matrix = values[np.newaxis] if values.ndim == 1 else values
    if matrix.ndim != 2:
        raise CardError(f"{what}: shape {values.shape} is not a matrix")
    surplus = [abs(n - (max(matrix.shape) if count is None else count)) for n in matrix.shape]
    if min(surplus) > 1:
        raise CardError(f"{what}: no axis of {matrix.shape} is as long as its time ({count})")
    by_row: Column = matrix if surplus[1] <= surplus[0] else matrix.T
    if row >= len(by_row):
        raise CardError(f"{what}: row {row} of {len(by_row)} (rows count from 0)")
    series: Column = by_row[row]
    return series


_CLOCKS = (
    *("header_stamp", "log_time", "time", "t", "timestamp", "stamp", "seconds", "secs", "elapsed", "time_stamp"),
    *("t_sec", "time_sec", "unix_time", "epoch", "datetime", "rostime", "ros_time", "host_time", "ts", "monotonic"),
    *("clock", "sec_of_day", "seconds_of_day", "time_of_day"),
)

_CLOCK = "(?:time|stamp|timestamp|time_stamp)"

_STAMPED = "(?:cmds?|commands?|poses?|mocap|control|sent|send|recv|received|rx|tx)"

_CLOCK_OF_SOMETHING = re.compile(f"(.+)_{_CLOCK}")

_CLOCK_OF_ROWS = re.compile(f"(?:t|{_CLOCK})_{_STAMPED}")

_PER_SECOND = {None: 1.0, "ms": 1e3, "us": 1e6, "ns": 1e9}

SINCE_1970 = 0.9e9, 4.1e9
"""Seconds from 1970 to the years 1998 and 2099."""

_FEW_ROWS = 8  # quaternions, vectors, sticks

_SPEED_SUFFIX = {"m_s": "m/s", "mps": "m/s", "cm_s": "cm/s", "rad_s": "rad/s", "deg_s": "deg/s", "dps": "deg/s"}

_UNIT_SUFFIX = re.compile(rf"_({'|'.join(_SPEED_SUFFIX)}|deg|rad|mm|cm|m|ms|us|ns|s)$")


def sample_count(table: Table) -> int:
    """Length of the longest axis of any column: the apparent number of samples in a table."""
    return max((max(values.shape, default=1) for values in table.columns.values()), default=0)


def shape_text(values: Column) -> str:
    """The shape of a matrix, such as ` (6 x 19780)`; empty for a single series."""
    return "" if values.ndim == 1 or 1 in values.shape else f" ({' x '.join(str(n) for n in values.shape)})"


def clock_of(log: Log, table: Table, count: int, of: str = "") -> Channel | None:
    """The likely clock of `count` samples, its unit inferred from its name or its steps; None if there is none.

    Args:
        log: Log that holds the table.
        table: The table.
        count: Number of samples.
        of: Name of a column that it is to stamp. A clock of all rows comes before those of one sensor, if it is filled
            where that column is; of the others the one that is blank in the same rows, as `t_cmd` beside `u_x`, or
            begins with the same words, as `pose.time` beside `pose.x`.
    """

    def rank(name: str) -> tuple[bool, bool, int, int]:
        plain = plain_name(name)
        of_rows = _CLOCK_OF_ROWS.fullmatch(plain) is not None
        own = _CLOCK_OF_SOMETHING.fullmatch(plain) and plain not in _CLOCKS and not plain.endswith("header_stamp")
        unlike = _unlike(table, name, of) if of_rows else 0
        return not _stamps(table, name, of), bool(own) or of_rows, unlike, -_words_shared(name, of)

    names = sorted(clocks_of(table, count), key=rank)
    if not names:
        return None
    of_ulog = format_of(log, table.name) == "ulog" and names[0] == "timestamp"
    stated = log.units.get((table.name, names[0]))
    unit = stated if stated in STAMP_UNITS else "us" if of_ulog else unit_of_name(names[0])
    time = Channel(source_of(log, table, names[0]), unit=unit)
    if time.unit is not None or plain_name(names[0]) in _CLOCKS[:2]:
        return time
    return replace(time, unit=_likely_unit(table.columns[names[0]].astype(np.float64).ravel()))


def _likely_unit(stamps: Array) -> str | None:
    """The unit of stamps, None for seconds: by their step, between 10 kHz and 1/3 Hz, and by the years since 1970.

    Where both leave two open, whole numbers at 1 kHz to 1 Hz are ms, us or ns; seconds in which several samples fall
    are seconds.
    """
    stamps = stamps[np.isfinite(stamps)]
    steps = np.diff(stamps)
    step, largest = float(np.median(steps[steps > 0])), float(np.max(np.abs(stamps)))
    units = [(unit, size) for unit, size in _PER_SECOND.items() if 1e-4 <= step / size <= 3.0]
    for unit, size in units:
        if SINCE_1970[0] < largest / size < SINCE_1970[1]:
            return unit
    if np.median(steps) <= 0 or np.any(stamps % 1 != 0):
        return units[0][0] if units else None
    return next((unit for unit, size in reversed(units) if step / size >= 0.999e-3), None)


def clocks_of(table: Table, count: int) -> list[str]:
    """Columns that are named like clocks, advance, and match `count` samples; the likeliest first."""
    return [name for name, size in clocks(table).items() if abs(size - count) <= 1]


def clocks(table: Table) -> dict[str, int]:
    """Columns that are named like clocks, or like those of something, and advance; the likeliest first.

    Names as `t_cmd`, which may be a thrust, are clocks only where they never go back and one of them is blank in some
    rows. Where there is no clock, those that count ms, us or ns, or hold dates.
    """
    plain = {name: name_without_unit(name) for name, values in table.columns.items() if is_series(values)}
    names = {one: name for name, one in plain.items()}
    likely = [names[clock] for clock in _CLOCKS if clock in names]
    likely += [name for name, one in plain.items() if _CLOCK_OF_SOMETHING.fullmatch(one) and name not in likely]
    of_rows = [name for name, one in plain.items() if _CLOCK_OF_ROWS.fullmatch(one) and _never_goes_back(table, name)]
    likely += of_rows if any(_has_blanks(table, name) for name in of_rows) else []
    if not likely:
        likely = [name for name in plain if _counts_time(table, name) or _holds_dates(table, name)]
    return {name: table.columns[name].size for name in likely if _advances(table.columns[name].ravel().astype(float))}


def _counts_time(table: Table, name: str) -> bool:
    """Whether a column is in a unit of time by its name and never goes back: `tx_ms`, not `latency_ms`."""
    return unit_of_name(name) in ("ms", "us", "ns") and _never_goes_back(table, name)


def _holds_dates(table: Table, name: str) -> bool:
    """Whether a column holds dates, which readers convert to nanoseconds since 1970, and never goes back."""
    values = table.columns[name]
    if values.dtype.kind != "i" or not _never_goes_back(table, name):
        return False
    return bool(SINCE_1970[0] < np.min(values) / 1e9 and np.max(values) / 1e9 < SINCE_1970[1])


def _has_blanks(table: Table, name: str) -> bool:
    return not np.all(np.isfinite(table.columns[name].astype(float)))


def _never_goes_back(table: Table, name: str) -> bool:
    values = table.columns[name].ravel().astype(float)
    return bool(np.all(np.diff(values[np.isfinite(values)]) >= 0))


def _advances(stamps: Array) -> bool:
    return bool(np.any(np.diff(stamps[np.isfinite(stamps)]) > 0))


def _stamps(table: Table, clock: str, name: str) -> bool:
    """Whether a clock is filled in most rows in which a column is; True where the column is the row of a matrix."""
    stamps, values = table.columns[clock].ravel(), table.columns.get(name)
    if values is None or values.size != stamps.size:
        return True
    filled = np.isfinite(values.ravel())
    return bool(np.sum(np.isfinite(stamps) & filled) >= 0.5 * np.sum(filled))


def _unlike(table: Table, clock: str, name: str) -> int:
    """Number of rows in which a clock has a value and a column has none, or the reverse."""
    stamps, values = table.columns[clock].ravel(), table.columns.get(name)
    if values is None or values.size != stamps.size:
        return 0
    return int(np.sum(np.isfinite(stamps) != np.isfinite(values.ravel())))


def _words_shared(one: str, other: str) -> int:
    """Number of words at the start that two names share."""
    pairs = zip(plain_name(one).split("_"), plain_name(other).split("_"), strict=False)
    return len(list(takewhile(lambda pair: pair[0] == pair[1], pairs)))


def is_series(values: Column) -> bool:
    """Whether a column is one series of real numbers with more than one sample."""
    return values.dtype.kind in "iuf" and values.size > 1 and values.size == max(values.shape)


def series_of(table: Table) -> dict[str, int]:
    """Columns that are one series, and the rows of matrices with few rows as `NAME[i]`, with their lengths."""
    found = {name: values.size for name, values in table.columns.items() if is_series(values)}
    for name, values in table.columns.items():
        if values.dtype.kind in "iuf" and values.ndim == 2 and 1 < min(values.shape) <= _FEW_ROWS < max(values.shape):
            found |= {f"{name}[{row}]": max(values.shape) for row in range(min(values.shape))}
    return found


def plain_name(name: str) -> str:
    """Converts a name to lower case with underscores: `cmdVel.linear.x` becomes `cmd_vel_linear_x`."""
    return re.sub(r"[^a-z0-9]+", "_", re.sub(r"([a-z])([A-Z])", r"\1_\2", name).lower()).strip("_")


def name_without_unit(name: str) -> str:
    """The plain name without a trailing unit: `Time_ms` becomes `time`."""
    return _UNIT_SUFFIX.sub("", plain_name(name))


def unit_of_name(name: str) -> str | None:
    """The unit at the end of a name; None where there is none or it is SI."""
    match = _UNIT_SUFFIX.search(plain_name(name))
    unit = _SPEED_SUFFIX.get(match[1], match[1]) if match else None
    return None if unit in ("m", "rad", "s", "m/s", "rad/s") else unit


def source_of(log: Log, table: Table, name: str) -> str:
    """The source of a column as a card writes it: `TABLE:COLUMN`, or `COLUMN` where the log has one table."""
    return name if len(log.tables) == 1 else f"{table.name}:{name}"
