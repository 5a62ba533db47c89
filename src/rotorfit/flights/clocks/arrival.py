"""Log + Card -> the same log by better stamps: the recorder's for empty headers, a regular sender's for arrivals.

Stamps of arrival -> the stamps that a regular sender would have given.

A camera or a flight controller sends at a steady rate; the network delivers late, never early, and often several
messages at once. What arrives as number k at a_k was sent not after it, so the sender's clock lies on or below all of

    a_k = start + period k + lateness_k,    lateness_k >= 0

Among the lines that do, the one that leaves the least lateness in the mean is taken: it touches the messages that came
through at once. Where messages were lost, their numbers are not known, and the stamps stay as they are.
"""

from dataclasses import dataclass, replace

import numpy as np

from rotorfit.core.card import Card, Channel
from rotorfit.core.flight_data import Note
from rotorfit.core.frames import Array
from rotorfit.core.log import Log
from rotorfit.flights.columns import table_of
from rotorfit.flights.stamps import MISSING_STAMP, Stamps, rate, stamps_of

FEWEST = 400
"""Messages below which no rate is told from them."""

JITTER_SHARE = 0.5
"""Spread of the steps (5th to 95th percentile), as a share of the period, below which stamps stay as they are."""

LEAST_JITTER = 0.004
"""Spread below which stamps stay as they are [s]: at 1 m/s it is 4 mm."""

BURST = 0.2
"""A step below this share of the period is one that no regular sender makes: two messages came together."""

BURST_SHARE = 0.02
"""Share of such steps from which on stamps are those of arrival."""

STEADY = 1.7
"""Spread of the lateness over the whole log, over the median of its spread in blocks of `BLOCK` messages, beyond which
the sender is irregular: a lateness comes and goes, while a sender whose intervals vary by themselves wanders off, by
more the longer the log. Of 1000 such senders of 500 messages none passed."""

BLOCK = 30
"""Messages of a block."""

PROMPT = 0.3
"""Share of that spread below which the earliest message of every tenth of the log is late; a lost message, or an
irregular sender, lifts it."""


@dataclass(frozen=True)
class Straight:
    """Stamps of a regular sender.

    Attributes:
        stamps: In place of those of arrival, shape (N,) [ns].
        period: Of the sender [s].
        mean: Mean of what was taken off [s].
        most: 95th percentile of it [s].
    """

    stamps: Stamps
    period: float
    mean: float
    most: float


def straightened(arrival: Stamps) -> Straight | None:
    """The sender's stamps of messages that a regular sender sent.

    Args:
        arrival: In the order of sending, shape (N,) [ns]; missing and reversed ones stay as they are.

    Returns:
        The stamps; None where the data do not show a regular sender behind jittered arrivals: too few messages, little
        jitter, no bursts, or a lateness that wanders or never ends.

    Source: the lower envelope as a linear program: S. B. Moon, P. Skelly, D. Towsley, Estimation and removal of clock
    skew from network delay measurements, INFOCOM 1999, pp. 227-234.
    """
    rows = np.flatnonzero(arrival != MISSING_STAMP)
    rows = rows[arrival[rows] >= np.maximum.accumulate(arrival[rows])] if rows.size else rows
    if rows.size < FEWEST or rows.size < 0.99 * arrival.size:
        return None
    time = (arrival[rows] - arrival[rows[0]]) / 1e9
    jitter, period = rate(arrival[rows]).jitter, float(time[-1]) / (rows.size - 1)
    if jitter is None or jitter[1] - jitter[0] < max(JITTER_SHARE * period, LEAST_JITTER):
        return None
    if np.mean(np.diff(time) < BURST * period) < BURST_SHARE:
        return None
    start, period = _envelope(time)
    late = time - start - period * np.arange(time.size)
    if not _steady(late):
        return None
    stamps = arrival.copy()
    stamps[rows] -= np.round(late * 1e9).astype(np.int64)
    return Straight(stamps, period, float(np.mean(late)), float(np.percentile(late, 95)))


def _envelope(time: Array) -> tuple[float, float]:
    """Start and period of the line below all points that is nearest to them in the mean.

    It is the edge of the lower convex hull above the middle of the numbers.
    """
    hull: list[int] = []
    for k in range(time.size):
        while len(hull) > 1:
            i, j = hull[-2:]
            if (time[j] - time[i]) * (k - i) < (time[k] - time[i]) * (j - i):
                break
            hull.pop()
        hull.append(k)
    right = max(1, int(np.searchsorted(hull, (time.size - 1) / 2)))
    i, j = hull[right - 1], hull[right]
    period = float(time[j] - time[i]) / (j - i)
    return float(time[i]) - period * i, period


def _steady(late: Array) -> bool:
    """Whether the lateness comes and goes, and some message comes through at once in every tenth of the log."""
    blocks = late[: late.size // BLOCK * BLOCK].reshape(-1, BLOCK)
    within = float(np.median(np.ptp(np.percentile(blocks, (5, 95), axis=1), axis=0)))
    earliest = [float(np.min(part)) for part in np.array_split(late, 10)]
    return float(np.ptp(np.percentile(late, (5, 95)))) < STEADY * within and max(earliest) < PROMPT * within


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
