"""The flight so far, as rows that only grow: the input of a look, in this process or in another that takes the news."""

import math
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from rotorfit.core.card import Card
from rotorfit.core.flight_data import Flight, Note, Segment
from rotorfit.core.frames import AXES, Array

UNRECORDED = "live, not recorded"
"""What a flight is called that no file has."""

HOLD = 1.0
"""How long a command acts if no other follows and the card does not say [s]."""

MISSED, REGULAR, NEWEST = 5.0, 2.5, 500
"""A sender is regular if nine tenths of its last `NEWEST` intervals are at most `REGULAR` medians long. If a regular
sender is silent for `MISSED` medians, commands were lost, and the command in force is unknown."""

SHORTEST = 0.05
"""Segments that are not longer are dropped [s]."""

NOTES = {
    "late_commands": "commands were no newer than the last: left out",
    "late_poses": "poses were no newer than the last: left out",
    "stale_poses": "poses repeat the one before with a fresh stamp: left out",
    "wild_poses": "poses lie where no vehicle can be a moment later, and the next do not: left out",
    "landed": "stands on the ground after a landing on the way: left out",
    "strange_stamps": "stamps cannot be true beside the arrival of the sample, or the stamps around it: left out",
    "not_numbers": "samples are no numbers: left out",
    "pose_clock_steps": "steps of the poses' clock, by their arrivals: removed from the stamps",
    "command_clock_steps": "steps of the commands' clock, by their arrivals: removed from the stamps",
}
"""Code of a note on samples that were left out or moved, and its text."""


class Rows:
    """Stamped rows in arrays that grow at the end and are cut at the beginning.

    Rows that were handed out are not written to again, except `last` of the newest: new rows are added behind them, and
    larger arrays are copies.

    Args:
        width: Number of values of a row, without its time and its last number, which has an array of its own.

    Attributes:
        first: Index of the oldest row kept, counted over all rows ever added.
    """

    def __init__(self, width: int) -> None:
        self._time, self._values, self._last = np.empty(1024), np.empty((1024, width)), np.empty(1024)
        self._low, self._high, self.first = 0, 0, 0

    @property
    def count(self) -> int:
        """Number of rows ever added."""
        return self.first + self._high - self._low

    def append(self, time: float, values: Sequence[float] | Array, last: float) -> None:
        """Adds a row."""
        if self._high == len(self._time):
            size, low, high = self._high - self._low, self._low, self._high
            for name in ("_time", "_values", "_last"):
                rows = getattr(self, name)
                larger = np.empty((max(2 * size, 1024), *rows.shape[1:]))
                larger[:size] = rows[low:high]
                setattr(self, name, larger)
            self._low, self._high = 0, size
        self._time[self._high], self._values[self._high], self._last[self._high] = time, values, last
        self._high += 1

    def forget(self, before: float) -> None:
        """Drops the rows before a time [s], except the last of them: a command that may still act."""
        while self._low + 1 < self._high and self._time[self._low + 1] < before:
            self._low += 1
            self.first += 1

    def since(self, time: float) -> Array:
        """Rows from a time [s] on, as time, values and last number, shape (N, 2 + width)."""
        new = slice(self._low + int(np.searchsorted(self.time, time)), self._high)
        return np.column_stack([self._time[new], self._values[new], self._last[new]])

    @property
    def time(self) -> Array:
        """Times, shape (N,) [s]."""
        return self._time[self._low : self._high]

    @property
    def values(self) -> Array:
        """Values, shape (N, width)."""
        return self._values[self._low : self._high]

    @property
    def last(self) -> Array:
        """The last number of each row, shape (N,); that of the newest row may be overwritten."""
        return self._last[self._low : self._high]


@dataclass(frozen=True)
class News:
    """What was added to a flight since the previous news.

    Attributes:
        commands: Time, values and end of each command, shape (N, 6); the first repeats the last of the previous news,
            which may have ended.
        poses: Time, position and yaw, shape (M, 5).
        oldest: Times of the oldest command and pose that are kept [s].
        now: Time of the newest sample [s].
        standing: All intervals in which nothing is learnt [s].
        jumps: All times at which the pose jumped [s].
        counts: Code of `NOTES` to the number of samples or steps.
        shared_error: Half the 95 % interval of what the stamps may be off by [s].
        pose_lateness: How long before its stamp a pose may have been measured [s].
    """

    commands: Array
    poses: Array
    oldest: Sequence[float]
    now: float
    standing: Sequence[tuple[float, float]]
    jumps: Sequence[float]
    counts: dict[str, int]
    shared_error: float
    pose_lateness: float


class FlightSoFar:
    """Commands, poses, and the intervals in which nothing can be learnt from them.

    Args:
        card: The vehicle's card: hold and axes of the commands.
        path: File of the recording; models name it as their flight.

    Attributes:
        commands: Rows of forward, left, up, counter-clockwise [unit of the card's command], and the latest end [s].
        poses: Rows of world position [m], and unwrapped yaw [rad].
        now: Time of the newest sample [s].
        standing: Intervals in which nothing is learnt [s].
        jumps: Times at which the pose jumped as no vehicle can [s].
        counts: Code of `NOTES` to the number of samples or steps.
        shared_error: Half the 95 % interval of what the stamps may be off by [s].
        pose_lateness: How long before its stamp a pose may have been measured [s].
    """

    def __init__(self, card: Card, path: str = UNRECORDED) -> None:
        self._card, self._path = card, path
        self._hold = HOLD if card.hold is None else card.hold
        self.commands, self.poses, self.now = Rows(4), Rows(3), 0.0
        self.standing: Sequence[tuple[float, float]] = ()
        self.jumps: Sequence[float] = ()
        self.counts: Counter[str] = Counter()
        self.shared_error = math.hypot(card.command_time.error, card.pose_time.error)
        self.pose_lateness = 0.0
        self._sent = [-np.inf, -np.inf]

    def pose_error(self, error: float) -> None:
        """Takes half the 95 % interval of what the stamps of the poses may be off by, as the link knows it [s]."""
        time, other = self._card.pose_time, self._card.command_time
        self.shared_error = math.hypot(max(time.error, error), other.error)

    def flight(self) -> Flight | None:
        """The flight so far; None until it has a segment: a command that is obeyed, and two poses under it."""
        time, poses = self.commands.time, self.poses.time
        if not time.size or poses.size < 2:
            return None
        until = np.minimum(np.append(time[1:], self.now), time + _believed(time, self._hold))
        runs = _runs(time, np.minimum(until, self.commands.last))
        segments = tuple(
            part
            for part in parts_without(runs, self.standing, self.jumps)
            if part.end - part.start > SHORTEST
            and np.searchsorted(poses, part.end) - np.searchsorted(poses, part.start) > 1
        )
        if not segments:
            return None
        return Flight(
            path=self._path,
            sha256="",
            card=self._card,
            span=(float(time[0]), self.now),
            axes=tuple(axis for axis in AXES if axis in self._card.command),
            command_time=time,
            command=self.commands.values,
            pose_time=poses,
            position=self.poses.values,
            yaw=self.poses.last,
            segments=segments,
            notes=tuple(Note(code, NOTES[code], count) for code, count in self.counts.items()),
            shared_error=self.shared_error,
            pose_lateness=self.pose_lateness,
        )

    def news(self) -> News:
        """What is new since the last call."""
        rows = self.commands, self.poses
        new = rows[0].since(self._sent[0]), rows[1].since(np.nextafter(self._sent[1], np.inf))
        oldest, newest = ([float(each.time[k]) if each.time.size else -np.inf for each in rows] for k in (0, -1))
        self._sent = newest
        counts = dict(self.counts)
        return News(*new, oldest, self.now, self.standing, self.jumps, counts, self.shared_error, self.pose_lateness)

    def take(self, news: News) -> None:
        """Adds the news of another `FlightSoFar`, to become equal to it."""
        rows = news.commands
        if rows.size and self.commands.time.size and rows[0, 0] == self.commands.time[-1]:
            self.commands.last[-1], rows = rows[0, 5], rows[1:]
        for each, new in ((self.commands, rows), (self.poses, news.poses)):
            for row in new:
                each.append(row[0], row[1:-1], row[-1])
        for each, oldest in zip((self.commands, self.poses), news.oldest, strict=True):
            each.forget(np.nextafter(oldest, np.inf))
        self.now, self.standing, self.jumps = news.now, news.standing, news.jumps
        self.counts, self.shared_error = Counter(news.counts), news.shared_error
        self.pose_lateness = news.pose_lateness


def _believed(time: Array, hold: float) -> float:
    """How long a command acts if no other is received [s]: at most `MISSED` periods if the sender is regular."""
    steps = np.diff(time[-NEWEST:])
    if steps.size < NEWEST // 10:
        return hold
    usual, often = np.quantile(steps, [0.5, 0.9])
    return float(min(hold, MISSED * usual)) if often <= REGULAR * usual else hold


def _runs(time: Array, until: Array) -> Iterator[tuple[float, float]]:
    """Start and end of each run of commands in which every command acts until the next [s]."""
    fresh = np.append(True, time[1:] > until[:-1] + 1e-6)
    last = np.append(fresh[1:], True)
    yield from zip(time[fresh].tolist(), until[last].tolist(), strict=True)


def parts_without(
    runs: Iterable[tuple[float, float]], closed: Sequence[tuple[float, float]], jumps: Sequence[float]
) -> Iterator[Segment]:
    """The runs without the closed intervals, split where the pose jumped."""
    holes = sorted((*closed, *((float(np.nextafter(jump, -np.inf)), jump) for jump in jumps)))
    for start, end in runs:
        for low, high in (*holes, (end, end)):
            if low > start:
                yield Segment(start, min(low, end))
            start = max(start, min(high, end))
            if start >= end:
                break
