"""Since when each axis is watched for changes, and how much of its time could not be tested."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from rotorfit.core.tracked import HARDLY, Alarm
from rotorfit.tracking.changes import compares
from rotorfit.tracking.scores import WINDOWS, Scores


@dataclass(frozen=True)
class WatchedAxis:
    """What tests have seen of one axis.

    Attributes:
        until: Time of the last row that was counted [s].
        untested: Number of rows so far that could not be tested.
        rows: Number of rows so far.
        lately: Share of the longest window that could not be tested.
    """

    until: float = -np.inf
    untested: int = 0
    rows: int = 0
    lately: float = 0.0


class WatchedTime:
    """The axes about which alarms can be raised.

    Attributes:
        since: Axis to the time of the first test that could have raised an alarm about it [s].
    """

    def __init__(self) -> None:
        self.since: dict[str, float] = {}
        self._seen: dict[str, WatchedAxis] = {}

    def of(self, axis: str) -> WatchedAxis | None:
        """What tests have seen of an axis; None before the first."""
        return self._seen.get(axis)

    def since_alarms(self, alarms: Sequence[Alarm]) -> dict[str, float]:
        """Axis to the time of the first test since its last alarm that could have raised another [s]."""
        raised = {axis: alarm.raised for alarm in alarms for axis in alarm.axes}
        return {axis: time for axis, time in self.since.items() if time > raised.get(axis, 0.0)}

    def note(
        self,
        scored: Mapping[tuple[str, ...], Scores],
        lengths: Sequence[float],
        now: float,
        alarms: Sequence[Alarm],
    ) -> None:
        """Notes the axes about which an alarm can be raised from now on, and how much of their time is not tested.

        Args:
            scored: The scores of a test, by their names.
            lengths: Lengths of the windows that it compares [s].
            now: Its time [s].
            alarms: Those raised so far.
        """
        watched = self.since_alarms(alarms)
        for names, scores in scored.items():
            axes, until = {name.partition(".")[0] for name in names}, float(scores.time[-1])
            untested, rows = scores.untested(until - WINDOWS[-1])
            for axis in axes:
                before = self._seen.get(axis, WatchedAxis())
                new = scores.untested(before.until)
                counts = before.untested + new[0], before.rows + new[1]
                self._seen[axis] = WatchedAxis(until, *counts, untested / rows)
            if not axes <= watched.keys() and untested < HARDLY * rows and compares(scores, lengths):
                self.since = {**self.since, **dict.fromkeys(axes - watched.keys(), now)}
