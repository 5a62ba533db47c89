"""Looks at a flight that grows: who makes them, and one who makes them at once."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, Protocol

from rotorfit.core.flight_data import Flight
from rotorfit.core.tracked import Regime, Tracked
from rotorfit.tracking.air import Course
from rotorfit.tracking.following import Following
from rotorfit.tracking.growing_flight import GrowingFlight


@dataclass(frozen=True)
class Looked:
    """What came of a look.

    Attributes:
        state: What is known.
        memory: What `Following.recall` goes on from.
        courses: Filters of the motion, to go on with.
        doubt: Axis name to the standard error of the wind that coefficients leave.
    """

    state: Tracked
    memory: Mapping[str, Any]
    courses: tuple[Course, ...] = ()
    doubt: Mapping[str, float] = field(default_factory=dict)


def looked_at(following: Following, flight: Flight, now: float, standing: bool) -> Looked:
    """A look with all that goes on from it; see `Following.look`."""
    state = following.look(flight, now, standing)
    return Looked(state, following.memory(), following.courses, following.doubt)


End = tuple[Tracked, tuple[Regime, ...]]
"""The last state, and the regimes."""


class Looks(Protocol):
    """Makes looks at a flight that grows."""

    def ask(self, growing: GrowingFlight) -> None:
        """Wants a look at the flight as it is now."""

    def answers(self) -> Iterator[Looked]:
        """Looks that have been made since the last call, in order."""

    def finish(self, growing: GrowingFlight) -> End | None:
        """The end; None of a flight that never began. Looks that were asked for come first, by `answers`."""

    def recall(self, memory: Mapping[str, Any]) -> None:
        """Goes on from the memory of a look; before the first."""

    def close(self) -> None:
        """Leaves nothing behind."""


class LooksHere:
    """Looks at once, in the calling thread; see `Looks`.

    Args:
        following: The estimates.
    """

    def __init__(self, following: Following) -> None:
        self._following = following
        self._looked: list[Looked] = []

    def ask(self, growing: GrowingFlight) -> None:
        """See `Looks`."""
        if flight := growing.flight():
            self._looked.append(looked_at(self._following, flight, growing.now, growing.standing))

    def answers(self) -> Iterator[Looked]:
        """See `Looks`."""
        while self._looked:
            yield self._looked.pop(0)

    def finish(self, growing: GrowingFlight) -> End | None:
        """See `Looks`."""
        flight = growing.flight()
        return self._following.finish(flight, growing.now) if flight else None

    def recall(self, memory: Mapping[str, Any]) -> None:
        """See `Looks`."""
        self._following.recall(memory)

    def close(self) -> None:
        """See `Looks`."""
