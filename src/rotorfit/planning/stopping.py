"""A vehicle stops v t + v |v| / (2 a) after a command of zero, by its reaction time t and deceleration a."""

import math

from rotorfit.core.flight_plan import Plan
from rotorfit.core.frames import AXES
from rotorfit.core.limits import GRAVITY, meaning_of
from rotorfit.files.cards import card_from_mapping
from rotorfit.planning.plan_control import full_scale

Three = tuple[float, float, float]

SHARE = 0.5
"""Share of the acceleration of a full command that braking may use; the rest is kept for wind and a wrong belief."""

SERVO = 1.0
"""Damping from which an axis is taken to stop by itself on a command of zero [1/s]: a velocity loop."""

UNKNOWN_DELAY = 0.3
"""Delay of a command without a belief [s]."""

UNKNOWN_TILT = math.radians(10)
"""Largest tilt if the card gives none [rad]."""

UNKNOWN_DAMPING = 1.5
"""Damping of a velocity loop without a belief [1/s]."""

FILTER = 0.1
"""Time constant of the guard's velocity [s]."""


def braking_of(plan: Plan) -> tuple[Three, Three]:
    """Reaction time with the lag of the guard's velocity [s], and deceleration [m/s^2], along x, y and z.

    A vehicle that has turned may brake along the world's x as it does along its own y: the weaker counts for both.

    Raises:
        CardError: The plan's card is wrong.
    """
    stops = [_stop(plan, axis) for axis in AXES[:3]]
    flat, upright = (max(late for late, _ in each) + FILTER for each in (stops[:2], stops[2:]))
    brakes, climbs = (min(deceleration for _, deceleration in each) for each in (stops[:2], stops[2:]))
    return (flat, flat, upright), (brakes, brakes, climbs)


def _stop(plan: Plan, axis: str) -> tuple[float, float]:
    """Reaction time [s] and deceleration [m/s^2] along an axis."""
    card, place = card_from_mapping(plan.card, f"of plan {plan.name}"), AXES.index(axis)
    delay = float(plan.belief["delay"][place]) if "delay" in plan.belief else UNKNOWN_DELAY
    if "gamma" in plan.belief:
        gain, damping = (float(number) for number in plan.belief["gamma"][2 * place : 2 * place + 2])
        return stopping(gain, damping, delay, full_scale(card, axis))
    if meaning_of(card, axis).asked == "tilt":
        return delay, SHARE * GRAVITY * math.tan(card.limits.get("tilt", UNKNOWN_TILT))
    return delay + 1 / UNKNOWN_DAMPING, math.inf


def stopping(gain: float, damping: float, delay: float, full_scale: float) -> tuple[float, float]:
    """Reaction time [s] and deceleration [m/s^2] along an axis.

    A velocity loop stops within one over its damping after the delay; a tilt brakes with a share of a full command.

    Args:
        gain: Believed input gain [m/s^2 per command of 1].
        damping: Believed damping [1/s].
        delay: Believed delay [s].
        full_scale: Largest command.
    """
    if damping >= SERVO:
        return delay + 1 / damping, math.inf
    return delay, SHARE * abs(gain) * min(full_scale, 1.0)
