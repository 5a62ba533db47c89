"""The motion under a law of the first order with a limited acceleration, and what the limits add to the law's.

A velocity loop asks for the acceleration d = q - b v, where q is the demand g u(t - tau), behind a lag where there is
one. Its vehicle gives no more than A, in the direction asked for, and changes it by no more than J in a second:
v' = a + trim, where a follows d min(1, A / |d|) with |a'| <= J.
"""

import numpy as np

from rotorfit.core.compiled import kernel
from rotorfit.core.frames import Array
from rotorfit.core.laws import DAMPING, GAIN, LAG, ORDER, TRIM
from rotorfit.dynamics.general_step import lags_in_world


def limited_motion(
    step: float,
    command: Array,
    yaw: Array,
    law: Array,
    velocity: Array,
    acceleration: float = np.inf,
    jerk: float = np.inf,
) -> tuple[Array, Array, Array]:
    """Motion on a grid of G times.

    Args:
        step: Step of the grid [s], short beside lag and 1 / b.
        command: Delayed command in force at each time, shape (G, K); two axes are forward and left.
        yaw: Heading, shape (G,) [rad]; ignored for one axis.
        law: Vectors of the law by axis, of the first order, with or without a lag on the input, shape (K, LAW_SIZE).
        velocity: World velocity at the start, shape (K,) [m/s or rad/s].
        acceleration: Largest acceleration A [m/s^2 or rad/s^2].
        jerk: Largest jerk J [m/s^3 or rad/s^3].

    Returns:
        Size of the acceleration asked for, shape (G,); what the limits add to it, a - d, and the velocity, both in the
        heading frame, shape (G, K).
    """
    asked, added, moved = np.zeros(len(command)), np.zeros(command.shape), np.zeros(command.shape)
    _limited_motion(step, command, yaw, law, velocity, acceleration, jerk, asked, added, moved)
    return asked, added, moved


@kernel()
def _limited_motion(
    step: float,
    command: Array,
    yaw: Array,
    law: Array,
    velocity: Array,
    acceleration: float,
    jerk: float,
    asked: Array,
    added: Array,
    moved: Array,
) -> None:
    """The compiled loop; fills `asked`, `added` and `moved`. What is not named of the heading is of the world."""
    K = law.shape[0]
    y, world = K - 1, lags_in_world(law)
    keep_x = np.exp(-step / law[0, LAG]) if law[0, ORDER] == 1 else 0.0
    keep_y = np.exp(-step / law[y, LAG]) if law[y, ORDER] == 1 else 0.0
    vx, vy, qx, qy, ax, ay = velocity[0], velocity[y], 0.0, 0.0, 0.0, 0.0
    for i in range(command.shape[0]):
        c, s = (np.cos(yaw[i]), np.sin(yaw[i])) if K == 2 else (1.0, 0.0)
        wx, wy = law[0, GAIN] * command[i, 0], (law[y, GAIN] * command[i, y]) if K == 2 else 0.0
        qc, qs = (c, s) if world else (1.0, 0.0)
        lx, ly = (wx, wy) if i == 0 else (qc * qx + qs * qy, qc * qy - qs * qx)
        lx, ly = wx + keep_x * (lx - wx), wy + keep_y * (ly - wy)
        qx, qy = qc * lx - qs * ly, qs * lx + qc * ly
        forward, left = c * vx + s * vy, (c * vy - s * vx) if K == 2 else 0.0
        dx = lx - law[0, DAMPING] * forward
        dy = ly - law[y, DAMPING] * left if K == 2 else 0.0
        size = np.hypot(dx, dy)
        share = min(1.0, acceleration / size) if size > 0 else 1.0
        jx, jy = share * (c * dx - s * dy) - ax, share * (s * dx + c * dy) - ay
        change = np.hypot(jx, jy)
        part = min(1.0, jerk * step / change) if i > 0 and change > 0 else 1.0
        ax, ay = ax + part * jx, ay + part * jy
        asked[i] = size
        added[i, 0], moved[i, 0] = c * ax + s * ay - dx, forward
        if K == 2:
            added[i, 1], moved[i, 1] = c * ay - s * ax - dy, left
        trim_x, trim_y = law[0, TRIM], (law[y, TRIM] if K == 2 else 0.0)
        vx, vy = vx + step * (ax + c * trim_x - s * trim_y), vy + step * (ay + s * trim_x + c * trim_y)
