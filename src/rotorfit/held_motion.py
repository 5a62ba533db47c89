"""The motion of one axis under held, delayed commands, from rest and in still air: where a signal leads.

Between two switching times the command is constant and the motion is known in closed form, as in `response`; here for
planning, without sensitivities.
"""

from typing import NamedTuple

import numpy as np

from rotorfit.excitation import Steps
from rotorfit.frames import AXES, Array
from rotorfit.plan import Feedback

EARLY = 1e-6
"""Levels change so much early [s]: a command loop that ticks at these times takes the new level however they round."""


class Dynamics(NamedTuple):
    """What is believed of one axis: v' = gain u(t - delay) - damping v."""

    gain: float
    damping: float
    delay: float


def transitions(damping: float, dt: Array) -> tuple[Array, Array, Array]:
    """f, k, h of v(t + dt) = f v + k a, p(t + dt) = p + k v + h a under a constant acceleration a, damping positive."""
    k = -np.expm1(-damping * dt) / damping
    return np.exp(-damping * dt), k, (dt - k) / damping


def held_states(dynamics: Dynamics, command: Array, length: Array) -> tuple[Array, Array]:
    """Position and velocity at the ends of N held commands of some lengths [s], the start first: twice (N + 1,).

    The delay only shifts the motion and does not enter.
    """
    f, k, h = transitions(dynamics.damping, length)
    a = dynamics.gain * command
    p, v = np.zeros(a.size + 1), np.zeros(a.size + 1)
    for i in range(a.size):
        v[i + 1] = f[i] * v[i] + k[i] * a[i]
        p[i + 1] = p[i] + k[i] * v[i] + h[i] * a[i]
    return p, v


def extremes(dynamics: Dynamics, command: Array, step: float) -> tuple[float, float, float]:
    """Lowest and highest position and largest speed of commands held for a step each, between the steps too.

    Source: the closed form of eq. (4); the velocity turns at most once in a step.
    """
    p, v = held_states(dynamics, command, np.full(command.size, step))
    turns = np.flatnonzero(v[:-1] * v[1:] < 0)
    a = dynamics.gain * command[turns]
    _, k, h = transitions(dynamics.damping, np.log1p(-dynamics.damping * v[turns] / a) / dynamics.damping)
    path = np.concatenate([p, p[turns] + k * v[turns] + h * a])
    return float(path.min()), float(path.max()), float(np.abs(v).max())


def motion_at(dynamics: Dynamics, signal: Steps, t: Array) -> tuple[Array, Array]:
    """Position and velocity at times since the signal's own start, each shape (N,)."""
    time, level = np.array([0.0, *signal.time]) + dynamics.delay, np.array([0.0, *signal.level])
    p, v = held_states(dynamics, level[:-1], np.diff(time))
    at = np.maximum(np.searchsorted(time, t, side="right") - 1, 0)
    _, k, h = transitions(dynamics.damping, np.maximum(t - time[at], 0.0))
    a = dynamics.gain * level[at]
    return p[at] + k * v[at] + h * a, v[at] + k * (a - dynamics.damping * v[at])


def against_feedback(
    signal: Steps, axis: str, dynamics: Dynamics, feedback: Feedback, end: float, step: float
) -> Steps:
    """A signal that leads through the same motion although a feedback holds the vehicle at the start.

    The feedback asks for -(K p + D v) / g; the signal is given the same of the believed motion, held over each step, on
    top. What the feedback then corrects is only what wind, trim and wrong beliefs add: it tracks the designed motion,
    and takes nothing from what the design tells.

    Args:
        signal: Of the commands.
        axis: Its axis.
        dynamics: As believed; the feedback's own belief in g must be the same.
        feedback: That acts on the axis, with no position reference there.
        end: Of the signal [s].
        step: How long each level holds [s]; the signal's own levels must change at its multiples.
    """
    a = AXES.index(axis)
    time = step * np.arange(int(end / step + 1e-9), dtype=np.float64)
    middle = time + step / 2
    position = motion_at(dynamics, signal, middle)[0]
    velocity = motion_at(dynamics, signal, middle - feedback.filter_time)[1]
    own = np.array([0.0, *signal.level])[np.searchsorted(np.array(signal.time), middle, side="right")]
    level = own + (feedback.stiffness[a] * position + feedback.damping[a] * velocity) / dynamics.gain
    return Steps((*np.maximum(time - EARLY, 0.0).tolist(), float(end)), (*level.tolist(), 0.0))
