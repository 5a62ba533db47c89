"""When the motion teaches nothing: on the ground, and while the autopilot moves the vehicle by itself.

A vehicle stands if it rests at the lowest height seen so far. It moves by itself if it climbs or sinks although all
commands have been zero for a while, as in a take-off or a landing. If the link reports whether commands are obeyed,
that counts too. A vehicle that hovers motionless at that height is taken to stand; it teaches nothing either.

Between touching down and being seen to stand lies a second in which the ground looks like another vehicle: who has
sunk, as commanded, to the lowest height so far, or no longer sinks as commanded, may have touched down. So the ground
is also found where it is higher than before, or where the height has drifted. Likewise who climbs or sinks since all
commands became zero may take off or land by itself.

Who stopped at once under a command to sink, and then stands, has landed: a hover is reached more slowly.
"""

from collections import deque
from collections.abc import Sequence

import numpy as np

from rotorfit.core.frames import Array

WINDOW, EVERY = 1.0, 0.1
"""Length of the window that is checked for rest, and interval between checks [s]."""

RESTS = np.array([0.02, 0.02, 0.02, 0.04])
"""Largest range of x, y, z [m] and yaw [rad] over the window of a vehicle at rest."""

SPREAD, SAMPLES = 5.0, 100.0
"""Range of about ten poses at rest, in standard deviations of their noise; number of poses that determine these."""

LEAVES = 2.5
"""How much more noise a vehicle on the ground may show before it counts as moving."""

FAST, NOISIEST = 0.05, np.array([0.015, 0.015, 0.015, 0.03])
"""Longest period of poses whose noise is determined [s], and the largest noise that is allowed for [m, rad]: with more,
flight at 0.2 m/s would look like rest."""

LOW = 0.05
"""Height above the lowest seen so far up to which the vehicle may be on the ground [m]."""

BEGUN = 0.7
"""How long a vehicle may have obeyed before its sideways motion is detected [s]."""

SILENT = 1.0
"""Time without a non-zero command after which motion is not due to the commands [s]."""

BY_ITSELF, CALM = 0.25, 0.1
"""Vertical speed from which a vehicle takes off or lands by itself, and up to which it no longer does [m/s]."""

SANK, HELD_UP, SLOWED, STILL_ASKED = 0.1, 0.15, 0.3, 0.15
"""How far a vehicle that may have touched down has sunk over the window [m]; time over which it sinks at less than a
share of its speed before [s], and that share; the age of the last command to sink [s]."""

UNDIMINISHED, THEN = 0.5, 3.0
"""Share of the strongest command to sink of the window up to which a later one still asks to sink on; and time after
the stop within which a vehicle that has landed stands [s]."""

LET_GO = 0.25
"""Time without a non-zero command after which a vehicle that climbs or sinks may do so by itself [s]; twice `SILENT`
after it, it either does or has come to rest."""

ASKED = 1e-3
"""Largest command that counts as zero [unit of the command]."""


class Ground:
    """Watches commands and poses, in the order of their times."""

    def __init__(self) -> None:
        self.level = np.inf
        self._closed: list[tuple[float, float]] = []
        self._landed: list[tuple[float, float]] = []
        self._since: float | None = None
        self._obeys, self._allowed = True, -np.inf  # when the commands were last obeyed again
        self._recent: deque[tuple[float, Array]] = deque()
        self._last: list[tuple[float, Array]] = []  # the last three poses
        self._noise, self._count = np.zeros(4), 0.0  # of the poses, from their second differences
        self._looked = -np.inf
        self._asked = -np.inf  # when a command last asked for anything
        self._down = -np.inf  # when a command last asked to sink
        self._vertical: deque[tuple[float, float]] = deque()  # the vertical commands of the window
        self._struck = -np.inf  # when the vehicle last stopped at once although commanded to sink
        self._lands = False  # whether it stands because of that
        self._sank = -np.inf  # when the vehicle may last have touched down, having sunk as commanded
        self._alone = False  # whether it climbs or sinks without being asked

    @property
    def stands(self) -> bool:
        """Whether nothing can be learnt now."""
        return self._since is not None

    @property
    def touches(self) -> bool:
        """Whether the vehicle stands, may have touched down a moment ago, or may take off or land by itself."""
        return self.stands or self._alone or self._looked - self._sank < WINDOW

    def low(self, height: float) -> bool:
        """Whether a height [m] may be that of the ground."""
        return height <= self.level + float(np.hypot(LOW, SPREAD / 2 * min(self._noise[2], NOISIEST[2])))

    def asked_within(self, now: float, time: float) -> bool:
        """Whether a non-zero command came in the last `time` seconds before `now` [s]."""
        return now - self._asked <= time

    def command(self, time: float, values: Sequence[float]) -> None:
        """Takes a command.

        Args:
            time: Its stamp [s].
            values: Forward, left, up, counter-clockwise [unit of the card's command].
        """
        if max(map(abs, values)) > ASKED:
            self._asked = time
        if values[2] < -ASKED:
            self._down = time
        self._vertical.append((time, values[2]))
        while self._vertical[0][0] < time - WINDOW:
            self._vertical.popleft()

    def report(self, time: float, obeys: bool) -> None:
        """Takes the vehicle's own report.

        Args:
            time: When it came [s].
            obeys: Whether it obeys the commands that are recorded.
        """
        if obeys and not self._obeys:
            self._allowed = time
        self._obeys = obeys
        if not obeys and self._since is None:
            self._since, self._lands = time, False

    def pose(self, time: float, pose: Array) -> None:
        """Takes a pose.

        Args:
            time: Its stamp [s].
            pose: World x, y, z [m] and unwrapped yaw [rad], shape (4,).
        """
        self._hear(time, pose)
        if time - self._looked < EVERY:
            return
        self._looked = time
        self._recent.append((time, pose))
        if len(self._recent) > 1 and time - self._recent[-2][0] > WINDOW:  # a gap: the poses before it are of no use
            self._recent.clear()
            self._recent.append((time, pose))
        while len(self._recent) > 2 and self._recent[1][0] <= time - WINDOW:
            self._recent.popleft()
        past = np.array([one for _, one in self._recent])
        begun = self._recent[0][0]
        self.level = min(self.level, float(np.median(past[:, 2])))
        if time - begun < WINDOW - EVERY:
            return
        ranges = np.ptp(past, axis=0)
        sinks, slowed = time - self._down <= STILL_ASKED, self._slowed(past[:, 2])
        held_up = sinks and slowed
        sank = bool(np.max(past[:, 2]) - past[-1, 2] > SANK)
        if sank and time - self._down <= WINDOW and (held_up or self.low(float(pose[2]))):
            self._sank = time
        if sank and slowed and self._undiminished(time - HELD_UP - EVERY):
            self._struck = time - HELD_UP
        climb = float(past[-1, 2] - past[len(past) // 2, 2]) / max(time - self._recent[len(past) // 2][0], EVERY)
        silent = not self.asked_within(time, SILENT)
        rests = self._still(past, 1.0)
        self._alone = LET_GO < time - self._asked < 2 * SILENT and abs(climb) > CALM
        if self._since is None:
            if rests and (self.low(float(pose[2])) or (sinks and self._looked - self._sank < 3 * WINDOW)):
                self._lands = time - self._struck < THEN
                self._since, self.level = min(begun, self._struck) if self._lands else begun, float(pose[2])
            elif silent and abs(climb) > BY_ITSELF:
                self._since, self._lands = max(self._asked + SILENT, begun), False
            return
        moving_by_itself = silent and (abs(climb) > CALM or self.low(float(pose[2])))
        if self._obeys and not self._still(past, LEAVES) and not moving_by_itself:
            sideways = int(np.argmax(ranges / RESTS)) != 2
            end = max(time - BEGUN, self._since) if sideways else time
            self._closed.append((self._since, max(end, self._allowed)))
            self._landed += self._closed[-1:] if self._lands else []
            self._since = None

    def _hear(self, time: float, pose: Array) -> None:
        """Updates the noise of the poses: what a pose differs from the line through the two before it.

        Only from poses that come so fast that no acceleration shows, and up to a noise that hides no slow flight.
        """
        self._last = [*self._last[-2:], (time, pose)]
        if len(self._last) < 3 or time - self._last[0][0] > 2 * FAST:
            return
        (first, a), (second, b), _ = self._last
        ahead = (time - second) / max(second - first, 1e-6)
        off = np.abs(pose - b - ahead * (b - a)) / (0.8 * np.sqrt(1 + (1 + ahead) ** 2 + ahead**2))  # mean of |N(0, 1)|
        self._count = min(self._count + 1.0, SAMPLES)
        if self._count == SAMPLES:
            off = np.minimum(off, SPREAD * self._noise + 1e-6)  # no jump
        self._noise += (off - self._noise) / self._count

    def _still(self, past: Array, factor: float) -> bool:
        """Whether poses over the window, shape (N, 4), stay in place, as far as a multiple of their noise tells."""
        noise, half = factor * np.minimum(self._noise, NOISIEST), len(past) // 2
        drift = np.abs(past[half:].mean(axis=0) - past[:half].mean(axis=0))
        within = np.ptp(past, axis=0) <= np.hypot(RESTS, SPREAD * noise)
        return bool(np.all(within & (drift <= np.hypot(RESTS / 2, noise))))

    def _slowed(self, height: Array) -> bool:
        """Whether a vehicle that sank over the window has stopped within the last `HELD_UP`."""
        times = np.array([at for at, _ in self._recent])
        turn = int(np.searchsorted(times, times[-1] - HELD_UP - EVERY / 2))
        if not 0 < turn < times.size - 1:
            return False
        before, now = np.diff(height[[0, turn, -1]]) / np.maximum(np.diff(times[[0, turn, -1]]), 1e-6)
        return bool(now > SLOWED * before)

    def _undiminished(self, since: float) -> bool:
        """Whether a command from a time [s] on asked to sink about as fast as any of the window."""
        strongest = min(-ASKED, *(down for _, down in self._vertical))
        return any(time >= since and down <= UNDIMINISHED * strongest for time, down in self._vertical)

    def jumped(self, to: float) -> None:
        """Takes note that the pose jumped, to a height [m]: that of the ground has changed by as much."""
        if self._recent:
            self.level += to - float(self._recent[-1][1][2])
        self._recent.clear()

    def forget(self, before: float) -> None:
        """Drops the intervals that ended before a time [s]."""
        for past in (self._closed, self._landed):
            while past and past[0][1] < before:
                past.pop(0)

    def standing(self, now: float) -> list[tuple[float, float]]:
        """Intervals in which nothing can be learnt, in order, up to now [s]."""
        return [*self._closed, *([(self._since, now)] if self._since is not None else [])]

    def landed(self, now: float) -> list[tuple[float, float]]:
        """Those of them in which the vehicle stood after a landing that it was commanded, in order, up to now [s]."""
        return [*self._landed, *([(self._since, now)] if self._since is not None and self._lands else [])]

    def intervals(self) -> list[tuple[float, float]]:
        """The same intervals for a file; one that is not over ends at infinity [s]."""
        return self.standing(np.inf)

    def recall(self, intervals: Sequence[Sequence[float]], level: float, obeys: bool) -> None:
        """Continues from a file.

        Args:
            intervals: As `intervals` gave them [s].
            level: Lowest height seen [m].
            obeys: Whether the vehicle obeyed.
        """
        self._closed = [(low, high) for low, high in intervals if np.isfinite(high)]
        self._since = next((low for low, high in intervals if not np.isfinite(high)), None)
        self.level, self._obeys = level, obeys
