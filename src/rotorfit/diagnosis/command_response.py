"""Answers: which command moves the vehicle in which direction, from the motion alone, whatever its name.

The velocity along an axis is modelled as a sum of the commands, each delayed and smoothed as by a first-order vehicle,
plus a straight line in time for wind and trim. Delay and time constant minimise the residual; standard errors come from
leaving out each tenth of the flight in turn. Only the sign and the axis of the effects are used.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from rotorfit.core.flight_data import Flight
from rotorfit.core.frames import AXES, Array, world_from_heading
from rotorfit.core.results import Motion
from rotorfit.dynamics.first_order_low_pass import first_order_low_pass
from rotorfit.dynamics.kinematics import motion_from_flight

DELAYS = np.arange(0.0, 0.41, 0.1)
"""Delays that are tried [s]."""

CONSTANTS = (0.1, 0.3, 1.0, 3.0, 10.0)
"""Time constants that are tried [s]: from a stiff velocity loop to the drag of a vehicle commanded by its tilt."""

QUICKEST = float(DELAYS[0]) + CONSTANTS[0]
"""Least lag that is tried [s]: what has it horizontally is no response of a vehicle, which leans first."""

GRID = 0.02
"""Step of the grid on which commands are smoothed [s]."""

RATE = 10.0
"""Rate of the velocities that are used [Hz]."""

BLOCKS = 10
"""Number of stretches of the flight, each of which is left out in turn."""

LEAST_POSES = 100
"""Least number of poses under commands."""

SIGNIFICANT = 5.0
"""Standard errors above which a response has a sign and a direction."""

EXPLAINED = 0.3
"""Share of the variance of the velocity that commands must explain: the commands of a loop that only holds position
follow the motion, and their sign is that of the loop."""

AT_ONCE = 0.95
"""The same where the motion goes against a command within `QUICKEST`: so it does in a loop that holds the vehicle in
wind, whose commands explain 0.3 to 0.92 of it; a vehicle takes longer, or its commands explain nearly all."""

CLEARLY = 1.5
"""Least ratio of the significance of one axis to that of any other for a command to belong to it."""

OBLIQUE = 0.6
"""Largest effect along the other horizontal axis, as a share of that along the first, for a command to belong to that
one: beyond 31 degrees commands and poses have axes that are turned against each other."""

SHARED = 0.9
"""Share of a command that is in the others above which the motion may bear out what its name says, and not contradict
it: the others stand in for it. Where one pair of sines is flown on all axes at once it is 0.93 to 1; on recorded
flights, whose motion tells the commands apart, it is 0.02 to 0.93."""

TURNING = np.radians(20.0)
"""Standard deviation of yaw above which frames are distinguishable: below, a rotated frame is a wrong zero of yaw."""

BETTER = 0.9
"""Largest residual variance of the world frame, as a share of the heading frame's, for it to be chosen."""


Frame = Literal["heading", "world"]


@dataclass(frozen=True)
class CommandResponse:
    """Response to a command.

    Attributes:
        axis: The axis that it moves, one of `AXES`; None where none stands out.
        sign: +1 where a positive command moves forward, left, up or counter-clockwise; else -1.
        certainty: Effect on that axis, or where none stands out on the one it is named after, in standard errors.
        explained: Share of the variance of the velocity along the same axis explained by all commands together.
        lag: Delay plus time constant of the response [s].
        shared: Share of the variance of the command that the other commands explain. Where it is nearly all, the motion
            does not tell the commands apart.
    """

    axis: str | None
    sign: int
    certainty: float
    explained: float
    lag: float
    shared: float


@dataclass(frozen=True)
class Answers:
    """Responses to the commands of a flight.

    Attributes:
        frame: Frame of the x and y commands: `heading` or `world`; None where the flight turned too little.
        of: Name of the command in the card to its response.
        left: Residual sum of squares of the horizontal velocity [m^2/s^2].
    """

    frame: Frame | None
    of: dict[str, CommandResponse]
    left: float = 0.0


@dataclass(frozen=True)
class _Fit:
    """Effects of all commands on one axis.

    Attributes:
        effect: Effects in standard errors, with sign, shape (K,).
        size: Effects, in velocity per command, shape (K,).
        lag: Best delay plus time constant [s].
        left: Residual sum of squares.
        explained: Share of the variance about a straight line.
    """

    effect: Array
    size: Array
    lag: float
    left: float
    explained: float


def answers_of(flight: Flight, motion: Motion | None = None, unturned: Frame = "heading") -> Answers:
    """Determines which command moves the vehicle in which direction.

    Args:
        flight: Read with a card that takes the commands as they are (`frame = "heading"`, no signs changed).
        motion: Motion of the flight, if already computed.
        unturned: Frame in which the responses are given if the flight turned too little to tell it.

    Returns:
        The frame and the responses; no responses for a flight that is too short.
    """
    motion = motion or motion_from_flight(flight)
    names = [axis for axis in flight.axes if np.ptp(flight.command[:, AXES.index(axis)]) > 0]
    if not names or len(motion.time) < LEAST_POSES:
        return Answers(None, {})
    motion = thinned(motion, flight.duration)
    lagged = smoothed(flight, motion.time, [AXES.index(name) for name in names], DELAYS)
    frames: tuple[Frame, ...] = ("heading", "world")
    fits = {frame: _fits(lagged, motion.time, _velocity(motion, frame)) for frame in frames}
    left = {frame: fits[frame][0].left + fits[frame][1].left for frame in frames}
    turned = bool(np.std(motion.yaw) > TURNING) and bool({"x", "y"} & set(names))
    frame: Frame = "world" if left["world"] < BETTER * left["heading"] else "heading"
    frame = frame if turned else unturned
    found = {name: _answer(fits[frame], j, name, _shared(lagged, motion.time, j)) for j, name in enumerate(names)}
    return Answers(frame if turned else None, found, left[frame])


def thinned(motion: Motion, duration: float) -> Motion:
    """The motion at about `RATE` times a second of a flight of this duration [s]."""
    thin = max(1, round(len(motion.time) / max(duration, 1e-9) / RATE))
    return Motion(*(getattr(motion, name)[::thin] for name in ("time", "yaw", "command", "velocity", "acceleration")))


def smoothed(flight: Flight, time: Array, columns: list[int], delays: Array) -> list[tuple[float, Array]]:
    """Lag [s] and smoothed commands at some times, shape (N, K), for each of `CONSTANTS` and each delay [s]."""
    grid = np.arange(flight.command_time[0], flight.command_time[-1] + GRID, GRID)
    held = flight.command[np.searchsorted(flight.command_time, grid + 1e-9, side="right") - 1][:, columns]
    found = []
    for constant in CONSTANTS:
        smooth = first_order_low_pass(held, float(np.exp(-GRID / constant)))
        for delay in delays.tolist():
            parts = [np.interp(time - delay, grid, series) for series in smooth.T]
            found.append((delay + constant, np.column_stack(parts)))
    return found


def _velocity(motion: Motion, frame: str) -> Array:
    """Velocity along the axes of a frame, shape (N, 4)."""
    if frame == "heading":
        return motion.velocity
    return np.column_stack([world_from_heading(motion.velocity[:, :2], motion.yaw), motion.velocity[:, 2:]])


def _shared(lagged: list[tuple[float, Array]], time: Array, j: int) -> float:
    """Share of the variance of a command, smoothed least, that the others explain, smoothed by every time constant."""
    smoothed = [commands for _, commands in lagged[:: len(DELAYS)]]
    rest = np.column_stack([np.ones_like(time), time - time.mean()])
    others = np.column_stack([*(np.delete(commands, j, axis=1) for commands in smoothed), rest])
    alone, left = (float(_left(design, smoothed[0][:, j : j + 1])[0]) for design in (rest, others))
    return 1 - left / alone if alone > 0 else 0.0


def _fits(lagged: list[tuple[float, Array]], time: Array, velocity: Array) -> list[_Fit]:
    """Effects of the commands on the velocity along each axis, shape (N, 4)."""
    rest = np.column_stack([np.ones_like(time), time - time.mean()])
    designs = [np.column_stack([commands, rest]) for _, commands in lagged]
    left = np.array([_left(design, velocity) for design in designs])
    alone, block = _left(rest, velocity), np.arange(len(time)) * BLOCKS // len(time)
    found = []
    for k, index in enumerate(np.argmin(left, axis=0).tolist()):
        kept = [block != b for b in range(BLOCKS)]
        parts = np.array([_solved(designs[index][some], velocity[some, k])[:-2] for some in kept])
        size = np.asarray(parts.mean(axis=0))
        spread = np.sqrt((BLOCKS - 1) / BLOCKS * np.sum((parts - size) ** 2, axis=0))
        explained = float(1 - left[index, k] / alone[k]) if alone[k] > 0 else 0.0
        found.append(_Fit(size / np.maximum(spread, 1e-12), size, lagged[index][0], float(left[index, k]), explained))
    return found


def _left(design: Array, target: Array) -> Array:
    """Residual sum of squares of each column of a target (N, K), shape (K,)."""
    return np.asarray(np.sum((target - design @ _solved(design, target)) ** 2, axis=0))


def _solved(design: Array, target: Array) -> Array:
    return np.asarray(np.linalg.lstsq(design, target, rcond=None)[0])


def _answer(fits: list[_Fit], j: int, name: str, shared: float) -> CommandResponse:
    """The axis that a command moves most significantly; where none stands out, figures of the one it is named after."""
    order = sorted(range(4), key=lambda k: -abs(fits[k].effect[j]))
    first, second = fits[order[0]], fits[order[1]]
    told = float(first.effect[j])
    sure = abs(told) > max(SIGNIFICANT, CLEARLY * abs(float(second.effect[j]))) and first.explained > EXPLAINED
    sure = sure and not _is_oblique(fits, order[0], j)
    answered = told < 0 and first.lag <= QUICKEST and first.explained < AT_ONCE
    borne_out = AXES[order[0]] == name and told > 0
    axis = AXES[order[0]] if sure and not answered and (borne_out or not shared > SHARED) else None
    shown = first if axis else fits[AXES.index(name)]
    told = float(shown.effect[j])
    return CommandResponse(axis, int(np.sign(told)), abs(told), shown.explained, shown.lag, shared)


def _is_oblique(fits: list[_Fit], first: int, j: int) -> bool:
    """Whether a command moves the vehicle along both horizontal axes."""
    if first > 1:
        return False
    along, across = fits[first], fits[1 - first]
    share = abs(float(across.size[j])) / max(abs(float(along.size[j])), 1e-12)
    return share > OBLIQUE and abs(float(across.effect[j])) > SIGNIFICANT
