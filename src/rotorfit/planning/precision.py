"""Precision: the standard errors expected from a plan before it is flown.

The plan is flown by possible vehicles, with their wind and noise, including the feedback on the measured pose; the
information of the likelihood in each flight, at the vehicle that flew it, is inverted to the covariance that an
efficient estimator reaches (Cramer-Rao). Trim and start velocities are unknown, as in a fit. So are the levels of the
disturbance; that costs nothing to first order, because the information of coefficients and levels is block diagonal.
Flights of one vehicle differ by more than that; the errors are widened to those of the vehicle, as in a fit.

Rehearsal: a plan flown by the paper's vehicle, in a room that agrees with the belief.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from rotorfit.core.flight_data import Flight, Segment
from rotorfit.core.flight_plan import Four, Plan, command_at, reference_at
from rotorfit.core.frames import AXES, Array
from rotorfit.core.model import COEFFICIENTS
from rotorfit.core.progress import Progress
from rotorfit.files.cards import load_card
from rotorfit.flights.assemble import flight_from_log
from rotorfit.planning.belief import NAMES, Belief, levels_of, sample_vehicles
from rotorfit.planning.plan_control import Tracker, tracker_of
from rotorfit.simulation.paper_vehicle import (
    HOVER_HEIGHT,
    Controller,
    Draw,
    SimulatedFlight,
    Truth,
    as_log,
    draw,
    draw_evenly,
    flown,
)

COARSE = 0.02  # s, longest step of the integration: a path of 60 s is then accurate to a tenth of a millimetre


def fly_plan(tracker: Tracker, truth: Truth, seed: int) -> SimulatedFlight:
    """Flies a plan, including its feedback and full scale.

    Args:
        tracker: The plan, with what its feedback believes.
        truth: The vehicle; commands are sent at the rate of the plan.
        seed: Seed of wind and noise.

    Returns:
        The flight, from rest at `paper_vehicle.HOVER_HEIGHT` above the origin, with the heading of the plan's start.
    """
    plan = tracker.plan
    truth = replace(truth, command_rate=plan.rate, command_jitter=min(truth.command_jitter, 0.2 / plan.rate))
    return next(fly_draws(tracker, [draw(_integrable(truth), plan.duration, seed, max_step=COARSE)]))


def draw_path(truth: Truth, rate: float, duration: float, seed: int) -> Draw:
    """Stamps, air and noise for the path of a vehicle, for any plan of a rate of commands [Hz] and a duration [s].

    The grid is that of the commands, which moves a path of 60 s by some millimetres.
    """
    truth = replace(_integrable(truth), command_rate=rate, command_jitter=0.0)
    return draw_evenly(truth, duration, seed, max_step=COARSE)


def _integrable(truth: Truth) -> Truth:
    """The vehicle without time constants below `COARSE`, with which Runge-Kutta steps of that length diverge.

    Such an axis is slowed to `COARSE` at the same steady gain, which moves its path by less than a step does.
    """
    table = np.array(truth.gamma).reshape(4, 2)
    slowed = table / np.maximum(1.0, COARSE * np.abs(table[:, 1:]))
    return replace(truth, gamma=tuple(map(float, slowed.ravel())))


def fly_draws(tracker: Tracker, draws: Sequence[Draw]) -> Iterator[SimulatedFlight]:
    """Flies a plan as `fly_plan`, from draws made before that have the same stamps of commands."""
    plan, feedback, scale = tracker.plan, tracker.plan.feedback, _four(tracker.full_scale)
    sent = draws[0].command_stamp.astype(np.float64) * 1e-9
    command, reference = command_at(plan, sent), reference_at(plan, sent)
    follows = any(each.target == "position" for each in plan.excitations)
    controller = Controller(axes=(), full_scale=scale)
    if feedback:
        controller = Controller(
            feedback.stiffness, feedback.damping, feedback.filter_time, feedback.axes,
            tuple(map(float, tracker.gamma)), (lambda _: reference) if follows else None, scale,
        )  # fmt: skip
    for drawn in draws:
        yield flown(drawn, lambda _: command, controller, plan.space.start[3])


def recorded_flight(flight: SimulatedFlight) -> Flight:
    """The flight as the estimator receives it, from its log."""
    return flight_from_log(as_log(flight), load_card("rotorfit-demo"))


def seen_flight(flight: SimulatedFlight) -> Flight:
    """The flight as `recorded_flight`, without a log in between."""
    origin, fresh = flight.command_stamp[0], ~flight.stale & (flight.pose_stamp >= flight.command_stamp[0])
    command_time, pose_time = (flight.command_stamp - origin) / 1e9, (flight.pose_stamp[fresh] - origin) / 1e9
    end, pose = float(pose_time[-1]), flight.pose[fresh]
    acting = command_time < end
    return Flight(
        path="", sha256="", card=load_card("rotorfit-demo"), span=(0.0, end), axes=AXES,
        command_time=command_time[acting], command=flight.command[acting], pose_time=pose_time,
        position=pose[:, :3], yaw=pose[:, 3], segments=(Segment(0.0, end),),
    )  # fmt: skip


def path(plan: Plan, flight: SimulatedFlight) -> Array:
    """True pose in the room of the plan, shape (N, 4) [m, rad]."""
    begin = np.array([0.0, 0.0, HOVER_HEIGHT, plan.space.start[3]])
    return np.asarray(flight.true_pose - begin + np.array(plan.space.start))


def excited_axes(plan: Plan) -> tuple[str, ...]:
    """Axes with a signal of their own."""
    return tuple(axis for axis in AXES if any(each.axis == axis for each in plan.excitations))


def _four(values: Array) -> Four:
    x, y, z, yaw = map(float, values)
    return x, y, z, yaw


DRAWS = 6
"""Vehicles drawn from the belief, besides the likeliest, over which the predicted variance is averaged."""


@dataclass(frozen=True)
class Precision:
    """Expected knowledge after some flights.

    Attributes:
        axes: Axes that are excited, or were known before.
        stderr: Axis to coefficient to standard error: the root of the variance, averaged over the likeliest vehicle and
            draws of the belief; infinite if the variance is not finite for some draw.
        nominal: The same for the likeliest vehicle alone.
        covariance: Covariance of the twelve coefficients at the likeliest vehicle, shape (12, 12); infinite on the
            diagonal where nothing is known.
        draws: Number of vehicles over which `stderr` is averaged.
    """

    axes: tuple[str, ...]
    stderr: Mapping[str, Mapping[str, float]]
    nominal: Mapping[str, Mapping[str, float]]
    covariance: Array
    draws: int


def predicted_errors(
    plans: Sequence[Plan],
    belief: Belief,
    draws: int = DRAWS,
    seed: int = 0,
    before: Array | None = None,
    progress: Progress | None = None,
    *,
    of_vehicle: bool = True,
) -> Precision:
    """Standard errors that a joint fit of all these flights is expected to report.

    Args:
        plans: One flight each.
        belief: Belief about the vehicle, its air and its room.
        draws: Vehicles besides the likeliest.
        seed: Seed of the draws, the wind and the noise.
        before: Information from earlier flights, shape (12, 12).
        progress: Called with a fraction and a text; raising in it cancels.
        of_vehicle: Whether the errors hold for the vehicle over its flights; else for these flights alone.
    """
    return precision_of(informations(plans, belief, draws, seed, progress, of_vehicle=of_vehicle), before)


def informations(
    plans: Sequence[Plan],
    belief: Belief,
    draws: int = DRAWS,
    seed: int = 0,
    progress: Progress | None = None,
    *,
    of_vehicle: bool = True,
) -> Array:
    """Information of all these flights together, for the likeliest vehicle and each draw, shape (1 + draws, 12, 12).

    Arguments as for `predicted_errors`.
    """
    wider = vehicle_widening() if of_vehicle else np.ones(len(NAMES))
    out = np.zeros((1 + draws, 12, 12))
    for number, truth in enumerate([belief.truth, *sample_vehicles(belief, draws, seed)]):
        if progress:
            progress(number / len(out), "predicting the standard errors")
        for place, plan in enumerate(plans):
            out[number] += information(plan, truth, belief, seed + 1000 * number + place) / np.outer(wider, wider)
    return out


def precision_of(information: Array, before: Array | None = None) -> Precision:
    """Precision from `informations`, and from what earlier flights add to each, shape (12, 12)."""
    inverse = [inverse_of(each if before is None else before + each) for each in information]
    variances = np.array([np.diag(each) for each in inverse])
    known = tuple(axis for a, axis in enumerate(AXES) if np.all(np.isfinite(variances[0, 3 * a : 3 * a + 3])))
    return Precision(
        axes=known,
        stderr=_table(np.sqrt(np.mean(variances, axis=0)), known),
        nominal=_table(np.sqrt(variances[0]), known),
        covariance=inverse[0],
        draws=len(information),
    )


def vehicle_widening() -> Array:
    """Ratio of the standard error for the vehicle to that of one flight, due to the spread between flights, (12,).

    A fit of one flight widens its intervals likewise, until a second flight shows how flights differ.
    """
    from rotorfit.estimation.judgement.random_effects import random_effects
    from rotorfit.estimation.judgement.spread_prior import spread_scale

    alone = {name: random_effects(np.zeros(1), np.ones(1), spread_scale(name)).sd for name in COEFFICIENTS}
    return np.array([alone[name] for _ in AXES for name in COEFFICIENTS])


def _table(errors: Array, axes: Sequence[str]) -> dict[str, dict[str, float]]:
    return {axis: {name: float(errors[NAMES.index(f"{axis}.{name}")]) for name in COEFFICIENTS} for axis in axes}


def inverse_of(information: Array) -> Array:
    """Covariance from information, shape (12, 12); infinite on the diagonal where there is none."""
    known = np.diag(information) > 0
    out = np.diag(np.where(known, 0.0, np.inf))
    scale = np.sqrt(np.diag(information)[known])
    part = np.linalg.inv(information[np.ix_(known, known)] / np.outer(scale, scale)) / np.outer(scale, scale)
    out[np.ix_(known, known)] = part
    return out


def information(plan: Plan, truth: Truth, belief: Belief, seed: int) -> Array:
    """Information about input, damping and delay of x, y, z, yaw in one flight of a vehicle, shape (12, 12).

    Rows of axes without a signal of their own are 0: the little that their feedback excites is ignored.
    """
    return information_of(seen_flight(fly_plan(tracker_of(plan), truth, seed)), truth, belief, excited_axes(plan))


def information_of(flight: Flight, truth: Truth, belief: Belief, axes: Sequence[str]) -> Array:
    """Information about the coefficients of some axes in a recorded flight, at the vehicle that flew it, (12, 12).

    As in a fit, x and y are combined where the heading turns.
    """
    from rotorfit.estimation.likelihood.blocks import record

    out = np.zeros((12, 12))
    plane = record(flight, ("x", "y"))
    pair = tuple(axis for axis in ("x", "y") if axis in axes)
    turned = plane is not None and not plane.held and pair
    groups = [("x", "y")] if turned else [(axis,) for axis in pair]
    for group in (*groups, *((axis,) for axis in ("z", "yaw") if axis in axes)):
        part = _group_information(flight, truth, belief, group)
        at = [NAMES.index(f"{axis}.{name}") for axis in group for name in COEFFICIENTS]
        out[np.ix_(at, at)] = part
    dropped = [a for a, name in enumerate(NAMES) if name.split(".")[0] not in axes]
    out[dropped], out[:, dropped] = 0.0, 0.0
    return out


def _group_information(flight: Flight, truth: Truth, belief: Belief, group: Sequence[str]) -> Array:
    """Information of the axes of a group, all else unknown, ordered axis by axis, shape (3 K, 3 K)."""
    from rotorfit.estimation.likelihood.axis_estimate import free_of
    from rotorfit.estimation.likelihood.blocks import record
    from rotorfit.estimation.likelihood.likelihood import inverted, score
    from rotorfit.estimation.likelihood.parameters import Point

    rec, K = record(flight, group), len(group)
    if rec is None:
        return np.zeros((3 * K, 3 * K))
    places = [AXES.index(axis) for axis in group]
    gamma = np.array(truth.gamma).reshape(4, 2)[places]
    levels = np.stack([levels_of(belief, truth, axis) for axis in group])
    point = Point(
        gamma[:, 0], np.log(gamma[:, 1]), np.array(truth.delay)[places], np.array(truth.trim)[None, places],
        np.zeros((rec.starts.size, K)), np.log(levels),
    )  # fmt: skip
    at_rest, start = score([rec], point), slice(point.n - point.start.size, point.n)
    # The start speed carries information about the damping, too: a quarter more where a flight begins fast. The
    # position is linear in that speed, so one step finds it.
    speed = np.asarray(np.linalg.solve(at_rest.information[start, start], at_rest.gradient[start]), float)
    point = replace(point, start=speed.reshape(point.start.shape))
    full = score([rec], point).information[: point.n, : point.n]
    covariance = inverted(full, free_of([rec], [True] * K)[: point.n])[: 3 * K, : 3 * K]
    scale = np.concatenate([np.ones(K), gamma[:, 1], np.ones(K)])  # the likelihood uses the logarithm of the damping
    order = np.arange(3 * K).reshape(3, K).T.ravel()
    return np.asarray(np.linalg.inv(covariance * np.outer(scale, scale))[np.ix_(order, order)])
