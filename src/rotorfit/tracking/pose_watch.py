"""Poses that cannot be the vehicle's: those that jump as no vehicle can, or repeat themselves to the last digit.

A pose is predicted from the last few at their velocity; the deviation must be within noise and the fastest motion of a
vehicle. A pose outside waits for the next ones: if they continue from it, the pose has jumped (a reset, another
origin); if they continue from before it, it was wild and is left out.
"""

from dataclasses import dataclass, replace

import numpy as np

from rotorfit.core.frames import Array
from rotorfit.core.tracked import Alarm

FASTEST = np.array([40.0, 40.0, 40.0, 8.0])
"""Largest speed of a vehicle between two poses, x, y, z and yaw [m/s, rad/s]."""

REACH = np.array([0.3, 0.3, 0.3, 0.08])
"""Tolerance of every prediction [m, rad]: no sensor is that noisy."""

SUDDEN = np.array([60.0, 60.0, 60.0, 20.0])
"""Largest acceleration of a vehicle [m/s^2, rad/s^2]: about the vertical only the drag of its rotors turns it."""

NOISY = 12.0
"""Largest deviation that counts as noise, over the usual one."""

PAST, LEAST = 0.1, 0.03
"""Time over which the velocity is measured, and below which it is unknown [s]."""

SHARE = 0.05
"""Weight of the newest pose in the running averages."""

FROZEN = 0.5
"""Least time of repeated poses after which the pose is frozen [s]."""

REPEATS, USUAL = 8, 3.0
"""The pose is frozen only after as many periods of the poses, and as many times the longest repetition so far: a coarse
sensor repeats itself."""

SLOW = 0.05
"""Speed up to which a vehicle may stand still the next moment [m/s]."""

ENOUGH, REPEATED = 2.0, 0.25
"""Number of poses that continue from a deviating one and so prove a jump; weight of one that only repeats it."""

ALL = ("x", "y", "z", "yaw")

LEARNT = "; x and y are learnt anew, as their commands may now act in other directions"
"""What follows from a jump of the heading."""


@dataclass(frozen=True)
class Seen:
    """The verdict on a pose.

    Attributes:
        believed: Poses that now count, with their times [s]: none, this one, or this one and those that waited.
        left_out: Code of `NOTES` if the pose does not count; else empty.
        alarm: The alarm that it raises, if any.
    """

    believed: tuple[tuple[float, Array], ...] = ()
    left_out: str = ""
    alarm: Alarm | None = None


class PoseWatch:
    """Watches poses, in the order of their times.

    Args:
        jumps: Times of earlier jumps of the pose [s].
    """

    def __init__(self, jumps: list[float] | None = None) -> None:
        self.jumps, self.frozen = list(jumps or []), False
        self._past: list[tuple[float, Array]] = []
        self._earlier: list[tuple[float, Array]] = []  # the past without its last pose
        self._waiting: list[tuple[float, Array]] = []
        self._evidence = 0.0
        self._usual, self._period = np.zeros(4), 0.0
        self._since: float | None = None  # of the pose that repeats itself
        self._repeats, self._longest = 0, 0.0

    def take(self, time: float, pose: Array, stands: bool) -> Seen:
        """Judges a pose.

        Args:
            time: Its stamp, later than the last [s].
            pose: World x, y, z [m] and unwrapped yaw [rad], shape (4,).
            stands: Whether the vehicle may be so still that its pose repeats itself.
        """
        if self._waiting and np.array_equal(pose, self._waiting[-1][1]):
            return self._judged_again(time, pose)
        if not self._past:  # the first pose may itself be wild
            return replace(self._judged_again(time, pose), left_out="")
        if np.array_equal(pose, self._past[-1][1]):
            self._waiting = []
            return self._repeated(time, stands)
        self._moved(time)
        if self._explained(time, pose, self._past) and not self._nearer_to_waiting(time, pose):
            self._waiting = []
            self._learn(time, pose)
            return Seen(((time, pose),))
        if not self._waiting and self._last_was_wild(time, pose):
            self._past = self._earlier
            self._learn(time, pose)
            return Seen(((time, pose),))
        return self._judged_again(time, pose)

    @property
    def slow(self) -> bool:
        """Whether the vehicle hardly moved over the last poses that counted."""
        if not self._past:
            return True
        (first, before), (last, here) = self._past[0], self._past[-1]
        return bool(np.linalg.norm(here[:3] - before[:3]) <= SLOW * max(last - first, 1e-3))

    def forget(self, before: float) -> None:
        """Drops the jumps before a time [s]."""
        while self.jumps and self.jumps[0] < before:
            self.jumps.pop(0)

    def _judged_again(self, time: float, pose: Array) -> Seen:
        """Judges a deviating pose together with those that wait."""
        if not self._waiting or not self._explained(time, pose, self._waiting[:1]):
            self._waiting, self._evidence = [(time, pose)], 0.0
            return Seen(left_out="wild_poses")
        if np.array_equal(pose, self._waiting[-1][1]):
            self._evidence += REPEATED
        else:
            self._evidence += 1.0
            self._waiting.append((time, pose))
        if self._evidence < ENOUGH:
            return Seen(left_out="wild_poses")
        past, self._past, self._earlier, self._waiting, self._since = self._past, self._waiting, [], [], None
        if not past:
            return Seen(tuple(self._past))
        (at, there), (last, before) = self._past[0], past[-1]
        self.jumps.append(at)
        off = there - before
        turned = bool(self._deviates(at, there, past)[3])
        more = LEARNT if turned else ""
        alarm = Alarm(
            time, ALL, "pose_jumped", (last, at), {}, 1.0, 0.0,
            f"the pose went {float(np.linalg.norm(off[:3])):.2f} m and {abs(np.degrees(off[3])):.0f} deg within "
            f"{at - last:.3f} s and went on from there: no vehicle does, its frame or its track changed{more}",
            turned=turned,
        )  # fmt: skip
        return Seen(tuple(self._past), alarm=alarm)

    def _repeated(self, time: float, stands: bool) -> Seen:
        """Judges a pose that repeats the last one with a fresh stamp."""
        self._since = self._past[-1][0] if self._since is None else self._since
        self._repeats += 1
        lasted, least = time - self._since, max(FROZEN, REPEATS * self._period, USUAL * self._longest)
        if self.frozen or stands or lasted < least or self._repeats < REPEATS:
            return Seen(left_out="stale_poses")
        self.frozen = True
        alarm = Alarm(
            time, ALL, "pose_frozen", (self._since, min(self._since + self._period, time)), {}, 1.0, 0.0,
            f"the pose has repeated itself to the last digit for {lasted:.1f} s: it is no longer measured",
        )  # fmt: skip
        return Seen(left_out="stale_poses", alarm=alarm)

    def _moved(self, time: float) -> None:
        """Notes that the pose has changed."""
        if self._since is not None and not self.frozen:
            self._longest = max(self._longest, time - self._since)
        self._since, self._repeats, self.frozen = None, 0, False

    def _explained(self, time: float, pose: Array, past: list[tuple[float, Array]]) -> bool:
        """Whether a vehicle can have reached a pose from the past ones."""
        return not any(self._deviates(time, pose, past))

    def _deviates(self, time: float, pose: Array, past: list[tuple[float, Array]]) -> list[bool]:
        """Which of x, y, z and yaw no vehicle can have reached from the past ones; stamps may be wrong by a period."""
        (first, before), (last, here) = past[0], past[-1]
        since, known = time - last, last - first
        long = max(since, self._period)
        if known < LEAST or since > PAST:  # there is no valid velocity
            return list(np.abs(pose - here) > FASTEST * long + REACH)
        off = np.abs(pose - here - (here - before) / known * since)
        return list(off > REACH + SUDDEN * long * (long + known) + NOISY * self._usual)

    def _nearer_to_waiting(self, time: float, pose: Array) -> bool:
        """Whether a pose continues from those that wait rather than from the past, which allows more as it ages."""
        if not self._waiting:
            return False
        velocity = _velocity(self._past)
        past, waiting = (_off(time, pose, one, velocity) for one in (self._past[-1], self._waiting[-1]))
        return waiting < past

    def _last_was_wild(self, time: float, pose: Array) -> bool:
        """Whether a pose continues from before the last one, which was wild by too little to be seen then."""
        if not self._earlier:
            return False
        past, earlier = (_off(time, pose, one[-1], _velocity(one)) for one in (self._past, self._earlier))
        return earlier < 0.5 * past and self._explained(time, pose, self._earlier)

    def _learn(self, time: float, pose: Array) -> None:
        """Updates the usual deviation, the usual period, and the past poses."""
        (first, before), (last, here) = self._past[0], self._past[-1]
        since, known = time - last, last - first
        if known >= LEAST and since <= PAST:
            off = np.abs(pose - here - (here - before) / known * since)
            self._usual += SHARE * (np.minimum(off, 3 * self._usual + 0.01) - self._usual)
        self._period += SHARE * (min(since, 2 * self._period + 0.02) - self._period)
        self._earlier = list(self._past)
        self._past.append((time, pose))
        while len(self._past) > 2 and self._past[1][0] < time - PAST:
            self._past.pop(0)
        if since > PAST:
            self._past = self._past[-1:]


def _velocity(past: list[tuple[float, Array]]) -> Array:
    """Velocity from the first to the last of some poses; 0 where they lie too near to each other."""
    (first, before), (last, here) = past[0], past[-1]
    return (here - before) / (last - first) if last - first >= LEAST else np.zeros(4)


def _off(time: float, pose: Array, begin: tuple[float, Array], velocity: Array) -> float:
    """Distance of a pose from where a velocity leads from another, in tolerances."""
    at, there = begin
    return float(np.max(np.abs(pose - there - velocity * (time - at)) / REACH))
