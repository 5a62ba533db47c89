"""Looks at a growing flight: the interface of those that make them, and one that makes them at once."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, Protocol

from rotorfit.core.flight_data import Flight
from rotorfit.core.tracked import Alarm, Regime, Tracked
from rotorfit.tracking.air import Course
from rotorfit.tracking.following import Following
from rotorfit.tracking.growing_flight import GrowingFlight
from rotorfit.tracking.wind_error import Doubt


@dataclass(frozen=True)
class Looked:
    """The result of a look.

    Attributes:
        state: What is known.
        memory: What `Following.recall` continues from.
        courses: Motion filters, ready to be continued.
        doubt: Axis name to the errors of its motion due to the coefficients.
    """

    state: Tracked
    memory: Mapping[str, Any]
    courses: tuple[Course, ...] = ()
    doubt: Mapping[str, Doubt] = field(default_factory=dict)


def looked_at(
    following: Following, flight: Flight, now: float, standing: bool, alarms: tuple[Alarm, ...] = ()
) -> Looked | None:
    """A look with everything that continues from it, or a glance, None without an alarm; see `Following.follow`."""
    state = following.follow(flight, now, standing, alarms)
    return Looked(state, following.memory(), following.courses, following.doubt) if state else None


End = tuple[Tracked, tuple[Regime, ...]]
"""The last state, and the regimes."""


class Looks(Protocol):
    """Makes looks at a growing flight."""

    def ask(self, growing: GrowingFlight) -> None:
        """Requests a look, or a glance, at the flight as it is now; it takes the alarms of the pose."""

    def answers(self) -> Iterator[Looked]:
        """The looks that were completed since the last call, in order, and glances that raised or revised an alarm."""

    def finish(self, growing: GrowingFlight) -> End | None:
        """The last state and the regimes; None for a flight that never began. Pending looks then come by `answers`."""

    def recall(self, memory: Mapping[str, Any]) -> None:
        """Continues from the memory of a look; call it before the first look."""

    def close(self) -> None:
        """Frees all resources."""


class LooksHere:
    """Makes each look at once, in the calling thread; see `Looks`.

    Args:
        following: The estimates.
    """

    def __init__(self, following: Following) -> None:
        self._following = following
        self._looked: list[Looked] = []

    def ask(self, growing: GrowingFlight) -> None:
        """See `Looks`."""
        flight = growing.flight()
        if flight and (looked := looked_at(self._following, flight, growing.now, growing.standing, growing.alarms())):
            self._looked.append(looked)

    def answers(self) -> Iterator[Looked]:
        """See `Looks`."""
        while self._looked:
            yield self._looked.pop(0)

    def finish(self, growing: GrowingFlight) -> End | None:
        """See `Looks`."""
        flight = growing.flight()
        return self._following.finish(flight, growing.now, growing.alarms()) if flight else None

    def recall(self, memory: Mapping[str, Any]) -> None:
        """See `Looks`."""
        self._following.recall(memory)

    def close(self) -> None:
        """See `Looks`."""
