"""What is known of a growing flight at one moment: its regimes, and an estimate of every group of axes."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from rotorfit.core.frames import AXES
from rotorfit.core.tracked import Alarm
from rotorfit.tracking.groups import Group
from rotorfit.tracking.regimes import Bounds, learnt_from


@dataclass(frozen=True)
class Learnt:
    """Regimes and estimates.

    Attributes:
        since: Axis to the start of its regime [s].
        changed: Axis to the time of its last change [s].
        laws: Axis to the law that it obeyed before its last change.
        known: Axis to the last time at which it was known, in this regime [s].
        bounds: Start of each regime [s] and its alarm.
        groups: Groups of axes.
    """

    since: Mapping[str, float]
    changed: Mapping[str, float]
    laws: Mapping[str, str]
    known: Mapping[str, float]
    bounds: Bounds
    groups: Mapping[tuple[str, ...], Group]

    @property
    def alarms(self) -> list[Alarm]:
        """Those that began the regimes."""
        return [alarm for _, alarm in self.bounds if alarm]

    def since_of(self, axes: Sequence[str]) -> float:
        """Start of the regime of axes that are fitted together [s]."""
        return max(self.since[axis] for axis in axes)

    def group(self, axes: tuple[str, ...]) -> Group:
        """Axes that are fitted together; without an estimate if they are seen for the first time."""
        return self.groups.get(axes, Group(axes, self.since_of(axes)))

    def holding(self, group: Group) -> "Learnt":
        """The same with another estimate of a group."""
        return replace(self, groups={**self.groups, group.axes: group})


NOTHING_LEARNT = Learnt(dict.fromkeys(AXES, 0.0), {}, {}, {}, ((0.0, None),), {})
"""At the start of a flight."""


def after_change(now: Learnt, before: Learnt, alarm: Alarm, when: float) -> Learnt:
    """What is known once an alarm has begun a regime for its axes.

    Args:
        now: What is known now, perhaps by an earlier version of the alarm: an axis that only that one named is as it
            was before.
        before: What was known before the change.
        alarm: The alarm.
        when: Time of the change [s].
    """
    groups, laws = dict(now.groups), dict(now.laws)
    for axes, group in groups.items():
        known = before.groups.get(axes, group)
        if known.fitted:
            held = {axis: known.fitted.fit.model.axes[axis].structure for axis in known.fitted.estimates}
            laws |= {axis: law for axis, law in held.items() if axis in alarm.axes}
        if set(axes) & set(alarm.axes):
            groups[axes] = Group(axes, learnt_from(alarm, axes), answers=group.answers)
        elif group.since != known.since:
            groups[axes] = known
    return Learnt(
        since={**before.since, **{axis: learnt_from(alarm, (axis,)) for axis in alarm.axes}},
        changed={**before.changed, **dict.fromkeys(alarm.axes, when)},
        laws=laws,
        known={axis: time for axis, time in now.known.items() if axis not in alarm.axes},
        bounds=sorted([*before.bounds, (when, alarm)], key=lambda bound: bound[0]),
        groups=groups,
    )
