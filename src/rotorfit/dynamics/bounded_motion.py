"""The motion under a law of the first order with a bounded acceleration, and what the bound takes off it.

A velocity loop asks for the acceleration d = q - b v, where q is the demand g u(t - tau), behind a lag where there is
one. Its vehicle gives no more than A, in the direction asked for: v' = d min(1, A / |d|) + c.
"""

import numpy as np

from rotorfit.core.frames import Array
from rotorfit.core.laws import DAMPING, GAIN, LAG, ORDER, TRIM
from rotorfit.dynamics.compiled import kernel
from rotorfit.dynamics.general_step import lags_in_world


def bounded_motion(
    step: float, command: Array, yaw: Array, law: Array, velocity: Array, bounds: Array
) -> tuple[Array, Array]:
    """Accelerations asked for on a grid of G times, and what each of A bounds takes off them.

    Args:
        step: Step of the grid [s], short beside lag and 1 / b.
        command: Delayed command in force at each time, shape (G, K); two axes are forward and left.
        yaw: Heading, shape (G,) [rad]; ignored for one axis.
        law: Vectors of the law by axis, of the first order, with or without a lag on the input, shape (K, LAW_SIZE).
        velocity: World velocity at the start, shape (K,) [m/s or rad/s].
        bounds: Shape (A,) [m/s^2 or rad/s^2].

    Returns:
        Size of the acceleration asked for, shape (A, G); and what the bound adds to it, against its direction, in the
        heading frame, shape (A, G, K).
    """
    asked, taken = np.zeros((bounds.size, len(command))), np.zeros((bounds.size, *command.shape))
    _bounded_motion(step, command, yaw, law, velocity, bounds, asked, taken)
    return asked, taken


@kernel()
def _bounded_motion(
    step: float, command: Array, yaw: Array, law: Array, velocity: Array, bounds: Array, asked: Array, taken: Array
) -> None:
    """The compiled loop; fills `asked` and `taken`."""
    K = law.shape[0]
    y, world = K - 1, lags_in_world(law)
    keep_x = np.exp(-step / law[0, LAG]) if law[0, ORDER] == 1 else 0.0
    keep_y = np.exp(-step / law[y, LAG]) if law[y, ORDER] == 1 else 0.0
    for a in range(bounds.size):
        vx, vy, qx, qy = velocity[0], velocity[y], 0.0, 0.0
        for i in range(command.shape[0]):
            c, s = (np.cos(yaw[i]), np.sin(yaw[i])) if K == 2 else (1.0, 0.0)
            wx, wy = law[0, GAIN] * command[i, 0], (law[y, GAIN] * command[i, y]) if K == 2 else 0.0
            qc, qs = (c, s) if world else (1.0, 0.0)
            lx, ly = (wx, wy) if i == 0 else (qc * qx + qs * qy, qc * qy - qs * qx)
            lx, ly = wx + keep_x * (lx - wx), wy + keep_y * (ly - wy)
            qx, qy = qc * lx - qs * ly, qs * lx + qc * ly
            dx = lx - law[0, DAMPING] * (c * vx + s * vy)
            dy = ly - law[y, DAMPING] * (c * vy - s * vx) if K == 2 else 0.0
            size = np.hypot(dx, dy)
            share = min(1.0, bounds[a] / size) if size > 0 else 1.0
            asked[a, i] = size
            taken[a, i, 0] = (share - 1) * dx
            if K == 2:
                taken[a, i, 1] = (share - 1) * dy
            ax, ay = share * dx + law[0, TRIM], (share * dy + law[y, TRIM]) if K == 2 else 0.0
            vx, vy = vx + step * (c * ax - s * ay), vy + step * (s * ax + c * ay)
