"""A controller at work: measured poses and a reference path in, commands out; every vehicle state by its stamp.

Position, velocity and disturbance are kept in the world frame at the stamp of the last pose. Between stamps, and from
the last one to the instant at which the command that is now due will act, they move by the commands that were sent, as
the model has it in the heading frame: exactly for a heading that is kept, else by that in the middle of every step.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numba
import numpy as np

from rotorfit.control_law import AxisLaw
from rotorfit.frames import AXES, Array
from rotorfit.reference_paths import ReferencePath
from rotorfit.response import transition

MEMORY = 64
"""Commands that are remembered."""


@dataclass(frozen=True)
class Controller:
    """Laws of the axes that are controlled, ready to be flown.

    Attributes:
        laws: Axis name to its law, all of one period; an axis without one is commanded zero.
        full_scale: Largest command of each axis, shape (4,) [unit of the card's command].
    """

    laws: Mapping[str, AxisLaw]
    full_scale: Array

    @property
    def period(self) -> float:
        """Between commands [s]."""
        return next(iter(self.laws.values())).period


@dataclass(frozen=True)
class Steering:
    """What a controller knows.

    Attributes:
        time: Stamp of the last pose [s].
        pose: Measured then: world x, y, z, yaw, unwrapped, shape (4,).
        state: Position, velocity and disturbance then, world, by the observers, shape (3, 4).
        error: Reference less pose then, its filtered rate and its integral, world, shape (3, 4).
        sent: When the last `MEMORY` commands were sent, the latest last, shape (MEMORY,) [s].
        command: Those commands, heading frame, shape (MEMORY, 4).
        bounded: Axes whose last command full scale has bounded, shape (4,).
        saturated: Commands so far that full scale has bounded on some axis.
    """

    time: float
    pose: Array
    state: Array
    error: Array
    sent: Array
    command: Array
    bounded: Array
    saturated: int = 0


def at_rest(pose: Array, time: float = 0.0) -> Steering:
    """The start, hovering at a pose, shape (4,)."""
    state = np.zeros((3, 4))
    state[0] = pose
    nothing = np.zeros(4, np.bool_)
    return Steering(time, pose.copy(), state, np.zeros((3, 4)), np.full(MEMORY, -1e9), np.zeros((MEMORY, 4)), nothing)


def seen(controller: Controller, steering: Steering, t: float, pose: Array, path: ReferencePath) -> Steering:
    """Takes in a pose.

    Args:
        controller: Its laws.
        steering: Before it.
        t: Stamp of the pose [s]; one that is not later than the last is left out.
        pose: World x, y, z, yaw, shape (4,); yaw may be wrapped.
        path: What is to be followed.
    """
    since = t - steering.time
    if since <= 0:
        return steering
    pose = pose.copy()
    pose[3] = steering.pose[3] + (pose[3] - steering.pose[3] + np.pi) % (2 * np.pi) - np.pi
    way, now = _directions(pose[3]), np.array([t])
    state, error = moved(controller, steering, t, pose[3]), steering.error.copy()
    innovation = way.T @ (pose - state[0])
    missing = path.known(now, now)[0][0] - pose
    filter_time = np.zeros(4)
    for a, axis in enumerate(AXES):
        if axis in controller.laws:
            law = controller.laws[axis]
            filter_time[a] = law.filter_time
            state += np.outer(law.observer or np.zeros(3), way[:, a] * innovation[a])
    error[1] += (missing - error[0] - since * error[1]) / (filter_time + since)
    error[2] += since * np.where(steering.bounded, 0.0, missing)
    error[0] = missing
    return replace(steering, time=t, pose=pose, state=state, error=error)


def commanded(controller: Controller, steering: Steering, t: float, path: ReferencePath) -> tuple[Steering, Array]:
    """The command that is due at a time, shape (4,), heading frame, within full scale."""
    laws = [controller.laws.get(axis) for axis in AXES]
    ahead = t + np.array([law.delay if law else 0.0 for law in laws])
    place, rate, growth = path.known(ahead, np.full(4, t))
    heading = steering.pose[3]
    if laws[3] and laws[3].observer:
        heading = moved(controller, steering, ahead[3], heading)[0, 3]
    wanted = np.zeros(4)
    for a, law in enumerate(laws):
        if law is None:
            continue
        if law.observer:
            p, v, d = moved(controller, steering, ahead[a], heading)
            asked = law.stiffness * (place[a] - p) + law.rate * (rate[a] - v) - d
        else:
            asked = np.array([law.stiffness, law.rate, law.integral]) @ steering.error
        asked = asked + law.forward * growth[a] + law.damping * rate[a]
        wanted[a] = _directions(heading if law.observer else steering.pose[3])[:, a] @ asked / law.input
    command = np.clip(wanted, -controller.full_scale, controller.full_scale)
    return replace(
        steering,
        sent=np.append(steering.sent[1:], t),
        command=np.vstack([steering.command[1:], command]),
        bounded=command != wanted,
        saturated=steering.saturated + bool((command != wanted).any()),
    ), command


def moved(controller: Controller, steering: Steering, until: float, heading: float) -> Array:
    """Position, velocity and disturbance at a later time, world, shape (3, 4), the heading turning to that one."""
    laws = [controller.laws.get(axis) for axis in AXES]
    numbers = np.array([(law.input, law.damping, law.delay) if law else (0.0, 0.0, 0.0) for law in laws])
    state = steering.state.copy()
    _move(state, steering.time, until, steering.pose[3], heading, steering.sent, steering.command, numbers)
    return state


@numba.njit(cache=True)
def _move(state, t, end, yaw, yaw_end, sent, command, numbers):  # type: ignore[no-untyped-def]
    """Moves world p, v, d (3, 4) from t to an end under the commands in force; of each axis input, damping, delay."""
    start, span = t, max(end - t, 1e-12)
    force = np.empty(4)
    while t < end:
        until = end
        for a in range(4):
            k = sent.size - 1
            while k > 0 and sent[k] + numbers[a, 2] > t:
                until = min(until, sent[k] + numbers[a, 2])
                k -= 1
            force[a] = numbers[a, 0] * command[k, a]
        psi = yaw + (yaw_end - yaw) * (0.5 * (t + until) - start) / span
        c, s = np.cos(psi), np.sin(psi)
        v0, v1 = c * state[1, 0] + s * state[1, 1], c * state[1, 1] - s * state[1, 0]
        d0, d1 = c * state[2, 0] + s * state[2, 1], c * state[2, 1] - s * state[2, 0]
        f, k0, h0 = transition(numbers[0, 1], until - t)[:3]
        p0, v0 = k0 * v0 + h0 * (force[0] + d0), f * v0 + k0 * (force[0] + d0)
        f, k1, h1 = transition(numbers[1, 1], until - t)[:3]
        p1, v1 = k1 * v1 + h1 * (force[1] + d1), f * v1 + k1 * (force[1] + d1)
        state[0, 0] += c * p0 - s * p1
        state[0, 1] += s * p0 + c * p1
        state[1, 0], state[1, 1] = c * v0 - s * v1, s * v0 + c * v1
        for a in range(2, 4):
            f, k2, h2 = transition(numbers[a, 1], until - t)[:3]
            push = force[a] + state[2, a]
            state[0, a] += k2 * state[1, a] + h2 * push
            state[1, a] = f * state[1, a] + k2 * push
        t = until


def _directions(heading: float) -> Array:
    """Columns: the world's components of forward, left, up and counter-clockwise, shape (4, 4)."""
    out = np.eye(4)
    out[:2, :2] = [[np.cos(heading), -np.sin(heading)], [np.sin(heading), np.cos(heading)]]
    return out
