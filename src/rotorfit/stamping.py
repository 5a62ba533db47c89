"""Log + Card -> the same log by better stamps: the recorder's for empty headers, a regular sender's for arrivals."""

from dataclasses import replace

import numpy as np

from rotorfit.card import Card, Channel
from rotorfit.card_columns import table_of
from rotorfit.clock import MISSING_STAMP, stamps_of
from rotorfit.log import Log
from rotorfit.straight import straightened
from rotorfit.stream import Note

_HEADER, _RECORDER = "header.stamp", "log_time"


def with_sound_stamps(log: Log, card: Card) -> tuple[Log, tuple[Note, ...]]:
    """Replaces stamps that nobody filled in, and straightens those of arrival.

    The stamp of a sender is taken as it is. Where the card names one that stands still, the recorder's takes its place.
    Stamps of arrival are straightened where the data show a regular sender: of the recorder, and of poses in a table
    without a sender's stamp, because cameras are regular. Commands in such a table may be stamped where they are sent,
    and a late command is late. Where poses and commands share a table, its clock is that of the logger.

    Args:
        log: As recorded.
        card: Which column is what.

    Returns:
        The log, its clocks `retimed` where that was done; and what was done.

    Raises:
        CardError: A column is not there.
    """
    notes: list[Note] = []
    streams = {"command": card.command_time, "pose": card.pose_time}
    tables = {what: table_of(log, str(time.source))[0] for what, time in streams.items()}
    for what, time in streams.items():
        table, name = table_of(log, str(time.source))
        clock, arrived = time, name == _RECORDER or (what == "pose" and name != _HEADER)
        if name == _HEADER and _RECORDER in table.columns and _stands_still(log, time):
            clock, arrived = Channel(str(time.source).removesuffix(_HEADER) + _RECORDER), True
            stamps = stamps_of(log, clock)
            log = replace(log, retimed={**log.retimed, (table.name, name): stamps})
            text = f"{_HEADER} of {len(stamps)} {what}s stands still: the recorder's {_RECORDER} was taken"
            notes.append(Note(f"{what}_header_unfilled", text, len(stamps)))
        stamped = name != _HEADER and _HEADER in table.columns and not _stands_still(log, _beside(time, name))
        if stamped or not arrived or tables["command"] is tables["pose"]:
            continue
        found = straightened(stamps_of(log, clock))
        if found is not None:
            log = replace(log, retimed={**log.retimed, (table.name, name): found.stamps})
            text = (
                f"stamps of arrival of {len(found.stamps)} {what}s were straightened to the sender's "
                f"{1 / found.period:.4g} Hz: they were late by {1e3 * found.mean:.1f} ms in the mean, up to "
                f"{1e3 * found.most:.1f} ms in 95 %"
            )
            notes.append(Note(f"{what}_stamps_straightened", text, len(found.stamps)))
    return log, tuple(notes)


def _beside(time: Channel, name: str) -> Channel:
    """The sender's stamp in the table of a clock."""
    return Channel(str(time.source).removesuffix(name) + _HEADER)


def _stands_still(log: Log, time: Channel) -> bool:
    """Whether a clock has but one value, as a header that nobody filled in."""
    stamps = stamps_of(log, time)
    there = stamps[stamps != MISSING_STAMP]
    return there.size > 1 and not np.any(np.diff(there))
