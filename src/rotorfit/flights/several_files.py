"""Log + Log -> Log: one flight recorded in several files, and which file holds which column."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import combinations

from rotorfit.core.card import Card, Channel
from rotorfit.core.errors import CardError
from rotorfit.core.log import Log, Table
from rotorfit.files.logs.several import join_logs
from rotorfit.flights.columns import card_for, fits

MOST_FILES = 3
"""Largest number of files that are joined without a plus: commands, poses, and one more."""


def bound(card: Card, log: Log) -> Card:
    """The card with the names of this log; in a log of several files every column gets its table.

    Columns that a section names without a table share one table: the only one that holds them all, or, if several do,
    the one that the section names elsewhere. So `time` in `[command]` and in `[pose]` may be in two files.

    Args:
        card: As written.
        log: Of one file, or joined.
    """
    card = card_for(log, card)
    if not log.file_of:
        return card
    attitude, velocity = dict(card.attitude), dict(card.velocity)
    command = _section(log, {"time": card.command_time, **card.command})
    pose = _section(log, {"time": card.pose_time, **card.pose})
    velocity = _section(log, velocity | ({"time": card.velocity_time} if card.velocity_time else {}))
    attitude = _section(log, attitude | ({"time": card.attitude_time} if card.attitude_time else {}))
    placed = replace(
        card,
        command_time=command.pop("time"),
        command=command,
        pose_time=pose.pop("time"),
        pose=pose,
        velocity_time=velocity.pop("time", None),
        velocity=velocity,
        attitude_time=attitude.pop("time", None),
        attitude=attitude,
        reference=_section(log, card.reference),
        window=tuple(replace(part, channel=_section(log, {"when": part.channel})["when"]) for part in card.window),
        resets=tuple(_section(log, {str(i): one for i, one in enumerate(card.resets)}).values()),
    )
    return card_for(log, placed)  # once more: the log states units of columns of its tables


def _section(log: Log, channels: Mapping[str, Channel]) -> dict[str, Channel]:
    """The channels of a section, each with its table where that is unambiguous."""
    sources = [channel.source for channel in channels.values() if isinstance(channel.source, str)]
    plain = [source for source in sources if not _placed(log, source)]
    holders = [table.name for table in log.tables.values() if all(_holds(table, name) for name in plain)]
    beside = {source.partition(":")[0] for source in sources} & set(holders)  # tables that the section names elsewhere
    holders = list(beside) if len(beside) == 1 else holders
    if not plain or len(holders) != 1:
        return dict(channels)
    return {
        key: replace(channel, source=f"{holders[0]}:{channel.source}") if channel.source in plain else channel
        for key, channel in channels.items()
    }


def _placed(log: Log, source: str) -> bool:
    """Whether a source names its table."""
    return source.partition(":")[0] in log.tables and ":" in source


def _holds(table: Table, name: str) -> bool:
    return name in table.columns or (name.endswith("]") and name.rpartition("[")[0] in table.columns)


def flights_of(logs: Sequence[Log], card: Card | None) -> list[tuple[int, Log]]:
    """Groups logs into flights: logs that only together hold all columns of a card are joined, with a note.

    Args:
        logs: As read.
        card: Defines the columns needed; None joins nothing.

    Returns:
        The index of the first log of each flight, and the flight's log, in that order. Logs that cannot be joined
        stay single, so that a later error reports what they lack.

    Raises:
        CardError: They can be joined in more than one way.
    """
    parts = [i for i, log in enumerate(logs) if card and not log.file_of and not fits(log, card)]
    groups = _groups([logs[i] for i in parts], card) if card and len(parts) > 1 else []
    taken = {parts[place] for group in groups for place in group}
    found = [(i, log) for i, log in enumerate(logs) if i not in taken]
    for group in groups:
        log = join_logs([logs[parts[place]] for place in group])
        note = f"taken as one flight, {log.path}: no file alone holds all that the card names, together they do"
        found.append((parts[group[0]], replace(log, notes=(note, *log.notes))))
    return sorted(found, key=lambda one: one[0])


def _groups(logs: Sequence[Log], card: Card) -> list[tuple[int, ...]]:
    """Indices of the logs of each flight, as few logs per flight as fit; empty where none can be joined.

    Raises:
        CardError: The grouping is ambiguous.
    """
    groups = [
        group
        for size in range(2, min(len(logs), MOST_FILES) + 1)
        for group in combinations(range(len(logs)), size)
        if _together([logs[i] for i in group], card)
    ]
    least = [group for group in groups if not any(set(other) < set(group) for other in groups)]
    places = [place for group in least for place in group]
    if not least or sorted(places) == list(range(len(logs))):
        return least
    files = [str(log.path) for log in logs]
    offer = "+".join(files[place] for place in least[0])
    raise CardError(
        f"{', '.join(files)}: no file alone holds all that the card names, and it is unclear which belong together: "
        f"join the files of each flight by a plus, as {offer}"
    )


def _together(logs: Sequence[Log], card: Card) -> bool:
    log = join_logs(logs)
    return fits(log, bound(card, log))
