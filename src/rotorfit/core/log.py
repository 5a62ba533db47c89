"""Log: the content of a file as recorded: named tables of columns."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from rotorfit.core.display import counted, html_table, short_repr

Column = npt.NDArray[Any]
"""A column: shape (N,), or (N, M) / (M, N) for a matrix in a MAT file. Any type, as recorded."""


@dataclass(frozen=True)
class Table:
    """Columns that were recorded together.

    Attributes:
        name: Topic, message name, or the file's stem for a file that holds one table.
        columns: Name to values, as recorded: no unit, sign or type is changed. Nested message fields are dotted
            (`pose.position.x`); stamps of messages (`header.stamp`, `log_time`) are int64 nanoseconds. All columns of
            a bag's table have N rows; those of a MAT file need not.
    """

    name: str
    columns: Mapping[str, Column]

    __repr__ = short_repr


@dataclass(frozen=True)
class Event:
    """An event in flight.

    Attributes:
        time: By the recorder's clock [ns].
        text: Description.
    """

    time: int
    text: str


@dataclass(frozen=True)
class Log:
    """A file as recorded.

    Attributes:
        path: Where it was read from.
        format: Name of the format, a key of `files.logs.FORMATS`, such as `csv` or `rosbag1`; or `simulated`.
        sha256: Hex digest of the file (for a folder: of the bytes of its files in the order of their names).
        tables: Name to table, in the order of the file.
        skipped: Tables that exist but were not decoded: name to the reason, the type and the count of messages.
        notes: What was recovered on reading, and which columns were left out, one line each.
        attached: Texts that `rotorfit fly` wrote beside the samples: `plan` and `card` (TOML), `link`, `rotorfit`
            (version).
        events: Events that `rotorfit fly` recorded in flight, in order.
        file_of: Table to its file where several files were joined; else empty, also for parts of one recording.
        retimed: Table and column of a clock to the stamps that replace it, shape (N,) [ns]: shifted onto another clock,
            or corrected by arrival times. Empty as read.
        damage: What was lost because the file is damaged or cut short, one line each.
        units: Table and column to the unit stated by the log itself, one of `frames.UNIT_SCALE`.
    """

    path: Path
    format: str
    sha256: str
    tables: Mapping[str, Table]
    skipped: Mapping[str, str]
    notes: tuple[str, ...] = ()
    attached: Mapping[str, str] = field(default_factory=dict)
    events: tuple[Event, ...] = ()
    file_of: Mapping[str, str] = field(default_factory=dict)
    retimed: Mapping[tuple[str, str], npt.NDArray[np.int64]] = field(default_factory=dict)
    damage: tuple[str, ...] = ()
    units: Mapping[tuple[str, str], str] = field(default_factory=dict)

    def __repr__(self) -> str:
        return f"Log({str(self.path)!r}, {self.format}, {counted(len(self.tables), 'table')})"

    def _repr_html_(self) -> str:
        rows = []
        for table in self.tables.values():
            length = max((len(column) for column in table.columns.values()), default=0)
            rows.append((table.name, str(length), ", ".join(table.columns)))
        return html_table(repr(self), ("table", "rows", "columns"), rows)


@dataclass(frozen=True)
class Sample:
    """One stamped value of a live link's stream, in the same form from a vehicle, a simulator or a replayed log.

    Attributes:
        stream: `pose`: x, y, z [m], then the quaternion w, x, y, z, world z up. `velocity`: x, y, z [m/s] and yaw rate
            [rad/s] by the vehicle's own sensors, heading frame. `command`: forward, left, up, counter-clockwise, as
            they were sent. `battery`: remaining charge, 0 to 1. `obeys`: 1 while the vehicle obeys the commands, 0
            while its autopilot takes off, lands or flies by itself. `said`: a text message of the vehicle or the link,
            without numbers.
        stamp: Time of measurement, by the sender's clock [ns].
        received: Time of arrival, by the link's clock [ns].
        values: The numbers.
        text: Text of a `said` sample.
        error: Half the 95 % interval of an offset of the stamp, which other samples of the stream share [s]; 0 where
            it is small or unknown.
    """

    stream: Literal["pose", "velocity", "command", "battery", "obeys", "said"]
    stamp: int
    received: int
    values: tuple[float, ...]
    text: str = ""
    error: float = 0.0


NUMBERS: Mapping[str, int] = {"pose": 7, "velocity": 4, "command": 4, "battery": 1, "obeys": 1, "said": 0}
"""Number of values of a sample of each stream."""
