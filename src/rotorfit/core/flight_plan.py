"""Plan: one flight before it is flown: the signals on each axis, where, how fast, and the belief about the vehicle.

Status: the progress of a flight. Flown: its outcome.

A plan is stored as a TOML file that a person can read, edit and pass on.
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
    """A sine whose frequency sweeps exponentially from start to end (a logarithmic chirp).

    Attributes:
        amplitude: In the unit of the signal.
        frequency: Start and end [rad/s].
        duration: Length of the sweep [s]; past it the frequency keeps growing.
    """

    amplitude: float
    frequency: tuple[float, float]
    duration: float


@dataclass(frozen=True)
class Steps:
    """Piecewise constant levels, each held until the next one; 0 before the first.

    Attributes:
        time: Start of each level, increasing, shape (K,) [s].
        level: Shape (K,), in the unit of the signal.
    """

    time: tuple[float, ...]
    level: tuple[float, ...]


Signal = Sines | Chirp | Steps


def value(signal: Signal, t: Array) -> Array:
    """The signal at times t since its own start, shape (N,) [s]; shape (N,), in the unit of the signal."""
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
    """The signal at times t, shape (N,) [s], and its first and second derivatives, each shape (N,); 0 for steps."""
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
        start: Start, from the start of the plan [s].
        duration: Length [s].
        signal: Function of the time since `start`.
    """

    axis: str
    target: Target
    start: float
    duration: float
    signal: Signal


@dataclass(frozen=True)
class Feedback:
    """A tracking controller on the measured pose; its command is added to those of the signals.

    u = (stiffness (reference - pose) + damping (reference' - velocity) + reference'' + b reference') / input, in the
    heading frame, with the velocity from filtered differences of the measured poses and the vehicle's input and
    damping b as believed. The reference is given by the excitations with target `position`, else by the pose at the
    start.

    Attributes:
        axes: The axes on which it acts.
        stiffness: For each of x, y, z, yaw [1/s^2].
        damping: For each of x, y, z, yaw, in addition to the vehicle's own [1/s].
        filter_time: Time constant of the velocity filter [s].
    """

    axes: tuple[str, ...]
    stiffness: Four = (0.6, 0.6, 0.6, 0.6)
    damping: Four = (1.0, 1.0, 1.0, 1.0)
    filter_time: float = 0.05


@dataclass(frozen=True)
class Space:
    """Limits that the flight must respect, and its start.

    Attributes:
        lower: Corner of the box with the smallest x, y, z, in the world frame of the poses [m].
        upper: The opposite corner [m].
        start: x, y, z [m] and yaw [rad] of the hover at the start of the plan.
        speed: Largest horizontal speed, x and y combined [m/s].
        climb: Largest vertical speed [m/s].
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
        name: For people, and for file names.
        design: How the signals were designed: `two_sines`, `optimal` and so on.
        card: The whole card whose commands are planned: meanings and limits.
        rate: Command rate [Hz].
        duration: Length of the plan, without take-off and landing [s].
        ramp: Time over which the commands of each signal fade in at its start and out at its end [s].
        excitations: The signals to fly.
        feedback: None for open loop on all axes.
        space: Fence and limits.
        belief: Belief about the vehicle, as stored by `belief`; planning and feedback use it.
        predicted: What planning expects: standard errors, path, speeds, as stored by `planning`.
        seed: Seed of all random draws.
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
        """Draws the signals over time, with their ramps but without the feedback; see `rotorfit plan --picture`.

        Returns:
            The matplotlib axes: one panel for signals that are commands, one for those that are positions to track.
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
    """The command signals, with their ramps, at times from the start of the plan.

    Args:
        plan: The plan.
        t: Times, shape (N,) [s].

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
    """The reference that the feedback tracks, at times from the start of the plan, as an offset from the start pose.

    Args:
        plan: The plan.
        t: Times, shape (N,) [s].

    Returns:
        Position [m, rad], velocity [m/s, rad/s] and acceleration [m/s^2, rad/s^2], forward, left, up and
        counter-clockwise of the start, each shape (N, 4).
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
    """Window factor that ramps from 0 to 1 and back, with its first and second derivatives, each shape (N,).

    10 s^3 - 15 s^4 + 6 s^5 of the fraction s of the ramp: the polynomial of least degree whose first and second
    derivatives vanish at both ends, so that a ramped position can be tracked. 0 outside the excitation.
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
    """Why a flight ended, and a text: `completed`, `operator`, `disk`, `command`, `start`, `take_off`, `error`, or a
    code of the guard.
    """

    reason: str
    text: str


@dataclass(frozen=True)
class Jitter:
    """Lateness of the commands against their due times: median, 99th percentile, maximum [s]."""

    p50: float
    p99: float
    max: float


@dataclass(frozen=True)
class Status:
    """Progress of a flight.

    Attributes:
        phase: `take-off`, `approach` or `plan`.
        time: Time since the phase began [s].
        duration: Duration of the plan [s].
        pose: x, y, z [m], yaw [rad]; None before the first.
        room: Distance to the fence, less the braking distance [m].
        battery: 0 to 1; None if the vehicle does not report it.
    """

    phase: str
    time: float
    duration: float
    pose: Four | None
    room: float
    battery: float | None


@dataclass(frozen=True)
class Flown:
    """Outcome of a flight.

    Attributes:
        reason: `completed`, or what ended it, see `Ending`.
        text: The same for people.
        duration: Length of the plan that was flown [s].
        jitter: Lateness of the commands by the clock of the link; meaningless where that clock is simulated.
        late: Number of commands sent more than three periods late.
        commands: Number of commands sent.
        poses: Number of poses received.
        outliers: Number of implausible poses.
        landed: Whether a landing was requested and the link accepted it.
        path: Path of the recording.
        notes: What a user should know about the flight.
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
