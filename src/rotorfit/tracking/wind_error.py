"""The error of the wind that is due to the coefficients.

The wind is the part of the acceleration that the commands do not explain:

    w = a + b v - g u(t - tau)

An error of the input g, the damping b or the delay tau therefore propagates to w in proportion to u and v, averaged as
the filter averages them; an error of the trim c in proportion to the share of a constant push that the filter misses.
"""

import functools
from collections.abc import Mapping

import numpy as np

from rotorfit.core.flight_data import Flight
from rotorfit.core.frames import AXES, Array, heading_from_world
from rotorfit.dynamics.disturbance import distinct_steps
from rotorfit.dynamics.disturbance_state import disturbance_states
from rotorfit.estimation.likelihood.axis_estimate import Estimate
from rotorfit.estimation.likelihood.estimand import estimands
from rotorfit.estimation.likelihood.extra_parameters import conditional_covariance, estimated_extras
from rotorfit.estimation.likelihood.parameters import Point

RATE, BACK = 30.0, 10.0
"""Sampling rate [1/s] and length [s] of the averages over the past."""


def coefficient_error(flight: Flight, axis: str, estimate: Estimate, widened: Mapping[str, float]) -> float:
    """Standard error of the wind of an axis at the last pose, due to those of the coefficients [m/s^2, rad/s^2].

    Args:
        flight: The flight so far.
        axis: Name of the axis.
        estimate: Its estimate.
        widened: Coefficient to the factor by which it is less certain than the information implies.
    """
    optimum, k = estimate.optimum, estimate.place
    told = estimands(optimum, k)
    weights = _response(tuple(optimum.point.levels[k, :4]), told["damping"].value)
    time = flight.pose_time[-1] - np.arange(weights.size)[::-1] / RATE
    late = told.get("delay_plus_lag", told.get("delay"))
    # what data cannot tell of a lag or zero, damping or delay makes up for, and the wind stays
    C = conditional_covariance(optimum, k, [extra.name for extra in estimated_extras(optimum, k)])
    by = {
        "input": -told["input"].value * weights @ _command(flight, axis, time - (late.value if late else 0.0)),
        "damping": told["damping"].value * weights @ _velocity(flight, axis, time),
    }
    if late:
        error = max(late.error(optimum, C), 1e-3)
        sooner, later = (weights @ _command(flight, axis, time - late.value + off) for off in (error, -error))
        widened = {**widened, late.name: widened.get("delay", 1.0)}
        by[late.name] = told["input"].value * (sooner - later) / (2 * error)
    slope = np.sum([by[name] * widened.get(name, 1.0) * told[name].slope for name in by], axis=0)
    slope[_trim_at(optimum.point, k)] = (1 - weights.sum()) * max(widened.values(), default=1.0)
    return float(np.sqrt(max(slope @ C[: slope.size, : slope.size] @ slope, 0.0)))


def trim_error(estimate: Estimate) -> float:
    """Standard error of the mean wind of an axis due to that of the trim, where the filter misses it [m/s^2, rad/s^2].

    Args:
        estimate: Of the axis.
    """
    optimum, k = estimate.optimum, estimate.place
    damping = estimands(optimum, k)["damping"].value
    missed = 1.0 - _response(tuple(optimum.point.levels[k, :4]), damping).sum()
    at = _trim_at(optimum.point, k)
    return float(abs(missed) * np.sqrt(optimum.covariance[at, at]))


def _trim_at(point: Point, k: int) -> int:
    """Place of the last flight's trim of axis k among the parameters."""
    return point.coefficients + point.trim.size - point.gain.size + k


@functools.lru_cache(maxsize=16)
def _response(levels: tuple[float, ...], damping: float) -> Array:
    """Weight of the push at each point of the last `BACK` seconds in the filter's wind now, the oldest first.

    They come from the filter's response to a constant push that begins after it has settled.

    Args:
        levels: Logarithms of the levels of the disturbance.
        damping: Of the axis [1/s].
    """
    powers = np.exp(levels)
    time = np.arange(round(2 * BACK * RATE)) / RATE
    pushed = np.maximum(time - BACK, 0.0)
    fallen = (pushed + np.expm1(-damping * pushed) / damping) / damping
    means, _ = disturbance_states(*distinct_steps(time), fallen, np.full(time.size, powers[1]), powers)
    answer = means[time >= BACK] @ np.array([0.0, damping, 1.0])
    return np.asarray(np.diff(answer, prepend=0.0)[::-1])


def _command(flight: Flight, axis: str, time: Array) -> Array:
    """The command that was in force at each time, shape of `time` [unit of the card's command]."""
    at = np.searchsorted(flight.command_time, time, side="right") - 1
    return np.asarray(flight.command[np.maximum(at, 0), AXES.index(axis)])


def _velocity(flight: Flight, axis: str, time: Array) -> Array:
    """The velocity along an axis of the heading frame at each time, from the poses, shape of `time` [m/s, rad/s]."""
    i = max(int(np.searchsorted(flight.pose_time, time[0])) - 1, 0)
    pose = np.column_stack([flight.position[i:], flight.yaw[i:]])
    there = np.column_stack([np.interp(time, flight.pose_time[i:], values) for values in pose.T])
    v = np.gradient(there, time, axis=0)
    v[:, :2] = heading_from_world(v[:, :2], there[:, 3])
    return np.asarray(v[:, AXES.index(axis)])
