"""Card: the meaning of each command channel, the vehicle's limits, and the column of each quantity."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal, TypeVar

from rotorfit.core.display import html_table
from rotorfit.core.frames import UNIT_SCALE, Array

Numbers = TypeVar("Numbers", float, Array)


@dataclass(frozen=True)
class Channel:
    """Source of one quantity: raw * scale + offset, then converted from `unit` to SI.

    Attributes:
        source: `TABLE:COLUMN`, `COLUMN`, `COLUMN[i]`, or a constant number.
        scale: Factor on the raw value.
        offset: Added after scaling.
        unit: One of the names in `frames.UNIT_SCALE`, or None where the value is SI or a fraction.
        meaning: For commands: `tilt`, `velocity`, `vertical_speed` or `yaw_rate`; None where the card does not say.
        full_scale: For commands: the limit (a key of `Card.limits`) that the value is a fraction of.
        error: For the time of commands or poses: half the 95 % interval of an offset that all stamps share [s].
        others: Alternatives in other versions of the same format, in order of preference; the first channel that the
            log holds is read, see `columns.card_for`.
    """

    source: str | float
    scale: float = 1.0
    offset: float = 0.0
    unit: str | None = None
    meaning: str | None = None
    full_scale: str | None = None
    error: float = 0.0
    others: tuple["Channel", ...] = ()

    @property
    def factor(self) -> float:
        """Factor to SI from its unit."""
        return 1.0 if self.unit is None else UNIT_SCALE[self.unit]

    def in_si(self, raw: Numbers) -> Numbers:
        """The quantity of raw values, in SI or as the fraction that the card defines."""
        return (raw * self.scale + self.offset) * self.factor

    def raw(self, value: float) -> float:
        """The raw value of a quantity: the inverse of `in_si`."""
        return (value / self.factor - self.offset) / self.scale


@dataclass(frozen=True)
class Condition:
    """One condition under which commands count.

    Attributes:
        channel: The column that is tested.
        equals: The condition holds while the column is one of these; with all else empty, while it is not 0.
        above: The condition holds while the column exceeds this; None if unused.
        opens: For event columns: the condition holds from an event with one of these numbers on,
        closes: until an event with one of these.
        optional: Whether a log without the column is accepted, without the condition.
    """

    channel: Channel
    equals: tuple[float, ...] = ()
    above: float | None = None
    opens: tuple[float, ...] = ()
    closes: tuple[float, ...] = ()
    optional: bool = False


@dataclass(frozen=True)
class Prior:
    """Prior of a coefficient: mean and standard deviation, in the coefficient's SI unit for a command of 1."""

    mean: float
    sd: float


@dataclass(frozen=True)
class Card:
    """A vehicle and its set-up.

    Attributes:
        name: Name of the vehicle, for people.
        frame: World frame of the pose: `ENU` (z up) or `NED`.
        command_frame: `heading` or `world`.
        hold: Longest time that a command acts without a successor [s]; None where `flights.command_hold` estimates it.
        command_time: Stamp of the commands.
        command: Axis name to channel, for the commanded axes only.
        pose_time: Stamp of the poses.
        pose: `x`, `y`, `z`, and `yaw` or the four of `qw`, `qx`, `qy`, `qz`. x and y together, or z, are absent where
            only their velocity is measured.
        velocity: Optional onboard velocity, `x`, `y`, `z`, `yaw` to channel.
        velocity_frame: Frame of its x and y, `heading` or `world`.
        velocity_time: Stamp of the velocity; None for that of its table.
        velocity_independent: Whether the velocity is an independent measurement: neither velocity nor pose was derived
            from the other.
        attitude: Optional onboard heading: `yaw`, or the four of `qw`, `qx`, `qy`, `qz`.
        attitude_time: Stamp of the heading; None for that of its table.
        clock: For a flight in several files: `own` if each file has its own clock, `one` if all share one.
        reference: Optional setpoint of a position controller, axis name to channel.
        window: Optional conditions (armed, in the air, under velocity control): commands count while all hold.
        resets: Optional counters that change when an onboard estimator resets its pose: the flight is split there.
        limits: `tilt` [rad], `vertical_speed` [m/s], `yaw_rate` [rad/s], `speed` [m/s], as far as known.
        prior: Axis to coefficient (`input`, `damping`, `delay`) to its prior; used only on request.
        raw: The whole card as parsed from TOML, as the model file stores it.
        fail_safe: What the vehicle does when commands stop, for people; empty where the card does not say.
        over: Built-in cards that are not proposed where this one also reads a flight from the log.
        heading_offset: Added to the heading of the pose's quaternion, in `frame` [rad].
    """

    name: str
    frame: Literal["ENU", "NED"]
    command_frame: Literal["heading", "world"]
    hold: float | None
    command_time: Channel
    command: Mapping[str, Channel]
    pose_time: Channel
    pose: Mapping[str, Channel]
    velocity: Mapping[str, Channel] = field(default_factory=dict)
    velocity_frame: Literal["heading", "world"] = "world"
    velocity_independent: bool = False
    reference: Mapping[str, Channel] = field(default_factory=dict)
    window: tuple[Condition, ...] = ()
    resets: tuple[Channel, ...] = ()
    limits: Mapping[str, float] = field(default_factory=dict)
    prior: Mapping[str, Mapping[str, Prior]] = field(default_factory=dict)
    raw: Mapping[str, Any] = field(default_factory=dict)
    velocity_time: Channel | None = None
    attitude: Mapping[str, Channel] = field(default_factory=dict)
    attitude_time: Channel | None = None
    clock: Literal["own", "one"] = "own"
    fail_safe: str = ""
    over: tuple[str, ...] = ()
    heading_offset: float = 0.0

    def __repr__(self) -> str:
        return f"Card({self.name!r}, commands {' '.join(self.command)}, pose {' '.join(self.pose)} in {self.frame})"

    def _repr_html_(self) -> str:
        rows = [
            (f"{what} {axis}", str(one.source), f"{one.scale:g}", one.unit or "", one.meaning or "")
            for what, channels in (("command", self.command), ("pose", self.pose), ("velocity", self.velocity))
            for axis, one in channels.items()
        ]
        return html_table(repr(self), ("what", "from", "scale", "unit", "meaning"), rows)

    @property
    def velocity_only(self) -> tuple[str, ...]:
        """Axes with a velocity but no pose, in the order of `AXES`."""
        return tuple(axis for axis in ("x", "y", "z") if axis not in self.pose)


LENGTH_UNITS, SPEED_UNITS, ANGLE_UNITS, RATE_UNITS, STAMP_UNITS = (
    ("m", "cm", "mm"),
    ("m/s", "cm/s"),
    ("rad", "deg"),
    ("rad/s", "deg/s"),
    ("s", "ms", "us", "ns"),
)

KINDS = (LENGTH_UNITS, SPEED_UNITS, ANGLE_UNITS, RATE_UNITS)
"""Groups of units of values that convert into each other."""

UNITS_OF_POSE = {"x": LENGTH_UNITS, "y": LENGTH_UNITS, "z": LENGTH_UNITS, "yaw": ANGLE_UNITS}
"""Quantity of a pose to the units in which it may be given, SI first."""

UNITS_OF_VELOCITY = {"x": SPEED_UNITS, "y": SPEED_UNITS, "z": SPEED_UNITS, "yaw": RATE_UNITS}
"""The same for a velocity."""

LIMIT_UNITS = {"tilt": ANGLE_UNITS, "vertical_speed": SPEED_UNITS, "yaw_rate": RATE_UNITS, "speed": SPEED_UNITS}
"""Limit to the units in which it may be given, SI first."""
