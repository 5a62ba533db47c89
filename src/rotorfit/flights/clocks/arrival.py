"""Log + Card -> the same log with better stamps: the recorder's for empty headers, a regular sender's for arrivals.

Reconstruction of a regular sender's stamps from stamps of arrival: a camera or a flight controller sends at a steady
rate; the network delivers late, never early, and often several messages at once. Message k, which arrives at a_k, was
sent no later, so the sender's clock lies on or below all of

    a_k = start + period k + lateness_k,    lateness_k >= 0

Among such lines the one with the least mean lateness is taken: it touches the messages that arrived without delay.
Where messages were lost, their numbers are unknown, and the stamps are kept.
"""

from dataclasses import dataclass, replace

import numpy as np

from rotorfit.core.card import Card, Channel
from rotorfit.core.flight_data import Note
from rotorfit.core.frames import Array
from rotorfit.core.log import Log
from rotorfit.flights.clocks.lower_line import line_below
from rotorfit.flights.columns import table_of
from rotorfit.flights.stamps import MISSING_STAMP, Stamps, continued, rate, set_back, stamps_of

FEWEST = 400
"""Least number of messages from which a rate is estimated."""

JITTER_SHARE = 0.5
"""Spread of the steps (5th to 95th percentile), as a share of the period, above which it is jitter. A scheduler on a
busy computer gives 0.1 to 0.3; messages that arrive in bursts over Wi-Fi exceed 1."""

LEAST_JITTER = 0.004
"""Spread of the steps that is no jitter in any case [s]: at 1 m/s it is 4 mm."""

BURST = 0.2
"""A step below this share of the period cannot come from a regular sender: two messages arrived together."""

BURST_SHARE = 0.02
"""Share of such steps above which stamps are those of arrival."""

STEADY = 1.7
"""Ratio of the lateness's spread over the whole log to its median spread in blocks of `BLOCK` messages above which the
sender is irregular: lateness comes and goes, while a sender with varying intervals drifts off, the further the longer
the log. Of 1000 such senders of 500 messages none passed."""

BLOCK = 30
"""Number of messages in a block."""

PROMPT = 0.3
"""The earliest message in every tenth of the log must be late by less than this share of that spread, and of the
period: a lost message, or an irregular sender, raises it."""


@dataclass(frozen=True)
class Straight:
    """Reconstructed stamps of a regular sender.

    Attributes:
        stamps: Replacing those of arrival, shape (N,) [ns].
        period: Period of the sender [s].
        mean: Mean lateness removed [s].
        most: 95th percentile of the lateness [s].
    """

    stamps: Stamps
    period: float
    mean: float
    most: float


def straightened(arrival: Stamps) -> Straight | None:
    """Reconstructs the stamps of messages sent by a regular sender.

    Args:
        arrival: Shape (N,) [ns], in the order of sending or nearly; missing and reversed stamps are kept.

    Returns:
        The stamps; None where the data do not show a regular sender with jittered arrivals: too few messages, little
        jitter, no bursts, or a lateness that drifts or persists.
    """
    rows = np.flatnonzero(arrival != MISSING_STAMP)
    rows = rows[~set_back(arrival[rows])] if rows.size else rows
    rows = rows[np.argsort(arrival[rows], kind="stable")]
    if rows.size < FEWEST or rows.size < 0.99 * arrival.size:
        return None
    time = (arrival[rows] - arrival[rows[0]]) / 1e9
    jitter, period = rate(arrival[rows]).jitter, float(time[-1]) / (rows.size - 1)
    if jitter is None or jitter[1] - jitter[0] < max(JITTER_SHARE * period, LEAST_JITTER):
        return None
    if np.mean(np.diff(time) < BURST * period) < BURST_SHARE:
        return None
    start, period = line_below(np.arange(time.size, dtype=float), time)
    late = time - start - period * np.arange(time.size)
    if not _steady(late, period):
        return None
    stamps = arrival.copy()
    stamps[rows] -= np.round(late * 1e9).astype(np.int64)
    return Straight(stamps, period, float(np.mean(late)), float(np.percentile(late, 95)))


def _steady(late: Array, period: float) -> bool:
    """Whether the lateness comes and goes, and some message in every tenth of the log arrives promptly."""
    blocks = late[: late.size // BLOCK * BLOCK].reshape(-1, BLOCK)
    within = float(np.median(np.ptp(np.percentile(blocks, (5, 95), axis=1), axis=0)))
    earliest = [float(np.min(part)) for part in np.array_split(late, 10)]
    return float(np.ptp(np.percentile(late, (5, 95)))) < STEADY * within and max(earliest) < PROMPT * min(
        within, period
    )


_HEADER, _RECORDER = "header.stamp", "log_time"


def with_sound_stamps(log: Log, card: Card) -> tuple[Log, tuple[Note, ...], float]:
    """Replaces stamps that were never filled in, and corrects those of arrival.

    A sender's stamp is used as it is. Where the card names one that stands still, the recorder's replaces it. Stamps of
    arrival are corrected where the data show a regular sender: those of the recorder, and those of poses in a table
    without a sender's stamp, because cameras are regular. Commands in such a table may be stamped where they are sent,
    where a late command is truly late. Where poses and commands share a table, its clock is that of the logger.

    Args:
        log: As recorded.
        card: The meaning of each column.

    Returns:
        The log, with corrected clocks in `retimed`; notes on what was done; and the transmission time that arrivals do
        not show, as half a 95 % interval [s]: their own mean lateness, for want of a better measure.

    Raises:
        CardError: A column is missing.
    """
    notes: list[Note] = []
    unseen = 0.0
    streams = {"command": card.command_time, "pose": card.pose_time}
    tables = {what: table_of(log, str(time.source))[0] for what, time in streams.items()}
    for time in dict.fromkeys(streams.values()):
        table, name = table_of(log, str(time.source))
        stamps = stamps_of(log, time)
        whole = continued(stamps)
        if (count := int(np.sum(whole != stamps))) and (table.name, name) not in log.retimed:
            log = replace(log, retimed={**log.retimed, (table.name, name): whole})
            notes.append(Note("clock_continued", f"{count} stamps of {name} come after it started again", count))
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
                f"{1e3 * found.most:.1f} ms in 95 %; that mean is added to the interval of every delay, since no clock "
                "shows how late the promptest were"
            )
            unseen = float(np.hypot(unseen, found.mean))
            notes.append(Note(f"{what}_stamps_straightened", text, len(found.stamps)))
    return log, tuple(notes), unseen


def _beside(time: Channel, name: str) -> Channel:
    """The sender's stamp in the table of a clock."""
    return Channel(str(time.source).removesuffix(name) + _HEADER)


def _stands_still(log: Log, time: Channel) -> bool:
    """Whether a clock has a single value, like a header that was never filled in."""
    stamps = stamps_of(log, time)
    there = stamps[stamps != MISSING_STAMP]
    return there.size > 1 and not np.any(np.diff(there))
