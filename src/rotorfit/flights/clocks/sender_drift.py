"""Log + Card -> the same log, its stamps corrected for drift and steps of the senders' clocks against the recorder's.

A message stamped s by its sender arrives at a by the recorder's clock. It cannot arrive before it is sent, so

    a - s = error of the clock + travel,    travel >= 0

and the error lies on or below all of a - s: on their lower envelope, up to the travel time of the fastest messages. A
clock runs at one rate, slightly bent by slow changes of temperature: the envelope is the line below all points, raised
by a curve that bends no faster than `BEND`, so that a stretch in which everything is late hardly raises it. A step of
the clock shows as a jump in the stamps while the arrivals continue; a change of route shows in the arrivals.

Arrivals bound the mean error of the clock on one side only: messages do not arrive before they are sent. So the clock
is taken to be right where it is least behind the arrivals, and is shifted if even there it is ahead of them. A clock
that is merely ahead is shifted where the other of commands and poses is stamped by the recorder.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np

from rotorfit.core.card import Card, Channel
from rotorfit.core.flight_data import Note
from rotorfit.core.frames import Array, Indices
from rotorfit.core.log import Log
from rotorfit.flights.clocks.lower_line import line_below
from rotorfit.flights.clocks.motion_signals import attitude_clock, velocity_clock
from rotorfit.flights.columns import table_of
from rotorfit.flights.other_tables import sample_rows
from rotorfit.flights.stamps import MISSING_STAMP, Stamps, stamps_of

FEWEST = 100
"""Least number of messages whose arrivals are evaluated."""

BLOCKS = 10
"""Number of parts of the recording whose early arrivals are compared."""

EARLY = 0.05
"""Quantile of the travel time that counts as early: a single message may be an accident."""

SIGMAS = 8.0
"""Significance of the drift of the early arrivals, in standard errors: a route that slows down once reaches 5."""

LEAST_GROWTH = 0.002
"""Drift over the recording that is not corrected [s]: its mean effect is half of it, less than most delay errors."""

LEAST_STEP = 0.02
"""Least step of a clock that is detected [s]; time daemons slew smaller ones."""

LEAST_AHEAD = 0.002
"""Least time by which a clock must be ahead of all arrivals to be shifted [s]: stamps and arrivals are rounded."""

LEAST_TRAVEL = 0.005
"""Travel of the fastest messages, which no clock tells, in a local network at most [s]."""

AROUND = 2.0
"""Time before and after a step over which its size is measured [s]."""

BEND = 1e-4
"""Largest plausible change of a clock's error per second besides its drift, as of a crystal that warms up."""


@dataclass(frozen=True)
class Correction:
    """Error of a sender's clock against the recorder's.

    Attributes:
        error: Added to each stamp to correct it, shape (N,) [s].
        drift: Change of the error per second, between the steps.
        steps: Sizes of the steps in order [s].
        half_width: Half the 95 % interval of the remaining uncertainty [s].
    """

    error: Array
    drift: float
    steps: tuple[float, ...]
    half_width: float


def on_the_recorders_clock(log: Log, card: Card) -> tuple[Log, tuple[Note, ...], float]:
    """Removes drift and steps from the stamps of commands, poses and onboard motion.

    Only stamps of senders (`header.stamp`) with arrivals (`log_time`) beside them, in a single file, are corrected.

    Args:
        log: As recorded.
        card: The meaning of each column.

    Returns:
        The log, with corrected clocks in `retimed`; notes on what was done; and half the 95 % interval of the remaining
        offset between commands and poses [s], 0 where nothing was done.

    Raises:
        CardError: A column is missing.
    """
    if log.file_of:
        return log, (), 0.0
    filled = set(log.retimed)
    notes: list[Note] = []
    unknown = 0.0
    by_recorder = any(table_of(log, str(one.source))[1] == "log_time" for one in (card.command_time, card.pose_time))
    for what, time, channels in _streams(card):
        table, name = table_of(log, str(time.source))
        if name != "header.stamp" or "log_time" not in table.columns or (table.name, name) in filled:
            continue
        stamps = stamps_of(log, time)
        arrivals = stamps_of(log, Channel(f"{str(time.source).removesuffix(name)}log_time"))
        rows = np.flatnonzero(
            (stamps != MISSING_STAMP) & (arrivals != MISSING_STAMP) & sample_rows(log, time, channels)
        )
        rows = rows[np.argsort(arrivals[rows], kind="stable")]  # several writers may have exchanged messages
        found = correction(stamps[rows], arrivals[rows]) or (
            _shift(stamps[rows], arrivals[rows]) if by_recorder else None
        )
        if found is None:
            continue
        moved = stamps.copy()
        moved[rows] += np.round(found.error * 1e9).astype(np.int64)
        log = replace(log, retimed={**log.retimed, (table.name, name): moved})
        notes.append(Note(f"{what}_clock_corrected", _sentence(what, found), int(rows.size)))
        if what in ("command", "pose"):
            unknown = float(np.hypot(unknown, found.half_width))
    return log, tuple(notes), unknown


def correction(stamps: Stamps, arrivals: Stamps) -> Correction | None:
    """Estimates the error of a sender's clock against the recorder's.

    Args:
        stamps: By the sender, shape (N,) [ns].
        arrivals: By the recorder, shape (N,) [ns].

    Returns:
        The correction; None where the clock neither drifts nor steps by more than late messages can mimic.

    Source: the envelope as a line: S. B. Moon, P. Skelly, D. Towsley, Estimation and removal of clock skew from network
    delay measurements, INFOCOM 1999, pp. 227-234.
    """
    if stamps.size < FEWEST or np.any(np.diff(arrivals) < 0):
        return None
    time, late = (arrivals - arrivals[0]) / 1e9, (arrivals - stamps) / 1e9
    if not time[-1] > 2 * AROUND:
        return None
    base, late = float(np.median(late)), late - float(np.median(late))  # keeps numbers small if the epochs differ
    at, sizes = _steps(time, stamps, arrivals, late)
    stepped = np.concatenate([[0.0], np.cumsum(sizes)])[np.searchsorted(at, np.arange(late.size), side="right")]
    start, drift = line_below(time, late - stepped)
    if not _drifts(time, late - stepped, drift):
        if not sizes.size:
            return None
        drift = 0.0
        start = float(np.min(late - stepped))
    line = start + drift * time
    bend = _bent_below(time, late - stepped - line)
    error = stepped + line + bend
    right = max(base + float(np.min(error)), 0.0) - base
    return Correction(error - right, drift, tuple(sizes.tolist()), _half_width(late - error))


def _half_width(travel: Array) -> float:
    """Half the 95 % interval of the error that travel times leave, shape (N,) [s]: the fastest took some time, too."""
    fastest = np.array([part.min() for part in np.array_split(travel, BLOCKS)])
    return float(np.hypot(np.quantile(fastest, 0.95), np.median(travel)))


def _shift(stamps: Stamps, arrivals: Stamps) -> Correction | None:
    """The correction of a clock by which many messages arrive before they are sent; None if it is not ahead."""
    late = (arrivals - stamps) / 1e9
    if late.size < FEWEST or (early := float(np.quantile(late, EARLY))) > -LEAST_AHEAD:
        return None
    return Correction(np.full(late.size, early), 0.0, (), float(np.hypot(_half_width(late - early), LEAST_TRAVEL)))


def _streams(card: Card) -> Iterator[tuple[str, Channel, Mapping[str, Channel]]]:
    """The streams of a card with clocks that senders may have stamped."""
    yield "command", card.command_time, card.command
    yield "pose", card.pose_time, card.pose
    if any(isinstance(channel.source, str) for channel in card.velocity.values()):
        yield "velocity", velocity_clock(card), card.velocity
    if card.attitude:
        yield "attitude", attitude_clock(card), card.attitude


def _steps(time: Array, stamps: Stamps, arrivals: Stamps, late: Array) -> tuple[Indices, Array]:
    """Steps of the sender's clock: the index of the first message after each, and their sizes [s].

    At a step the stamps jump, the arrivals do not, and the difference persists.
    """
    sent, came = np.diff(stamps) / 1e9, np.diff(arrivals) / 1e9
    sent, came = sent - np.median(sent), came - np.median(came)
    jump, jolt = np.abs(sent), np.abs(came)
    found: list[tuple[int, float]] = []
    for i in (np.flatnonzero((jump > LEAST_STEP) & (jolt < 0.5 * jump)) + 1).tolist():
        before = late[(time >= time[i - 1] - AROUND) & (np.arange(time.size) < i)]
        after = late[(time <= time[i] + AROUND) & (np.arange(time.size) >= i)]
        size = float(np.quantile(after, EARLY) - np.quantile(before, EARLY))
        if min(before.size, after.size) > 4 and abs(size) > LEAST_STEP and abs(size + sent[i - 1]) < 0.5 * abs(size):
            found.append((i, size))
    return np.array([i for i, _ in found], dtype=np.int64), np.array([size for _, size in found])


def _drifts(time: Array, late: Array, drift: float) -> bool:
    """Whether the early messages of successive parts drift, too: the ends of an envelope move by chance."""
    early = np.array([np.quantile(part, EARLY) for part in np.array_split(late, BLOCKS)])
    middle = np.array([np.mean(part) for part in np.array_split(time, BLOCKS)])
    x = middle - middle.mean()
    slope = float(x @ early / (x @ x))
    rest = early - early.mean() - slope * x
    error = float(np.sqrt(rest @ rest / (BLOCKS - 2) / (x @ x)))
    length = float(time[-1])
    return min(slope * np.sign(drift), abs(drift)) * length > LEAST_GROWTH and abs(slope) > SIGMAS * error


def _bent_below(time: Array, late: Array) -> Array:
    """The largest function below all points that changes by no more than `BEND` per second, shape (N,) [s]."""
    forward = np.minimum.accumulate(late - BEND * time) + BEND * time
    backward = np.minimum.accumulate((late + BEND * time)[::-1])[::-1] - BEND * time
    return np.asarray(np.minimum(forward, backward))


def _sentence(what: str, found: Correction) -> str:
    """What was done, in one sentence."""
    parts = [f"drifts by {1e6 * found.drift:+.0f} us/s"] if found.drift else []
    parts += [] if found.drift or found.steps else [f"is ahead by {-1e3 * float(found.error[0]):.0f} ms"]
    parts += [f"{'steps' if n == 0 else 'and'} by {1e3 * size:+.0f} ms" for n, size in enumerate(found.steps)]
    mean, most = 1e3 * float(np.mean(found.error)), 1e3 * float(np.ptp(found.error))
    return (
        f"the clock of {found.error.size} {what}s {', '.join(parts)} against the recorder's, by the earliest arrivals: "
        f"corrected by {mean:+.1f} ms on average, {most:.1f} ms peak to peak, known to +-"
        f"{1e3 * found.half_width:.1f} ms"
    )
