"""One log in several files: `A+B`, or files written by one logger."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from rotorfit.core.log import Log, Table


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

    Tables with the same name are distinguished by the stem of their file, as `flight2/cmd_vel`; all others keep their
    names.

    Args:
        logs: Of one flight; none of them joined before.

    Returns:
        A log whose path is `A+B`, whose digest is the digests of the files joined by plus signs, and which records the
        file of each table.
    """
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
    return Log(
        path=Path("+".join(str(log.path) for log in logs)),
        format="+".join(log.format for log in logs),
        sha256="+".join(log.sha256 for log in logs),
        tables=tables,
        skipped=skipped,
        notes=tuple(f"{log.path.name}: {note}" for log in logs for note in log.notes),
        damage=tuple(f"{log.path.name}: {text}" for log in logs for text in log.damage),
        file_of=file_of,
        attached={name: text for log in logs for name, text in log.attached.items()},
        events=tuple(event for log in logs for event in log.events),
        units=units,
    )


def format_of(log: Log, table: str) -> str:
    """The format of the file that holds a table."""
    if not log.file_of:
        return log.format
    return log.format.split("+")[list(dict.fromkeys(log.file_of.values())).index(log.file_of[table])]
