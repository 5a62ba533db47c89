"""Change: what becomes of a vehicle in flight at a stated second.

A payload, a weak propeller, a battery that gives way, other limits, a slower radio. What happens to the pose alone is
with the mocap (`sensors.Mocap`), and the wind that rises with the air (`air.Wind`).
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

from rotorfit.core.errors import LinkError
from rotorfit.simulation.vehicle import Four, Radio, Vehicle

GIVEN = {"mass": 1, "rotors": 4, "latency": 1, "tilt": 1, "speed": 1, "vertical_speed": 1, "yaw_rate": 1}
"""What an address can change, and how many numbers it takes; names of `Change`."""


@dataclass(frozen=True)
class Change:
    """What changes at one instant, for good; several may follow one another.

    Attributes:
        time: Since the start of the flight [s].
        mass: Factor on the mass: a payload at the centre, which neither turns with more effort nor adds drag.
        rotors: Factors on the thrust of each rotor: front left, front right, rear right, rear left.
        fade: Share of the full thrust of all rotors that the battery loses over `fade_time`.
        fade_time: [s].
        latency: Added to the time that commands sent from then on are on the way [s].
        tilt: New tilt of a full command [rad]; None for the old one. This and the following are settings: a command
            that arrives from then on obeys them.
        speed: New horizontal speed of a full command [m/s]; None likewise.
        vertical_speed: [m/s].
        yaw_rate: [rad/s].

    Raises:
        ValueError: A time before the start, a factor or limit that is not positive, all thrust lost.
    """

    time: float
    mass: float = 1.0
    rotors: Four = (1.0, 1.0, 1.0, 1.0)
    fade: float = 0.0
    fade_time: float = 1.0
    latency: float = 0.0
    tilt: float | None = None
    speed: float | None = None
    vertical_speed: float | None = None
    yaw_rate: float | None = None

    def __post_init__(self) -> None:
        if self.time < 0 or min(self.mass, *self.rotors, self.fade_time) <= 0 or not 0 <= self.fade < 1:
            raise ValueError("change: time must not be negative, factors and times positive, the share lost below 1")
        if min(self.limits().values(), default=1.0) <= 0:
            raise ValueError("change: limits must be positive")

    def limits(self) -> dict[str, Any]:
        """The limits that change, by their names in `vehicle.Command`."""
        limits = {name: getattr(self, name) for name in ("tilt", "speed", "vertical_speed", "yaw_rate")}
        return {name: value for name, value in limits.items() if value is not None}


def changed(vehicle: Vehicle, changes: Sequence[Change]) -> Vehicle:
    """The vehicle after all of these changes, its autopilot having learnt of them: `linear` says what it is then.

    Drag is a deceleration, so that it falls as the mass grows. A weak rotor or battery leaves no trace here: what has
    been learnt is made up for, as long as there is thrust to spare.
    """
    for one in changes:
        vehicle = replace(
            vehicle,
            mass=vehicle.mass * one.mass,
            drag=(vehicle.drag[0] / one.mass, vehicle.drag[1] / one.mass, vehicle.drag[2] / one.mass),
            command=replace(vehicle.command, **one.limits()),
            radio=later(vehicle.radio, one),
        )
    return vehicle


def later(radio: Radio, change: Change) -> Radio:
    """The radio after a change."""
    return replace(radio, latency=radio.latency + change.latency)


def changes_of(options: Sequence[str], address: str) -> tuple[Change, ...]:
    """The changes of an address, from options such as `mass=1.3@40` or `rotors=0.9/1/1/1@40`: at second 40.

    Raises:
        LinkError: One that is none.
    """
    found = []
    for option in options:
        key, _, rest = option.partition("=")
        text, _, when = rest.partition("@")
        try:
            numbers, time = [float(part) for part in text.split("/")], float(when)
            if len(numbers) != GIVEN.get(key) or not all(map(math.isfinite, (*numbers, time))):
                raise ValueError
            value: Any = tuple(numbers) if key == "rotors" else numbers[0]
            found.append(Change(time, **{key: value}))
        except ValueError:
            wanted = "WHAT=VALUE@SECOND" if "@" in option else f"{option}@SECOND"
            raise LinkError(
                f"--link sim{'' if address.startswith(',') else ':'}{address}: {option!r} is not {wanted}; "
                f"what can change: {', '.join(GIVEN)}, factors and limits above 0"
            ) from None
    return tuple(found)
