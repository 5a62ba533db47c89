"""Result of a format's reader, and the limits for untrusted files."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from rotorfit.core.errors import LogError
from rotorfit.core.log import Column, Event, Table
from rotorfit.core.plain import visible

LIMIT = 1 << 29
"""Most bytes of the decoded numbers of one log, or of one of its arrays: about 15 hours of poses at 120 Hz."""

BLOCK_LIMIT = 1 << 26
"""Most bytes of one record, or one compressed block, of a bag: recorders end a chunk at about one MiB. A block of tiny
messages takes four times as much memory while it is decoded."""

MOST_COLUMNS = 10_000
"""Most columns of one table: ten times the largest autopilot log. Each takes a millisecond to display."""

LARGEST = 1 << 32
"""Most bytes of an autopilot's log: the largest file on its memory card (FAT32)."""

WIDEST = 64
"""Longest array in a message that is decoded as a matrix; longer ones are ranges, maps and pixels, not states."""


class DamageError(Exception):
    """Bytes that are not what they claim to be. Readers turn it into a note, or into a `LogError`."""


class TornError(DamageError):
    """Bytes that cannot be the head of a record: the record before them may be torn as well."""


@dataclass(frozen=True)
class Content:
    """Content of a file as found by a format's reader.

    Attributes:
        tables: Name to table, in the order of the file.
        skipped: Tables that exist but were not decoded: name to the reason.
        notes: What was recovered or left out on reading, one sentence each.
        attached: See `Log.attached`.
        events: See `Log.events`.
        damage: What was lost because the file is damaged or cut short, one sentence each.
        units: See `Log.units`.
    """

    tables: Mapping[str, Table]
    skipped: Mapping[str, str]
    notes: tuple[str, ...]
    attached: Mapping[str, str] = field(default_factory=dict)
    events: tuple[Event, ...] = ()
    damage: tuple[str, ...] = ()
    units: Mapping[tuple[str, str], str] = field(default_factory=dict)


def check_size(path: Path, columns: Iterable[Column]) -> None:
    """Raises `LogError` if the numbers decoded so far exceed `LIMIT`."""
    if sum(values.nbytes for values in columns) > LIMIT:
        raise LogError(f"{path}: more than {LIMIT >> 20} MiB of numbers; cut the log to the flight that you need")


def size_of(path: Path) -> int:
    """Size of an autopilot's log in bytes; raises `LogError` above `LARGEST`."""
    size = path.stat().st_size
    if size > LARGEST:
        raise LogError(f"{path}: a log of {size >> 30} GiB, more than {LARGEST >> 30}; cut it to the flight you need")
    return size


def too_wide(count: int) -> str:
    """Error text for a table with so many columns; empty up to `MOST_COLUMNS`."""
    told = f"a table of {count} columns, more than {MOST_COLUMNS}; keep those of time, commands and pose"
    return told if count > MOST_COLUMNS else ""


def check_width(path: Path, count: int) -> None:
    """Raises `LogError` if a table has more than `MOST_COLUMNS` columns; called before they are processed."""
    if told := too_wide(count):
        raise LogError(f"{path}: {told}")


def one_line(text: object) -> str:
    """First line of a text or an error, at most 300 characters: names in a damaged file may contain anything."""
    line = visible((str(text).strip() or type(text).__name__).splitlines()[0].strip())
    return line if len(line) <= 300 else f"{line[:299]}…"


def listed(names: Sequence[str], most: int = 6) -> str:
    """The first names and the number of further ones, for a note."""
    more = len(names) - most
    return visible(", ".join(names[:most])) + (f" and {more} more" if more > 0 else "")


def column_from(values: Column) -> Column:
    """Drops axes of length one and foreign byte order: shape (N,) or (N, M), native, as compiled code requires."""
    squeezed = np.atleast_1d(np.squeeze(values)) if values.size else np.zeros(0, values.dtype)
    return np.asarray(squeezed, dtype=squeezed.dtype.newbyteorder("="))
