"""Plan: one flight before it is flown: which signal on which axis, where, how fast, and what is believed of the drone.

A plan is a TOML file that a person can read, edit and send on.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

from rotorfit.excitation import Signal

Four = tuple[float, float, float, float]  # one value for each of x, y, z, yaw
Target = Literal["command", "position"]


@dataclass(frozen=True)
class Excitation:
    """A signal on one axis.

    Attributes:
        axis: `x`, `y`, `z` or `yaw`.
        target: What the signal is: the `command` of the axis [unit of the card's command], or the `position` that the
            feedback tracks, as an offset from the start, forward and left of the heading there [m, rad].
        start: When it begins, from the start of the plan [s].
        duration: How long it lasts [s].
        signal: As a function of the time since `start`.
    """

    axis: str
    target: Target
    start: float
    duration: float
    signal: Signal


@dataclass(frozen=True)
class Feedback:
    """A tracking controller on the measured pose; its command is added to that of the signals.

    u = (stiffness (reference - pose) + damping (reference' - velocity) + reference'' + b reference') / input, in the
    heading frame, with the velocity from filtered differences of the measured poses and the believed input and damping
    b of the vehicle. The reference is what excitations of the target `position` say, else the pose at the start.

    Attributes:
        axes: The axes on which it acts.
        stiffness: For each of x, y, z, yaw [1/s^2].
        damping: For each of x, y, z, yaw, beyond what the vehicle damps by itself [1/s].
        filter_time: Time constant of the velocity's filter [s].
    """

    axes: tuple[str, ...]
    stiffness: Four = (0.6, 0.6, 0.6, 0.6)
    damping: Four = (1.0, 1.0, 1.0, 1.0)
    filter_time: float = 0.05


@dataclass(frozen=True)
class Space:
    """What the flight must stay within, and where it starts.

    Attributes:
        lower: Corner of the box with the smallest x, y, z, in the world frame of the poses [m].
        upper: The opposite corner [m].
        start: x, y, z [m] and yaw [rad] of the hover that the plan begins with.
        speed: Largest speed along x and y together [m/s].
        climb: Largest speed along z [m/s].
    """

    lower: tuple[float, float, float]
    upper: tuple[float, float, float]
    start: Four
    speed: float
    climb: float


@dataclass(frozen=True)
class Plan:
    """One flight before it is flown.

    Attributes:
        name: For people, and for files.
        design: How the signals came about: `two_sines`, `optimal` and so on.
        card: The whole card whose commands are planned: meaning and limits.
        rate: Commands a second.
        duration: Of the plan, without take-off and landing [s].
        ramp: The commands of the signals grow from 0 and fade to 0 over so long at both ends of each [s].
        excitations: What is flown.
        feedback: None for an open loop on all axes.
        space: Fence and limits.
        belief: What is believed of the vehicle, as `belief` stores it; planning and feedback use it.
        predicted: What planning expects: standard errors, path, speeds, as `planning` stores them.
        seed: Of all that was drawn.
    """

    name: str
    design: str
    card: Mapping[str, Any]
    rate: float
    duration: float
    ramp: float
    excitations: tuple[Excitation, ...]
    feedback: Feedback | None
    space: Space
    belief: Mapping[str, Any] = field(default_factory=dict)
    predicted: Mapping[str, Any] = field(default_factory=dict)
    seed: int = 0
