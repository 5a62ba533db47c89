"""Samples -> the flight so far: the causal repairs of a stream, one sample at a time.

A command holds until the next, but no longer than the card's hold; a pose counts that is newer than the last and
another one. What does not count is left out and counted. Where commands and poses are known, and the vehicle obeys
them, are the segments; memory is that of `KEPT` seconds.

Stamps are the senders'. Where a stamp cannot be true beside its arrival, the sample is left out, and where that goes
on, the sender has another clock: from then on its samples are timed by their arrival.
"""

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from rotorfit.core.card import Card
from rotorfit.core.flight_data import Flight, Note, Segment
from rotorfit.core.frames import AXES, Array, yaw_from_quaternion
from rotorfit.core.log import Sample
from rotorfit.core.tracked import Alarm
from rotorfit.tracking.ground import Ground
from rotorfit.tracking.pose_watch import FROZEN, PoseWatch

KEPT = 900.0
"""Time that is remembered [s]."""

REMEMBERED = 300.0
"""Time of it that `memory` gives [s]: what an estimate looks back over."""

MISSED, REGULAR, NEWEST = 5.0, 2.5, 500
"""A sender nine tenths of whose newest commands come within so many usual periods is regular; where so many periods go
without one, others were sent that nobody heard, and what the vehicle was told is not known."""

HOLD = 1.0
"""Time that a command acts if no other follows, where the card does not say [s]."""

ONE_CLOCK = (-0.05, 2.0)
"""From stamp to arrival [s]: outside, sender and receiver do not share a clock. A radio may hold a sample back."""

STRANGE = 10
"""So many samples in a row outside, and the sender's clock is another one: arrivals count."""

LARGEST = 1e9
"""Metres or commands beyond which a number is none."""

SHORTEST = 0.05
"""Segments below this are none [s]."""

_LENGTH = {"pose": 7, "command": 4}


class _Rows:
    """Stamped rows in arrays that grow at the end and are cut at the beginning."""

    def __init__(self, width: int) -> None:
        self._data, self._low, self._high = np.empty((1024, 1 + width)), 0, 0

    def append(self, time: float, values: Sequence[float]) -> None:
        if self._high == len(self._data):
            rows = self._data[self._low : self._high]
            self._data = np.empty((max(2 * len(rows), 1024), rows.shape[1]))
            self._data[: len(rows)] = rows
            self._low, self._high = 0, len(rows)
        self._data[self._high, 0] = time
        self._data[self._high, 1:] = values
        self._high += 1

    def forget(self, before: float) -> None:
        """Drops what is older, but for the last of it: a command that still acts."""
        while self._low + 1 < self._high and self._data[self._low + 1, 0] < before:
            self._low += 1

    @property
    def all(self) -> Array:
        """Time and values, shape (N, 1 + width)."""
        return self._data[self._low : self._high]

    @property
    def time(self) -> Array:
        return self._data[self._low : self._high, 0]

    @property
    def values(self) -> Array:
        return self._data[self._low : self._high, 1:]


class _Clock:
    """Times the samples of one sender [ns]."""

    def __init__(self) -> None:
        self.by_arrival, self.strange = False, 0

    def stamp(self, sample: Sample) -> int | None:
        """When a sample was measured or sent; None where its stamp cannot be true."""
        if sample.received <= 0:  # nobody has said when it arrived
            return sample.stamp
        if self.by_arrival:
            return sample.received
        if ONE_CLOCK[0] <= (sample.received - sample.stamp) / 1e9 <= ONE_CLOCK[1]:
            self.strange = 0
            return sample.stamp
        self.strange += 1
        self.by_arrival = self.strange >= STRANGE
        return sample.received if self.by_arrival else None


class GrowingFlight:
    """The flight so far.

    Args:
        card: Hold and axes of the commands.
        origin: Stamp of second 0 [ns]; None for that of the first sample.
    """

    def __init__(self, card: Card, origin: int | None = None) -> None:
        self._card, self._origin = card, origin
        self._hold = HOLD if card.hold is None else card.hold
        self._commands, self._poses = _Rows(5), _Rows(4)  # a command's fifth number: when it ended at the latest
        self._clocks = {"pose": _Clock(), "command": _Clock()}
        self._counts: Counter[str] = Counter()
        self._watch, self._ground = PoseWatch(), Ground()
        self._alarms: list[Alarm] = []
        self._obeys, self._newest, self._resumed = True, -np.inf, False
        self.now = 0.0

    def add(self, sample: Sample) -> bool:
        """Takes a sample; whether it counts."""
        if sample.stream == "obeys":
            return self._obeyed(sample)
        if sample.stream not in ("pose", "command"):
            return False
        stamp = self._clocks[sample.stream].stamp(sample)
        if stamp is None:
            return self._left_out("strange_stamps")
        if self._resumed and self._origin is not None:
            self._resumed = False
            if (stamp - self._origin) / 1e9 < self.now - HOLD:  # the clock is another one than before the restart
                self._origin = stamp - round((self.now + HOLD) * 1e9)
        time = 0.0 if self._origin is None else (stamp - self._origin) / 1e9
        if sample.stream == "command" and not _is_sound(sample):
            return self._without_command(time)
        if not _is_sound(sample):
            return self._left_out("not_numbers")
        if self._origin is None:
            self._origin = stamp
        took = self._command(time, sample.values) if sample.stream == "command" else self._pose(time, sample.values)
        self.now = max(self.now, time)
        return took

    def alarms(self) -> tuple[Alarm, ...]:
        """Those of the pose since the last call: a pose that is frozen, or that jumped."""
        found, self._alarms = tuple(self._alarms), []
        return found

    def _obeyed(self, sample: Sample) -> bool:
        """Whether the vehicle obeys the commands that are heard, as its autopilot says."""
        if self._obeys != bool(sample.values[0]):
            self._obeys = not self._obeys
            self._ground.told(self.now, self._obeys)
        return False

    def _command(self, time: float, values: Sequence[float]) -> bool:
        if self._commands.time.size and time <= self._commands.time[-1]:
            return self._left_out("late_commands")
        self._commands.append(time, (*values, np.inf))
        self._commands.forget(time - KEPT)
        self._ground.command(time, values)
        return True

    def _without_command(self, time: float) -> bool:
        """A command that is no number ends the one before."""
        rows = self._commands.values
        if len(rows) and time > self._commands.time[-1]:
            rows[-1, 4] = min(rows[-1, 4], time)
        return self._left_out("not_numbers")

    def _pose(self, time: float, values: Sequence[float]) -> bool:
        x, y, z, *quaternion = values
        pose = np.array([x, y, z, float(yaw_from_quaternion(*np.array(quaternion)))])
        if time <= self._newest:
            return self._left_out("late_poses")
        self._newest = time
        if self._poses.time.size:
            before = self._poses.values[-1, 3]
            pose[3] = before + (pose[3] - before + np.pi) % (2 * np.pi) - np.pi
        seen = self._watch.take(time, pose, self._rests(time, pose))
        if seen.alarm:
            self._alarms.append(seen.alarm)
        if seen.left_out:
            return self._left_out(seen.left_out)
        for at, one in seen.believed:
            self._poses.append(at, one.tolist())
            self._ground.pose(at, one)
        self._poses.forget(time - KEPT)
        self._watch.forget(time - KEPT)
        self._ground.forget(time - KEPT)
        return True

    def _rests(self, time: float, pose: Array) -> bool:
        """Whether the vehicle may stand so still that its pose repeats itself: asked for nothing, or on the ground."""
        ground = self._ground
        return not ground.asked_within(time, FROZEN) or (ground.low(float(pose[2])) and self._watch.slow)

    def _left_out(self, code: str) -> bool:
        self._counts[code] += 1
        return False

    @property
    def standing(self) -> bool:
        """Whether the vehicle stands, or takes off or lands by itself."""
        return self._ground.stands

    @property
    def frozen(self) -> bool:
        """Whether the pose repeats itself while commands go on."""
        return self._watch.frozen

    @property
    def jumps(self) -> tuple[float, ...]:
        """When the pose jumped as no vehicle can [s]."""
        return tuple(self._watch.jumps)

    def flight(self) -> Flight | None:
        """The flight so far; None before the first command that is obeyed, or the second pose."""
        time, end = self._commands.time, self.now
        if not time.size or self._poses.time.size < 2:
            return None
        rows = self._commands.values
        until = np.minimum(np.minimum(np.append(time[1:], end), time + _believed(time, self._hold)), rows[:, 4])
        poses = self._poses.time
        segments = tuple(
            part
            for part in _without(_runs(time, until), self._ground.standing(end), self._watch.jumps)
            if part.end - part.start > SHORTEST
            and np.searchsorted(poses, part.end) - np.searchsorted(poses, part.start) > 1
        )
        if not segments:
            return None
        return Flight(
            path="live",
            sha256="",
            card=self._card,
            span=(float(time[0]), end),
            axes=tuple(axis for axis in AXES if axis in self._card.command),
            command_time=time.copy(),
            command=rows[:, :4].copy(),
            pose_time=poses.copy(),
            position=self._poses.values[:, :3].copy(),
            yaw=self._poses.values[:, 3].copy(),
            segments=segments,
            notes=tuple(Note(code, LEFT_OUT[code], count) for code, count in self._counts.items()),
        )

    def memory(self) -> Mapping[str, Any]:
        """All that is remembered, as arrays: for a file from which `recalled` goes on."""
        if self._origin is None:
            return {}
        clocks = [self._clocks[name].by_arrival for name in _LENGTH]
        return {
            "origin": np.array(self._origin),
            "now": np.array(self.now),
            **_packed("commands", self._commands.all, self.now - REMEMBERED),
            **_packed("poses", self._poses.all, self.now - REMEMBERED),
            "by_arrival": np.array(clocks),
            "obeys": np.array(self._obeys),
            "jumps": np.array(self._watch.jumps),
            "standing": np.array(self._ground.intervals()).reshape(-1, 2),
            "ground": np.array(self._ground.level),
            "codes": np.array(list(self._counts), dtype=str),
            "counts": np.array(list(self._counts.values()), dtype=np.int64),
        }

    def recall(self, memory: Mapping[str, Any]) -> None:
        """Goes on from what `memory` gave, before the first sample."""
        if not memory:
            return
        self._origin, self.now = int(memory["origin"]), float(memory["now"])
        self._newest = float(np.max(memory["poses_time"], initial=-np.inf))
        self._resumed = True
        for rows, name in ((self._commands, "commands"), (self._poses, "poses")):
            for t, row in zip(memory[f"{name}_time"].tolist(), memory[name].tolist(), strict=True):
                rows.append(t, row)
        for name, by_arrival in zip(_LENGTH, memory["by_arrival"].tolist(), strict=True):
            self._clocks[name].by_arrival = by_arrival
        self._obeys = bool(memory["obeys"])
        self._watch = PoseWatch(memory["jumps"].tolist())
        self._ground.recall(memory["standing"].tolist(), float(memory["ground"]), self._obeys)
        self._counts.update(dict(zip(memory["codes"].tolist(), memory["counts"].tolist(), strict=True)))


LEFT_OUT = {
    "late_commands": "commands were no newer than the last: left out",
    "late_poses": "poses were no newer than the last: left out",
    "stale_poses": "poses repeat the one before with a fresh stamp: left out",
    "wild_poses": "poses lie where no vehicle can be a moment later, and the next do not: left out",
    "strange_stamps": "stamps cannot be true beside the arrival of the sample: left out",
    "not_numbers": "samples are no numbers: left out",
}
"""What is said of samples that do not count."""


def _believed(time: Array, hold: float) -> float:
    """How long a command acts if no other is heard [s]: of a sender that is regular, `MISSED` of its periods."""
    steps = np.diff(time[-NEWEST:])
    if steps.size < NEWEST // 10:
        return hold
    usual, often = np.quantile(steps, [0.5, 0.9])
    return float(min(hold, MISSED * usual)) if often <= REGULAR * usual else hold


def _packed(name: str, rows: Array, begin: float) -> dict[str, Array]:
    """The newest rows, values in single precision: a micrometre at ten metres."""
    new = rows[np.searchsorted(rows[:, 0], begin) :]
    return {f"{name}_time": new[:, 0].copy(), name: new[:, 1:].astype(np.float32)}


def _is_sound(sample: Sample) -> bool:
    """Whether a sample is of finite numbers, and its attitude one."""
    values = sample.values
    if len(values) != _LENGTH[sample.stream] or not all(abs(value) < LARGEST for value in values):
        return False
    return sample.stream == "command" or any(values[3:])


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
