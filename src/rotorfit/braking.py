"""Braking: slowing a vehicle that coasts when it is told zero, by its measured velocity.

A tilt of zero does not stop a multirotor. Some autopilots hover by themselves then; for the others

    u = -k (v + g sum of u on the way x period) / g          on the axes that coast, heading frame

with g the believed acceleration per command. The sum is the speed that commands which have not acted yet will take
away; without it the delay would make the vehicle swing. Source: O. J. M. Smith, "Closer control of loops with dead
time", Chemical Engineering Progress 53 (1957), 217-219.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

from rotorfit.card_file import card_from_mapping
from rotorfit.frames import AXES
from rotorfit.guard import SERVO, SHARE, UNKNOWN_DELAY
from rotorfit.plan import Four
from rotorfit.settings import meaning_of
from rotorfit.tracking import Tracker, full_scale

GAIN = 3.0
"""Deceleration that is asked for per speed [1/s]."""

Waiting = tuple[tuple[float, ...], ...]
"""Of each axis the commands that have been sent and do not act yet, the oldest first."""


@dataclass(frozen=True)
class Coasting:
    """An axis on which zero does not stop the vehicle.

    Attributes:
        place: 0 for x, 1 for y.
        gain: Believed acceleration per command.
        largest: Command that braking may use: what the guard's braking distance counts on.
        delay: Believed, from a command until it acts [s].
    """

    place: int
    gain: float
    largest: float
    delay: float


def coasting_axes(tracker: Tracker) -> tuple[Coasting, ...]:
    """The axes that are braked actively: tilts, unless the belief says that the vehicle `brakes_on_zero`.

    Without a belief in the gain nothing is braked: the vehicle is sent zero and does what it does.
    """
    belief = tracker.plan.belief
    if "gamma" not in belief or belief.get("brakes_on_zero"):
        return ()
    card = card_from_mapping(tracker.plan.card, f"of plan {tracker.plan.name}")
    delay = belief.get("delay", (UNKNOWN_DELAY,) * 4)
    return tuple(
        Coasting(place, float(tracker.gamma[2 * place]), SHARE * min(full_scale(card, axis), 1.0), float(delay[place]))
        for place, axis in enumerate(AXES[:2])
        if meaning_of(card, axis).asked == "tilt" and tracker.gamma[2 * place + 1] < SERVO
    )


def nothing_on_the_way(axes: Sequence[Coasting], period: float) -> Waiting:
    """Before the first command, one every `period` [s]."""
    return tuple((0.0,) * max(1, round(axis.delay / period)) for axis in axes)


def braking(
    axes: Sequence[Coasting], waiting: Waiting, pose: Four, velocity: Four, period: float
) -> tuple[Four, Waiting]:
    """The command that brakes now.

    Args:
        axes: That coast.
        waiting: What is on its way.
        pose: World, measured [m, rad].
        velocity: World, measured [m/s, rad/s].
        period: Between commands [s].

    Returns:
        Forward, left, 0, 0; and what is on its way then.
    """
    c, s = math.cos(pose[3]), math.sin(pose[3])
    heading = (c * velocity[0] + s * velocity[1], c * velocity[1] - s * velocity[0])
    command = [0.0, 0.0]
    for axis, sent in zip(axes, waiting, strict=True):
        ahead = heading[axis.place] + axis.gain * sum(sent) * period
        command[axis.place] = max(-axis.largest, min(axis.largest, -GAIN * ahead / axis.gain))
    then = tuple((*sent[1:], command[axis.place]) for axis, sent in zip(axes, waiting, strict=True))
    return (command[0], command[1], 0.0, 0.0), then
