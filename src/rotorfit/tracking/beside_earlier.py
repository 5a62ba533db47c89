"""What a growing flight has told beside the model of an earlier flight, remembered from one look to the next.

Whether the two differ is decided in `earlier`; here is which axes this flight tells by itself, what it contradicted a
look ago, and when it was last compared.
"""

from collections.abc import Collection, Mapping
from typing import Any

from rotorfit.core.frames import AXES
from rotorfit.core.tracked import Alarm, Tracked, TrackedAxis
from rotorfit.tracking.earlier import SHARE, Earlier, another_vehicle, compared, tells_as_much, told_after


class BesideEarlier:
    """A growing flight beside the model of an earlier one.

    Args:
        earlier: The earlier model.
        false_alarms_per_hour: Promised bound on their expected number, of which comparisons may spend `SHARE` [1/h].
    """

    def __init__(self, earlier: Earlier, false_alarms_per_hour: float) -> None:
        self._earlier, self._false_alarms = earlier, false_alarms_per_hour * SHARE
        self._compared, self._unlike = 0.0, set[str]()
        self._told_itself: set[str] = set()  # axes of which this flight has told as much as the earlier model
        self._contradicts: dict[str, tuple[str, ...]] = {}  # the quantities that it contradicted a look ago

    def told(self, axes: Mapping[str, TrackedAxis], changed: Collection[str]) -> dict[str, TrackedAxis]:
        """The axes after a look, each with the earlier numbers or compared with them.

        Args:
            axes: What this flight tells.
            changed: Axes that changed in this flight: of them the earlier model says nothing any more.
        """
        alone = AXES if self._unlike else (*changed, *self._told_itself)
        self._told_itself |= {axis for axis, one in axes.items() if tells_as_much(one, self._earlier, axis)}
        out = {
            axis: one
            if axis in changed
            else told_after(one, self._earlier, axis, axis in alone, self._contradicts.get(axis, ()))
            for axis, one in axes.items()
        }
        self._contradicts = {axis: one.contradicts for axis, one in out.items() if one.contradicts}
        self._told_itself |= self._contradicts.keys()
        return out

    def another_vehicle(self, state: Tracked, changed: Collection[str]) -> Alarm | None:
        """The alarm that the vehicle is not that of the earlier model, if a refit shows it.

        The promised false alarms accrue with time: a comparison may spend those of the time since the last one.

        Args:
            state: The state after a refit.
            changed: Axes that changed in this flight.
        """
        every = [
            unlike
            for axis, one in state.axes.items()
            if not one.earlier and axis not in changed and axis not in self._unlike
            if tells_as_much(one, self._earlier, axis)
            for unlike in compared(one, self._earlier, axis)
        ]
        if not every:
            return None
        threshold = self._false_alarms * (state.time - self._compared) / 3600.0 / len(every)
        self._compared = state.time
        found = [one for one in every if one.p_value < threshold]
        self._unlike |= {one.name.partition(".")[0] for one in found}
        return another_vehicle(found, self._earlier, state.time) if found else None

    def memory(self) -> dict[str, Any]:
        """What is remembered, as plain types."""
        told = {"compared": self._compared, "unlike": sorted(self._unlike), "told_itself": sorted(self._told_itself)}
        return {**told, "contradicts": dict(self._contradicts)}

    def recall(self, memory: Mapping[str, Any]) -> None:
        """Continues from what `memory` returned; nothing is remembered of a flight without an earlier model."""
        self._compared, self._unlike = memory.get("compared", 0.0), set(memory.get("unlike", ()))
        self._told_itself = set(memory.get("told_itself", ()))
        self._contradicts = dict(memory.get("contradicts", {}))
