"""When nothing is to be learnt from the motion: on the ground, and while the autopilot moves the vehicle by itself.

The vehicle stands where it rests at the lowest height that was seen. It moves by itself where it climbs or sinks while
all commands have been zero for a while, as in a take-off or a landing. Where a link says itself whether the commands
are obeyed, that counts too. A vehicle that hovers there without a stir is taken to stand; it tells nothing either.
"""

from collections import deque
from collections.abc import Sequence

import numpy as np

from rotorfit.core.frames import Array

WINDOW, EVERY = 1.0, 0.1
"""Rest is looked for over so long, so often [s]."""

RESTS = np.array([0.02, 0.02, 0.02, 0.04])
"""A vehicle whose pose stays within this over the window rests [m, rad]."""

LOW = 0.05
"""Height above the lowest that was seen, below which it can be the ground [m]."""

BEGUN = 0.7
"""Before it is seen that a vehicle moves sideways, so long it may have begun to obey [s]."""

SILENT = 1.0
"""All commands have been zero for so long before what moves the vehicle is not the commands [s]."""

BY_ITSELF, CALM = 0.25, 0.1
"""Vertical speed of a vehicle that takes off or lands by itself, and of one that no longer does [m/s]."""

ASKED = 1e-3
"""Commands below this ask for nothing [unit of the command]."""


class Ground:
    """Looks at commands and poses in the order of their times."""

    def __init__(self) -> None:
        self.level = np.inf
        self._closed: list[tuple[float, float]] = []
        self._since: float | None = None
        self._obeys, self._allowed = True, -np.inf  # since when what is heard counts again
        self._recent: deque[tuple[float, Array]] = deque()
        self._looked = -np.inf
        self._asked = -np.inf  # when a command last asked for anything

    @property
    def stands(self) -> bool:
        """Whether nothing is to be learnt now."""
        return self._since is not None

    def low(self, height: float) -> bool:
        """Whether a height can be that of the ground [m]."""
        return height <= self.level + LOW

    def asked_within(self, now: float, time: float) -> bool:
        """Whether a command has asked for anything in the last `time` seconds."""
        return now - self._asked <= time

    def command(self, time: float, values: Sequence[float]) -> None:
        """Takes a command.

        Args:
            time: [s].
            values: Forward, left, up, counter-clockwise.
        """
        if max(map(abs, values)) > ASKED:
            self._asked = time

    def told(self, time: float, obeys: bool) -> None:
        """What the vehicle says itself.

        Args:
            time: [s].
            obeys: Whether it obeys the commands that are heard.
        """
        if obeys and not self._obeys:
            self._allowed = time
        self._obeys = obeys
        if not obeys and self._since is None:
            self._since = time

    def pose(self, time: float, pose: Array) -> None:
        """Takes a pose.

        Args:
            time: [s].
            pose: x, y, z and unwrapped yaw, shape (4,).
        """
        if time - self._looked < EVERY:
            return
        self._looked = time
        self._recent.append((time, pose))
        if len(self._recent) > 1 and time - self._recent[-2][0] > WINDOW:  # a pause: what was before tells nothing
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
        climb = float(past[-1, 2] - past[len(past) // 2, 2]) / max(time - self._recent[len(past) // 2][0], EVERY)
        silent = not self.asked_within(time, SILENT)
        rests = bool(np.all(ranges <= RESTS))
        if self._since is None:
            if rests and self.low(float(pose[2])):
                self._since = begun
            elif silent and abs(climb) > BY_ITSELF:
                self._since = max(self._asked + SILENT, begun)
            return
        moving_by_itself = silent and (abs(climb) > CALM or self.low(float(pose[2])))
        if self._obeys and not rests and not moving_by_itself:
            sideways = int(np.argmax(ranges / RESTS)) != 2
            end = max(time - BEGUN, self._since) if sideways else time
            self._closed.append((self._since, max(end, self._allowed)))
            self._since = None

    def forget(self, before: float) -> None:
        """Drops what ended earlier."""
        while self._closed and self._closed[0][1] < before:
            self._closed.pop(0)

    def standing(self, now: float) -> list[tuple[float, float]]:
        """Times in which nothing is to be learnt, in order, up to now [s]."""
        return [*self._closed, *([(self._since, now)] if self._since is not None else [])]

    def intervals(self) -> list[tuple[float, float]]:
        """The same for a file: one that lasts ends never."""
        return self.standing(np.inf)

    def recall(self, intervals: Sequence[Sequence[float]], level: float, obeys: bool) -> None:
        """Goes on from what a file holds."""
        self._closed = [(low, high) for low, high in intervals if np.isfinite(high)]
        self._since = next((low for low, high in intervals if not np.isfinite(high)), None)
        self.level, self._obeys = level, obeys
