"""The virtual flight room as a link, in simulated time, which `receive` advances.

sim                        a Bebop 2 in still air
sim,wind=2                 the same in wind
sim:VEHICLE                a built-in vehicle, or a file of one
sim:VEHICLE,wind=2,gusts=0.3   mean wind along the world's x, and standard deviation of gusts [m/s]
sim,mass=1.3@40            heavier by 0.3 from second 40 on: WHAT=VALUE@SECOND, names of `simulation.change.Change`
sim,start=0/0/1.5/0,seed=3,flying=no   start x/y/z/yaw [m, rad]; seed of wind, noise and radio; on the floor
"""

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

from rotorfit.core.card import Card
from rotorfit.core.errors import LinkError, nearest
from rotorfit.core.flight_plan import Four
from rotorfit.core.limits import disagreement
from rotorfit.core.log import Sample
from rotorfit.files.cards import card_from_mapping
from rotorfit.flying.links.link import Action, Silence
from rotorfit.flying.links.opening import split
from rotorfit.simulation.air import wind_of
from rotorfit.simulation.change import GIVEN, changes_of

if TYPE_CHECKING:
    from rotorfit.simulation.flight_room import FlightRoom

VEHICLE = "bebop2"

EPOCH = 1_577_836_800 * 10**9
"""2020-01-01 [ns], where simulated time begins, so that a log of it looks like a real one."""


DEFAULTS = {"start": "0/0/1.5/0", "seed": "0", "flying": "yes"}
"""Start of the vehicle, seed of its wind, noise and radio, and whether it is already in the air."""


OPTIONS = ("wind", "gusts", *GIVEN, *DEFAULTS)
"""All that may follow the vehicle."""


def open_link(address: str, card: Card) -> "SimLink":
    """Opens the virtual flight room.

    Args:
        address: `VEHICLE,wind=MEAN,gusts=SIGMA,WHAT=VALUE@SECOND,start=X/Y/Z/YAW,seed=N,flying=no`; each may be left
            out, and the first of two counts; changes all count.
        card: The plan's card; its commands must have the meaning that the vehicle gives them.

    Raises:
        LinkError: An option is unknown, or the card's commands have another meaning than the vehicle's.
        VehicleError: There is no such vehicle.
    """
    return room_of(address, card, "the plan's card", "plan with --card sim:{}")


def room_of(address: str, card: Card, whose: str, remedy: str) -> "SimLink":
    """Opens the virtual flight room.

    Args:
        address: As for `open_link`.
        card: Its commands must have the meaning that the vehicle gives them.
        whose: What to call the card in the error message.
        remedy: What to try, with `{}` for the vehicle, in the error message.

    Raises:
        LinkError, VehicleError: As for `open_link`.
    """
    from rotorfit.simulation.flight_room import Conditions, FlightRoom
    from rotorfit.simulation.vehicle import load_vehicle

    name, *given = address.split(",")
    for key in (option.partition("=")[0] for option in given):
        if key not in OPTIONS:
            raise LinkError(f"--link sim: no option {key!r}{nearest(key, OPTIONS)}; options are {', '.join(OPTIONS)}")
    options = [option for option in given if option.partition("=")[0] not in DEFAULTS]
    start, seed, flying = _scene([option for option in given if option not in options])
    changes = [option for option in options if option.partition("=")[0] in GIVEN]
    address = ",".join([name, *options])
    shown = f"--link sim{':' if name else ''}{address}"
    wind = wind_of([option for option in options if option not in changes], shown)
    conditions = Conditions(wind, changes=changes_of(changes, address))
    vehicle = load_vehicle(name or VEHICLE)
    if trouble := disagreement(card, card_from_mapping(vehicle.card(), vehicle.name), (whose, "the vehicle's")):
        raise LinkError(f"sim: {whose} is not one of {vehicle.name}: {trouble}; {remedy.format(name or VEHICLE)}")
    if start[2] < conditions.floor:
        raise LinkError(
            f"sim: the start is at {start[2]:g} m, below the floor of the flight room at {conditions.floor:g} m: "
            "begin or plan above it"
        )
    return SimLink(FlightRoom(vehicle, conditions, seed, start, flying))


def changes_missed(link: str, now: int) -> str:
    """The changes of a simulated vehicle that were still to come at the end of the flight, one line; empty without any.

    Args:
        link: A link as given, and valid; others than `sim` have no changes.
        now: The link's clock at the end of the flight [ns].
    """
    name, address = split(link)
    end, options = (now - EPOCH) / 1e9, address.split(",")[1:] if name == "sim" else []
    missed = [option for option in options if "@" in option and float(option.partition("@")[2]) > end]
    return f"ended at {end:.0f} s, before the change {', '.join(missed)}: the flight is without it" if missed else ""


def _scene(options: Sequence[str]) -> tuple[Four, int, bool]:
    """Start, seed, and whether the vehicle is flying, from their options."""
    scene = DEFAULTS | {key: text for key, _, text in (option.partition("=") for option in reversed(options))}
    try:
        x, y, z, yaw = (float(part) for part in scene["start"].split("/"))
        seed, flying = int(scene["seed"]), {"yes": True, "no": False}[scene["flying"]]
        if not all(map(math.isfinite, (x, y, z, yaw))) or seed < 0:
            raise ValueError
    except (ValueError, KeyError):
        raise LinkError(
            f"--link sim: {', '.join(options)!r} is not start=X/Y/Z/YAW [m, rad], seed=NUMBER, flying=yes or no"
        ) from None
    return (x, y, z, yaw), seed, flying


class SimLink:
    """A vehicle in the virtual flight room; implements `links.Link`."""

    live, undone = False, ""

    def __init__(self, room: "FlightRoom") -> None:
        self._room = room
        pilot = room.vehicle.autopilot
        lands = f", and lands after {pilot.land_after:g} s" if math.isfinite(pilot.land_after) else ""
        self.silence = Silence(pilot.command_timeout)
        self.fail_safe = (
            f"Simulated: the vehicle follows the last command for {pilot.command_timeout:g} s, then hovers{lands}."
        )

    @property
    def now(self) -> int:
        """Simulated time [ns]."""
        return EPOCH + self._room.now

    def send(self, command: Sequence[float]) -> Sequence[float]:
        """Sends a command; see `links.Link`."""
        self._room.send(command)
        return command

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
