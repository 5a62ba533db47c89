"""Samples -> the flight so far: the causal repairs of a stream, one sample at a time.

A command holds until the next, but no longer than the card's hold; a pose counts that is newer than the last and
another one. What does not count is left out and counted. Memory is that of `KEPT` seconds.
"""

from collections.abc import Sequence

import numpy as np

from rotorfit.core.card import Card
from rotorfit.core.flight_data import Flight, Note, Segment
from rotorfit.core.frames import AXES, Array, yaw_from_quaternion
from rotorfit.core.log import Sample

KEPT = 900.0
"""Time that is remembered [s]."""

HOLD = 1.0
"""Time that a command acts if no other follows, where the card does not say [s]."""

FASTEST = 40.0
"""Speed between two poses beyond which the pose jumped, and the vehicle did not [m/s, rad/s]."""

REACH = 0.3
"""And so much beyond that, at the least [m, rad]."""

FROZEN = 0.5
"""Time of poses that repeat each other after which the pose is frozen [s]."""


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
        rows = self._data[self._low : self._high]
        self._low += max(int(np.searchsorted(rows[:, 0], before)) - 1, 0)

    @property
    def time(self) -> Array:
        return self._data[self._low : self._high, 0]

    @property
    def values(self) -> Array:
        return self._data[self._low : self._high, 1:]


class GrowingFlight:
    """The flight so far.

    Args:
        card: Hold and axes of the commands.
        origin: Stamp of second 0 [ns]; None for that of the first sample.
    """

    def __init__(self, card: Card, origin: int | None = None) -> None:
        self._card, self._origin = card, origin
        self._hold = HOLD if card.hold is None else card.hold
        self._commands, self._poses = _Rows(4), _Rows(4)
        self._counts: dict[str, int] = {}
        self._jumps: list[float] = []
        self.now = 0.0

    def add(self, sample: Sample) -> bool:
        """Takes a sample; whether it counts."""
        if sample.stream not in ("pose", "command") or not np.isfinite(sample.values).all():
            return False
        if self._origin is None:
            self._origin = sample.stamp
        time = (sample.stamp - self._origin) / 1e9
        took = self._command(time, sample.values) if sample.stream == "command" else self._pose(time, sample.values)
        if took:
            self.now = max(self.now, time)
        return took

    def _command(self, time: float, values: Sequence[float]) -> bool:
        if self._commands.time.size and time <= self._commands.time[-1]:
            return self._left_out("late_commands")
        self._commands.append(time, values)
        self._commands.forget(time - KEPT)
        return True

    def _pose(self, time: float, values: Sequence[float]) -> bool:
        x, y, z, *quaternion = values
        yaw = float(yaw_from_quaternion(*np.array(quaternion)))
        if self._poses.time.size:
            if time <= self._poses.time[-1]:
                return self._left_out("late_poses")
            before = self._poses.values[-1]
            yaw = before[3] + (yaw - before[3] + np.pi) % (2 * np.pi) - np.pi
            if (x, y, z, yaw) == tuple(before):
                return self._left_out("stale_poses")
            moved = float(np.linalg.norm(np.array([x, y, z]) - before[:3]))
            if moved > FASTEST * (time - self._poses.time[-1]) + REACH:
                self._jumps.append(time)
        self._poses.append(time, (x, y, z, yaw))
        self._poses.forget(time - KEPT)
        return True

    def _left_out(self, code: str) -> bool:
        self._counts[code] = self._counts.get(code, 0) + 1
        return False

    @property
    def frozen(self) -> bool:
        """Whether the pose has repeated itself for `FROZEN` while commands went on."""
        return self._poses.time.size > 0 and self.now - float(self._poses.time[-1]) > FROZEN

    @property
    def jumps(self) -> tuple[float, ...]:
        """When the pose jumped as no vehicle can [s]."""
        return tuple(self._jumps)

    def flight(self) -> Flight | None:
        """The flight so far; None before the first command or the second pose."""
        time, end = self._commands.time, self.now
        if not time.size or self._poses.time.size < 2:
            return None
        command, poses = self._commands.values, self._poses.values
        until = np.minimum(np.append(time[1:], end), time + self._hold)
        return Flight(
            path="live",
            sha256="",
            card=self._card,
            span=(float(time[0]), end),
            axes=tuple(axis for axis in AXES if axis in self._card.command),
            command_time=time.copy(),
            command=command.copy(),
            pose_time=self._poses.time.copy(),
            position=poses[:, :3].copy(),
            yaw=poses[:, 3].copy(),
            segments=_segments(time, until, [*self._jumps, np.inf]),
            notes=tuple(Note(code, LEFT_OUT[code], count) for code, count in self._counts.items()),
        )


LEFT_OUT = {
    "late_commands": "commands were no newer than the last: left out",
    "late_poses": "poses were no newer than the last: left out",
    "stale_poses": "poses repeat the one before with a fresh stamp: left out",
}
"""What is said of samples that do not count."""


def _segments(time: Array, until: Array, jumps: Sequence[float]) -> tuple[Segment, ...]:
    """Runs of commands in which each acts until the next comes, cut where the pose jumped."""
    fresh = np.append(True, time[1:] > until[:-1] + 1e-6)
    last = np.append(fresh[1:], True)
    out = []
    for start, end in zip(time[fresh], until[last], strict=True):
        for jump in jumps:
            if start < jump < end:
                out.append(Segment(float(start), float(np.nextafter(jump, start))))
                start = jump
        out.append(Segment(float(start), float(end)))
    return tuple(out)
