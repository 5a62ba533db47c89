"""The command of a plan at an instant: its signals with their ramps, and the feedback on the measured pose.

    u = signals + (K (r - p) + D (r' - v) + r'' + b r') / g        on the axes of the feedback

with p the last measured pose, v its filtered differences, r the reference, and g, b the believed input and damping of
the vehicle, all in the heading frame. The sum is clipped at full scale. `fly` runs these functions on a link; the
predicted flights run the same law (`paper_vehicle.Controller`).
"""

import math
from dataclasses import dataclass, replace

import numpy as np

from rotorfit.core.card import Card
from rotorfit.core.errors import PlanError
from rotorfit.core.flight_plan import Plan, Three, command_at, reference_at
from rotorfit.core.frames import AXES, Array
from rotorfit.core.limits import meaning_of
from rotorfit.files.cards import card_from_mapping


@dataclass(frozen=True)
class Tracker:
    """A plan with the parameters of its feedback, ready to be flown.

    Attributes:
        plan: The plan.
        gamma: Believed input and damping of x, y, z, yaw in turn, shape (8,), as in the paper.
        full_scale: Largest command of each axis, shape (4,) [unit of the card's command].
    """

    plan: Plan
    gamma: Array
    full_scale: Array


@dataclass(frozen=True)
class Tracking:
    """State of the feedback from one pose to the next.

    Attributes:
        origin: Pose at the start of the plan: x, y, z, yaw, shape (4,) [m, rad]. The reference is relative to it: its x
            and y are forward and left of the heading there.
        time: Time of the last pose, from the start of the plan [s].
        pose: The last pose, world, yaw unwrapped, shape (4,) [m, rad].
        velocity: Filtered differences of the poses, world, shape (4,) [m/s, rad/s].
        saturated: Number of commands so far that were clipped at full scale on some axis.
    """

    origin: Array
    time: float
    pose: Array
    velocity: Array
    saturated: int = 0


def tracker_of(plan: Plan) -> Tracker:
    """Prepares a plan for flying, with its own card and belief.

    Raises:
        PlanError: The plan has feedback but no believed gamma.
        CardError: Its card is invalid.
    """
    gamma = plan.belief.get("gamma")
    if gamma is None and plan.feedback:
        raise PlanError(f"plan {plan.name}: feedback needs the gamma of its belief, and there is none; plan it again")
    card = card_from_mapping(plan.card, f"of plan {plan.name}")
    return Tracker(plan, np.array(gamma or (1.0, 0.0) * 4, float), np.array([full_scale(card, axis) for axis in AXES]))


def full_scale(card: Card, axis: str) -> float:
    """Largest command of an axis: 1 for a fraction, else the limit of the card in SI; infinite where it has none."""
    meaning = meaning_of(card, axis)
    if meaning.asked is None or meaning.limit:
        return 1.0
    keys = {"tilt": ("tilt",), "velocity": ("speed",), "vertical_speed": ("vertical_speed", "speed")}
    return next((card.limits[key] for key in keys.get(meaning.asked, (meaning.asked,)) if key in card.limits), np.inf)


UNLIMITED = {"tilt": math.pi / 3, "velocity": 30.0, "vertical_speed": 30.0, "yaw_rate": 2 * math.pi}
"""Largest command where the card has no limit, SI: more than any such vehicle accepts."""


def largest_command(card: Card, axis: str) -> float:
    """`full_scale` bounded to a finite value: no larger command is ever sent."""
    scale = full_scale(card, axis)
    return scale if math.isfinite(scale) else UNLIMITED[meaning_of(card, axis).asked or "velocity"]


def begin(pose: Array) -> Tracking:
    """The state at the start of a plan, at a pose of shape (4,), at rest.

    Raises:
        ValueError: The pose has another shape.
    """
    if pose.shape != (4,):
        raise ValueError("a pose is x, y, z, yaw")
    return Tracking(pose.copy(), 0.0, pose.copy(), np.zeros(4))


def observed(tracker: Tracker, state: Tracking, t: float, pose: Array) -> Tracking:
    """Updates the state with a measured pose.

    Args:
        tracker: The plan.
        state: State before the pose.
        t: Time of measurement, from the start of the plan [s]; a pose that is not later than the last is ignored.
        pose: World x, y, z, yaw, shape (4,); yaw may be wrapped.
    """
    since = t - state.time
    if since <= 0:
        return state
    change = pose - state.pose
    change[3] = (change[3] + np.pi) % (2 * np.pi) - np.pi
    filter_time = tracker.plan.feedback.filter_time if tracker.plan.feedback else 0.0
    velocity = state.velocity + (change - state.velocity * since) / (filter_time + since)
    return replace(state, time=t, pose=state.pose + change, velocity=velocity)


@dataclass(frozen=True)
class Instant:
    """Setpoints of a plan at one instant, each of shape (4,).

    Attributes:
        command: Command of the signals, heading frame [unit of the card's command].
        reference: Position, velocity and acceleration of the reference, as from `reference_at`.
    """

    command: Array
    reference: Three


def instants(plan: Plan, t: Array) -> list[Instant]:
    """Setpoints of a plan at times from its start, shape (N,) [s], computed in advance for a real-time loop."""
    position, velocity, acceleration = reference_at(plan, t)
    told = zip(position, velocity, acceleration, strict=True)
    return [Instant(row, three) for row, three in zip(command_at(plan, t), told, strict=True)]


def steered(tracker: Tracker, state: Tracking, t: float) -> tuple[Tracking, Array]:
    """The command at an instant.

    Args:
        tracker: The plan.
        state: State after the last pose.
        t: From the start of the plan [s].

    Returns:
        The state, with a clipped command counted; and the command, shape (4,).
    """
    return obeyed(tracker, state, instants(tracker.plan, np.array([t]))[0])


def obeyed(tracker: Tracker, state: Tracking, instant: Instant) -> tuple[Tracking, Array]:
    """As `steered`, for an instant computed in advance."""
    wanted = instant.command
    if tracker.plan.feedback:
        wanted = wanted + demanded(tracker, state, instant) / tracker.gamma[::2]
    command = np.minimum(np.maximum(wanted, -tracker.full_scale), tracker.full_scale)
    bounded = bool((command != wanted).any())
    return replace(state, saturated=state.saturated + 1) if bounded else state, command


def demanded(tracker: Tracker, state: Tracking, instant: Instant) -> Array:
    """Acceleration demanded by the feedback, heading frame, 0 where it does not act, shape (4,) [m/s^2, rad/s^2]."""
    feedback = tracker.plan.feedback
    if feedback is None:
        return np.zeros(4)
    here, start = state.pose[3], state.origin[3]
    position, velocity, acceleration = instant.reference
    error = turned(state.origin - state.pose, -here) + turned(position, start - here)
    wanted = turned(velocity, start - here)
    missing = wanted - turned(state.velocity, -here)
    asked = np.multiply(feedback.stiffness, error) + np.multiply(feedback.damping, missing)
    asked += turned(acceleration, start - here) + tracker.gamma[1::2] * wanted
    return np.array([value if axis in feedback.axes else 0.0 for axis, value in zip(AXES, asked, strict=True)])


def step(tracker: Tracker, state: Tracking, t: float, pose: Array) -> tuple[Tracking, Array]:
    """`observed` followed by `steered`, for a loop in which each command has its own pose."""
    return steered(tracker, observed(tracker, state, t, pose), t)


def turned(four: Array, angle: float) -> Array:
    """x and y rotated counter-clockwise by an angle [rad]; z and yaw unchanged."""
    c, s = math.cos(angle), math.sin(angle)
    return np.array([c * four[0] - s * four[1], s * four[0] + c * four[1], four[2], four[3]])
