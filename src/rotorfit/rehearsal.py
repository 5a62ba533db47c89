"""Rehearsal: a plan flown by the paper's vehicle, in a room that is believed possible."""

import functools
from dataclasses import replace

import numpy as np

from rotorfit.card_file import load_card
from rotorfit.flight import Flight, flight_from_log
from rotorfit.frames import AXES, Array
from rotorfit.paper_log import as_log
from rotorfit.paper_vehicle import HOVER_HEIGHT, Controller, SimulatedFlight, Truth, simulate_flight
from rotorfit.plan import Four, Plan
from rotorfit.tracking import Tracker, command_at, reference_at

COARSE = 0.02  # s, longest step of the integration: with it a path of 60 s is right to a tenth of a millimetre


def flown(tracker: Tracker, truth: Truth, seed: int) -> SimulatedFlight:
    """Flies a plan, its feedback and full scale included.

    Args:
        tracker: The plan, and what its feedback believes.
        truth: What is flown; commands come at the rate of the plan.
        seed: Of wind and noise.

    Returns:
        The flight, from rest at `paper_vehicle.HOVER_HEIGHT` above the origin, with the heading of the plan's start.
    """
    plan, feedback = tracker.plan, tracker.plan.feedback
    truth = replace(truth, command_rate=plan.rate, command_jitter=min(truth.command_jitter, 0.2 / plan.rate))
    scale = _four(tracker.full_scale)
    controller = Controller(axes=(), full_scale=scale)
    if feedback:
        controller = Controller(
            feedback.stiffness, feedback.damping, feedback.filter_time, feedback.axes,
            tuple(map(float, tracker.gamma)), functools.partial(reference_at, plan), scale,
        )  # fmt: skip
    return simulate_flight(
        truth, functools.partial(command_at, plan), plan.duration, seed,
        controller=controller, initial_yaw=plan.space.start[3], max_step=COARSE,
    )  # fmt: skip


def recorded(flight: SimulatedFlight) -> Flight:
    """The flight as the estimator gets it, from its log."""
    return flight_from_log(as_log(flight), load_card("rotorfit-demo"))


def path(plan: Plan, flight: SimulatedFlight) -> Array:
    """True pose in the room of the plan, shape (N, 4) [m, rad]."""
    begin = np.array([0.0, 0.0, HOVER_HEIGHT, plan.space.start[3]])
    return np.asarray(flight.true_pose - begin + np.array(plan.space.start))


def excited_axes(plan: Plan) -> tuple[str, ...]:
    """The axes that have a signal of their own."""
    return tuple(axis for axis in AXES if any(each.axis == axis for each in plan.excitations))


def _four(values: Array) -> Four:
    x, y, z, yaw = map(float, values)
    return x, y, z, yaw
