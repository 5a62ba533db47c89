"""Link: carries commands to a vehicle and its pose back; three methods and a clock.

The clock of live links is the time of day at the start of the process, and runs evenly since.
"""

import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, Protocol

from rotorfit.core.log import Sample

Action = Literal["take_off", "land", "close"]


@dataclass(frozen=True)
class Silence:
    """What happens when commands stop coming.

    Attributes:
        goes_on: How long the vehicle may keep executing the last command [s]; None if unknown.
        parameter: The vehicle's parameter that sets this time; empty if there is none.
    """

    goes_on: float | None = None
    parameter: str = ""


class Link(Protocol):
    """Carries commands to a vehicle and samples back.

    Attributes:
        now: The link's clock [ns]: the wall clock of a live link, simulated time of a simulated one.
        live: Whether `now` is the wall clock, so that the flight is paced by it and something real may move.
        fail_safe: What the vehicle does by itself when the link is lost, for the user, one or two sentences.
        silence: How long it keeps executing the last command before that.
        undone: What the vehicle was asked to do and does not, or not yet: to obey commands, to land; a sentence for the
            user. Empty where it does, or the link cannot know.
    """

    @property
    def now(self) -> int:
        """The link's clock [ns]."""
        ...

    @property
    def live(self) -> bool:
        """Whether `now` is the wall clock."""
        ...

    @property
    def fail_safe(self) -> str:
        """What the vehicle does when the link is lost."""
        ...

    @property
    def silence(self) -> Silence:
        """How long it keeps executing the last command before that."""
        ...

    @property
    def undone(self) -> str:
        """What the vehicle was asked to do and does not."""
        ...

    def send(self, command: Sequence[float]) -> Sequence[float]:
        """Sends forward, left, up, counter-clockwise, in the unit of the card's commands. All zero means hover.

        Hover is sent as long as there is a way to send it, even where nothing is heard any more.

        Returns:
            The command as the vehicle gets it: rounded where the protocol rounds.

        Raises:
            LinkError: The link is gone.
        """
        ...

    def receive(self, until: int) -> list[Sample]:
        """Waits until the clock shows `until` [ns] and returns what has arrived since the last call, in order.

        Raises:
            LinkError: The link is gone.
        """

    def act(self, action: Action) -> None:
        """Asks the vehicle to take off or land, or closes the link; returns at once.

        Raises:
            LinkError: The link is gone, or does not support the action.
        """


_START = time.time_ns() - time.monotonic_ns()


def wall_clock() -> int:
    """Time since 1970 [ns] that never jumps: corrections of the computer's clock after the start do not affect it."""
    return _START + time.monotonic_ns()


def seconds_until(instant: int) -> float:
    """Time until the wall clock shows `instant` [ns], in seconds; 0 if it has passed."""
    return max(0.0, (instant - wall_clock()) / 1e9)
