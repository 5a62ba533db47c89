"""A vehicle stops v t + v |v| / (2 a) after a command of zero, by its reaction time t and deceleration a."""

import math

SHARE = 0.5
"""Share of the acceleration of a full command that braking may use; the rest is kept for wind and a wrong belief."""

SERVO = 1.0
"""Damping from which an axis is taken to stop by itself on a command of zero [1/s]: a velocity loop."""


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
