"""What the commands of one axis tell about input, damping and delay: a quadratic form of the command.

The model is linear in its commands, and so is every sensitivity: that of coefficient i is H_i u, already whitened by
the estimator's own filter, with the trim and the velocity of the start projected out of it. The Fisher information is

    M_ij = (H_i u)' (H_j u) = u' Q_ij u

so that the matrices Q_ij, built once, give the information of any command on the grid, and its gradient, at the cost
of a few products of matrix and vector.

Source: L. Ljung, System Identification, 2nd ed. (1999), section 13.2; the nuisances by the Schur complement.
"""

from dataclasses import dataclass, replace

import numpy as np

from rotorfit.disturbance import distinct_steps
from rotorfit.frames import Array
from rotorfit.held_motion import Dynamics
from rotorfit.likelihood import response, whiten
from rotorfit.point import Point
from rotorfit.record import BLOCK_RATE, DELAY_RANGE, Record


@dataclass(frozen=True)
class AxisInformation:
    """The information about (input / g, log b, tau) as a quadratic form of N commands held for one step each.

    Attributes:
        dynamics: Where it was taken.
        step: How long a command holds [s].
        duration: Of the flight, of which the commands are the first N steps [s].
        form: Q_ij, symmetric in i and j and in the commands, shape (3, 3, N, N).
    """

    dynamics: Dynamics
    step: float
    duration: float
    form: Array

    def products(self, command: Array) -> Array:
        """Q_ij u, shape (3, 3, N), of a command of shape (N,)."""
        upper = {(i, j): self.form[i, j] @ command for i in range(3) for j in range(i, 3)}
        return np.array([[upper[min(i, j), max(i, j)] for j in range(3)] for i in range(3)])

    def information(self, command: Array) -> Array:
        """M, shape (3, 3), of a command of shape (N,)."""
        return self.products(command) @ command

    def behind(self, window: Array) -> "AxisInformation":
        """The same of levels whose commands are these levels convolved with a window of W steps: N - W + 1 levels."""
        N, W = self.form.shape[-1], window.size
        smear = np.zeros((N, N - W + 1))
        for i, weight in enumerate(window):
            smear[np.arange(N - W + 1) + i, np.arange(N - W + 1)] = weight
        return replace(self, form=smear.T @ self.form @ smear)

    def errors(self, command: Array) -> Array:
        """Predicted standard errors of input and damping (shares of themselves) and delay [s], shape (3,)."""
        return np.asarray(np.sqrt(np.diag(np.linalg.inv(self.information(command)))))


def axis_information(
    dynamics: Dynamics, levels: Array, duration: float, step: float, pose_rate: float = 120.0
) -> AxisInformation:
    """Builds the form from the response to one pulse at a time, exact for held commands and averaged poses.

    Args:
        dynamics: At which the sensitivities are taken; the damping must be positive.
        levels: log of q, r, alpha, kappa of the disturbance, shape (4,), as in `point.Point`.
        duration: Of the flight, from its first command to its last pose [s].
        step: How long a command holds [s].
        pose_rate: Fresh poses a second, so the mocap's rate less its stale share [1/s].

    Source: paper, eq. (4) with a delay; `response` and `disturbance` for the sensitivities and the filter.
    """
    rec = _empty_record(duration, step, pose_rate)
    N, B, start = rec.command_time.size - 1, rec.count.size, rec.starts[0]
    gain, damping, delay = dynamics
    point = Point(
        np.array([gain]), np.log([damping]), np.array([delay]), np.zeros((1, 1)), np.zeros((1, 1)), levels[None]
    )
    columns = np.zeros((B, 3 * N + 2, 1))
    for k in range(N):
        pulse = np.zeros((N + 1, 1))
        pulse[k] = 1.0
        since = start - np.minimum(rec.command_time[k : k + 2] + delay, start)  # of its ends, before scoring starts
        velocity = gain / damping * float(np.diff(np.exp(-damping * since))[0])
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
    """A flight of one axis before it is flown: regular poses, cut and averaged as `record` does, no commands yet."""
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
        command=np.zeros((command_time.size, 1)), held=True, heading=0.0,
    )  # fmt: skip
