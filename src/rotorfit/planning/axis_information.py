"""Information of the commands of one axis about input, damping and delay: a quadratic form of the command.

The model is linear in its commands, and so is every sensitivity: that of coefficient i is H_i u, already whitened by
the estimator's own filter, with the trim and the start velocity projected out. The Fisher information is

    M_ij = (H_i u)' (H_j u) = u' Q_ij u

so that the matrices Q_ij, built once, give the information of any command on the grid, and its gradient, at the cost
of a few matrix-vector products.

Source: L. Ljung, System Identification, 2nd ed. (1999), section 13.2; the nuisances by the Schur complement.

Also the motion of one axis under held, delayed commands, from rest and in still air. Between two switching times the
command is constant and the motion is known in closed form, as in `dynamics.response`, here without sensitivities.
"""

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from rotorfit.core.flight_plan import Feedback, Steps
from rotorfit.core.frames import AXES, Array
from rotorfit.core.laws import DELAY_RANGE
from rotorfit.dynamics.disturbance import distinct_steps
from rotorfit.estimation.likelihood.block_response import response
from rotorfit.estimation.likelihood.blocks import BLOCK_RATE, Record
from rotorfit.estimation.likelihood.likelihood import whiten
from rotorfit.estimation.likelihood.parameters import Point

EARLY = 1e-6
"""Advance of level changes [s], so that a command loop that ticks at these times takes the new level despite rounding.
"""


class AxisBelief(NamedTuple):
    """Belief about one axis: v' = gain u(t - delay) - damping v."""

    gain: float
    damping: float
    delay: float


def transitions(damping: float, dt: Array) -> tuple[Array, Array, Array]:
    """f, k, h of v(t + dt) = f v + k a, p(t + dt) = p + k v + h a under a constant acceleration a, damping positive."""
    k = -np.expm1(-damping * dt) / damping
    return np.exp(-damping * dt), k, (dt - k) / damping


def held_states(dynamics: AxisBelief, command: Array, length: Array) -> tuple[Array, Array]:
    """Position and velocity at the ends of N held commands with given lengths [s], including the start: two (N + 1,).

    The delay only shifts the motion and is ignored.
    """
    f, k, h = transitions(dynamics.damping, length)
    a = dynamics.gain * command
    p, v = np.zeros(a.size + 1), np.zeros(a.size + 1)
    for i in range(a.size):
        v[i + 1] = f[i] * v[i] + k[i] * a[i]
        p[i + 1] = p[i] + k[i] * v[i] + h[i] * a[i]
    return p, v


def extremes(dynamics: AxisBelief, command: Array, step: float) -> tuple[float, float, float]:
    """Lowest and highest position and largest speed under commands held for `step` each, also between the steps.

    Source: the closed form of eq. (4); the velocity turns at most once in a step.
    """
    p, v = held_states(dynamics, command, np.full(command.size, step))
    turns = np.flatnonzero(v[:-1] * v[1:] < 0)
    a = dynamics.gain * command[turns]
    _, k, h = transitions(dynamics.damping, np.log1p(-dynamics.damping * v[turns] / a) / dynamics.damping)
    path = np.concatenate([p, p[turns] + k * v[turns] + h * a])
    return float(path.min()), float(path.max()), float(np.abs(v).max())


def motion_at(dynamics: AxisBelief, signal: Steps, t: Array) -> tuple[Array, Array]:
    """Position and velocity at times since the signal's own start, each shape (N,)."""
    time, level = np.array([0.0, *signal.time]) + dynamics.delay, np.array([0.0, *signal.level])
    p, v = held_states(dynamics, level[:-1], np.diff(time))
    at = np.maximum(np.searchsorted(time, t, side="right") - 1, 0)
    _, k, h = transitions(dynamics.damping, np.maximum(t - time[at], 0.0))
    a = dynamics.gain * level[at]
    return p[at] + k * v[at] + h * a, v[at] + k * (a - dynamics.damping * v[at])


def against_feedback(
    signal: Steps, axis: str, dynamics: AxisBelief, feedback: Feedback, end: float, step: float
) -> Steps:
    """A signal that produces the same motion although a feedback holds the vehicle at the start.

    The feedback demands -(K p + D v) / g; the opposite for the believed motion, held over each step, is added to the
    signal. The feedback then corrects only what wind, trim and wrong beliefs add: it tracks the designed motion and
    takes nothing from the information of the design.

    Args:
        signal: The commands.
        axis: Its axis.
        dynamics: Belief about the axis; the feedback must believe in the same g.
        feedback: Feedback that acts on the axis, without a position reference there.
        end: End of the signal [s].
        step: How long each level is held [s]; the signal's own levels must change at its multiples.
    """
    a = AXES.index(axis)
    time = step * np.arange(int(end / step + 1e-9), dtype=np.float64)
    middle = time + step / 2
    position = motion_at(dynamics, signal, middle)[0]
    velocity = motion_at(dynamics, signal, middle - feedback.filter_time)[1]
    own = np.array([0.0, *signal.level])[np.searchsorted(np.array(signal.time), middle, side="right")]
    level = own + (feedback.stiffness[a] * position + feedback.damping[a] * velocity) / dynamics.gain
    return Steps((*np.maximum(time - EARLY, 0.0).tolist(), float(end)), (*level.tolist(), 0.0))


@dataclass(frozen=True)
class AxisInformation:
    """The information about (input / g, log b, tau) as a quadratic form of N commands held for one step each.

    Where the commands are levels convolved with a window, it is that of the levels.

    Attributes:
        dynamics: Coefficients at which it was computed.
        step: How long a command is held [s].
        duration: Duration of the flight, whose first N steps are the commands [s].
        form: Q_ij, symmetric in i and j and in the commands, shape (3, 3, N, N).
    """

    dynamics: AxisBelief
    step: float
    duration: float
    form: Array

    def products(self, command: Array) -> Array:
        """Q_ij u, shape (3, 3, N), for a command of shape (N,)."""
        upper = {(i, j): self.form[i, j] @ command for i in range(3) for j in range(i, 3)}
        return np.array([[upper[min(i, j), max(i, j)] for j in range(3)] for i in range(3)])

    def information(self, command: Array) -> Array:
        """M, shape (3, 3), for a command of shape (N,)."""
        return self.products(command) @ command

    def held(self, count: int) -> "AxisInformation":
        """The same for N // count commands that are held `count` times as long."""
        n = self.form.shape[-1] // count
        parts = self.form[:, :, : n * count, : n * count].reshape(3, 3, n, count, n, count)
        return replace(self, step=count * self.step, form=parts.sum(axis=(3, 5)))

    def errors(self, command: Array) -> Array:
        """Predicted standard errors of input and damping (relative) and delay [s], shape (3,)."""
        return np.asarray(np.sqrt(np.diag(np.linalg.inv(self.information(command)))))


def axis_information(
    dynamics: AxisBelief,
    levels: Array,
    duration: float,
    step: float,
    pose_rate: float = 120.0,
    window: Array = np.ones(1),  # noqa: B008 (never changed)
) -> AxisInformation:
    """Builds the form from the response to one pulse at a time, exact for held commands and averaged poses.

    Args:
        dynamics: Coefficients at which the sensitivities are evaluated; the damping must be positive.
        levels: log of q, r, alpha, kappa of the disturbance, shape (4,), as in
            `estimation.likelihood.parameters.Point`.
        duration: Duration of the flight, from its first command to its last pose [s].
        step: How long a command is held [s].
        pose_rate: Rate of fresh poses, the mocap's rate without its stale share [Hz].
        window: Pulse of W commands that each level makes; by default one command per level.
    """
    rec = _empty_record(duration, step, pose_rate)
    W, B, start = window.size, rec.count.size, rec.starts[0]
    N = rec.command_time.size - W
    gain, damping, delay = dynamics
    point = Point(
        np.array([gain]), np.log([damping]), np.array([delay]), np.zeros((1, 1)), np.zeros((1, 1)), levels[None]
    )
    columns = np.zeros((B, 3 * N + 2, 1))
    for k in range(N):
        pulse = np.zeros((N + W, 1))
        pulse[k : k + W, 0] = window
        since = start - np.minimum(rec.command_time[k : k + W + 1] + delay, start)  # for its parts, before scoring
        velocity = gain / damping * float(window @ np.diff(np.exp(-damping * since)))
        _, sensitivity = response(replace(rec, command=pulse), point, 0, np.array([[velocity]]))
        columns[:, k : 3 * N : N] = sensitivity[:, :3]
    columns[:, 3 * N :] = sensitivity[:, 3:]
    rows = whiten(rec, columns, levels[None])[0][:, :, 0]
    nuisance, _ = np.linalg.qr(rows[:, 3 * N :])
    sensitive = rows[:, : 3 * N] - nuisance @ (nuisance.T @ rows[:, : 3 * N])
    sensitive[:, :N] *= gain
    form = (sensitive.T @ sensitive).reshape(3, N, 3, N).transpose(0, 2, 1, 3)
    return AxisInformation(dynamics, step, duration, np.ascontiguousarray(0.5 * (form + form.transpose(1, 0, 2, 3))))


def _empty_record(duration: float, step: float, pose_rate: float) -> Record:
    """A record of one axis before the flight: regular poses, cut and averaged as in `record`, without commands."""
    low, high = DELAY_RANGE[1], duration + DELAY_RANGE[0]
    t = np.arange(int(np.ceil(low * pose_rate - 1e-9)), int(np.floor(high * pose_rate + 1e-9)) + 1) / pose_rate
    _, block = np.unique(np.floor((t - t[0]) * BLOCK_RATE + 1e-6), return_inverse=True)
    count = np.bincount(block).astype(float)
    block_time = np.bincount(block, t) / count
    steps, index = distinct_steps(block_time)
    command_time = step * np.arange(int(duration / step + 1e-9) + 1, dtype=np.float64)
    return Record(
        axes=("z",), starts=np.array([low]), pose_range=np.array([[0, t.size]]),
        command_range=np.array([[0, command_time.size]]), pose_time=t, yaw=np.zeros(t.size), block=block, count=count,
        block_time=block_time, steps=steps, step=index, block_yaw=np.zeros(count.size),
        position=np.zeros((count.size, 1)), fresh=np.arange(count.size) == 0, command_time=command_time,
        command=np.zeros((command_time.size, 1)), rested=np.zeros(1, bool), held=True, heading=0.0,
    )  # fmt: skip
