"""A controller in flight: measured poses and a reference path in, commands out.

Position, velocity and disturbance are kept in the world frame at the stamp of the last pose. Between stamps, and from
the last stamp to the instant at which the command now due will act, they are propagated with the commands sent, by the
model in the heading frame: exactly for a constant heading, otherwise with the heading at the middle of each step.

Reference paths (circle, lemniscate and steps) are functions of time with their derivatives, in the world frame, around
a centre. Circle and lemniscate wait and then accelerate along a phase whose rate grows as 10 s^3 - 15 s^4 + 6 s^5 of
the share s of a ramp, so velocity and acceleration have no jumps. The controller does not know a step in advance.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal

import numpy as np

from rotorfit.control.control_law import AxisLaw
from rotorfit.core.compiled import kernel
from rotorfit.core.errors import PlanError
from rotorfit.core.flight_plan import Four, Space
from rotorfit.core.frames import AXES, Array, Mask
from rotorfit.core.laws import DELAY_RANGE
from rotorfit.dynamics.response import transition

Shape = Literal["circle", "lemniscate", "steps"]

SHAPES: tuple[Shape, ...] = ("circle", "lemniscate", "steps")

WAIT, RAMP = 5.0, 3.0
"""Time of hover before a path, and of its acceleration [s]."""

TURN, HEAVE = 0.8, 0.25
"""Amplitudes of a lemniscate's heading [rad], and of its height as a share of the size."""

HOLD = 6.0
"""Time between two steps [s]."""

STEPS: tuple[Four, ...] = (
    (1.0, 0.0, 0.0, 0.0), (1.0, 1.0, 0.0, 0.0), (1.0, 1.0, 0.5, 0.0), (1.0, 1.0, 0.5, 1.5), (0.0, 0.0, 0.0, 0.0)
)  # fmt: skip
"""Targets of the steps in turn: x, y, z as shares of the size, yaw [rad]."""

_LEVELS = np.array(STEPS)


@dataclass(frozen=True)
class ReferencePath:
    """A reference path.

    Attributes:
        shape: Which one.
        size: Radius of the circle, half the length of the lemniscate, length of the steps [m].
        speed: Largest speed of circle and lemniscate [m/s].
        duration: Duration, including the hover before it [s].
        centre: World x, y, z [m] and yaw [rad] of its centre; for steps, of their origin.
    """

    shape: Shape
    size: float
    speed: float
    duration: float = 40.0
    centre: Four = (0.0, 0.0, 1.5, 0.0)

    def at(self, t: Array) -> tuple[Array, Array, Array]:
        """Position, velocity and acceleration of x, y, z, yaw at times from the start, world, each shape (N, 4).

        Args:
            t: Times, shape (N,) [s].
        """
        out = np.empty((3, t.size, 4))
        full = self.speed / (self.size * (1.0 if self.shape == "circle" else np.sqrt(2.0 + HEAVE**2)))
        _fill(SHAPES.index(self.shape), self.size, full, np.array(self.centre), t, out)
        return out[0], out[1], out[2]

    def known(self, t: Array, now: Array) -> tuple[Array, Array, Array]:
        """As `at`, but as known at the time `now`: future steps are not.

        Args:
            t: Times, shape (N,) [s].
            now: When each is asked for, shape (N,) [s].
        """
        return self.at(np.minimum(t, now) if self.shape == "steps" else t)

    @property
    def start(self) -> Four:
        """Pose at the start: world x, y, z [m] and yaw [rad]."""
        x, y, z, yaw = self.at(np.zeros(1))[0][0].tolist()
        return x, y, z, yaw


@kernel()
def _fill(shape, size, full, centre, t, out):  # type: ignore[no-untyped-def]
    """Fills position, velocity and acceleration, shape (3, N, 4), at times (N,); `full`: final rate of the phase."""
    out[:] = 0.0
    for n in range(t.size):
        since = max(t[n] - WAIT, 0.0)
        s = min(since / RAMP, 1.0)
        phase = full * (RAMP * s**4 * (2.5 - 3 * s + s**2) + max(since - RAMP, 0.0))
        rate, growth = full * s**3 * (10 - 15 * s + 6 * s**2), full * 30 * s**2 * (1 - s) ** 2 / RAMP
        c, s = np.cos(phase), np.sin(phase)
        if shape == 0:  # a circle, heading kept
            way = ((size * c, -size * s, -size * c), (size * s, size * c, -size * s), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
        elif shape == 1:  # Gerono's lemniscate, fastest in the middle, with swinging height and heading
            lift = HEAVE * size
            way = (
                (size * s, size * c, -size * s), (size * s * c, size * (c * c - s * s), -4 * size * s * c),
                (lift * s, lift * c, -lift * s), (TURN * s, TURN * c, -TURN * s),
            )  # fmt: skip
        else:
            way = ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
            step = min(int(np.floor((t[n] - WAIT) / HOLD)), _LEVELS.shape[0] - 1)
            for a in range(4):
                if step >= 0:
                    out[0, n, a] = _LEVELS[step, a] * (size if a < 3 else 1.0)
        for a in range(4):
            out[0, n, a] += centre[a] + way[a][0]
            out[1, n, a] = way[a][1] * rate
            out[2, n, a] = way[a][2] * rate * rate + way[a][1] * growth


def within(path: ReferencePath, space: Space) -> None:
    """Refuses a path that leaves a space or exceeds its speed limits.

    Raises:
        PlanError: The path does; the message says by how much.
    """
    position, velocity, _ = path.at(np.arange(0.0, path.duration, 0.02))
    out = np.maximum(np.array(space.lower) - position[:, :3], position[:, :3] - np.array(space.upper)).max()
    if out > 0:
        raise PlanError(f"the {path.shape} of {path.size:g} m leaves the space by {out:.2f} m: make it smaller")
    fast, climb = np.hypot(velocity[:, 0], velocity[:, 1]).max(), np.abs(velocity[:, 2]).max()
    if fast > space.speed * (1 + 1e-9) or climb > space.climb:
        raise PlanError(
            f"the {path.shape} is flown at up to {fast:.2f} m/s and climbs at {climb:.2f} m/s, beyond {space.speed:g} "
            f"and {space.climb:g} m/s: fly it slower"
        )


(INPUT, DAMPING, DELAY, STIFFNESS, RATE, INTEGRAL, FORWARD, FILTER_TIME, OBSERVED, OBSERVER) = range(10)
"""Columns of `AxisControllers.numbers`; the observer has the last three."""


@dataclass(frozen=True)
class AxisControllers:
    """The laws of the controlled axes, ready to fly.

    Attributes:
        laws: Axis name to its law, all with the same period; an axis without one is commanded zero.
        full_scale: Largest command of each axis, shape (4,) [unit of the card's command].
    """

    laws: Mapping[str, AxisLaw]
    full_scale: Array

    @property
    def period(self) -> float:
        """Time between commands [s]."""
        return next(iter(self.laws.values())).period

    @cached_property
    def numbers(self) -> Array:
        """Numbers of each axis' law, in the columns named above, 0 without a law, shape (4, 12)."""
        out = np.zeros((4, 12))
        for a, axis in enumerate(AXES):
            if law := self.laws.get(axis):
                gains = (law.stiffness, law.rate, law.integral, law.forward, law.filter_time)
                observed = law.observer is not None
                out[a] = law.input, law.damping, law.delay, *gains, observed, *(law.observer or (0.0, 0.0, 0.0))
        return out


@dataclass(frozen=True)
class Steering:
    """The state of a controller.

    Attributes:
        time: Stamp of the last pose [s].
        pose: That pose as measured: world x, y, z [m] and unwrapped yaw [rad], shape (4,).
        state: Estimated position, velocity and disturbance at that stamp, world, shape (3, 4).
        error: Reference minus pose at that stamp, its filtered rate and its integral, world, shape (3, 4).
        sent: Times at which the M commands were sent that act at that stamp or later, the latest last, shape (M,) [s].
        command: Those commands, heading frame, shape (M, 4).
        bounded: Whether full scale bounded the last command of each axis, heading frame, shape (4,).
        saturated: Number of commands so far that full scale bounded on some axis.
    """

    time: float
    pose: Array
    state: Array
    error: Array
    sent: Array
    command: Array
    bounded: Mask
    saturated: int = 0


def at_rest(pose: Array, time: float = 0.0) -> Steering:
    """The state of a controller at the start, hovering.

    Args:
        pose: World x, y, z [m] and yaw [rad], shape (4,).
        time: Its stamp [s].
    """
    state = np.zeros((3, 4))
    state[0] = pose
    nothing = np.zeros(4, np.bool_)
    return Steering(time, pose.copy(), state, np.zeros((3, 4)), np.full(1, -1e9), np.zeros((1, 4)), nothing)


def observe(controller: AxisControllers, steering: Steering, t: float, pose: Array, path: ReferencePath) -> Steering:
    """The state of a controller after a pose.

    Args:
        controller: Its laws.
        steering: Its state before the pose.
        t: Stamp of the pose [s]; a pose that is not newer than the last is ignored.
        pose: World x, y, z [m] and yaw [rad], shape (4,); yaw may be wrapped.
        path: The reference path.
    """
    since = t - steering.time
    if since <= 0:
        return steering
    pose = pose.copy()
    pose[3] = steering.pose[3] + (pose[3] - steering.pose[3] + np.pi) % (2 * np.pi) - np.pi
    now = np.array([t])
    missing = path.known(now, now)[0][0] - pose
    state, error = predict_motion(controller, steering, t, pose[3]), steering.error.copy()
    _learn(state, error, pose, missing, since, steering.bounded, controller.numbers)
    # the last command that has acted on every axis is still in force; laws with a longer delay may follow in flight
    first = max(int(np.searchsorted(steering.sent, t - DELAY_RANGE[1], side="right")) - 1, 0)
    sent, command = steering.sent[first:], steering.command[first:]
    return replace(steering, time=t, pose=pose, state=state, error=error, sent=sent, command=command)


def commanded(controller: AxisControllers, steering: Steering, t: float, path: ReferencePath) -> tuple[Steering, Array]:
    """The command that is due at a time [s], shape (4,), heading frame, within full scale; and the state after it."""
    place, rate, growth = path.known(t + controller.numbers[:, DELAY], np.full(4, t))
    wanted = np.zeros(4)
    _ask(
        wanted, t, steering.time, steering.pose[3], steering.state, steering.error, place, rate, growth,
        steering.sent, steering.command, controller.numbers,
    )  # fmt: skip
    command = np.clip(wanted, -controller.full_scale, controller.full_scale)
    bounded = command != wanted
    return replace(
        steering,
        sent=np.append(steering.sent, t),
        command=np.vstack([steering.command, command]),
        bounded=bounded,
        saturated=steering.saturated + bool(bounded.any()),
    ), command


def predict_motion(controller: AxisControllers, steering: Steering, until: float, heading: float) -> Array:
    """Position, velocity and disturbance predicted for a later time [s], world, shape (3, 4).

    Args:
        controller: Its laws.
        steering: Its state.
        until: The later time [s].
        heading: Heading at that time [rad]; it changes linearly until then.
    """
    state = steering.state.copy()
    _move(state, steering.time, until, steering.pose[3], heading, steering.sent, steering.command, controller.numbers)
    return state


@kernel()
def _move(state, t, end, yaw, yaw_end, sent, command, numbers):  # type: ignore[no-untyped-def]
    """Propagates world p, v, d, shape (3, 4), in place from t to `end`; `numbers` are `AxisControllers.numbers`."""
    start, span = t, max(end - t, 1e-12)
    force = np.empty(4)
    while t < end:
        until = end
        for a in range(4):
            k = sent.size - 1
            while k > 0 and sent[k] + numbers[a, DELAY] > t:
                until = min(until, sent[k] + numbers[a, DELAY])
                k -= 1
            force[a] = numbers[a, INPUT] * command[k, a]
        psi = yaw + (yaw_end - yaw) * (0.5 * (t + until) - start) / span
        c, s = np.cos(psi), np.sin(psi)
        v0, v1 = c * state[1, 0] + s * state[1, 1], c * state[1, 1] - s * state[1, 0]
        d0, d1 = c * state[2, 0] + s * state[2, 1], c * state[2, 1] - s * state[2, 0]
        f, k0, h0 = transition(numbers[0, DAMPING], until - t)[:3]
        p0, v0 = k0 * v0 + h0 * (force[0] + d0), f * v0 + k0 * (force[0] + d0)
        f, k1, h1 = transition(numbers[1, DAMPING], until - t)[:3]
        p1, v1 = k1 * v1 + h1 * (force[1] + d1), f * v1 + k1 * (force[1] + d1)
        state[0, 0] += c * p0 - s * p1
        state[0, 1] += s * p0 + c * p1
        state[1, 0], state[1, 1] = c * v0 - s * v1, s * v0 + c * v1
        for a in range(2, 4):
            f, k2, h2 = transition(numbers[a, DAMPING], until - t)[:3]
            push = force[a] + state[2, a]
            state[0, a] += k2 * state[1, a] + h2 * push
            state[1, a] = f * state[1, a] + k2 * push
        t = until


@kernel()
def _along(world, heading, a):  # type: ignore[no-untyped-def]
    """Component of a world vector x, y, z, yaw along axis `a` of the heading frame."""
    if a == 0:
        return np.cos(heading) * world[0] + np.sin(heading) * world[1]
    if a == 1:
        return np.cos(heading) * world[1] - np.sin(heading) * world[0]
    return world[a]


@kernel()
def _learn(state, error, pose, missing, since, bounded, numbers):  # type: ignore[no-untyped-def]
    """Corrects the state with a pose, axis by axis in the heading frame, and updates the error; both in place."""
    off, c, s = pose - state[0], np.cos(pose[3]), np.sin(pose[3])
    ahead, aside = c * off[0] + s * off[1], c * off[1] - s * off[0]
    for i in range(3):
        x, y = numbers[0, OBSERVER + i] * ahead, numbers[1, OBSERVER + i] * aside
        state[i, 0] += c * x - s * y
        state[i, 1] += s * x + c * y
        for a in range(2, 4):
            state[i, a] += numbers[a, OBSERVER + i] * off[a]
    own = np.zeros((2, 4))  # what the axes of the vehicle add to the rate and to the integral
    grown = missing - error[0] - since * error[1]
    for a in range(4):
        own[0, a] = _along(grown, pose[3], a) / (numbers[a, FILTER_TIME] + since)
        own[1, a] = 0.0 if bounded[a] else since * _along(missing, pose[3], a)
    for i in range(2):
        error[1 + i, 0] += c * own[i, 0] - s * own[i, 1]
        error[1 + i, 1] += s * own[i, 0] + c * own[i, 1]
        error[1 + i, 2:] += own[i, 2:]
    error[0] = missing


@kernel()
def _ask(wanted, t, seen_at, yaw, state, error, place, rate, growth, sent, command, numbers):  # type: ignore[no-untyped-def]
    """Fills the commands of the laws, shape (4,); place, rate, growth: the reference for each axis in a row, (4, 4)."""
    heading = yaw
    if numbers[3, OBSERVED]:
        future = state.copy()
        _move(future, seen_at, t + numbers[3, DELAY], yaw, yaw, sent, command, numbers)
        heading = future[0, 3]
    for a in range(4):
        K, D, slow = numbers[a, STIFFNESS], numbers[a, RATE], numbers[a, INTEGRAL]
        if numbers[a, INPUT] == 0.0:
            continue
        asked = numbers[a, FORWARD] * growth[a] + numbers[a, DAMPING] * rate[a]
        turned = yaw
        if numbers[a, OBSERVED]:
            future, turned = state.copy(), heading
            _move(future, seen_at, t + numbers[a, DELAY], yaw, heading, sent, command, numbers)
            asked += K * (place[a] - future[0]) + D * (rate[a] - future[1]) - future[2]
        else:
            asked += K * error[0] + D * error[1] + slow * error[2]
        wanted[a] = _along(asked, turned, a) / numbers[a, INPUT]
