"""Tracked: what is known of a vehicle at one moment of its flight; Alarm: that it is another one since; Regime."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Literal

from rotorfit.core.display import counted

if TYPE_CHECKING:
    from rotorfit.core.model import Interval, Model

Knowledge = Literal["learning", "known", "holding", "not_identifiable", "not_excited"]
"""What an axis is: too short a flight so far, all coefficients told, none commanded for a while (the last values hold),
commanded but not told, or not moved by its commands."""

Cause = Literal["payload", "thrust", "limits", "delay", "pose_jumped", "pose_frozen", "other"]
"""What a change probably is; see `docs/track.md`."""

QUANTITIES = ("input", "damping", "delay", "lag", "steady_gain", "total_lag")
"""What an axis has, in the order of the lines that `rotorfit track --jsonl` prints."""


@dataclass(frozen=True)
class TrackedAxis:
    """One axis at one moment.

    Attributes:
        knowledge: In one word.
        state: In words, such as `holding (no excitation for 12 s)`.
        values: Name of `QUANTITIES` to its estimate; None where it is not told.
        ci95: The same to the 95 % interval of the vehicle as it flies now; an open end is None.
        ci95_vehicle: The same to the interval of the vehicle on any flight, as `fit` gives it.
        structure: Name of the law.
        wind: Acceleration that the commands do not explain, the trim with it [m/s^2, rad/s^2]; None where unknown.
        wind_ci95: Its 95 % interval.
        gusts: Standard deviation of the velocity that gusts give the vehicle [m/s, rad/s]; None where unknown.
        velocity: World x, y, z and the rate of yaw [m/s, rad/s]; None where unknown.
        ahead: The same a second later, if the last command holds; None where unknown.
        ahead_ci95: Its 95 % band.
    """

    knowledge: Knowledge = "learning"
    state: str = "learning"
    values: Mapping[str, float | None] = field(default_factory=lambda: dict.fromkeys(QUANTITIES))
    ci95: Mapping[str, Interval] = field(default_factory=dict)
    ci95_vehicle: Mapping[str, Interval] = field(default_factory=dict)
    structure: str = ""
    wind: float | None = None
    wind_ci95: Interval = (None, None)
    gusts: float | None = None
    velocity: float | None = None
    ahead: float | None = None
    ahead_ci95: Interval = (None, None)

    def to_mapping(self) -> dict[str, Any]:
        """As a line of JSON holds it."""
        return {
            "state": self.state,
            **{name: self.values.get(name) for name in QUANTITIES},
            "ci95": {name: list(ends) for name, ends in self.ci95.items()},
            "ci95_vehicle": {name: list(ends) for name, ends in self.ci95_vehicle.items()},
            "structure": self.structure,
            "wind": self.wind,
            "wind_ci95": list(self.wind_ci95),
            "gusts": self.gusts,
            "velocity": self.velocity,
            "velocity_in_1_s": self.ahead,
            "velocity_in_1_s_ci95": list(self.ahead_ci95),
        }


@dataclass(frozen=True)
class Air:
    """The mean wind of the last half minute, where commands are tilts and damping is drag.

    Attributes:
        speed: [m/s].
        speed_ci95: [m/s].
        direction: Where it blows to, from the world's x counter-clockwise [rad].
        direction_ci95: [rad].
    """

    speed: float
    speed_ci95: tuple[float, float]
    direction: float
    direction_ci95: tuple[float, float]

    def to_mapping(self) -> dict[str, Any]:
        """As a line of JSON holds it."""
        return {
            "speed": self.speed,
            "speed_ci95": list(self.speed_ci95),
            "direction": self.direction,
            "direction_ci95": list(self.direction_ci95),
        }


@dataclass(frozen=True)
class Alarm:
    """The vehicle, or what measures it, is not what it was.

    Attributes:
        time: When it was raised [s].
        axes: Which axes changed.
        cause: What it probably is.
        since: 95 % interval of when it happened [s].
        change: `AXIS.QUANTITY` to the 95 % interval of the ratio of new to old; of `delay` and `trim` the difference
            [s, m/s^2 or rad/s^2].
        confidence: Share of the evidence that the named cause has among all that were compared.
        p_value: Of a vehicle that did not change giving as much, before the number of looks is counted.
        why: Why this cause and not the others, a sentence.
    """

    time: float
    axes: tuple[str, ...]
    cause: Cause
    since: tuple[float, float]
    change: Mapping[str, tuple[float, float]]
    confidence: float
    p_value: float
    why: str

    def to_mapping(self) -> dict[str, Any]:
        """As a line of JSON holds it."""
        return {
            "type": "alarm",
            "time": self.time,
            "axes": list(self.axes),
            "cause": self.cause,
            "since": list(self.since),
            "change": {name: list(ends) for name, ends in self.change.items()},
            "confidence": self.confidence,
            "p_value": self.p_value,
            "why": self.why,
        }


@dataclass(frozen=True)
class Regime:
    """A stretch of flight in which the vehicle was one and the same.

    Attributes:
        start: [s].
        end: [s].
        model: Fitted to it; None where it was too short.
        begun_by: The alarm that began it; None for the first.
    """

    start: float
    end: float
    model: Model | None
    begun_by: Alarm | None = None


@dataclass(frozen=True)
class Tracked:
    """What is known at one moment.

    Attributes:
        time: In the seconds of the flight.
        axes: Axis name to what is known of it.
        alarms: Raised since the state before.
        regime: Number of the regime, from 0.
        regime_start: When it began [s].
        air: The mean wind; None where it is not known, or damping is no drag.
    """

    time: float
    axes: Mapping[str, TrackedAxis]
    alarms: tuple[Alarm, ...] = ()
    regime: int = 0
    regime_start: float = 0.0
    air: Air | None = None

    def to_mapping(self) -> dict[str, Any]:
        """As a line of JSON holds it."""
        return {
            "type": "state",
            "time": self.time,
            "regime": self.regime,
            "axes": {name: axis.to_mapping() for name, axis in self.axes.items()},
            "air": self.air.to_mapping() if self.air else None,
        }


@dataclass(frozen=True)
class Track:
    """A whole flight as it was tracked.

    Attributes:
        states: One a second, in order; the last is that of the end, after a last fit.
        regimes: In order, each with its model.
    """

    states: tuple[Tracked, ...]
    regimes: tuple[Regime, ...]

    @property
    def alarms(self) -> tuple[Alarm, ...]:
        """All that were raised, in order."""
        return tuple(alarm for state in self.states for alarm in state.alarms)

    def __repr__(self) -> str:
        end = self.states[-1].time if self.states else 0.0
        said = f"{end:.1f} s", counted(len(self.regimes), "regime"), counted(len(self.alarms), "alarm")
        return f"Track({', '.join(said)})"
