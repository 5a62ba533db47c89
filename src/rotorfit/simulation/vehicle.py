"""Vehicle: a multirotor with its autopilot, as physical parameters from TOML, and its equivalent linear model."""

import functools
import math
from collections.abc import Mapping
from dataclasses import MISSING, dataclass, fields
from importlib import resources
from importlib.resources.abc import Traversable
from pathlib import Path
from typing import Any, Literal, cast

from rotorfit.core.errors import VehicleError, nearest
from rotorfit.core.limits import GRAVITY
from rotorfit.core.plain import is_file, line_of, plain_toml, shown, text_of

Three = tuple[float, float, float]

Four = tuple[float, float, float, float]  # one value for each of x, y, z, yaw


@dataclass(frozen=True)
class Rotors:
    """Four rotors in an X. A rotor's thrust follows its command with a first-order lag.

    Attributes:
        arm: Distance from the centre to a rotor's axis [m].
        thrust: Least and most thrust of one rotor with a full battery [N].
        time_constant: Time constant of the lag [s].
        torque_ratio: Drag torque over thrust [m].
    """

    arm: float
    thrust: tuple[float, float]
    time_constant: float
    torque_ratio: float


@dataclass(frozen=True)
class Attitude:
    """The tilt loop: second order apart from the rotors' lag.

    Attributes:
        frequency: Natural frequency [rad/s].
        damping: Damping ratio.
        rate_limit: Largest roll and pitch rate demanded by the loop [rad/s].
        tilt_limit: Largest tilt demanded by the velocity loop [rad].
    """

    frequency: float
    damping: float
    rate_limit: float
    tilt_limit: float


@dataclass(frozen=True)
class Loops:
    """Outer loops: acceleration demanded per velocity error.

    Attributes:
        velocity: Forward and left [1/s]; where commands are tilts, only for braking.
        climb: Vertical speed [1/s].
        climb_acceleration: Largest vertical acceleration demanded [m/s^2].
        yaw: Yaw rate [1/s].
        yaw_acceleration: Largest yaw acceleration demanded [rad/s^2].
    """

    velocity: float
    climb: float
    climb_acceleration: float
    yaw: float
    yaw_acceleration: float


@dataclass(frozen=True)
class Command:
    """Meaning of the four commands.

    Attributes:
        horizontal: Meaning of forward and left: `tilt` angles or `velocity`.
        unit: `fraction` of the limits below, or `si`: m/s, rad/s, and rad for tilts. Values beyond the limits are
            clipped.
        vertical_speed: Limit [m/s].
        yaw_rate: Limit [rad/s].
        tilt: Limit [rad]; where commands are tilts.
        speed: Limit [m/s]; where commands are velocities.
    """

    horizontal: Literal["tilt", "velocity"]
    unit: Literal["fraction", "si"]
    vertical_speed: float
    yaw_rate: float
    tilt: float | None = None
    speed: float | None = None


@dataclass(frozen=True)
class Radio:
    """Transmission of commands. They arrive in the order in which they were sent.

    Attributes:
        latency: Least transmission time [s].
        jitter: Mean of an additional, exponentially distributed time [s].
        loss: Share of commands that never arrive, drawn independently. Take-off and landing are never lost.
    """

    latency: float
    jitter: float = 0.0
    loss: float = 0.0


@dataclass(frozen=True)
class Autopilot:
    """Autonomous behaviour of the autopilot.

    Attributes:
        brakes_on_zero: Whether forward and left both exactly zero make it hold zero velocity, where commands are tilts.
        command_timeout: Time after the last command at which it hovers [s].
        land_after: Time after the last command at which it lands [s]; inf for never.
        take_off_height: Hover height after take-off, above the floor [m].
        take_off_speed: Climb rate [m/s].
        landing_speed: Sink rate [m/s].
        learning: Time constant with which it adapts to changes of its thrust, a rotor or its mass [s]; inf for an
            autopilot without integral action. 0.2 s, chosen: with its battery it sinks 1 cm a minute.
    """

    brakes_on_zero: bool
    command_timeout: float
    land_after: float
    take_off_height: float
    take_off_speed: float
    landing_speed: float
    learning: float = 0.2


@dataclass(frozen=True)
class Odometry:
    """Onboard velocity, heading frame.

    rate: Sampling rate [Hz].
    noise: Standard deviation of the white error on x, y, z [m/s].
    bias: Standard deviation, from flight to flight, of the constant error [m/s].
    yaw_noise: Standard deviation of the white error of the yaw rate [rad/s].
    latency: From the measurement to its arrival [s]; the stamp is the instant of measurement.
    """

    rate: float
    noise: float
    bias: float
    yaw_noise: float
    latency: float


@dataclass(frozen=True)
class Battery:
    """The battery.

    Attributes:
        flight_time: Hovering time from full to empty [s].
        sag: Share of the thrust lost from full to empty at the same command.
        land_below: Remaining share at which the vehicle lands by itself.
    """

    flight_time: float
    sag: float
    land_below: float


@dataclass(frozen=True)
class Linear:
    """Linear equivalent of a vehicle for small slow motion: a = input u(t - delay) - damping v on each axis.

    Attributes:
        gamma: Input and damping of x, y, z, yaw in turn, per unit of command, shape (8,). Source: paper, eq. (4).
        delay: Effective delay from sending a command to its effect, x, y, z, yaw [s].
    """

    gamma: tuple[float, ...]
    delay: Four


@dataclass(frozen=True)
class Vehicle:
    """A multirotor with its autopilot.

    Attributes:
        name: For people.
        mass: Mass [kg].
        inertia: About the body's forward, left and up axes [kg m^2].
        drag: Deceleration per airspeed along those axes [1/s].
        rotors, attitude, loops, command, radio, autopilot, odometry, battery: See the classes.
    """

    name: str
    mass: float
    inertia: Three
    drag: Three
    rotors: Rotors
    attitude: Attitude
    loops: Loops
    command: Command
    radio: Radio
    autopilot: Autopilot
    odometry: Odometry
    battery: Battery

    def card(self) -> dict[str, Any]:
        """The card of its flights, as parsed from TOML: meaning and limits of commands, columns as recorded."""
        command, fraction = self.command, self.command.unit == "fraction"
        limit = {"x": self._horizontal_limit, "y": self._horizontal_limit, "z": "vertical_speed", "yaw": "yaw_rate"}
        meaning = {axis: name if name != "speed" else "velocity" for axis, name in limit.items()}
        field = {"x": "linear.x", "y": "linear.y", "z": "linear.z", "yaw": "angular.z"}
        channels = {
            axis: {"from": f"/rotorfit/command:twist.{field[axis]}", "meaning": meaning[axis]}
            | ({"full_scale": limit[axis]} if fraction else {})
            for axis in limit
        }
        pose = {axis: f"/rotorfit/pose:pose.position.{axis}" for axis in "xyz"}
        return {
            "name": f"{self.name}, virtual flight room",
            "frame": "ENU",
            "command": {"frame": "heading", "time": "/rotorfit/command:header.stamp", **channels},
            "pose": {"time": "/rotorfit/pose:header.stamp", **pose, "quaternion": "/rotorfit/pose:pose.orientation"},
            "limits": {name: getattr(command, name) for name in dict.fromkeys(limit.values())},
        }

    def linear(self, radio: Radio | None = None) -> Linear:
        """Coefficients and delays for small slow motion, from the parameters; docs/flight-room.md derives them.

        Args:
            radio: Transmission of commands; None for the vehicle's own.

        Raises:
            VehicleError: A loop overshoots so much that no first-order model matches it.
        """
        way = radio or self.radio
        latency = way.latency + way.jitter
        scale = self.full_scale()
        lag = 2 * self.attitude.damping / self.attitude.frequency
        second = self.attitude.frequency**-2
        rotor, loops = self.rotors.time_constant, self.loops
        if self.command.horizontal == "tilt":
            along = [(GRAVITY, drag, lag) for drag in self.drag[:2]]
        else:
            along = [_servo(loops.velocity, drag, lag, second) for drag in self.drag[:2]]
        axes = [*along, _servo(loops.climb, self.drag[2], rotor, 0.0), _servo(loops.yaw, 0.0, rotor, 0.0)]
        gamma = [part for k, (gain, damping, _) in enumerate(axes) for part in (gain * scale[k], damping)]
        return Linear(tuple(gamma), cast("Four", tuple(latency + delay for _, _, delay in axes)))

    def full_scale(self) -> Four:
        """Setpoint of a command of 1: rad or m/s twice, m/s, rad/s."""
        if self.command.unit == "si":
            return (1.0, 1.0, 1.0, 1.0)
        horizontal = self.limits()[0]
        return (horizontal, horizontal, self.command.vertical_speed, self.command.yaw_rate)

    def limits(self) -> Four:
        """Largest setpoint of a command: rad or m/s twice, m/s, rad/s."""
        horizontal = getattr(self.command, self._horizontal_limit)
        return (horizontal, horizontal, self.command.vertical_speed, self.command.yaw_rate)

    @property
    def _horizontal_limit(self) -> str:
        return "tilt" if self.command.horizontal == "tilt" else "speed"


def _servo(gain: float, drag: float, lag: float, second: float) -> tuple[float, float, float]:
    """Input, damping and delay of the first-order model of a velocity loop around 1 / (1 + lag s + second s^2).

    The loop is K / (1 + a s + b s^2 + ...). A delay and a lag T have the same mean and the same spread of their impulse
    response when T^2 = a^2 - 2 b and delay = a - T.

    Raises:
        VehicleError: The loop overshoots so much that no first-order model matches its spread.
    """
    a, b = (1 + lag * drag) / (gain + drag), (lag + second * drag) / (gain + drag)
    if a * a <= 2 * b:
        raise VehicleError(f"a loop of gain {gain:g}/s around a lag of {lag:g} s overshoots: lower the gain")
    time = math.sqrt(a * a - 2 * b)
    return gain / (gain + drag) / time, 1 / time, a - time


def load_vehicle(name_or_path: str) -> Vehicle:
    """Loads a built-in vehicle by its name, or one from a TOML file.

    Raises:
        VehicleError: Neither a known name nor a file; not TOML; or refused by `vehicle_from_mapping`.
    """
    built_in = _builtin_files()
    if name_or_path in built_in:
        return vehicle_from_mapping(plain_toml(built_in[name_or_path].read_text(encoding="utf-8")), name_or_path)
    path = Path(name_or_path)
    if not is_file(path):
        raise VehicleError(f"no vehicle {name_or_path!r}: neither a file nor one of {', '.join(built_in)}")
    try:
        raw = plain_toml(text_of(path))
    except (OSError, ValueError) as err:
        raise VehicleError(f"vehicle {name_or_path}: not readable as TOML: {line_of(err)}") from err
    return vehicle_from_mapping(raw, name_or_path)


def builtin_vehicles() -> dict[str, Vehicle]:
    """All vehicles that ship with rotorfit, by name, sorted."""
    texts = {name: file.read_text(encoding="utf-8") for name, file in _builtin_files().items()}
    return {name: vehicle_from_mapping(plain_toml(text), name) for name, text in texts.items()}


@functools.cache
def _builtin_files() -> dict[str, Traversable]:
    """Files of the vehicles that ship with rotorfit by name, sorted."""
    folder = resources.files("rotorfit.simulation").joinpath("vehicles")
    files = {entry.name.removesuffix(".toml"): entry for entry in folder.iterdir() if entry.name.endswith(".toml")}
    return dict(sorted(files.items()))


def vehicle_from_mapping(raw: Mapping[str, Any], where: str) -> Vehicle:
    """Checks a vehicle as parsed from TOML.

    Raises:
        VehicleError: A missing or unknown key (the nearest is suggested), a wrong type, or an impossible value.
    """
    vehicle = cast("Vehicle", _read(Vehicle, raw, f"vehicle {where}"))
    _check(vehicle, f"vehicle {where}")
    return vehicle


def _read(noun: type[Any], raw: Mapping[str, Any], place: str) -> Any:
    """Builds a dataclass of numbers, words and further dataclasses from a table with its keys."""
    known = {field.name: field for field in fields(noun)}
    for key in raw:
        if key not in known:
            raise VehicleError(f"{place}: unknown key {shown(key)}{nearest(key, known)}")
    missing = [name for name, field in known.items() if name not in raw and field.default is MISSING]
    if missing:
        raise VehicleError(f"{place}: {missing[0]} is missing")
    return noun(**{key: _value(known[key].type, value, f"{place}, {key}") for key, value in raw.items()})


def _value(kind: Any, value: Any, place: str) -> Any:
    if isinstance(kind, type) and hasattr(kind, "__dataclass_fields__"):
        if not isinstance(value, Mapping):
            raise VehicleError(f"{place}: must be a section, not {shown(value)}")
        return _read(kind, value, place)
    if kind is bool or kind is str:
        if not isinstance(value, kind):
            raise VehicleError(f"{place}: must be {'true or false' if kind is bool else 'a text'}, not {shown(value)}")
        return value
    words = getattr(kind, "__args__", ())
    if getattr(kind, "__origin__", None) is Literal:
        if value not in words:
            raise VehicleError(f"{place}: {shown(value)} is not one of {', '.join(words)}")
        return value
    if getattr(kind, "__origin__", None) is tuple:
        if not isinstance(value, list) or len(value) != len(words):
            raise VehicleError(f"{place}: must be {len(words)} numbers, not {shown(value)}")
        return tuple(_number(part, place) for part in value)
    return _number(value, place)


NEVER = ("land_after", "learning")
"""Times that may be infinite: it never happens."""


def _number(value: Any, place: str) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not value >= 0:
        raise VehicleError(f"{place}: must be a number that is not negative, not {shown(value)}")
    if math.isinf(value) and not place.endswith(NEVER):
        raise VehicleError(f"{place}: must be finite; only {' and '.join(NEVER)} may be inf, for never")
    return float(value)


def _check(vehicle: Vehicle, place: str) -> None:
    """Checks what the types do not guarantee."""
    needed = "tilt" if vehicle.command.horizontal == "tilt" else "speed"
    if getattr(vehicle.command, needed) is None:
        raise VehicleError(f"{place}, command: {needed} is missing where commands are a {vehicle.command.horizontal}")
    rotors, attitude = vehicle.rotors, vehicle.attitude
    positive = (
        vehicle.mass, *vehicle.inertia, rotors.arm, rotors.time_constant, rotors.torque_ratio, attitude.frequency,
        attitude.damping, vehicle.loops.climb, vehicle.loops.yaw, vehicle.odometry.rate, vehicle.battery.flight_time,
        vehicle.autopilot.learning,
    )  # fmt: skip
    if min(positive) <= 0:
        raise VehicleError(f"{place}: masses, inertias, times, rates and gains must be positive")
    if not 4 * rotors.thrust[0] < GRAVITY * vehicle.mass < 4 * rotors.thrust[1]:
        raise VehicleError(
            f"{place}, rotors: thrust must hold the weight of {vehicle.mass:g} kg between least and most"
        )
    if 2 * attitude.damping <= rotors.time_constant * attitude.frequency:
        raise VehicleError(
            f"{place}, attitude: rotors with a lag of {rotors.time_constant:g} s make this loop unstable"
        )
    vehicle.linear()
