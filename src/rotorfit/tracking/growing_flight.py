"""Samples to the flight so far: the causal repairs of a stream, one sample at a time.

A command acts until the next one, but no longer than the card's hold; a pose counts if it is newer than the last and
differs from it. Other samples are left out and counted. Segments are the times in which commands and poses are known
and the vehicle obeys. The last `KEPT` seconds are remembered.

Second 0 is the first command that is obeyed, as where a log is read: what comes before tells nothing of the vehicle.

Samples are timed by their `sender_clock`. Where no arrival is known, a sample far ahead of all others waits for the
next one: if that is no earlier, time has gone on; else it is left out.
"""

from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from rotorfit.core.card import Card
from rotorfit.core.flight_data import Flight
from rotorfit.core.frames import Array, yaw_from_quaternion
from rotorfit.core.log import Sample
from rotorfit.core.tracked import Alarm
from rotorfit.flights.stamps import rows_of_slower
from rotorfit.tracking.excited_time import LONGEST, excited_since
from rotorfit.tracking.flight_so_far import HOLD, UNRECORDED, FlightSoFar, News, Rows
from rotorfit.tracking.ground import Ground
from rotorfit.tracking.pose_watch import FROZEN, PoseWatch
from rotorfit.tracking.sender_clock import SenderClock

KEPT = 900.0
"""Time that is remembered [s]."""

AHEAD = 2.0
"""Time that a stamp lies ahead of all before it from which on the next one must confirm it [s]."""

FRAMES = 5000
"""Number of the last poses that tell whether rows hold the latest of slower ones."""

LARGEST = 1e9
"""Bound on the values of a sound sample [m or unit of the command]."""

_TIMED = ("pose", "command")
"""Streams with a clock."""


class _InLine:
    """Keeps a stamp far ahead of all others from carrying the flight away, where no arrival tells that it is wrong."""

    def __init__(self) -> None:
        self._newest: int | None = None
        self._waiting: Sample | None = None

    def take(self, sample: Sample) -> tuple[tuple[Sample, ...], bool]:
        """The samples that count now, in order, and whether the one that waited does not.

        None counts, or the sample, or the one that waited and the sample.
        """
        if sample.received > 0:
            return (sample,), False
        waited, self._waiting = self._waiting, None
        if self._newest is not None and sample.stamp - self._newest <= 1e9 * AHEAD:
            self._newest = max(self._newest, sample.stamp)
            return (sample,), waited is not None
        if waited and abs(sample.stamp - waited.stamp) <= 1e9 * AHEAD:
            self._newest = max(waited.stamp, sample.stamp)
            return (waited, sample), False
        if waited and sample.stamp > waited.stamp:  # as in a pause of the poses with few commands: time goes on
            self._newest, self._waiting = waited.stamp, sample
            return (waited,), False
        self._waiting = sample
        return (), waited is not None


@dataclass(frozen=True)
class Part:
    """The part of a flight that one recording holds.

    Attributes:
        path: File of the recording, or `UNRECORDED`.
        begin: Second of the flight that is its own second 0 [s].
        end: Second of the flight up to which it was tracked from [s].
    """

    path: str
    begin: float
    end: float


class GrowingFlight:
    """The flight so far, fed sample by sample.

    Args:
        card: The vehicle's card: hold and axes of the commands.
        origin: Stamp of second 0 [ns]; None for that of the first command that is obeyed.
        path: File of the recording.
    """

    def __init__(self, card: Card, origin: int | None = None, path: str = UNRECORDED) -> None:
        self._origin, self._so_far = origin, FlightSoFar(card, path)
        self._path, self._begun = path, np.inf  # when the first obeyed command came since the start or the restart
        self._earlier: list[Part] = []
        self._clocks = {name: SenderClock() for name in _TIMED}
        self._remarks: list[str] = []
        self._line, self._watch, self._ground = _InLine(), PoseWatch(), Ground()
        self._alarms: list[Alarm] = []
        self._obeys, self._newest, self._resumed = True, -np.inf, False
        self._commands, self._poses = self._so_far.commands, self._so_far.poses
        self._frames = deque[tuple[float, bool]](maxlen=FRAMES)  # time, and whether it repeated the pose before

    @property
    def rows(self) -> tuple[Rows, Rows]:
        """The growing rows of commands and poses."""
        return self._commands, self._poses

    @property
    def now(self) -> float:
        """Time of the newest sound sample [s]."""
        return self._so_far.now

    @property
    def origin(self) -> int | None:
        """Stamp of second 0, by the clock that times the commands [ns]; None before it is known."""
        return self._origin

    def add(self, sample: Sample) -> bool:
        """Takes a sample.

        Args:
            sample: Of the stream `pose`, `command` or `obeys`; others are ignored.

        Returns:
            Whether it was added to the flight, or one that waited for it.
        """
        if sample.stream == "obeys":
            return self._obeyed(sample)
        if sample.stream not in _TIMED:
            return False
        found, wild = self._line.take(sample)
        if wild:
            self._left_out("strange_stamps")
        clock = self._clocks[sample.stream]
        before = clock.by_arrival
        took = [self._timed(*timed) for one in found for timed in clock.take(one)]
        while clock.steps:
            self._stepped(sample.stream, clock.steps.pop(0))
        if clock.by_arrival and not before:
            self._remarks.append(
                f"{self.now:.1f} s: the clock of the {sample.stream}s is another one: from here on they are timed by "
                "their arrival"
            )
        return any(took)

    def _stepped(self, stream: str, size: float) -> None:
        """Tells that the clock of a sender was set on by `size` [s]."""
        self._so_far.counts[f"{stream}_clock_steps"] += 1
        self._remarks.append(
            f"{self.now:.1f} s: the clock of the {stream}s was set {'on' if size > 0 else 'back'} by "
            f"{1e3 * abs(size):.0f} ms a moment ago, by their arrivals; their stamps since then are moved by as much"
        )

    def remarks(self) -> list[str]:
        """What was done about the stream since the last call and should be told, one line each."""
        found, self._remarks = self._remarks, []
        return found

    def _timed(self, stamp: int | None, sample: Sample) -> bool:
        """Takes a pose or command whose turn it is, with its time [ns]."""
        if stamp is None:
            return self._left_out("strange_stamps")
        if self._resumed and self._origin is not None:
            self._resumed = False
            if (stamp - self._origin) / 1e9 < self.now - HOLD:  # the clock has changed with the restart
                self._origin = stamp - round((self.now + HOLD) * 1e9)
        if self._origin is None:
            if sample.stream != "command" or not self._obeys or not _is_sound(sample):
                return False
            self._origin = stamp
        time = (stamp - self._origin) / 1e9
        if sample.stream == "command" and not _is_sound(sample):
            return self._without_command(time)
        if not _is_sound(sample):
            return self._left_out("not_numbers")
        if time < 0:  # measured before the first command
            return False
        if sample.error and sample.stream == "pose":
            self._so_far.pose_error(sample.error)
        took = self._command(time, sample.values) if sample.stream == "command" else self._pose(time, sample.values)
        self._so_far.now = max(self.now, time)
        return took

    @property
    def parts(self) -> list[Part]:
        """The recordings of the flight, one for each start of the tracker that heard a command."""
        return [*self._earlier, *([Part(self._path, self._begun, self.now)] if self._begun < np.inf else [])]

    @property
    def raised(self) -> tuple[Alarm, ...]:
        """What the next call of `alarms` will return."""
        return tuple(self._alarms)

    def alarms(self) -> tuple[Alarm, ...]:
        """The alarms of the pose since the last call: that it froze, or jumped."""
        found, self._alarms = tuple(self._alarms), []
        return found

    def _obeyed(self, sample: Sample) -> bool:
        """Takes the autopilot's report whether the vehicle obeys the recorded commands; False, as it is no row."""
        if self._obeys != bool(sample.values[0]):
            self._obeys = not self._obeys
            self._ground.report(self.now, self._obeys)
        return False

    def _command(self, time: float, values: Sequence[float]) -> bool:
        if self._commands.time.size and time <= self._commands.time[-1]:
            return self._left_out("late_commands")
        if self._obeys:
            self._begun = min(self._begun, time)
        self._commands.append(time, values, np.inf)
        self._commands.forget(time - KEPT)
        self._ground.command(time, values)
        return True

    def _without_command(self, time: float) -> bool:
        """A command that is not a number ends the one before it."""
        ends = self._commands.last
        if ends.size and time > self._commands.time[-1]:
            ends[-1] = min(ends[-1], time)
        return self._left_out("not_numbers")

    def _pose(self, time: float, values: Sequence[float]) -> bool:
        x, y, z, *quaternion = values
        pose = np.array([x, y, z, float(yaw_from_quaternion(*np.array(quaternion)))])
        if time <= self._newest:
            return self._left_out("late_poses")
        self._newest = time
        if self._poses.time.size:
            before = self._poses.last[-1]
            pose[3] = before + (pose[3] - before + np.pi) % (2 * np.pi) - np.pi
        seen = self._watch.take(time, pose, self._rests(time, pose))
        if seen.left_out in ("", "stale_poses"):
            self._frames.append((time, bool(seen.left_out)))
            while self._frames[0][0] < time - KEPT:
                self._frames.popleft()
        if seen.alarm:
            self._alarms.append(seen.alarm)
            if seen.alarm.cause == "pose_jumped":
                self._ground.jumped(float(seen.believed[0][1][2]))
        if seen.left_out:
            return self._left_out(seen.left_out)
        for at, one in seen.believed:
            self._poses.append(at, one[:3], float(one[3]))
            self._ground.pose(at, one)
        self._poses.forget(time - KEPT)
        self._watch.forget(time - KEPT)
        self._ground.forget(time - KEPT)
        return True

    def _rests(self, time: float, pose: Array) -> bool:
        """Whether the vehicle may be so still that its pose repeats: without commands, or on the ground."""
        ground = self._ground
        return not ground.asked_within(time, FROZEN) or (ground.low(float(pose[2])) and self._watch.slow)

    def _left_out(self, code: str) -> bool:
        self._so_far.counts[code] += 1
        return False

    @property
    def standing(self) -> bool:
        """Whether nothing can be told now: it stands, touches down, takes off or lands by itself, or does not obey."""
        return self._ground.touches

    def flight(self) -> Flight | None:
        """The flight so far; None until it has a segment: a command that is obeyed, and two poses under it."""
        return self._up_to_date().flight()

    def news(self) -> News:
        """What is new since the last call, for `FlightSoFar.take` of another process."""
        return self._up_to_date().news()

    def _up_to_date(self) -> FlightSoFar:
        """The rows, with the intervals in which nothing is learnt updated to now."""
        self._so_far.standing, self._so_far.jumps = self._ground.standing(self.now), tuple(self._watch.jumps)
        if any(again for _, again in self._frames):
            time, again = np.array(self._frames).T
            if late := rows_of_slower(np.round(1e9 * time).astype(np.int64), again > 0):
                self._so_far.pose_lateness = late
        return self._so_far

    def memory(self) -> Mapping[str, Any]:
        """What an estimate looks back over and all that `recall` needs, as arrays for a file; empty at first."""
        if self._origin is None:
            return {}
        begin = self._looked_back_over()
        clocks = [self._clocks[name] for name in _TIMED]
        return {
            "origin": np.array(self._origin),
            "now": np.array(self.now),
            **_packed("commands", self._commands, begin),
            **_packed("poses", self._poses, begin),
            "by_arrival": np.array([clock.by_arrival for clock in clocks]),
            "shift": np.array([clock.shift for clock in clocks]),
            "obeys": np.array(self._obeys),
            "jumps": np.array(self._watch.jumps),
            "standing": np.array(self._ground.intervals()).reshape(-1, 2),
            "ground": np.array(self._ground.level),
            "paths": np.array([part.path for part in self.parts], dtype=str),
            "recorded": np.array([(part.begin, part.end) for part in self.parts]).reshape(-1, 2),
            "codes": np.array(list(self._so_far.counts), dtype=str),
            "pose_lateness": np.array(self._so_far.pose_lateness),
            "counts": np.array(list(self._so_far.counts.values()), dtype=np.int64),
        }

    def _looked_back_over(self) -> float:
        """Time since which an estimate of any axis that is commanded may use the flight [s]."""
        time, command = self._commands.time, self._commands.values
        first = max(self.now - KEPT, 0.0)
        moved = command[:, np.ptp(command, axis=0) > 0] if time.size else command
        begins = [excited_since(time, one[:, None], first, self.now) for one in moved.T]
        return min(begins, default=self.now - LONGEST)

    def recall(self, memory: Mapping[str, Any]) -> None:
        """Continues from what `memory` returned; call it before the first sample."""
        if not memory:
            return
        self._origin, self._so_far.now = int(memory["origin"]), float(memory["now"])
        self._newest = float(np.max(memory["poses_time"], initial=-np.inf))
        parts = zip(memory["paths"].tolist(), memory["recorded"].tolist(), strict=True)
        self._earlier = [Part(path, begin, end) for path, (begin, end) in parts]
        self._resumed = True
        for rows, name in ((self._commands, "commands"), (self._poses, "poses")):
            for t, row in zip(memory[f"{name}_time"].tolist(), memory[name].tolist(), strict=True):
                rows.append(t, row[:-1], row[-1])
        clocks = zip(_TIMED, memory["by_arrival"].tolist(), memory["shift"].tolist(), strict=True)
        self._clocks = {name: SenderClock(by_arrival, shift) for name, by_arrival, shift in clocks}
        self._obeys, self._so_far.pose_lateness = bool(memory["obeys"]), float(memory.get("pose_lateness", 0.0))
        self._watch = PoseWatch(memory["jumps"].tolist())
        self._ground.recall(memory["standing"].tolist(), float(memory["ground"]), self._obeys)
        self._so_far.counts.update(dict(zip(memory["codes"].tolist(), memory["counts"].tolist(), strict=True)))


def _packed(name: str, rows: Rows, begin: float) -> dict[str, Array]:
    """The rows from `begin` [s] on."""
    new = rows.since(begin)
    return {f"{name}_time": new[:, 0].copy(), name: new[:, 1:].copy()}


def _is_sound(sample: Sample) -> bool:
    """Whether a sample has plausible numbers, and a quaternion that is not zero."""
    values = sample.values
    if not all(abs(value) < LARGEST for value in values):
        return False
    return sample.stream == "command" or any(values[3:])
