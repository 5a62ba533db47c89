"""Links: what carries commands to a vehicle and its pose back. `open_link(name, ...) -> Link`.

A link is three methods and a clock. `fly` knows nothing else of a vehicle, so a simulated flight, a replayed log and a
real drone go through the same code.
"""

from collections.abc import Sequence
from typing import Literal, Protocol

from rotorfit.log import Sample

Action = Literal["take_off", "land", "close"]


class Link(Protocol):
    """What carries commands to a vehicle and samples back.

    Attributes:
        now: The link's clock [ns]: the wall clock of a live link, simulated time of a simulated one.
        fail_safe: What the vehicle does by itself when the link is lost, for people, one or two sentences.
    """

    now: int
    fail_safe: str

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
