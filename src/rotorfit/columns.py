"""What names and values of columns say: which is a series, which a clock, in what unit."""

import re
from dataclasses import replace

import numpy as np

from rotorfit.card import Channel
from rotorfit.log import Column, Log, Table

_CLOCKS = ("header_stamp", "log_time", "time", "t", "timestamp", "stamp", "seconds", "secs", "elapsed")
_FEW_ROWS = 8  # quaternions, vectors, sticks
_SPEED_SUFFIX = {"m_s": "m/s", "mps": "m/s", "cm_s": "cm/s", "rad_s": "rad/s", "deg_s": "deg/s", "dps": "deg/s"}
_UNIT_SUFFIX = re.compile(rf"_({'|'.join(_SPEED_SUFFIX)}|deg|rad|mm|cm|m|ms|us|ns|s)$")


def sample_count(table: Table) -> int:
    """Length of the longest axis of any column: how many samples a table seems to hold."""
    return max((max(values.shape, default=1) for values in table.columns.values()), default=0)


def shape_text(values: Column) -> str:
    """The shape of a matrix, as in ` (6 x 19780)`; nothing for a single series."""
    return "" if values.ndim == 1 or 1 in values.shape else f" ({' x '.join(str(n) for n in values.shape)})"


def clock_of(log: Log, table: Table, count: int) -> Channel | None:
    """The column that looks like the clock of `count` samples; its unit from its name or its steps."""
    names = clocks_of(table, count)
    if not names:
        return None
    of_ulog = log.format == "ulog" and names[0] == "timestamp"
    time = Channel(source_of(log, table, names[0]), unit="us" if of_ulog else unit_of_name(names[0]))
    if time.unit is not None or plain_name(names[0]) in _CLOCKS[:2]:
        return time
    steps = np.diff(table.columns[names[0]].astype(np.float64).ravel())
    step = float(np.median(steps[steps > 0]))  # between 1 kHz and 1 Hz in whatever unit
    return replace(time, unit="ns" if step > 1e6 else "us" if step > 1e3 else "ms" if step > 1.5 else None)


def clocks_of(table: Table, count: int) -> list[str]:
    """Columns that are named as clocks, advance, and go with `count` samples; the likeliest first."""
    names = {name_without_unit(name): name for name, values in table.columns.items() if is_series(values)}
    likely = [names[clock] for clock in _CLOCKS if clock in names]
    fitting = [name for name in likely if abs(table.columns[name].size - count) <= 1]
    return [name for name in fitting if np.any(np.diff(table.columns[name].ravel().astype(np.float64)) > 0)]


def is_series(values: Column) -> bool:
    """Whether a column is one series of real numbers, of more than one sample."""
    return values.dtype.kind in "iuf" and values.size > 1 and values.size == max(values.shape)


def series_of(table: Table) -> dict[str, int]:
    """Columns that are one series, and the rows of matrices of few rows as `NAME[i]`, with their lengths."""
    found = {name: values.size for name, values in table.columns.items() if is_series(values)}
    for name, values in table.columns.items():
        if values.dtype.kind in "iuf" and values.ndim == 2 and 1 < min(values.shape) <= _FEW_ROWS < max(values.shape):
            found |= {f"{name}[{row}]": max(values.shape) for row in range(min(values.shape))}
    return found


def plain_name(name: str) -> str:
    """Lower case with underscores: `cmdVel.linear.x` becomes `cmd_vel_linear_x`."""
    return re.sub(r"[^a-z0-9]+", "_", re.sub(r"([a-z])([A-Z])", r"\1_\2", name).lower()).strip("_")


def name_without_unit(name: str) -> str:
    """The plain name without a unit at its end: `Time_ms` becomes `time`."""
    return _UNIT_SUFFIX.sub("", plain_name(name))


def unit_of_name(name: str) -> str | None:
    """A unit that a name ends in, where it is not the default of its kind."""
    match = _UNIT_SUFFIX.search(plain_name(name))
    unit = _SPEED_SUFFIX.get(match[1], match[1]) if match else None
    return None if unit in ("m", "rad", "s", "m/s", "rad/s") else unit


def source_of(log: Log, table: Table, name: str) -> str:
    """How a card names a column: `TABLE:COLUMN`, or `COLUMN` where the log has one table."""
    return name if len(log.tables) == 1 else f"{table.name}:{name}"
