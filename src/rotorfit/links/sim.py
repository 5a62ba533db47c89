"""The virtual flight room as a link, in simulated time: `receive` lets it pass.

sim                        a Bebop 2 in still air
sim,wind=2                 the same in wind
sim:VEHICLE                a built-in vehicle, or a file of one
sim:VEHICLE,wind=2,gusts=0.3   mean wind along the world's x, and standard deviation of gusts [m/s]
"""

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

from rotorfit.card import Card
from rotorfit.card_file import card_from_mapping
from rotorfit.errors import LinkError
from rotorfit.links.link import Action
from rotorfit.log import Sample
from rotorfit.plan import Four
from rotorfit.settings import disagreement

if TYPE_CHECKING:  # the room brings numba
    from rotorfit.air import Wind
    from rotorfit.simulator import FlightRoom

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
    from rotorfit.simulator import Conditions, FlightRoom
    from rotorfit.vehicle import load_vehicle

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


def wind_of(options: Sequence[str], address: str) -> "Wind":
    """The wind of an address, from what follows its vehicle; errors as `open_link`."""
    from rotorfit.air import Gusts, Wind

    known, given = {"wind": 0.0, "gusts": 0.0}, f"--link sim{'' if address.startswith(',') else ':'}{address}"
    for option in options:
        key, equal, text = option.partition("=")
        try:
            if key not in known or not equal:
                raise ValueError
            known[key] = float(text)
        except ValueError:
            wanted = ", ".join(f"{name}=NUMBER" for name in known)
            raise LinkError(f"{given}: {option!r} is not one of {wanted}, in m/s") from None
    sigma = known["gusts"]
    if not (math.isfinite(known["wind"]) and 0 <= sigma < math.inf):
        raise LinkError(f"{given}: wind and gusts are finite, gusts not negative")
    return Wind((known["wind"], 0.0, 0.0), Gusts((sigma, sigma, sigma / 2)) if sigma else None)
