"""The flight so far, as rows that only grow: what a look sees, here or in another process that is told the news."""

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from rotorfit.core.card import Card
from rotorfit.core.flight_data import Flight, Note, Segment
from rotorfit.core.frames import AXES, Array

HOLD = 1.0
"""Time that a command acts if no other follows, where the card does not say [s]."""

MISSED, REGULAR, NEWEST = 5.0, 2.5, 500
"""A sender nine tenths of whose newest commands come within so many usual periods is regular; where so many periods go
without one, others were sent that nobody heard, and what the vehicle was told is not known."""

SHORTEST = 0.05
"""Segments below this are none [s]."""

LEFT_OUT = {
    "late_commands": "commands were no newer than the last: left out",
    "late_poses": "poses were no newer than the last: left out",
    "stale_poses": "poses repeat the one before with a fresh stamp: left out",
    "wild_poses": "poses lie where no vehicle can be a moment later, and the next do not: left out",
    "strange_stamps": "stamps cannot be true beside the arrival of the sample: left out",
    "not_numbers": "samples are no numbers: left out",
}
"""What is said of samples that do not count."""


class Rows:
    """Stamped rows in arrays that grow at the end and are cut at the beginning.

    What has been handed out is never written to again: rows are added behind it, and larger arrays are new ones.

    Args:
        width: Numbers of a row besides its last, which has an array of its own.

    Attributes:
        first: Number of the oldest row, counted from the first that ever came.
    """

    def __init__(self, width: int) -> None:
        self._time, self._values, self._last = np.empty(1024), np.empty((1024, width)), np.empty(1024)
        self._low, self._high, self.first = 0, 0, 0

    @property
    def count(self) -> int:
        """Rows that ever came."""
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
        """Drops what is older, but for the last of it: a command that still acts."""
        while self._low + 1 < self._high and self._time[self._low + 1] < before:
            self._low += 1
            self.first += 1

    def since(self, time: float) -> Array:
        """Rows from a time on, shape (N, 2 + width)."""
        new = slice(self._low + int(np.searchsorted(self.time, time)), self._high)
        return np.column_stack([self._time[new], self._values[new], self._last[new]])

    @property
    def time(self) -> Array:
        """Shape (N,)."""
        return self._time[self._low : self._high]

    @property
    def values(self) -> Array:
        """Shape (N, width)."""
        return self._values[self._low : self._high]

    @property
    def last(self) -> Array:
        """The last number of each row, shape (N,); of the newest row it may be written."""
        return self._last[self._low : self._high]


@dataclass(frozen=True)
class News:
    """By what a flight has grown since the news before.

    Attributes:
        commands: Time, values and end of each, shape (N, 6); the first is the last of before: it may have ended.
        poses: Time, position and yaw, shape (M, 5).
        oldest: Times of the oldest command and pose that are remembered [s].
        now: [s].
        standing: When nothing is to be learnt, all of it [s].
        jumps: When the pose jumped, all of it [s].
        counts: Of what was left out.
    """

    commands: Array
    poses: Array
    oldest: Sequence[float]
    now: float
    standing: Sequence[tuple[float, float]]
    jumps: Sequence[float]
    counts: dict[str, int]


class FlightSoFar:
    """Commands, poses, and in which times something can be learnt from them.

    Args:
        card: Hold and axes of the commands.

    Attributes:
        commands: Forward, left, up, counter-clockwise; and when each ended at the latest.
        poses: Position, and unwrapped yaw.
        now: [s].
        standing: When nothing is to be learnt [s].
        jumps: When the pose jumped as no vehicle can [s].
        counts: Code of `LEFT_OUT` to how many samples.
    """

    def __init__(self, card: Card) -> None:
        self._card = card
        self._hold = HOLD if card.hold is None else card.hold
        self.commands, self.poses, self.now = Rows(4), Rows(3), 0.0
        self.standing: Sequence[tuple[float, float]] = ()
        self.jumps: Sequence[float] = ()
        self.counts: Counter[str] = Counter()
        self._told = [-np.inf, -np.inf]

    def flight(self) -> Flight | None:
        """The flight; None before the first command that is obeyed, or the second pose."""
        time, poses = self.commands.time, self.poses.time
        if not time.size or poses.size < 2:
            return None
        until = np.minimum(np.append(time[1:], self.now), time + _believed(time, self._hold))
        runs = _runs(time, np.minimum(until, self.commands.last))
        segments = tuple(
            part
            for part in _without(runs, self.standing, self.jumps)
            if part.end - part.start > SHORTEST
            and np.searchsorted(poses, part.end) - np.searchsorted(poses, part.start) > 1
        )
        if not segments:
            return None
        return Flight(
            path="live",
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
            notes=tuple(Note(code, LEFT_OUT[code], count) for code, count in self.counts.items()),
        )

    def news(self) -> News:
        """What is new since the last call."""
        rows = self.commands, self.poses
        new = rows[0].since(self._told[0]), rows[1].since(np.nextafter(self._told[1], np.inf))
        oldest, newest = ([float(each.time[k]) if each.time.size else -np.inf for each in rows] for k in (0, -1))
        self._told = newest
        return News(*new, oldest, self.now, self.standing, self.jumps, dict(self.counts))

    def take(self, news: News) -> None:
        """Grows as another one has grown."""
        rows = news.commands
        if rows.size and self.commands.time.size and rows[0, 0] == self.commands.time[-1]:
            self.commands.last[-1], rows = rows[0, 5], rows[1:]
        for each, new in ((self.commands, rows), (self.poses, news.poses)):
            for row in new:
                each.append(row[0], row[1:-1], row[-1])
        for each, oldest in zip((self.commands, self.poses), news.oldest, strict=True):
            each.forget(np.nextafter(oldest, np.inf))
        self.now, self.standing, self.jumps = news.now, news.standing, news.jumps
        self.counts = Counter(news.counts)


def _believed(time: Array, hold: float) -> float:
    """How long a command acts if no other is heard [s]: of a sender that is regular, `MISSED` of its periods."""
    steps = np.diff(time[-NEWEST:])
    if steps.size < NEWEST // 10:
        return hold
    usual, often = np.quantile(steps, [0.5, 0.9])
    return float(min(hold, MISSED * usual)) if often <= REGULAR * usual else hold


def _runs(time: Array, until: Array) -> Iterator[tuple[float, float]]:
    """Runs of commands in which each acts until the next comes."""
    fresh = np.append(True, time[1:] > until[:-1] + 1e-6)
    last = np.append(fresh[1:], True)
    yield from zip(time[fresh].tolist(), until[last].tolist(), strict=True)


def _without(
    runs: Iterator[tuple[float, float]], closed: Sequence[tuple[float, float]], jumps: Sequence[float]
) -> Iterator[Segment]:
    """The runs less what is closed, and cut where the pose jumped."""
    holes = sorted((*closed, *((float(np.nextafter(jump, -np.inf)), jump) for jump in jumps)))
    for start, end in runs:
        for low, high in (*holes, (end, end)):
            if low > start:
                yield Segment(start, min(low, end))
            start = max(start, min(high, end))
            if start >= end:
                break
