"""The errors of the wind and of the velocity a second ahead that are due to the coefficients.

The wind is the part of the acceleration that the commands do not explain:

    w = a + b v - g u(t - tau)

An error of the input g, the damping b or the delay tau therefore propagates to w in proportion to u and v, averaged as
the filter averages them; an error of the trim c in proportion to the share of a constant push that the filter misses.
The prediction errs by what such a push has done to the velocity and the filter has not seen, and by all that it will
do until then.
"""

import functools
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from rotorfit.core.flight_data import Flight
from rotorfit.core.frames import AXES, Array, heading_from_world
from rotorfit.dynamics.disturbance import distinct_steps, step_tables
from rotorfit.dynamics.disturbance_state import disturbance_states
from rotorfit.dynamics.motion_filter import AHEAD
from rotorfit.estimation.likelihood.axis_estimate import Estimate
from rotorfit.estimation.likelihood.estimand import estimands
from rotorfit.estimation.likelihood.extra_parameters import conditional_covariance, estimated_extras
from rotorfit.estimation.likelihood.parameters import Point

RATE, BACK = 30.0, 10.0
"""Sampling rate [1/s] and length [s] of the averages over the past."""

AHEAD_SAMPLES = round(AHEAD * RATE)
"""Number of samples of the prediction."""

CONSTANT = np.array([1.0, 0.0])
"""Share of the trim in what is told as wind, and in the prediction apart from the push that it is."""


@dataclass(frozen=True)
class Doubt:
    """Standard errors of the motion of an axis that are due to its coefficients.

    Attributes:
        wind: Of the wind [m/s^2, rad/s^2].
        ahead: Of the velocity `AHEAD` later, in the frame of the coefficients [m/s, rad/s].
    """

    wind: float
    ahead: float


def coefficient_doubt(
    flight: Flight, axis: str, estimate: Estimate, widened: Mapping[str, float], velocity: tuple[float, float]
) -> Doubt:
    """Standard errors of the wind and of the prediction of an axis at the last pose, due to those of the coefficients.

    Args:
        flight: The flight so far.
        axis: Name of the axis.
        estimate: Its estimate.
        widened: Coefficient to the factor by which it is less certain than the information implies.
        velocity: Velocity now and predicted for `AHEAD` later, along the axis of the heading frame [m/s, rad/s].
    """
    optimum, k = estimate.optimum, estimate.place
    told = estimands(optimum, k)
    weights = _response(tuple(optimum.point.levels[k, :4]), told["damping"].value)
    past, future = weights.shape[1] - AHEAD_SAMPLES, np.arange(1, AHEAD_SAMPLES + 1) / RATE
    time = flight.pose_time[-1] + np.concatenate([np.arange(1 - past, 1) / RATE, future])
    late = told.get("delay_plus_lag", told.get("delay"))
    # what data cannot tell of a lag or zero, damping or delay makes up for, and the motion stays
    C = conditional_covariance(optimum, k, [extra.name for extra in estimated_extras(optimum, k)])
    now, later = velocity
    moving = np.concatenate([_velocity(flight, axis, time[:past]), now + (later - now) * future / AHEAD])
    by = {
        "input": -told["input"].value * weights @ _command(flight, axis, time - (late.value if late else 0.0)),
        "damping": told["damping"].value * weights @ moving,
    }
    if late:
        error = max(late.error(optimum, C), 1e-3)
        sooner, after = (weights @ _command(flight, axis, time - late.value + off) for off in (error, -error))
        widened = {**widened, late.name: widened.get("delay", 1.0)}
        by[late.name] = told["input"].value * (sooner - after) / (2 * error)
    slopes = np.sum([widened.get(name, 1.0) * np.outer(by[name], told[name].slope) for name in by], axis=0)
    slopes[:, _trim_at(optimum.point, k)] = (CONSTANT - weights.sum(axis=1)) * max(widened.values(), default=1.0)
    wind, ahead = np.sqrt(np.maximum(np.diag(slopes @ C[: slopes.shape[1], : slopes.shape[1]] @ slopes.T), 0.0))
    return Doubt(float(wind), float(ahead))


def trim_error(estimate: Estimate) -> float:
    """Standard error of the mean wind of an axis due to that of the trim, where the filter misses it [m/s^2, rad/s^2].

    Args:
        estimate: Of the axis.
    """
    optimum, k = estimate.optimum, estimate.place
    damping = estimands(optimum, k)["damping"].value
    missed = 1.0 - _response(tuple(optimum.point.levels[k, :4]), damping)[0].sum()
    at = _trim_at(optimum.point, k)
    return float(abs(missed) * np.sqrt(optimum.covariance[at, at]))


def _trim_at(point: Point, k: int) -> int:
    """Place of the last flight's trim of axis k among the parameters."""
    return point.coefficients + point.trim.size - point.gain.size + k


@functools.lru_cache(maxsize=16)
def _response(levels: tuple[float, ...], damping: float) -> Array:
    """Weights of a push that the law leaves out in the wind now and in the error of the prediction, the oldest first.

    They come from the filter's response to a constant push that begins after it has settled: the prediction knows of a
    past push what the filter has seen of it, and nothing of one in the second ahead.

    Args:
        levels: Logarithms of the levels of the disturbance.
        damping: Of the axis [1/s].

    Returns:
        At each point of the last `BACK` seconds and of the next `AHEAD`, shape (2, B + A).
    """
    powers = np.exp(levels)
    time = np.arange(round(2 * BACK * RATE)) / RATE
    pushed = np.maximum(time - BACK, 0.0)
    gained = -np.expm1(-damping * pushed) / damping
    fallen, noise = (pushed - gained) / damping, np.full(time.size, powers[1])
    means, _ = disturbance_states(*distinct_steps(time), fallen, noise, powers)
    wind = means @ np.array([0.0, damping, 1.0])
    later = step_tables(np.array([AHEAD]), powers[2], powers[3])[0][0, 1]
    missed = means @ later - np.exp(-damping * AHEAD) * gained
    since = time >= BACK
    past = np.diff([wind[since], missed[since]], prepend=0.0)[:, ::-1]
    future = np.exp(-damping * (AHEAD - np.arange(1, AHEAD_SAMPLES + 1) / RATE)) / RATE
    return np.hstack([past, [np.zeros(AHEAD_SAMPLES), -future]])


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
