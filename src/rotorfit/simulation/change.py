"""Change: a sudden change of a vehicle in flight.

A payload, a weak propeller, a failing battery, other limits, a slower radio. Changes of the pose alone belong to the
mocap (`sensors.Mocap`), rising wind to the air (`air.Wind`).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from rotorfit.core.errors import LinkError, nearest
from rotorfit.simulation.vehicle import Four, Radio, Vehicle


@dataclass(frozen=True)
class Given:
    """What an address can give of a change.

    Attributes:
        text: What the numbers are, with their unit.
        low: Least number that a flying vehicle can have.
        high: Largest number likewise.
        example: How it is written.
        count: How many numbers.
    """

    text: str
    low: float
    high: float
    example: str
    count: int = 1


LATEST = 1e7
"""Latest instant of a change [s]."""

GIVEN: Mapping[str, Given] = {
    "mass": Given("a factor", 0.1, 10, "mass=1.3@40"),
    "rotors": Given("four factors", 0.01, 2, "rotors=0.9/1/1/1@40", 4),
    "latency": Given("a time in s", 0, 5, "latency=0.1@40"),
    "tilt": Given("a limit in rad", 0.01, 1.5, "tilt=0.2@40"),
    "speed": Given("a limit in m/s", 0.1, 50, "speed=3@40"),
    "vertical_speed": Given("a limit in m/s", 0.1, 50, "vertical_speed=0.5@40"),
    "yaw_rate": Given("a limit in rad/s", 0.01, 20, "yaw_rate=1@40"),
}
"""What an address can change, by the names of `Change`."""


@dataclass(frozen=True)
class Change:
    """A permanent change at one instant; several may follow one another.

    Attributes:
        time: Since the start of the flight [s].
        mass: Factor on the mass: a payload at the centre, which changes neither inertia nor drag force.
        rotors: Factors on the thrust of each rotor: front left, front right, rear right, rear left.
        fade: Share of the full thrust of all rotors that the battery loses over `fade_time`.
        fade_time: Duration of that loss [s].
        latency: Added to the transmission time of commands sent from then on [s].
        tilt: New tilt of a full command [rad]; None for the old one. This and the following are settings, which apply
            to commands that arrive from then on.
        speed: New horizontal speed of a full command [m/s]; None likewise.
        vertical_speed: New vertical speed of a full command [m/s]; None likewise.
        yaw_rate: New yaw rate of a full command [rad/s]; None likewise.

    Raises:
        ValueError: A time before the start, a factor or limit that is not positive, or all thrust lost.
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
        """The changed limits, by their names in `vehicle.Command`."""
        limits = {name: getattr(self, name) for name in ("tilt", "speed", "vertical_speed", "yaw_rate")}
        return {name: value for name, value in limits.items() if value is not None}


def changed(vehicle: Vehicle, changes: Sequence[Change]) -> Vehicle:
    """The vehicle after all of these changes, once its autopilot has adapted; `linear` then gives its coefficients.

    Drag is a deceleration per airspeed, so it falls as the mass grows. A weak rotor or battery has no effect here: the
    autopilot compensates for it as long as there is thrust to spare.
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
    """The changes of a link address, from options such as `mass=1.3@40` or `rotors=0.9/1/1/1@40`: at second 40.

    Raises:
        LinkError: An option is not a valid change.
    """
    found = []
    for option in options:
        key, _, rest = option.partition("=")
        text, _, when = rest.partition("@")
        given = f"--link sim{'' if address.startswith(',') else ':'}{address}: {option!r}"
        if key not in GIVEN:
            raise LinkError(f"{given}: nothing called {key!r} can change{nearest(key, GIVEN)}; {', '.join(GIVEN)} can")
        known = GIVEN[key]
        try:
            numbers, time = [float(part) for part in text.split("/")], float(when)
            sound = all(known.low <= number <= known.high for number in numbers) and 0 <= time <= LATEST
            if not sound or len(numbers) != known.count:
                raise ValueError
        except ValueError:
            raise LinkError(
                f"{given} is no change: {key} is {known.text} from {known.low:g} to {known.high:g}, "
                f"then @ and the second, as in {known.example}"
            ) from None
        value: Any = tuple(numbers) if key == "rotors" else numbers[0]
        found.append(Change(time, **{key: value}))
    return tuple(found)
