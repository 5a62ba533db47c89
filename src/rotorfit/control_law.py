"""The law of one axis between a measured pose and a command, for a vehicle that answers late; as a linear system.

    v' = g u(t - delay) - b v + d                                  the vehicle, d slow: wind, trim
    u = (r'' + b r' + K (r - p) + D (r' - v) - d) / g              all at the instant at which u will act

The vehicle of that instant is not measured yet. A `predictor` (and `lqr`, whose K and D are optimal) knows p, v and d
at the last pose from an observer, and moves them over the delay by the commands that are under way, exactly. The
`linearising` law and the `pid` take the error of the last pose instead, and an integral of it for d.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from rotorfit.frames import Array
from rotorfit.response import transition

Kind = Literal["predictor", "lqr", "linearising", "pid"]

KINDS: tuple[Kind, ...] = ("predictor", "lqr", "linearising")
"""Designs that follow from a model; `pid` is the form that gains from elsewhere are flown in."""

ROUNDING = 1e-9
"""A delay so close to a whole number of periods is that number [periods]."""


@dataclass(frozen=True)
class AxisLaw:
    """The law of one axis.

    Attributes:
        kind: Which law.
        period: Between commands, each held until the next [s].
        input: g, acceleration per command [m/s^2 or rad/s^2]; 1 for gains that are commands per error.
        damping: b of the vehicle: of its motion in the observer, and of r' in the feed-forward [1/s].
        delay: From a command until it acts, as far as the law knows of it [s].
        latency: From the exposure of a pose to the command that uses it [s].
        stiffness: K [1/s^2]; of a `pid`, command per error.
        rate: D [1/s].
        integral: Of the error [1/s^3]; 0 with an observer, whose d does the same.
        filter_time: Of the filtered difference that gives the rate of the error [s]; 0 with an observer.
        observer: Corrections of p, v and d per error of the predicted pose, shape (3,) [1, 1/s, 1/s^2]; None without.
        forward: Weight of r'' in the feed-forward: 1, or 0 where there is none.
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
        """How far ahead of the pose the law must look: latency and delay together [s]."""
        return self.latency + self.delay


def whole_periods(reach: float, period: float) -> tuple[int, float]:
    """Whole periods in a time, and the rest [s]."""
    whole = int(np.floor(reach / period + ROUNDING))
    return whole, max(reach - whole * period, 0.0)


def motion_matrices(damping: float, time: float) -> tuple[Array, Array]:
    """p, v, d after a time from p, v, d, shape (3, 3), and from an acceleration that is held over it, shape (3,).

    Source: paper, eq. (4), with a constant disturbance; its closed form as in `response`.
    """
    f, k, h = transition(damping, time)[:3]
    return np.array([[1.0, k, h], [0.0, f, k], [0.0, 0.0, 1.0]]), np.array([h, k, 0.0])


def linear_system(law: AxisLaw, commands: int = 0) -> tuple[Array, Array, Array]:
    """The law at rest of its reference, s_k = A s_(k-1) + B y_k, u_k = C s_k, where y_k is the k-th measured pose.

    Args:
        law: The law.
        commands: How many commands the state must at least hold, the latest first, behind its first three entries.

    Returns:
        A of shape (n, n), B and C of shape (n,). Entry 3 of the state is u_k, entry 3 + j is u_(k-j).
    """
    return _with_observer(law, commands) if law.observer else _with_difference(law, commands)


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


def held_step(damping: float, reach: float, period: float) -> tuple[Array, Array, Array]:
    """p, v, d one period later: from themselves, shape (3, 3), and from the accelerations that are asked for by the
    command that acts until the rest of `reach` has passed and by the next one, shape (3,) each."""
    _, rest = whole_periods(reach, period)
    after, new = motion_matrices(damping, period - rest)
    before, held = motion_matrices(damping, rest)
    return after @ before, after @ held, new


def _shifted(n: int) -> tuple[Array, Array]:
    """The part that moves every command one place on."""
    A = np.zeros((n, n))
    A[4:, 3:-1] = np.eye(n - 4)
    return A, np.zeros(n)
