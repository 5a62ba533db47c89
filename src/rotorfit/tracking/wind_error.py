"""What errors of the coefficients add to the error of the wind.

What pushes the vehicle is what its motion shows and the commands do not explain:

    w = a + b v - g u(t - tau)

so an error of the input g, the damping b or the delay tau is an error of w by what u and v have been, as the filter
averages them; and one of the trim c by the share of a constant push that the filter does not see.
"""

from collections.abc import Mapping

import numpy as np

from rotorfit.core.flight_data import Flight
from rotorfit.core.frames import AXES, Array, heading_from_world
from rotorfit.core.model import COEFFICIENTS, Interval
from rotorfit.dynamics.disturbance import distinct_steps
from rotorfit.dynamics.disturbance_state import disturbance_states
from rotorfit.estimation.judgement.estimand import estimands
from rotorfit.estimation.likelihood.axis_estimate import Estimate
from rotorfit.estimation.likelihood.coefficients import statuses
from rotorfit.estimation.likelihood.likelihood import inverted

RATE, BACK = 30.0, 10.0
"""Points a second [1/s] of so long ago [s] that an average is made of."""


def coefficient_error(
    flight: Flight, axis: str, estimate: Estimate, ci95: Mapping[str, Interval], own: Mapping[str, Interval]
) -> float:
    """Standard error of the wind of an axis at the last pose, by those of the coefficients [m/s^2, rad/s^2].

    Args:
        flight: So far.
        axis: Its name.
        estimate: Of the axis.
        ci95: Intervals of the vehicle by name.
        own: The same of this flight, which are as wide as the information says.
    """
    optimum, k = estimate.optimum, estimate.place
    told = estimands(optimum, k)
    weights = _response(np.exp(optimum.point.levels[k, :4]), told["damping"].value)
    time = flight.pose_time[-1] - np.arange(weights.size)[::-1] / RATE
    late = told.get("delay_plus_lag", told.get("delay"))
    by = {
        "input": -told["input"].value * weights @ _command(flight, axis, time - (late.value if late else 0.0)),
        "damping": told["damping"].value * weights @ _velocity(flight, axis, time),
    }
    if late:
        error = max(late.error(optimum), 1e-3)
        sooner, later = (weights @ _command(flight, axis, time - late.value + off) for off in (error, -error))
        by[late.name] = told["input"].value * (sooner - later) / (2 * error)
    widened = {name: _wider(name, ci95, own) for name in by}
    slope = np.sum([by[name] * widened[name] * told[name].slope for name in by], axis=0)
    trim = optimum.point.coefficients + optimum.point.trim.size - optimum.point.gain.size + k
    slope[trim] = (1 - weights.sum()) * max(widened.values())
    C = inverted(optimum.score.information, optimum.free)[: slope.size, : slope.size]
    return float(np.sqrt(max(slope @ C @ slope, 0.0)))


def tells_wind(own: Mapping[str, Interval]) -> bool:
    """Whether this flight knows the damping, through which the wind is told.

    Args:
        own: Intervals of this flight by name.
    """
    whole = {name: own.get(name, (None, None)) for name in COEFFICIENTS}
    return statuses(whole)["damping"] == "ok"


def _response(levels: Array, damping: float) -> Array:
    """By how much the filter's wind of now is of the push at each point of the last `BACK` seconds, the oldest first.

    From its answer to a push that begins once it has settled and then stays.
    """
    time = np.arange(round(2 * BACK * RATE)) / RATE
    pushed = np.maximum(time - BACK, 0.0)
    fallen = (pushed + np.expm1(-damping * pushed) / damping) / damping
    means, _ = disturbance_states(*distinct_steps(time), fallen, np.full(time.size, levels[1]), levels)
    answer = means[time >= BACK] @ np.array([0.0, damping, 1.0])
    return np.asarray(np.diff(answer, prepend=0.0)[::-1])


def _command(flight: Flight, axis: str, time: Array) -> Array:
    """The command in force at each time."""
    at = np.searchsorted(flight.command_time, time, side="right") - 1
    return np.asarray(flight.command[np.maximum(at, 0), AXES.index(axis)])


def _velocity(flight: Flight, axis: str, time: Array) -> Array:
    """The velocity along an axis at each time, as poses show it."""
    pose = np.column_stack([flight.position, flight.yaw])
    there = np.column_stack([np.interp(time, flight.pose_time, values) for values in pose.T])
    v = np.gradient(there, time, axis=0)
    v[:, :2] = heading_from_world(v[:, :2], there[:, 3])
    return np.asarray(v[:, AXES.index(axis)])


def _wider(name: str, ci95: Mapping[str, Interval], own: Mapping[str, Interval]) -> float:
    """How much wider the vehicle's interval of a coefficient is than this flight's; 1 where either is open."""
    low, high = ci95.get(name, (None, None))
    least, most = own.get(name, (None, None))
    if low is None or high is None or least is None or most is None or least == most:
        return 1.0
    return max((high - low) / (most - least), 1.0)
