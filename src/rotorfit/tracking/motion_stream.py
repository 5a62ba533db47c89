"""The motion after each sample: the filters of the last look, continued pose by pose.

The filter is the one that a look runs over the flight so far, with the coefficients that the look found. Until the next
look, a command that arrives late acts late, and a jump of the pose ends the filter.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from rotorfit.core.model import NORMAL
from rotorfit.core.tracked import AxisMotion, Motion
from rotorfit.dynamics.motion_filter import GUSTS, LATER, LATER_ERROR, VELOCITY, WIND, WIND_ERROR
from rotorfit.tracking.air import PAIRS, Course
from rotorfit.tracking.flight_so_far import Rows
from rotorfit.tracking.wind_error import Doubt


@dataclass
class _Running:
    """A filter that is continued, and the index of the command from which it counts."""

    course: Course
    first: int


class MotionStream:
    """Continues the motion filters of looks.

    Args:
        commands: Commands of the flight so far.
        poses: Poses of the flight so far.
    """

    def __init__(self, commands: Rows, poses: Rows) -> None:
        self._commands, self._poses = commands, poses
        self._running: list[_Running] = []
        self._doubt: Mapping[str, Doubt] = {}
        self._seen = 0

    def begin(self, courses: Sequence[Course], doubt: Mapping[str, Doubt]) -> None:
        """Continues from a look.

        Args:
            courses: Its filters.
            doubt: Axis name to the errors of its motion due to the coefficients; an axis without a known wind is
                missing.
        """
        self._running, self._doubt = [], doubt
        for course in courses:
            course.filter.k[:] = np.searchsorted(self._commands.time, course.in_force)
            self._running.append(_Running(course, self._commands.first))
        self._seen = self._poses.count
        for one in self._running:
            self._follow(one, int(np.searchsorted(self._poses.time, one.course.filter.time, side="right")))

    def follow(self) -> None:
        """Takes the new poses."""
        new = self._poses.count - self._seen
        if new:
            self._seen = self._poses.count
            for one in self._running:
                self._follow(one, len(self._poses.time) - new)

    def end(self) -> None:
        """Ends the filters: there is no motion until the next look."""
        self._running = []

    def motion(self) -> Motion | None:
        """The motion at the last pose; None if no axis has one."""
        axes: dict[str, AxisMotion] = {}
        time = -np.inf
        commands = self._commands.time, self._commands.values
        for one in self._running:
            pair = next(pair for pair in PAIRS if one.course.axes[0] in pair)
            motion, time = one.course.filter.motion(*commands).tolist(), one.course.filter.time
            for axis in one.course.axes:
                if axis in self._doubt:
                    axes[axis] = _axis(motion[pair.index(axis)], self._doubt[axis])
        return Motion(time, axes) if axes else None

    def _follow(self, one: _Running, first: int) -> None:
        if dropped := self._commands.first - one.first:
            one.course.filter.k[:] = np.maximum(one.course.filter.k - dropped, 0)
            one.first = self._commands.first
        poses = self._poses
        one.course.filter.follow(
            poses.time[first:], poses.values[first:], poses.last[first:], self._commands.time, self._commands.values
        )


def _axis(now: Sequence[float], doubt: Doubt) -> AxisMotion:
    wind, later = now[WIND], now[LATER]
    wide, off = (
        NORMAL * float(np.hypot(*errors)) for errors in ((now[WIND_ERROR], doubt.wind), (now[LATER_ERROR], doubt.ahead))
    )
    return AxisMotion(now[VELOCITY], wind, (wind - wide, wind + wide), now[GUSTS], later, (later - off, later + off))
