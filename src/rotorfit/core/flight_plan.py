"""Flown: how a flight ended and what it left; Status: how it is going.

Plan: one flight before it is flown: which signal on which axis, where, how fast, and what is believed of the drone.

A plan is a TOML file that a person can read, edit and send on.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from rotorfit.core.display import AXIS_COLOURS, Line, Panel, html_table, line_panels, number
from rotorfit.core.frames import AXES, Array

if TYPE_CHECKING:
    from matplotlib.axes import Axes


@dataclass(frozen=True)
class Sines:
    """sum_k amplitude_k sin(frequency_k t + phase_k).

    Attributes:
        amplitude: Shape (K,), in the unit of the signal.
        frequency: Shape (K,) [rad/s].
        phase: Shape (K,) [rad].
    """

    amplitude: tuple[float, ...]
    frequency: tuple[float, ...]
    phase: tuple[float, ...]


@dataclass(frozen=True)
class Chirp:
    """A sine whose frequency moves from one end to the other at a constant rate of its logarithm.

    Attributes:
        amplitude: In the unit of the signal.
        frequency: Start and end [rad/s].
        duration: Over which the frequency moves [s].
    """

    amplitude: float
    frequency: tuple[float, float]
    duration: float


@dataclass(frozen=True)
class Steps:
    """Levels, each held from its time on until the next one; 0 before the first.

    Attributes:
        time: Increasing, shape (K,) [s].
        level: Shape (K,), in the unit of the signal.
    """

    time: tuple[float, ...]
    level: tuple[float, ...]


Signal = Sines | Chirp | Steps


def value(signal: Signal, t: Array) -> Array:
    """The signal at times t since its own start, shape (N,) [s]."""
    if isinstance(signal, Sines):
        amplitude, frequency, phase = (np.array(each) for each in (signal.amplitude, signal.frequency, signal.phase))
        return np.asarray(np.sin(np.multiply.outer(t, frequency) + phase) @ amplitude)
    if isinstance(signal, Chirp):
        low, high = signal.frequency
        rate = np.log(high / low) / signal.duration
        return np.asarray(signal.amplitude * np.sin(low * np.expm1(rate * t) / rate))
    levels = np.array([0.0, *signal.level])
    return np.asarray(levels[np.searchsorted(np.array(signal.time), t, side="right")])


def motion(signal: Signal, t: Array) -> tuple[Array, Array, Array]:
    """The signal at times t, shape (N,) [s], with its first and second derivative; those of steps are 0."""
    if isinstance(signal, Sines):
        amplitude, frequency, phase = (np.array(each) for each in (signal.amplitude, signal.frequency, signal.phase))
        angle = np.multiply.outer(t, frequency) + phase
        first = np.cos(angle) @ (amplitude * frequency)
        return (
            np.asarray(np.sin(angle) @ amplitude),
            np.asarray(first),
            np.asarray(-np.sin(angle) @ (amplitude * frequency**2)),
        )
    if isinstance(signal, Chirp):
        low, high = signal.frequency
        rate = np.log(high / low) / signal.duration
        angle, speed = low * np.expm1(rate * t) / rate, low * np.exp(rate * t)
        sine, cosine = signal.amplitude * np.sin(angle), signal.amplitude * np.cos(angle)
        return sine, speed * cosine, rate * speed * cosine - speed**2 * sine
    return value(signal, t), np.zeros(t.shape), np.zeros(t.shape)


Four = tuple[float, float, float, float]  # one value for each of x, y, z, yaw

Target = Literal["command", "position"]


@dataclass(frozen=True)
class AxisExcitation:
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
    excitations: tuple[AxisExcitation, ...]
    feedback: Feedback | None
    space: Space
    belief: Mapping[str, Any] = field(default_factory=dict)
    predicted: Mapping[str, Any] = field(default_factory=dict)
    seed: int = 0

    def __repr__(self) -> str:
        axes = " ".join(dict.fromkeys(each.axis for each in self.excitations))
        loop = f"feedback on {' '.join(self.feedback.axes)}" if self.feedback else "open loop"
        return f"Plan({self.name!r}, {self.duration:g} s at {self.rate:g} Hz, moves {axes}, {loop})"

    def _repr_html_(self) -> str:
        errors = self.predicted.get("stderr", {})
        heads = ("axis", *(f"standard error of {name}" for name in next(iter(errors.values()), {})))
        rows = [(axis, *(number(error) for error in row.values())) for axis, row in errors.items()]
        return html_table(repr(self), heads, rows)

    def plot(self) -> "tuple[Axes, ...]":
        """Draws the signals over time, with their ramps and without the feedback; see `rotorfit plan --picture`.

        Returns:
            The matplotlib axes: one for the signals that are commands, one for those that are positions to track.
        """
        t = np.arange(0.0, self.duration, 1 / self.rate)
        panels = []
        for target, title, label, series in (
            ("command", "commands of the signals", "command", command_at(self, t)),
            ("position", "position references, from the start", "m, rad", reference_at(self, t)[0]),
        ):
            axes = dict.fromkeys(each.axis for each in self.excitations if each.target == target)
            lines = [Line(axis, t, series[:, AXES.index(axis)], {"color": AXIS_COLOURS[axis]}) for axis in axes]
            if lines:
                panels.append(Panel(title, "time [s]", label, lines))
        return line_panels(panels, 1, (8.0, 2.4))


Three = tuple[Array, Array, Array]


def command_at(plan: Plan, t: Array) -> Array:
    """The signals that are commands, with their ramps, at times from the start of the plan.

    Args:
        plan: What is flown.
        t: Shape (N,) [s].

    Returns:
        Forward, left, up, counter-clockwise, shape (N, 4) [unit of the card's command].
    """
    out = np.zeros((t.size, 4))
    for excitation in plan.excitations:
        if excitation.target == "command":
            weight = window(excitation, plan.ramp, t)[0]
            out[:, AXES.index(excitation.axis)] += weight * value(excitation.signal, t - excitation.start)
    return out


def reference_at(plan: Plan, t: Array) -> Three:
    """What the feedback tracks at times from the start of the plan, as an offset from where it began.

    Args:
        plan: What is flown.
        t: Shape (N,) [s].

    Returns:
        Position, velocity and acceleration, forward, left, up and counter-clockwise of the start, each shape (N, 4).
    """
    position, velocity, acceleration = np.zeros((3, t.size, 4))
    for excitation in plan.excitations:
        if excitation.target == "position":
            a = AXES.index(excitation.axis)
            w, dw, ddw = window(excitation, plan.ramp, t)
            s, ds, dds = motion(excitation.signal, t - excitation.start)
            position[:, a] += w * s
            velocity[:, a] += dw * s + w * ds
            acceleration[:, a] += ddw * s + 2 * dw * ds + w * dds
    return position, velocity, acceleration


def window(excitation: AxisExcitation, ramp: float, t: Array) -> Three:
    """The factor that grows from 0 to 1 and fades again, with its first and second derivative, each shape (N,).

    10 s^3 - 15 s^4 + 6 s^5 of the share s of the ramp: the least polynomial at whose ends velocity and acceleration
    vanish, so that a ramped position can be tracked. 0 outside the excitation.
    """
    since, left = t - excitation.start, excitation.start + excitation.duration - t
    inside = ((since >= 0) & (left > 0)).astype(float)
    if ramp <= 0:
        return inside, np.zeros(t.shape), np.zeros(t.shape)
    length = min(ramp, excitation.duration / 2)
    nearer = np.minimum(since, left)
    s = np.clip(nearer / length, 0.0, 1.0)
    sign = np.where(since <= left, 1.0, -1.0)
    grown = s**3 * (10 - 15 * s + 6 * s**2)
    slope = sign * 30 * s**2 * (1 - s) ** 2 / length
    bend = 60 * s * (1 - s) * (1 - 2 * s) / length**2
    return inside * grown, inside * slope, inside * bend


@dataclass(frozen=True)
class Ending:
    """Why a flight ended: `completed`, `operator`, `disk`, `command`, `error`, or a code of the guard; and a text."""

    reason: str
    text: str


@dataclass(frozen=True)
class Jitter:
    """By how much commands left later than they were due: median, 99th percentile, largest [s]."""

    p50: float
    p99: float
    max: float


@dataclass(frozen=True)
class Status:
    """How a flight is going.

    Attributes:
        phase: `take-off`, `approach` or `plan`.
        time: Since the phase began [s].
        duration: Of the plan [s].
        pose: x, y, z [m], yaw [rad]; None before the first.
        room: Distance to the fence, braking distance included [m].
        battery: 0 to 1; None where nobody says.
    """

    phase: str
    time: float
    duration: float
    pose: Four | None
    room: float
    battery: float | None


@dataclass(frozen=True)
class Flown:
    """A flight that has ended.

    Attributes:
        reason: `completed`, or what ended it, see `Ending`.
        text: The same for people.
        duration: Of the plan, as far as it was flown [s].
        jitter: Of the commands, by the clock of the link; says nothing where that clock is simulated.
        late: Commands that came more than three periods late.
        commands: Sent.
        poses: Received.
        outliers: Poses that could not be true.
        landed: Whether a landing was asked for and the link took it.
        path: Of the recording.
        notes: What a user should know of it.
    """

    reason: str
    text: str
    duration: float
    jitter: Jitter
    late: int
    commands: int
    poses: int
    outliers: int
    landed: bool
    path: Path
    notes: tuple[str, ...] = ()
