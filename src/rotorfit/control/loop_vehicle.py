"""A vehicle in a control loop: the small motion of one axis under its own law, sampled with a delay.

    v' = q - b v,  T q' = g u(t - tau) - q                      a lag T of the attitude loop
    T v'' + v' + b v = g (u + Z u')(t - tau)                    second order, with a zero Z

The drag b (1 - m + m |v|/V) v of `quadratic_drag` damps the small motion about a speed v by b (1 - m + 2 m |v|/V). A
loop has the least margins where a vehicle damps itself least: at hover, by b (1 - m). The acceleration limit of
`limited_acceleration` does not act on small motion.

Trims and disturbances do not change the stability of a loop and are left out.
"""

from functools import lru_cache
from typing import NamedTuple

import numpy as np

from rotorfit.control.control_law import held_step, whole_periods
from rotorfit.core.frames import Array
from rotorfit.core.laws import LAG, ZERO, Structure
from rotorfit.core.model import Predictor
from rotorfit.dynamics.transfer_function import has_transfer_function
from rotorfit.planning.axis_information import AxisBelief


class LaggedAxis(NamedTuple):
    """An axis whose law has a lag; the symbols are those above.

    Attributes:
        gain: g.
        damping: b [1/s].
        delay: tau [s].
        lag: T, positive [s].
        zero: Z [s]; 0 with a lag on the input.
        order: 1 for a lag on the input, 2 for the second order.
    """

    gain: float
    damping: float
    delay: float
    lag: float
    zero: float
    order: int


LoopVehicle = AxisBelief | LaggedAxis


def has_own_margins(structure: Structure) -> bool:
    """Whether the margins of a loop follow from a law: its small motion is linear, on one axis, and has a delay.

    A law that was chosen without a delay would promise too much.
    """
    return structure.delayed and (has_transfer_function(structure) or differs_at_hover(structure))


def has_quadratic_drag(structure: Structure) -> bool:
    """Whether the drag of a law grows with the speed, on one axis: it damps itself less at rest."""
    return structure.kicks == 1


def differs_at_hover(structure: Structure) -> bool:
    """Whether the small motion about hover, which a loop is made for, is another than that of large commands."""
    return has_quadratic_drag(structure) or structure.limited


def damping_at_rest(point: Predictor) -> float:
    """Damping of the small motion about hover [1/s]: less than b under quadratic drag."""
    return point.damping * (1.0 - point.extra.get("drag_share", 0.0))


def loop_vehicle(structure: Structure, point: Predictor) -> LoopVehicle | None:
    """The small motion of an axis about hover; None for a law that `has_own_margins` denies.

    No vehicle moves before its command: a delay below 0, as where stamps are off, counts as none.
    """
    if not has_own_margins(structure):
        return None
    extra = {one.place: point.extra[one.name] for one in structure.extras}
    delay = max(point.delay, 0.0)
    if LAG not in extra:
        return AxisBelief(point.input, damping_at_rest(point), delay)
    return LaggedAxis(point.input, point.damping, delay, extra[LAG], extra.get(ZERO, 0.0), structure.order)


def first_order_about(vehicle: LoopVehicle) -> AxisBelief:
    """A vehicle, without a zero, as one of the first order that is as late: its faster pole becomes delay."""
    if isinstance(vehicle, AxisBelief):
        return vehicle
    g, b, delay, lag, _, order = vehicle
    if order == 1:
        return AxisBelief(g, b, delay + lag)
    slow = 2.0 * b / (1.0 + np.sqrt(max(1.0 - 4.0 * b * lag, 0.0)))  # the time constants of both poles add to 1 / b
    return AxisBelief(g * slow / b, slow, delay + 1.0 / b - 1.0 / slow)


def vehicle_step(vehicle: LoopVehicle, reach: float, period: float) -> tuple[Array, Array, Array]:
    """The states of a vehicle one period later, position and velocity first, as `control_law.held_step` has them.

    Args:
        vehicle: The vehicle.
        reach: Time from the exposure of a pose until the command that uses it acts [s].
        period: Time between commands [s].

    Returns:
        Their transition, shape (n, n), and the effects of two commands, shape (n,) each: of the one that still acts for
        the rest of `reach`, and of the next.
    """
    if isinstance(vehicle, LaggedAxis):
        return _lagged_step(vehicle, whole_periods(reach, period)[1], period)
    step, late, new = held_step(vehicle.damping, reach, period)
    return step[:2, :2], vehicle.gain * late[:2], vehicle.gain * new[:2]


@lru_cache(maxsize=4096)  # each vehicle is tried with many laws
def _lagged_step(vehicle: LaggedAxis, rest: float, period: float) -> tuple[Array, Array, Array]:
    before, held = _held(vehicle, rest)
    after, new = _held(vehicle, period - rest)
    return after @ before, after @ held, new


def _held(vehicle: LaggedAxis, time: float) -> tuple[Array, Array]:
    """Transition over a time [s], shape (3, 3), and the effect of a command held over it, shape (3,).

    The third state is q, and for the second order v' less the jump g Z u / T that the zero gives it.
    """
    from scipy.linalg import expm

    g, b, _, T, Z, order = vehicle
    M = np.zeros((4, 4))
    if order == 2:
        M[:3] = [0, 1, 0, 0], [0, 0, 1, g * Z / T], [0, -b / T, -1 / T, g * (1 - Z / T) / T]
    else:
        M[:3] = [0, 1, 0, 0], [0, -b, 1, 0], [0, 0, -1 / T, g / T]
    moved = expm(M * time)
    return moved[:3, :3], moved[:3, 3]
