"""One log in several files: `A+B`, or files written by one logger."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import combinations, pairwise
from pathlib import Path

import numpy as np

from rotorfit.core.log import Column, Log, Table
from rotorfit.files.logs.content import listed

RECORDER = "log_time"
"""The recorder's clock in the tables of a bag."""


def parts_of(path: str | Path) -> tuple[str, ...]:
    """The files of `A+B`; the path itself if such a file exists, or if it contains no plus."""
    text = str(path)
    parts = tuple(part for part in text.split("+") if part)
    return (text,) if len(parts) < 2 or is_there(text) else parts


def is_there(path: str) -> bool:
    """Whether a file or folder exists; a text that cannot be a path does not."""
    try:
        return Path(path).exists()
    except (OSError, ValueError):
        return False


def join_logs(logs: Sequence[Log]) -> Log:
    """One log with the tables of several.

    Files of a recorder that begins a new one while it records become one recording again. Else tables with the same
    name are distinguished by the stem of their file, as `flight2/cmd_vel`; all others keep their names.

    Args:
        logs: Of one flight; none of them joined before.

    Returns:
        A log whose path is `A+B`, whose digest is the digests of the files joined by plus signs, and which records the
        file of each table, unless they are one recording.
    """
    if all(_follows(*pair) for pair in pairwise(logs)) and all(_alike(*pair) for pair in combinations(logs, 2)):
        return _one_recording(logs)
    names = [name for log in logs for name in log.tables]
    tables: dict[str, Table] = {}
    file_of: dict[str, str] = {}
    units: dict[tuple[str, str], str] = {}
    skipped: dict[str, str] = {}
    for log in logs:
        for name, table in log.tables.items():
            own = name if names.count(name) == 1 else f"{log.path.stem}/{name.lstrip('/')}"
            while own in tables:
                own += "'"
            tables[own], file_of[own] = replace(table, name=own), str(log.path)
            units |= {(own, column): unit for (of, column), unit in log.units.items() if of == name}
        skipped |= {name: reason for name, reason in log.skipped.items() if name not in names}
    joined = replace(
        _joined(logs, tables, skipped), format="+".join(log.format for log in logs), file_of=file_of, units=units
    )
    several = [name for name in dict.fromkeys(names) if names.count(name) > 1]
    note = (
        f"in more than one file, so a card must say from which: {listed([own for own in tables if own not in names])}"
    )
    return replace(joined, notes=(*joined.notes, *([note] if several else [])))


def _joined(logs: Sequence[Log], tables: Mapping[str, Table], skipped: Mapping[str, str]) -> Log:
    """What logs of any kind have together, and their tables."""
    return Log(
        path=Path("+".join(str(log.path) for log in logs)),
        format=logs[0].format,
        sha256="+".join(log.sha256 for log in logs),
        tables=tables,
        skipped=skipped,
        notes=tuple(f"{log.path.name}: {note}" for log in logs for note in log.notes),
        damage=tuple(f"{log.path.name}: {text}" for log in logs for text in log.damage),
        attached={name: text for log in logs for name, text in log.attached.items()},
        events=tuple(event for log in logs for event in log.events),
        units={column: unit for log in logs for column, unit in log.units.items()},
    )


def _follows(first: Log, second: Log) -> bool:
    """Whether a log continues another: by the recorder's clock it comes after it, with some of its topics."""
    before, after = _filled(first), _filled(second)
    if first.format != second.format or not all(RECORDER in one for one in (*before.values(), *after.values())):
        return False
    return bool(before.keys() & after.keys()) and _times(before).max() <= _times(after).min()


def _alike(one: Log, other: Log) -> bool:
    """Whether the topics that two logs share have the same fields."""
    here, there = _filled(one), _filled(other)
    return all(_shapes(here[name]) == _shapes(there[name]) for name in here.keys() & there.keys())


def _filled(log: Log) -> dict[str, Mapping[str, Column]]:
    """Columns of the tables that have rows."""
    return {name: one.columns for name, one in log.tables.items() if any(map(len, one.columns.values()))}


def _shapes(columns: Mapping[str, Column]) -> dict[str, tuple[int, ...]]:
    return {name: column.shape[1:] for name, column in columns.items()}


def _times(tables: Mapping[str, Mapping[str, Column]]) -> Column:
    return np.concatenate([columns[RECORDER] for columns in tables.values()])


def _one_recording(logs: Sequence[Log]) -> Log:
    """The tables of logs that follow each other, one after the other."""
    tables = {name: table for log in logs for name, table in log.tables.items()}
    filled = [_filled(log) for log in logs]
    for name in tables:
        if parts := [log[name] for log in filled if name in log]:
            tables[name] = Table(name, {key: np.concatenate([part[key] for part in parts]) for key in parts[0]})
    skipped = {name: reason for log in logs for name, reason in log.skipped.items() if name not in tables}
    joined = _joined(logs, tables, skipped)
    note = f"one recording in {len(logs)} files that follow each other: {listed([log.path.name for log in logs])}"
    return replace(joined, notes=(note, *joined.notes))


def format_of(log: Log, table: str) -> str:
    """The format of the file that holds a table."""
    if not log.file_of:
        return log.format
    return log.format.split("+")[list(dict.fromkeys(log.file_of.values())).index(log.file_of[table])]
