"""Tests whether a command is nothing but a position controller's response to the motion, and which came first.

A controller that only holds an axis commands u = c - K p - D v of a slightly earlier pose, its noise included. Where
that law is nearly the whole command, it contains nothing else: nobody excites the axis, and a fit that inverts the law,
v = -(u + K p) / D, explains the motion by its own consequence. It shows as a negative gain without memory. And since no
controller knows the future, a law that fits best to poses stamped after the command shows that the stamps of the poses
are late, or those of the commands early.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cache, partial

import numpy as np

from rotorfit.core.finding import Finding
from rotorfit.core.flight_data import Flight
from rotorfit.core.frames import AXES, Array, heading_from_world
from rotorfit.core.results import Motion
from rotorfit.diagnosis.recording import Recording
from rotorfit.dynamics.kinematics import motion_from_flight

LAGS = np.arange(-0.30, 0.301, 0.02)
"""Lags of the poses' stamps behind the command that responds to them, as tried [s]."""

WHOLE = 0.9
"""Share of the variance of the averaged command above which the law is all of it. For held axes it is 0.97 to 0.9999 on
simulated flights with poses good to 0.5 mm, 0.94 to 0.9998 on recorded ones; for axes excited inside such a loop less
than 0.5."""

POSITION = 0.5
"""Largest ratio of the residual with position to that with velocity alone. Velocity alone also follows a command that
drives it, and then position adds next to nothing: the ratio is 0.8 to 1 on clean flights."""

EARLY = 0.03
"""Lag from which a pose comes after its response [s]: one and a half steps above the largest possible, 0."""

AVERAGED = 0.2
"""Time over which command and motion are averaged before they are compared [s]. A controller that differentiates poses
commands their noise, too. That moves nothing, but on held axes of recorded flights it is 15 to 95 % of the variance of
the command; of its averages the law is 94 to 99.9 %."""

LEAST = 50
"""Least number of averages: in parts of 5.7, 7.7 and 10.7 s of clean flights 39 of 911, 7 of 660 and 0 of 472 excited
axes looked held."""

THINNED = 2000
"""Largest number of averages used, evenly spread."""


MotionOf = Callable[[Flight], Motion]
"""Gives the motion of a flight."""


@dataclass(frozen=True)
class Law:
    """A command as a response to the pose.

    Attributes:
        lag: Best lag of the pose's stamp behind the command; negative where the command follows the pose [s].
        explained: Share of the variance of the command.
    """

    lag: float
    explained: float


def restoring_law(flight: Flight, axis: str, motion: Motion | None = None, least: int = LEAST) -> Law | None:
    """The law of a position controller, if it is the whole command of an axis; else None.

    Args:
        flight: Commands in the heading frame.
        axis: `x`, `y`, `z` or `yaw`.
        motion: Motion of the flight; computed if not given.
        least: Least number of averages.
    """
    k = AXES.index(axis)
    if axis not in flight.axes or flight.velocity_only or not np.ptp(flight.command[:, k]) > 0:
        return None
    motion = motion or motion_from_flight(flight)
    if not motion.time.size:
        return None
    begin = _begins(flight, motion)
    if begin.size < least:
        return None
    command = _integral(flight.command_time, flight.command[:, k : k + 1])
    u = _averages(flight.command_time, command, begin)[:, 0]
    if not np.ptp(u) > 0:  # all changes are at the ends, where no motion is measured
        return None
    velocity = _integral(motion.time, motion.velocity[:, k : k + 1])
    place = _integral(flight.pose_time, _place(flight, k))
    late = (begin + LAGS[:, None]).ravel()
    parts = (_averages(motion.time, velocity, late), _averages(flight.pose_time, place, late))
    fits = [_fitted(u, *each) for each in zip(*(np.split(part, LAGS.size) for part in parts), strict=True)]
    best = int(np.argmin([left for left, _, _ in fits]))
    left, alone, gains = fits[best]
    whole = left < (1 - WHOLE) and left < POSITION * alone and (gains < 0).all()
    return Law(float(LAGS[best]), 1 - left) if whole and 0 < best < LAGS.size - 1 else None


def _begins(flight: Flight, motion: Motion) -> Array:
    """Where averages begin: one after the other where the motion at every lag is known [s]."""
    parts = [
        np.arange(
            max(part.start, motion.time[0]) - LAGS[0], min(part.end, motion.time[-1]) - LAGS[-1] - AVERAGED, AVERAGED
        )
        for part in flight.segments
    ]
    begin: Array = np.concatenate(parts)
    return begin[:: max(1, -(-begin.size // THINNED))]


def _integral(time: Array, value: Array) -> Array:
    """Integral of signals (N, C) over time, by trapezoids, shape (N, C)."""
    middle = 0.5 * (value[1:] + value[:-1]) * np.diff(time)[:, None]
    return np.vstack([np.zeros(value.shape[1]), np.cumsum(middle, axis=0)])


def _averages(time: Array, integral: Array, begin: Array) -> Array:
    """Means over `AVERAGED` from each beginning (R,) of the signals with these integrals (N, C), shape (R, C)."""
    return np.asarray((_between(time, integral, begin + AVERAGED) - _between(time, integral, begin)) / AVERAGED)


def _between(time: Array, value: Array, at: Array) -> Array:
    """Signals (N, C) by linear interpolation, constant beyond their ends, shape (R, C): one search for all."""
    at = np.clip(at, time[0], time[-1])
    i = np.clip(np.searchsorted(time, at, side="right") - 1, 0, time.size - 2)
    share = (at - time[i]) / (time[i + 1] - time[i])
    return np.asarray(value[i] + share[:, None] * (value[i + 1] - value[i]))


def _place(flight: Flight, k: int) -> Array:
    """Position along an axis at the poses, and the regressors of a constant place to be held, shape (N, 1 + C)."""
    if k < 2:
        turned = heading_from_world(flight.position[:, :2], flight.yaw)[:, k]
        return np.column_stack([turned, np.cos(flight.yaw), np.sin(flight.yaw), np.ones(flight.yaw.size)])
    return np.column_stack([flight.position[:, 2] if k == 2 else flight.yaw, np.ones(flight.yaw.size)])


def _fitted(u: Array, velocity: Array, place: Array) -> tuple[float, float, Array]:
    """Shares of the command left unexplained by the law, and by velocity alone; gains of position and velocity."""
    total = float(np.sum((u - u.mean()) ** 2))
    left = []
    for design in (np.hstack([velocity, place[:, 1:]]), np.hstack([place[:, :1], velocity, place[:, 1:]])):
        solution = np.linalg.lstsq(design, u, rcond=None)[0]
        left.append(float(np.sum((u - design @ solution) ** 2)) / total)
    return left[1], left[0], np.asarray(solution[:2], np.float64)


def restored_axes(
    flights: Sequence[Flight], axes: Sequence[str], least: int = LEAST, motion_of: MotionOf = motion_from_flight
) -> tuple[str, ...]:
    """The axes, of those given, that each flight which commands them only holds by such a law.

    Args:
        flights: The flights.
        axes: Names of axes.
        least: Least number of averages; where there are fewer, an axis is not held.
        motion_of: Gives the motion of a flight.
    """
    motions = [cache(partial(motion_of, flight)) for flight in flights]

    def held(axis: str) -> bool:
        """Whether every flight that moves the command of an axis only holds it."""
        k = AXES.index(axis)
        moving = [
            (flight, motion)
            for flight, motion in zip(flights, motions, strict=True)
            if axis in flight.axes and np.ptp(flight.command[:, k]) > 0
        ]
        return bool(moving) and all(
            restoring_law(flight, axis, motion(), least) is not None for flight, motion in moving
        )

    return tuple(axis for axis in axes if held(axis))


def restoring_findings(recording: Recording) -> Iterator[Finding]:
    """Finding on stamps where a law responds to future poses; at most one."""
    flight, motion = recording.flight, recording.motion
    laws = {axis: law for axis in flight.axes if (law := restoring_law(flight, axis, motion))}
    early = {axis: law for axis, law in laws.items() if law.lag > EARLY}
    if not early:
        return
    told = " and ".join(f"{100 * law.explained:.0f} % of that of {axis}" for axis, law in early.items())
    least = min(law.lag for law in early.values())
    yield Finding(
        "answers_before_motion",
        "warning",
        f"commands respond to the motion before it is seen: a position controller explains {told} by poses that are "
        f"stamped {1e3 * least:.0f} ms later",
        f"the delay of every axis comes out at least {1e3 * least:.0f} ms too long; a fit of axes that are only "
        "held identifies the feedback instead of the vehicle",
        "check the clocks: the poses are stamped late or the commands early; take the stamps at which both were "
        "received, or give the time of [pose] in the card a negative offset",
    )
