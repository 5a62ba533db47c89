"""The control law of one axis, from a measured pose to a command, for a vehicle with a delay; as a linear system.

    v' = g u(t - delay) - b v + d                                  the vehicle, d slow: wind, trim
    u = (r'' + b r' + K (r - p) + D (r' - v) - d) / g              all at the instant at which u will act

The state at that instant is not measured yet. A `predictor` (and `lqr`, whose K and D are optimal) estimates p, v and d
at the last pose with an observer, and propagates them over the delay with the commands under way, exactly. The
`linearising` law and the `pid` use the error of the last pose instead, and its integral for d.

All gains follow from the model and one number, the bandwidth w. Both poles of the tracking error are at -w: K = w^2,
D = 2 w - b. Where b > 2 w that would speed nothing up: D = 0, K = w (b - w), with poles at -w and
-(b - w). The slow disturbance
is rejected at SLOW w, by the third pole of an observer or the pole of an integral. For LQR, w^4 is the weight of the
squared error relative to that of the squared acceleration: without damping its poles are those of a Butterworth filter
of that frequency.

Source: third-order pole placement; for observers by one bandwidth Z. Gao, Scaling and bandwidth-parameterization based
controller tuning, American Control Conference 2003. The optimal law of a vehicle with a delay is the optimal law
without it, applied to the predicted state, because no decision taken now can change what happens before it acts: K. J.
Åström, B. Wittenmark, Computer-Controlled Systems (optimal control with delays). A test solves the augmented system
that holds the commands under way.
"""

from dataclasses import dataclass
from functools import lru_cache
from typing import Literal

import numpy as np
from scipy.linalg import solve_discrete_are

from rotorfit.core.frames import Array
from rotorfit.dynamics.response import transition
from rotorfit.planning.axis_information import AxisBelief

Kind = Literal["predictor", "lqr", "linearising", "pid"]

KINDS: tuple[Kind, ...] = ("predictor", "lqr", "linearising")
"""Designs that follow from a model; `pid` is the form for gains from elsewhere."""

ROUNDING = 1e-9
"""Tolerance within which a delay is a whole number of periods [periods]."""


@dataclass(frozen=True)
class AxisLaw:
    """The law of one axis.

    Attributes:
        kind: Which law.
        period: Time between commands, each held until the next [s].
        input: g, acceleration per command [m/s^2 or rad/s^2]; 1 for gains in command per error.
        damping: b of the vehicle, in the observer and in the feed-forward [1/s].
        delay: Time from a command until it acts, as the law assumes it [s].
        latency: Time from the exposure of a pose to the command that uses it [s].
        stiffness: K [1/s^2]; for a `pid`, command per error.
        rate: D [1/s]; for a `pid`, command per rate of the error.
        integral: Gain of the integrated error [1/s^3]; 0 with an observer, whose d does the same.
        filter_time: Time constant of the filtered difference that gives the rate of the error [s]; 0 with an observer.
        observer: Corrections of p, v and d per error of the predicted pose, shape (3,) [1, 1/s, 1/s^2]; None without
            an observer.
        forward: Weight of r'' in the feed-forward: 1, or 0 for none.
    """

    kind: Kind
    period: float
    input: float
    damping: float
    delay: float
    latency: float
    stiffness: float
    rate: float
    integral: float = 0.0
    filter_time: float = 0.0
    observer: tuple[float, float, float] | None = None
    forward: float = 1.0

    @property
    def reach(self) -> float:
        """How far ahead of the pose the law must predict: latency plus delay [s]."""
        return self.latency + self.delay


def whole_periods(reach: float, period: float) -> tuple[int, float]:
    """The number of whole periods in a time [s], and the rest [s]."""
    whole = int(np.floor(reach / period + ROUNDING))
    return whole, max(reach - whole * period, 0.0)


def motion_matrices(damping: float, time: float) -> tuple[Array, Array]:
    """Transition of p, v, d over a time [s], shape (3, 3), and the effect of an acceleration held over it, shape (3,).

    Source: paper, eq. (4), with a constant disturbance; its closed form as in `response`.
    """
    f, k, h = transition(damping, time)[:3]
    return np.array([[1.0, k, h], [0.0, f, k], [0.0, 0.0, 1.0]]), np.array([h, k, 0.0])


@lru_cache(maxsize=64)  # each law is tried around many vehicles
def linear_system(law: AxisLaw, commands: int = 0) -> tuple[Array, Array, Array]:
    """The law for a reference of zero, s_k = A s_(k-1) + B y_k, u_k = C s_k, where y_k is the k-th measured pose.

    Args:
        law: The law.
        commands: Least number of commands in the state, the latest first, after its first three entries.

    Returns:
        A of shape (n, n), B and C of shape (n,), not to be written to. Entry 3 of the state is u_k, entry 3 + j is
        u_(k-j).
    """
    system = _with_observer(law, commands) if law.observer else _with_difference(law, commands)
    for part in system:
        part.flags.writeable = False
    return system


def _with_difference(law: AxisLaw, commands: int) -> tuple[Array, Array, Array]:
    """States: the pose, the filtered difference of the error and its integral."""
    n, h, fresh = 3 + max(commands, 1), law.period, 1 / (law.filter_time + law.period)
    A, B = _shifted(n)
    B[0] = 1.0
    A[1, :2], B[1] = (fresh, 1 - h * fresh), -fresh
    A[2, 2], B[2] = 1.0, -h
    A[3], B[3] = 0.0, -law.stiffness / law.input
    A[3] += (law.rate * A[1] + law.integral * A[2]) / law.input
    B[3] += (law.rate * B[1] + law.integral * B[2]) / law.input
    return A, B, np.eye(n)[3]


def _with_observer(law: AxisLaw, commands: int) -> tuple[Array, Array, Array]:
    """States: p, v and d at the last pose."""
    whole, rest = whole_periods(law.reach, law.period)
    n = 3 + max(commands, whole + 2)
    A, B = _shifted(n)
    step, late, new = held_step(law.damping, law.reach, law.period)
    A[:3, :3] = step
    A[:3, 3 + whole] += law.input * new
    A[:3, 4 + whole] += law.input * late
    correction = np.array(law.observer)
    A[:3] -= np.outer(correction, A[0])
    B[:3] = correction
    ahead, _ = motion_matrices(law.damping, law.reach)
    wish = np.array([law.stiffness, law.rate, 1.0]) / law.input
    A[3], B[3] = -wish @ ahead @ A[:3], -wish @ ahead @ B[:3]
    for j in range(whole + 1):  # the commands under way, the latest first; the oldest acts for the rest of its period
        left, _ = motion_matrices(law.damping, j * law.period)
        _, held = motion_matrices(law.damping, law.period if j < whole else rest)
        A[3, 3 + j] -= law.input * float(wish @ left @ held)
    return A, B, np.eye(n)[3]


@lru_cache(maxsize=4096)  # each vehicle is tried with many laws
def held_step(damping: float, reach: float, period: float) -> tuple[Array, Array, Array]:
    """p, v, d one period later: their transition, shape (3, 3), and the effects of two accelerations, shape (3,) each.

    The first is that of the command that still acts for the rest of `reach`, the second that of the next command. They
    are not to be written to.
    """
    _, rest = whole_periods(reach, period)
    after, new = motion_matrices(damping, period - rest)
    before, held = motion_matrices(damping, rest)
    moved = after @ before, after @ held, new
    for part in moved:
        part.flags.writeable = False
    return moved


def _shifted(n: int) -> tuple[Array, Array]:
    """A and B with only the part that shifts the stored commands by one place, shapes (n, n) and (n,)."""
    A = np.zeros((n, n))
    A[4:, 3:-1] = np.eye(n - 4)
    return A, np.zeros(n)


SLOW = 0.2
"""Pole of the disturbance over the bandwidth, chosen: at the same peak sensitivity it hardly matters against gusts."""


def law_of_bandwidth(
    kind: Kind, vehicle: AxisBelief, bandwidth: float, period: float, latency: float, filter_time: float
) -> AxisLaw:
    """The law of an axis for one bandwidth.

    Args:
        kind: One of `KINDS`.
        vehicle: The vehicle that the law assumes.
        bandwidth: w [rad/s].
        period: Time between commands [s].
        latency: Time from the exposure of a pose to the command that uses it [s].
        filter_time: Time constant of the velocity from poses: of the observer's fast poles, or of the difference [s].
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
    """Observer gains that place the poles of the error of p, v, d between corrected estimates, shape (3,).

    Source: Ackermann's formula for (F, C F), F being the motion over a period and C the pose.
    """
    F, _ = motion_matrices(damping, period)
    seen = np.array([F[0], F[0] @ F, F[0] @ F @ F])
    wanted = np.linalg.multi_dot([F - pole * np.eye(3) for pole in poles])
    p, v, d = (wanted @ np.linalg.solve(seen, [0.0, 0.0, 1.0])).tolist()
    return p, v, d


def optimal_gains(vehicle: AxisBelief, bandwidth: float, period: float) -> tuple[float, float]:
    """K [1/s^2] and D [1/s] that minimise the sum of w^4 p^2 + (g u)^2, sampled, without the delay."""
    step, _, new = held_step(vehicle.damping, 0.0, period)
    A, B = step[:2, :2], new[:2, None]
    P = solve_discrete_are(A, B, np.diag([bandwidth**4, 0.0]), np.eye(1))
    K, D = np.linalg.solve(np.eye(1) + B.T @ P @ B, B.T @ P @ A)[0].tolist()
    return K, D
