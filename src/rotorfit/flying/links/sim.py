"""The virtual flight room as a link, in simulated time: `receive` lets it pass.

sim                        a Bebop 2 in still air
sim,wind=2                 the same in wind
sim:VEHICLE                a built-in vehicle, or a file of one
sim:VEHICLE,wind=2,gusts=0.3   mean wind along the world's x, and standard deviation of gusts [m/s]
"""

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

from rotorfit.core.card import Card
from rotorfit.core.errors import LinkError
from rotorfit.core.flight_plan import Four
from rotorfit.core.limits import disagreement
from rotorfit.core.log import Sample
from rotorfit.files.cards import card_from_mapping
from rotorfit.flying.links.link import Action
from rotorfit.simulation.air import wind_of

if TYPE_CHECKING:
    from rotorfit.simulation.flight_room import FlightRoom

VEHICLE = "bebop2"

EPOCH = 1_577_836_800 * 10**9
"""2020-01-01 [ns], where simulated time begins, so that a log of it looks like a real one."""


def open_link(address: str, card: Card, start: Four, seed: int, flying: bool) -> "SimLink":
    """Opens the virtual flight room.

    Args:
        address: `VEHICLE,wind=MEAN,gusts=SIGMA`; each may be left out.
        card: Of the plan; its commands must mean what the vehicle takes them for.
        start: x, y, z [m] and yaw [rad].
        seed: Of wind, noise and radio.
        flying: Whether the vehicle is in the air already.

    Raises:
        LinkError: An option that nobody knows, or a card whose commands mean something else to this vehicle.
        VehicleError: No such vehicle.
    """
    from rotorfit.simulation.flight_room import Conditions, FlightRoom
    from rotorfit.simulation.vehicle import load_vehicle

    name, *options = address.split(",")
    vehicle = load_vehicle(name or VEHICLE)
    if trouble := disagreement(card, card_from_mapping(vehicle.card(), vehicle.name)):
        raise LinkError(
            f"sim: the plan's card is not one of {vehicle.name}: {trouble}; plan with --card sim:{name or VEHICLE}"
        )
    return SimLink(FlightRoom(vehicle, Conditions(wind_of(options, address)), seed, start, flying))


class SimLink:
    """A vehicle in the virtual flight room; implements `links.Link`."""

    live = False

    def __init__(self, room: "FlightRoom") -> None:
        self._room = room
        pilot = room.vehicle.autopilot
        lands = f", and lands after {pilot.land_after:g} s" if math.isfinite(pilot.land_after) else ""
        self.fail_safe = (
            f"Simulated: the vehicle goes on as last told for {pilot.command_timeout:g} s, then hovers{lands}."
        )

    @property
    def now(self) -> int:
        """Simulated time [ns]."""
        return EPOCH + self._room.now

    def send(self, command: Sequence[float]) -> None:
        """Sends a command; see `links.Link`."""
        self._room.send(command)

    def receive(self, until: int) -> list[Sample]:
        """Lets simulated time pass; see `links.Link`."""
        if until <= self.now:
            return []
        return [
            Sample(one.stream, EPOCH + one.stamp, EPOCH + one.received, one.values)
            for one in self._room.advance(until - EPOCH)
        ]

    def act(self, action: Action) -> None:
        """Takes off or lands; see `links.Link`."""
        if action == "take_off":
            self._room.take_off()
        elif action == "land":
            self._room.land()
