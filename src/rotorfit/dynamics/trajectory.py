"""Model -> Trajectory: the motion of a model under commands, and the model as a state space."""

from dataclasses import dataclass

import numpy as np

from rotorfit.core.display import short_repr
from rotorfit.core.errors import ModelError
from rotorfit.core.frames import AXES, Array
from rotorfit.core.laws import FIRST_ORDER_DELAY, law_of, structure_named
from rotorfit.core.model import Model, Predictor, predictor_of


@dataclass(frozen=True)
class StateSpace:
    """Linear model of the excited axes in a frame with a constant heading: x' = A x + B u(t - delay), y = C x.

    Attributes:
        axes: The n axes. The states are their positions, their velocities, then the states of structures with a lag:
            the lagged input, or for a second order the acceleration without the part that a zero adds to it.
        A: Shape (2 n + lags, 2 n + lags).
        B: Shape (2 n + lags, n).
        C: Selects the positions, shape (n, 2 n + lags).
        delay: One per input, shape (n,) [s].
    """

    axes: tuple[str, ...]
    A: Array
    B: Array
    C: Array
    delay: Array


def state_space(model: Model) -> StateSpace:
    """Linear state space of the excited axes in the heading frame.

    Raises:
        ModelError: No axis has a predictor, or the structure of one is not linear.

    Source: paper, eq. (4), with an input delay; the linear laws of `core.laws`.
    """
    axes = tuple(axis for axis in AXES if model.axes[axis].predictor)
    if not axes:
        raise ModelError("the model has no excited axis: nothing to build a state space from; fit a flight that moves")
    points = [predictor_of(model, axis) for axis in axes]
    structures = [structure_named(model.axes[axis].structure) for axis in axes]
    bent = [axis for axis, structure in zip(axes, structures, strict=True) if not structure.linear]
    if bent:
        raise ModelError(f"the structure of {', '.join(bent)} is not linear and has no state space; fit a linear one")
    n = len(axes)
    lags = [i for i, structure in enumerate(structures) if structure.order]
    A, B = np.zeros((2 * n + len(lags),) * 2), np.zeros((2 * n + len(lags), n))
    A[:n, n : 2 * n] = np.eye(n)
    for i, (point, structure) in enumerate(zip(points, structures, strict=True)):
        v = at = n + i
        if structure.order:
            at, T = 2 * n + lags.index(i), point.extra["lag"]
            A[v, at], A[at, at], B[at, i] = 1.0, -1 / T, point.input / T
            if structure.order == 2:
                lead = point.extra.get("zero", 0.0) / T
                A[at, v] = -point.damping / T
                B[v, i], B[at, i] = lead * point.input, (1 - lead) * point.input / T
        else:
            B[v, i] = point.input
        if structure.order < 2:
            A[v, v] = -point.damping
        other = {"x": "y", "y": "x"}.get(axes[i])
        if structure.coupled and other in axes:
            j = axes.index(other)
            B[v, j], A[v, n + j] = point.extra["cross_input"], -point.extra["cross_damping"]
    C = np.hstack([np.eye(n), np.zeros((n, len(A) - n))])
    return StateSpace(axes, A, B, C, np.array([p.delay for p in points]))


TURN_STEP = 0.005
"""Longest step of `simulate` [s]: the heading is held over each, so sparse times would turn x and y too late."""


@dataclass(frozen=True)
class Trajectory:
    """A simulated motion: times (N,), pose x, y, z, yaw (N, 4) and its rate (N, 4), world frame, SI."""

    time: Array
    pose: Array
    velocity: Array

    __repr__ = short_repr


def simulate(
    model: Model,
    command_time: Array,
    command: Array,
    time: Array,
    pose: Array | None = None,
    velocity: Array | None = None,
    before: Array | None = None,
) -> Trajectory:
    """Motion under held commands from a given state; axes without a predictor keep their velocity.

    Args:
        model: The model.
        command_time: Increasing stamps, shape (M,) [s]. A command is held until the next.
        command: x, y, z, yaw commands in the heading frame, shape (M, 4).
        time: Increasing times at which the motion is evaluated, shape (N,) [s]; the motion starts at the first.
        pose: World x, y, z, yaw at the first time, shape (4,) [m, rad]; the origin by default.
        velocity: Its rate, shape (4,) [m/s, rad/s]; rest by default.
        before: Command in force until the first one acts, shape (4,); zero by default.

    Returns:
        The trajectory, without trim and disturbance.

    Raises:
        ModelError: No times, times that do not increase, or a number that is not finite.

    Source: paper, eq. (5), with u(t - delay).
    """
    from rotorfit.dynamics.predictor import free_run

    pose = np.zeros(4) if pose is None else np.asarray(pose, float)
    velocity = np.zeros(4) if velocity is None else np.asarray(velocity, float)
    time, command_time, command = (np.asarray(a, float) for a in (time, command_time, command))
    for name, given in (("time", time), ("command_time", command_time)):
        if not given.size:
            raise ModelError(f"{name} is empty: give at least one")
        if not np.all(np.diff(given) > 0):
            raise ModelError(f"{name} does not increase: give each time once, in order")
    if not all(np.isfinite(one).all() for one in (time, command_time, command, pose, velocity)):
        raise ModelError("times, commands and the start must be finite numbers")
    command_time = np.append(command_time[:1] - 1.0, command_time)  # the stamp itself plays no role
    command = np.vstack([np.zeros(4) if before is None else before, command])
    points = [model.axes[axis].predictor or Predictor(0.0, 0.0, 0.0) for axis in AXES]
    structures = [structure_named(model.axes[axis].structure) for axis in AXES]
    laws = np.array([
        law_of(s if model.axes[a].predictor else FIRST_ORDER_DELAY, p.input, p.damping, p.delay, p.extra)
        for s, p, a in zip(structures, points, AXES, strict=True)
    ])  # fmt: skip

    at = np.union1d(time, np.arange(time[0], time[-1], TURN_STEP))
    wanted = np.searchsorted(at, time)

    def run(pair: list[int], heading: Array) -> Array:
        return free_run(
            command_time, np.ascontiguousarray(command[:, pair]), laws[pair], pose[pair], velocity[pair], at, heading
        )

    side = run([2, 3], np.zeros(at.size))
    plane = run([0, 1], np.ascontiguousarray(side[:, 1]))[wanted]
    side = side[wanted]
    return Trajectory(time, np.hstack([plane[:, :2], side[:, :2]]), np.hstack([plane[:, 2:], side[:, 2:]]))
