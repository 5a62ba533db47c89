"""Run on: where the likeliest vehicle comes to rest if commands stop at the worst instant of a plan.

It obeys the last command for some seconds, then stops:

    v' = g u - b v with the last command u held, then v t + v |v| / (2 a)

with the believed g and b, and t and a of `stopping`.
"""

from dataclasses import dataclass

import numpy as np

from rotorfit.core.flight_plan import Plan
from rotorfit.core.frames import Array, world_from_heading
from rotorfit.planning.belief import belief_from_mapping
from rotorfit.planning.plan_control import tracker_of
from rotorfit.planning.precision import fly_plan, path
from rotorfit.planning.stopping import stopping
from rotorfit.simulation.paper_vehicle import noise_free


@dataclass(frozen=True)
class RunOn:
    """The worst case over all instants, each quantity by itself.

    Attributes:
        sideways: Horizontal distance from where commands stopped [m].
        upright: Vertical distance from there [m].
        outside: Distance outside the box at which the vehicle comes to rest [m]; 0 where it stays inside.
        instant: Instant of `outside` or, if that is 0, of the longest way [s from the start of the plan].
    """

    sideways: float
    upright: float
    outside: float
    instant: float


def run_on(plan: Plan, goes_on: float) -> RunOn:
    """Distance covered by a vehicle that obeys the last command for `goes_on` seconds after commands stop.

    Raises:
        PlanError: The plan's belief is incomplete.
        CardError: Its card is invalid.
    """
    tracker = tracker_of(plan)
    flight = fly_plan(tracker, noise_free(belief_from_mapping(plan.belief, f"plan {plan.name}").truth), plan.seed)
    at, seen = flight.command_stamp, flight.pose_stamp
    place = np.stack([np.interp(at, seen, column) for column in path(plan, flight).T], axis=1)
    speed = np.stack([np.interp(at, seen, column) for column in flight.velocity[:, :3].T], axis=1)
    yaw = place[:, 3]
    speed[:, :2] = world_from_heading(speed[:, :2], -yaw)
    gain, b = tracker.gamma[:6:2], np.maximum(tracker.gamma[1:6:2], 1e-3)
    push = gain * flight.command[:, :3]
    faded = -np.expm1(-b * goes_on) / b
    way = speed * faded + push * (goes_on - faded) / b
    speed = speed * np.exp(-b * goes_on) + push * faded
    believed = zip(gain, b, plan.belief["delay"][:3], tracker.full_scale[:3], strict=True)
    reaction, deceleration = np.array([stopping(*(float(number) for number in axis)) for axis in believed]).T
    way += speed * reaction + speed * np.abs(speed) / (2 * deceleration)
    way[:, :2] = world_from_heading(way[:, :2], yaw)
    return _worst(
        plan, np.asarray(at * 1e-9, np.float64), np.asarray(place[:, :3], np.float64), np.asarray(way, np.float64)
    )


def _worst(plan: Plan, time: Array, place: Array, way: Array) -> RunOn:
    flat, up = np.hypot(way[:, 0], way[:, 1]), np.abs(way[:, 2])
    rest = place + way
    beyond = np.maximum(np.array(plan.space.lower) - rest, rest - np.array(plan.space.upper)).max(axis=1)
    worst = int(np.argmax(beyond if beyond.max() > 0 else np.hypot(flat, up)))
    return RunOn(float(flat.max()), float(up.max()), float(max(beyond.max(), 0.0)), float(time[worst]))
