"""Levels of disturbance and noise: their names for each kind of measurement, search ranges, start values; usual trims.

Structures: the laws that an axis may obey, and the parameters that each adds to gain, damping and delay.

One general law holds them all; along one axis of the heading frame, with the delayed command u,

    w = g (1 + s sign u) min(max(|u| - D, 0), L) sign u + h u'         what the command demands
    T q' = w - q,   v' = q - b (1 - m + m |v| / V) v - k v' + c        first-order lag T of the attitude loop
    T v'' + v' + b v = w + Z dw/dt + c                                 second order instead
    T v'' + v' = min(max(w - b v, -A), A) + c                          a velocity loop that asks for A at most

In the world frame the lagged demand q of x and y keeps its direction while the vehicle turns, else it turns, too.

u' and v' in the last terms of the first and second lines are those of the other horizontal axis. A structure states
which of the further parameters are estimated; the others keep the values at which they have no effect
(s = D = h = m = k = T = Z = 0, L and A infinite).

The steady gain is g / b under every linear law. The total lag, minus the slope of the phase at zero frequency, is
tau + T + 1 / b with a lag on the input and tau + 1 / b - Z for a second order.
"""

import functools
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np

from rotorfit.core.errors import ModelError
from rotorfit.core.frames import Array

Measured = Literal["position", "velocity", "both"]
"""What the blocks of poses contain."""

LEVELS_OF: dict[Measured, tuple[str, ...]] = {
    "position": ("wind_power", "pose_variance", "wind_damping", "wind_overlap"),
    "velocity": ("wind_power", "velocity_variance", "wind_damping", "wind_overlap"),
    "both": ("wind_power", "pose_variance", "wind_damping", "wind_overlap", "velocity_variance"),
}
"""Names of the L levels: q [unit^2/s^5], r [unit^2], alpha [1/s], kappa in (0, 1], and r_v [unit^2/s^2], the variance
of one velocity measurement without its rounding."""

LEVEL_RANGE = np.log(np.array([[1e-9, 1e4], [1e-12, 1e-2], [0.05, 200.0], [1e-3, 1.0]]))
"""Logarithmic bounds of the disturbance levels q, r, alpha, kappa, shape (4, 2)."""

START_LEVELS = np.log(np.array([0.1, 1e-7, 2.5, 0.64]))
"""Start values of the logarithmic levels q, r, alpha, kappa, shape (4,)."""

VELOCITY_RANGE = np.log(np.array([1e-9, 1.0]))
"""Logarithmic bounds of the variance of a velocity, shape (2,) [m^2/s^2]."""

START_VELOCITY = np.log(1e-3)
"""Its start value."""


USUAL_TRIM = (0.05, 0.05, 0.03, 0.02)
"""Standard deviation of the trims of x, y, z, yaw [m/s^2; rad/s^2 for yaw]: a tilt of 0.3 degrees is 0.05 m/s^2."""


@functools.cache
def level_range(measured: Measured) -> Array:
    """Logarithmic bounds of the L levels in the order of `LEVELS_OF`, shape (L, 2)."""
    if measured == "both":
        return np.vstack([LEVEL_RANGE, VELOCITY_RANGE])
    out: Array = LEVEL_RANGE.copy()
    if measured == "velocity":
        out[1] = VELOCITY_RANGE
    return out


def start_levels(measured: Measured) -> Array:
    """Start values of the L logarithmic levels in the order of `LEVELS_OF`, shape (L,)."""
    if measured == "both":
        return np.append(START_LEVELS, START_VELOCITY)
    out: Array = START_LEVELS.copy()
    if measured == "velocity":
        out[1] = START_VELOCITY
    return out


(
    GAIN, DAMPING, DELAY, TRIM, LAG, ASYMMETRY, LEVEL, DEAD, SHARE, SPEED, CROSS_INPUT, CROSS_DAMPING, ORDER, KICKS,
    ZERO, WORLD, LIMIT,
) = range(17)  # fmt: skip
"""Indices into the vector of the general law: g, b, tau, c, T, s, L, D, m, V, h, k; order of the lag (0 none, 1 on the
input, 2 second order); what acts on the velocity besides linear damping (1 quadratic drag, 2 the other axis, 4 the
limit A); Z; whether the lag is in the world frame; and A."""

LAW_SIZE = 17


@dataclass(frozen=True)
class Extra:
    """A parameter that a structure adds.

    Attributes:
        name: Name in the model file.
        place: Index in the vector of the general law.
        low: Lower bound of the search.
        high: Upper bound of the search.
        logarithmic: Whether its logarithm is estimated.
        estimated: Whether it is estimated at all; else it is a constant derived from the others.
        unit: `s`, `1/s`, `speed` (m/s or rad/s), `acceleration`, `command` (that of the command), `gain` (acceleration
            per command), or empty for a dimensionless number.
        closed: Whether the upper bound is an admissible value, so that an interval may end there.
    """

    name: str
    place: int
    low: float
    high: float
    logarithmic: bool = False
    estimated: bool = True
    unit: str = ""
    closed: bool = False

    def coordinate(self, value: float) -> float:
        """Coordinate that the estimator varies: the value or its logarithm."""
        return float(np.log(value)) if self.logarithmic else value

    def value(self, coordinate: float) -> float:
        """The parameter at a coordinate."""
        return float(np.exp(coordinate)) if self.logarithmic else float(coordinate)


@dataclass(frozen=True)
class Structure:
    """A law with the parameters that it leaves free besides gain, damping and trim.

    Attributes:
        name: Name on the command line.
        law: The equation, as one line of text.
        extras: Further parameters.
        delayed: Whether the delay is estimated; else it is 0.
        order: Order of the lag: 0 none, 1 on the input, 2 of the velocity itself.
        world: Whether the lagged demand q of x and y keeps its direction in the world while the vehicle turns.
        twice: Whether the command passes its lag twice, as an inner loop of the second order.
        linear: Whether the motion is linear in commands and state.
        tried: Axes for which `auto` tries the structure.
    """

    name: str
    law: str
    extras: tuple[Extra, ...] = ()
    delayed: bool = True
    order: int = 0
    world: bool = False
    twice: bool = False
    linear: bool = True
    tried: tuple[str, ...] = ("x", "y", "z", "yaw")

    @property
    def size(self) -> int:
        """Number of estimated parameters besides gain and damping."""
        return self.delayed + sum(extra.estimated for extra in self.extras)

    @property
    def kicks(self) -> int:
        """What acts on the velocity besides linear damping: 1 quadratic drag, 2 the other axis, 4 a limit."""
        places = {extra.place for extra in self.extras}
        return (SHARE in places) + 2 * (CROSS_DAMPING in places) + 4 * (LIMIT in places)

    @property
    def coupled(self) -> bool:
        """Whether x and y move each other."""
        return bool(self.kicks & 2)

    @property
    def limited(self) -> bool:
        """Whether the acceleration asked for is limited."""
        return bool(self.kicks & 4)


_LAG = Extra("lag", LAG, 0.005, 2.0, logarithmic=True, unit="s")

_ZERO = Extra("zero", ZERO, 0.0, 2.0, unit="s")

_DRAG = (
    Extra("drag_share", SHARE, 0.0, 1.0, closed=True),
    Extra("reference_speed", SPEED, 0.0, np.inf, False, False, "speed"),
)

_CROSS = (
    Extra("cross_input", CROSS_INPUT, -np.inf, np.inf, unit="gain"),
    Extra("cross_damping", CROSS_DAMPING, -np.inf, np.inf, unit="1/s"),
)

AVERAGED = "averaged"
"""Selects the default: delay and lag, or a second order with a zero where the data require it; see `law_average`."""

FIRST_ORDER_DELAY = Structure("first_order_delay", "v' = g u(t - tau) - b v + c")

STRUCTURES: Mapping[str, Structure] = {
    structure.name: structure
    for structure in (
        Structure("first_order", "v' = g u - b v + c, the paper's", delayed=False),
        FIRST_ORDER_DELAY,
        Structure("first_order_lag", "v' = q - b v + c, T q' = g u - q", (_LAG,), delayed=False, order=1),
        Structure("first_order_delay_lag", "v' = q - b v + c, T q' = g u(t - tau) - q", (_LAG,), order=1),
        Structure(
            "first_order_delay_world_lag",
            "v' = q - b v + c, T q' = g u(t - tau) - q, q in the world frame",
            (_LAG,),
            order=1,
            world=True,
            tried=("x", "y"),
        ),
        Structure("quadratic_drag", "v' = g u(t - tau) - b (1 - m + m |v|/V) v + c", _DRAG, linear=False),
        Structure(
            "climb_descent",
            "v' = g (1 + s sign u) u(t - tau) - b v + c",
            (Extra("asymmetry", ASYMMETRY, -0.95, 0.95),),
            linear=False,
            tried=("z",),
        ),
        Structure(
            "saturation",
            "v' = g u(t - tau) - b v + c, |u| no more than L",
            (Extra("level", LEVEL, 1e-4, 1e4, logarithmic=True, unit="command"),),
            linear=False,
        ),
        Structure(
            "dead_zone",
            "v' = g u(t - tau) - b v + c, |u| less D",
            (Extra("dead_zone", DEAD, 0.0, 1e4, unit="command"),),
            linear=False,
        ),
        Structure(
            "coupled", "v' = g u(t - tau) + h u' - b v - k v' + c, u', v' across", _CROSS, tried=("x", "y")
        ),
        Structure(
            "second_order", "T v'' + v' + b v = g u(t - tau) + c", (_LAG,), order=2
        ),
        Structure(
            "second_order_zero",
            "T v'' + v' + b v = g (u + Z u')(t - tau) + c",
            (_LAG, _ZERO),
            order=2,
        ),
        Structure(
            "limited_acceleration",
            "T v'' + v' = (g u(t - tau) - b v, within -A and A) + c",
            (_LAG, Extra("acceleration_limit", LIMIT, 0.01, 100.0, logarithmic=True, unit="acceleration")),
            order=2,
            linear=False,
            tried=("x", "y", "z"),
        ),
    )
}  # fmt: skip
"""Every structure by its name, simplest first."""


def structure_named(name: str) -> Structure:
    """The structure with a given name.

    Raises:
        ModelError: No structure has this name.
    """
    if name not in STRUCTURES:
        raise ModelError(f"no such structure: {name!r}; structures are {', '.join(STRUCTURES)}")
    return STRUCTURES[name]


def law_of(
    structure: Structure, gain: float, damping: float, delay: float, extra: Mapping[str, float], trim: float = 0.0
) -> Array:
    """The vector of the general law, shape (LAW_SIZE,).

    Args:
        structure: Structure that defines the parameters.
        gain: g [m/s^2 or rad/s^2 per unit of the command].
        damping: b [1/s].
        delay: tau [s].
        extra: Name to value of the further parameters.
        trim: c [m/s^2 or rad/s^2].
    """
    law = np.zeros(LAW_SIZE)
    law[[GAIN, DAMPING, DELAY, TRIM, LEVEL, LIMIT]] = gain, damping, delay, trim, np.inf, np.inf
    law[[ORDER, KICKS, WORLD]] = structure.order, structure.kicks, structure.world
    for one in structure.extras:
        law[one.place] = extra[one.name]
    return law


DELAY_RANGE = (-0.1, 0.6)
"""Range of delays that is searched [s]. It extends below zero because a bound at zero biases; a negative optimum is a
finding."""


def given_by_law(structure: str) -> tuple[str, ...]:
    """Coefficients fixed by the law, about which the data say nothing: the delay, for a law without one."""
    return () if structure_named(structure).delayed else ("delay",)
