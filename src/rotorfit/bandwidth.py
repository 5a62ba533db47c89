"""One number, the bandwidth w, to the law of an axis: every gain of a kind follows from it and from the model.

Where feedback decides, both poles of the tracking error stand at -w: K = w^2, D = 2 w - b. A vehicle that damps itself
faster than that keeps its own pole: D = 0, K = w (b - w). The slow disturbance is taken out at SLOW w: by the third
pole of an observer, or by an integral whose pole that is. Of LQR, w^4 is the price of the error's square over that of
the square of the acceleration asked for: without damping its poles are those of a Butterworth filter of that frequency.

Source: third-order pole placement; for observers by one bandwidth Z. Gao, Scaling and bandwidth-parameterization based
controller tuning, American Control Conference 2003. The optimal law of a vehicle with a delay is the optimal law
without it, at the predicted state, because nothing that is decided now can change what comes before: K. J. Åström,
B. Wittenmark, Computer-Controlled Systems (optimal control with delays). A test solves the
system that holds the commands under way.
"""

import numpy as np
from scipy.linalg import solve_discrete_are

from rotorfit.control_law import AxisLaw, Kind, held_step, motion_matrices
from rotorfit.held_motion import Dynamics

SLOW = 0.2
"""Pole of the disturbance over the bandwidth; chosen: at the same peak of the sensitivity gusts hardly feel it."""


def law_of_bandwidth(
    kind: Kind, vehicle: Dynamics, bandwidth: float, period: float, latency: float, filter_time: float
) -> AxisLaw:
    """The law of an axis.

    Args:
        kind: One of `control_law.KINDS`.
        vehicle: What the law believes.
        bandwidth: w [rad/s].
        period: Between commands [s].
        latency: From the exposure of a pose to the command that uses it [s].
        filter_time: Of the velocity that comes from poses: of the observer's fast poles, or of the difference [s].
    """
    g, b, delay = vehicle
    slow = SLOW * bandwidth
    if kind == "lqr":
        stiffness, rate = optimal_gains(vehicle, bandwidth, period)
    else:
        rate = max(2 * bandwidth - b, 0.0)
        stiffness = bandwidth * (b + rate - bandwidth)
    if kind == "linearising":
        integral, stiffness = slow * stiffness, stiffness + slow * (b + rate)
        rate += slow
        return AxisLaw(kind, period, g, b, delay, latency, stiffness, rate, integral, filter_time)
    poles = np.exp(-period * np.array([1 / filter_time, 1 / filter_time, slow]))
    return AxisLaw(kind, period, g, b, delay, latency, stiffness, rate, observer=observer_of_poles(b, period, poles))


def observer_of_poles(damping: float, period: float, poles: np.ndarray) -> tuple[float, float, float]:
    """Corrections that give the error of p, v, d these poles from one corrected estimate to the next, shape (3,).

    Source: Ackermann's formula for (F, C F), F being the motion over a period and C the pose.
    """
    F, _ = motion_matrices(damping, period)
    seen = np.array([F[0], F[0] @ F, F[0] @ F @ F])
    wanted = np.linalg.multi_dot([F - pole * np.eye(3) for pole in poles])
    p, v, d = (wanted @ np.linalg.solve(seen, [0.0, 0.0, 1.0])).tolist()
    return p, v, d


def optimal_gains(vehicle: Dynamics, bandwidth: float, period: float) -> tuple[float, float]:
    """K and D that minimise the sum of w^4 p^2 + (g u)^2, sampled, without the delay."""
    step, _, new = held_step(vehicle.damping, 0.0, period)
    A, B = step[:2, :2], new[:2, None]
    P = solve_discrete_are(A, B, np.diag([bandwidth**4, 0.0]), np.eye(1))
    K, D = np.linalg.solve(np.eye(1) + B.T @ P @ B, B.T @ P @ A)[0].tolist()
    return K, D
