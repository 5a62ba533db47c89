"""What a format's reader hands back, and the bounds that a file from a stranger must keep."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from rotorfit.core.errors import LogError
from rotorfit.core.log import Column, Event, Table
from rotorfit.core.plain import visible

LIMIT = 1 << 29
"""Most bytes that one log's decoded numbers, or one of its arrays, may take: about 15 hours of poses at 120 Hz."""

BLOCK_LIMIT = 1 << 26
"""Most bytes that one record, or one packed block, of a bag may take: recorders end a chunk at about one MiB. A block
of tiny messages takes four times as much while it is taken apart."""

MOST_COLUMNS = 10_000
"""Most columns of one table: ten times the largest log of an autopilot. Each costs a millisecond until it is shown."""

LARGEST = 1 << 32
"""Most bytes of an autopilot's log: the largest file of its memory card."""

WIDEST = 64
"""Longest array inside a message that is given as a matrix; beyond lie ranges, maps and pixels, not vehicle states."""


class DamageError(Exception):
    """Bytes that cannot be what they claim to be. Readers turn it into a note, or into a `LogError`."""


class TornError(DamageError):
    """Bytes that cannot even be the head of a record: the record before them may be torn as well."""


@dataclass(frozen=True)
class Content:
    """What a format's reader found in a file.

    Attributes:
        tables: Name to table, in the order of the file.
        skipped: Tables that exist but were not decoded: name to the reason.
        notes: What was recovered or left out on reading, one sentence each.
        attached: As `Log.attached`.
        events: As `Log.events`.
        damage: What was lost because the file is damaged or cut short, one sentence each.
        units: As `Log.units`.
    """

    tables: Mapping[str, Table]
    skipped: Mapping[str, str]
    notes: tuple[str, ...]
    attached: Mapping[str, str] = field(default_factory=dict)
    events: tuple[Event, ...] = ()
    damage: tuple[str, ...] = ()
    units: Mapping[tuple[str, str], str] = field(default_factory=dict)


def check_size(path: Path, columns: Iterable[Column]) -> None:
    """Raises `LogError` where the numbers decoded so far take more memory than `LIMIT`."""
    if sum(values.nbytes for values in columns) > LIMIT:
        raise LogError(f"{path}: more than {LIMIT >> 20} MiB of numbers; cut the log to the flight that you need")


def size_of(path: Path) -> int:
    """Bytes of an autopilot's log; raises `LogError` where no card of an autopilot writes one so large."""
    size = path.stat().st_size
    if size > LARGEST:
        raise LogError(f"{path}: a log of {size >> 30} GiB, more than {LARGEST >> 30}; cut it to the flight you need")
    return size


def too_wide(count: int) -> str:
    """What is wrong with a table of so many columns; empty where nothing is."""
    told = f"a table of {count} columns, more than {MOST_COLUMNS}; keep those of time, commands and pose"
    return told if count > MOST_COLUMNS else ""


def check_width(path: Path, count: int) -> None:
    """Raises `LogError` where a table has more than `MOST_COLUMNS`; called before each of them takes time."""
    if told := too_wide(count):
        raise LogError(f"{path}: {told}")


def one_line(text: object) -> str:
    """First line of a text or an error, at most 300 characters: names in a damaged file may hold anything."""
    line = visible((str(text).strip() or type(text).__name__).splitlines()[0].strip())
    return line if len(line) <= 300 else f"{line[:299]}…"


def listed(names: Sequence[str], most: int = 6) -> str:
    """The first names and how many more there are, for a note."""
    more = len(names) - most
    return ", ".join(names[:most]) + (f" and {more} more" if more > 0 else "")


def column_from(values: Column) -> Column:
    """Drops axes of length one and foreign byte order: shape (N,) or (N, M), native, as compiled code needs it."""
    squeezed = np.atleast_1d(np.squeeze(values)) if values.size else np.zeros(0, values.dtype)
    return np.asarray(squeezed, dtype=squeezed.dtype.newbyteorder("="))
