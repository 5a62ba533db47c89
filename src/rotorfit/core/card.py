"""Card: what each command channel means, its limits, and which column is what."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

from rotorfit.core.display import html_table


@dataclass(frozen=True)
class Channel:
    """Where one quantity comes from: (raw * scale + offset), then the unit.

    Attributes:
        source: `TABLE:COLUMN`, `COLUMN`, `COLUMN[i]`, or a constant number.
        scale: Factor on the raw value.
        offset: Added after the factor.
        unit: One of the names in `frames.UNIT_SCALE`, or None where the value is SI or a fraction.
        meaning: For commands: `tilt`, `velocity`, `vertical_speed` or `yaw_rate`; None where the card does not say.
        full_scale: For commands: the limit (a key of `Card.limits`) that the value is a fraction of.
        others: What stands in its place in other versions of the same format, in the order of asking; the first of
            all of them that a log holds is read: `card_columns.card_for`.
    """

    source: str | float
    scale: float = 1.0
    offset: float = 0.0
    unit: str | None = None
    meaning: str | None = None
    full_scale: str | None = None
    others: tuple["Channel", ...] = ()


@dataclass(frozen=True)
class Condition:
    """One thing that must hold while commands count.

    Attributes:
        channel: The column that tells.
        equals: It holds while the column is one of these; empty with all else empty: while it is not 0.
        above: It holds while the column is more than this; None where that is not asked.
        opens: For events: it holds from an event of one of these numbers,
        closes: until one of these.
        optional: Whether logs without the column are taken without the condition.
    """

    channel: Channel
    equals: tuple[float, ...] = ()
    above: float | None = None
    opens: tuple[float, ...] = ()
    closes: tuple[float, ...] = ()
    optional: bool = False


@dataclass(frozen=True)
class Prior:
    """What is believed of a coefficient before a flight: its mean and standard deviation, SI per command of 1."""

    mean: float
    sd: float


@dataclass(frozen=True)
class Card:
    """A vehicle and its set-up.

    Attributes:
        name: For people.
        frame: Of the pose: `ENU` (z up) or `NED`.
        command_frame: `heading` or `world`.
        hold: Longest time that a command acts without a successor [s]; None for what `hold` judges.
        command_time: Stamp of the commands.
        command: Axis name to channel, for the commanded axes only.
        pose_time: Stamp of the poses.
        pose: `x`, `y`, `z`, and `yaw` or the four of `qw`, `qx`, `qy`, `qz`. x and y together, or z, are left out where
            there is only their velocity.
        velocity: Optional onboard velocity, `x`, `y`, `z`, `yaw` to channel; with `velocity_frame`.
        velocity_time: Its stamp; None for that of the table it stands in.
        velocity_independent: Whether the velocity is a measurement of its own, beside the pose: neither came from the
            other.
        attitude: Optional onboard heading: `yaw`, or the four of `qw`, `qx`, `qy`, `qz`.
        attitude_time: Its stamp; None likewise.
        clock: Of a flight in several files: `own`, each file has its own, or `one`, all have the same.
        reference: Optional: what a position controller was told.
        window: Optional conditions (armed, in the air, under velocity control): commands count while all hold.
        resets: Optional counters that move where an estimator steps its own pose: the flight is split there.
        limits: `tilt` [rad], `vertical_speed` [m/s], `yaw_rate` [rad/s], `speed` [m/s], as far as known.
        prior: Axis to coefficient (`input`, `damping`, `delay`) to what is believed of it; used only where asked for.
        raw: The whole card as parsed from TOML: what the model file stores.
        fail_safe: What the vehicle does by itself when commands stop, for people; empty where the card does not say.
        over: Built-in cards that are not proposed where this one makes a flight of the log, too.
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
        """The axes of which there is a velocity and no pose, in the order of `AXES`."""
        return tuple(axis for axis in ("x", "y", "z") if axis not in self.pose)


LENGTH_UNITS, SPEED_UNITS, ANGLE_UNITS, RATE_UNITS = (
    ("m", "cm", "mm"),
    ("m/s", "cm/s"),
    ("rad", "deg"),
    ("rad/s", "deg/s"),
)

KINDS = (LENGTH_UNITS, SPEED_UNITS, ANGLE_UNITS, RATE_UNITS)
"""Units that can stand for each other."""

LIMIT_UNITS = {"tilt": ANGLE_UNITS, "vertical_speed": SPEED_UNITS, "yaw_rate": RATE_UNITS, "speed": SPEED_UNITS}
"""Limit to the units that it may be given in, SI first."""
