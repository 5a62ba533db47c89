"""Link: what carries commands to a vehicle and its pose back: three methods and a clock."""

from collections.abc import Sequence
from typing import Literal, Protocol

from rotorfit.log import Sample

Action = Literal["take_off", "land", "close"]


class Link(Protocol):
    """What carries commands to a vehicle and samples back.

    Attributes:
        now: The link's clock [ns]: the wall clock of a live link, simulated time of a simulated one.
        live: Whether `now` is the wall clock, so that the flight is paced by it and something real may move.
        fail_safe: What the vehicle does by itself when the link is lost, for people, one or two sentences.
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

    def send(self, command: Sequence[float]) -> None:
        """Sends forward, left, up, counter-clockwise, in the unit of the card's commands. All zero means hover.

        Raises:
            LinkError: The link is gone.
        """

    def receive(self, until: int) -> list[Sample]:
        """Waits until the clock shows `until` [ns] and returns what has come since the last call, in order.

        Raises:
            LinkError: The link is gone.
        """

    def act(self, action: Action) -> None:
        """Asks the vehicle to take off or land, or closes the link; returns at once.

        Raises:
            LinkError: The link is gone, or cannot do that.
        """
