"""How late the vehicle's own velocity is against its pose: told by the motion itself, without a model of the commands.

Pose and velocity of one axis go through the filter of `fusion` as if the commands were unknown: all motion is a
velocity coloured by two poles. The latency is where the two fit best, that is where the likelihood is highest.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from rotorfit.estimate import free_of
from rotorfit.flight import Flight, Note
from rotorfit.frames import AXES
from rotorfit.levels import start_levels
from rotorfit.likelihood import Point, score
from rotorfit.maximum import maximise
from rotorfit.modes import excerpt, start_point
from rotorfit.record import DELAY_RANGE, HALF_STEP, record

LATENCY_RANGE = (-0.1, 0.5)
"""Latencies that are searched [s]."""

GRID = 0.02
"""Step of the first look [s]: a fraction of the time in which a multirotor changes its velocity."""

ENOUGH = 1e-4
"""To this the top and the ends of the interval are found [s]."""

FALL = 0.5 * 1.959964**2
"""Fall of the log-likelihood at the ends of the 95 % interval of one parameter."""

GROUPS = (("x", "y"), ("z",), ("yaw",))
"""Axes that share a latency."""

WIDEST = 0.1
"""Width of the interval [s] beyond which a velocity says too little about when: it is left out."""


@dataclass(frozen=True)
class Latency:
    """How late a velocity is against the pose [s].

    Attributes:
        value: Where the likelihood is highest.
        low: Lower end of its 95 % interval, None where the searched range cuts it off.
        high: Upper end, likewise.
    """

    value: float
    low: float | None
    high: float | None

    @property
    def known(self) -> bool:
        """Whether it is well enough known for the velocity to be of use."""
        return self.low is not None and self.high is not None and self.high - self.low < WIDEST


def on_the_poses_clock(flight: Flight) -> Flight:
    """The flight with its velocity on the clock of the poses, by what the motion tells, and a note for each group.

    Horizontal velocity, climb and turn often come from different sensors and filters: each has a latency of its own.
    A velocity whose latency the motion does not tell is left out. One that stands alone has no pose to be late against.
    """
    velocity, both = flight.velocity, both_axes(flight)
    if velocity is None or not both or velocity.late is not None:
        return flight
    late, value, notes = np.zeros(len(AXES)), velocity.value.copy(), flight.notes
    for group in GROUPS:
        axes = tuple(axis for axis in group if axis in both)
        if not axes:
            continue
        places, named = [AXES.index(axis) for axis in axes], ", ".join(axes)
        latency = latency_of(flight, axes)
        if latency is not None and latency.known:
            late[places] = latency.value
            text = (
                f"the vehicle's own velocity of {named} is {1e3 * latency.value:.0f} ms later than the pose (95 %: "
                f"{1e3 * (latency.low or 0.0):.0f} to {1e3 * (latency.high or 0.0):.0f}): its stamps were moved by that"
            )
        else:
            value[:, places] = np.nan
            text = f"how late the vehicle's own velocity of {named} is cannot be told from this flight: it is not used"
        notes = (*notes, Note("velocity_latency", text, velocity.time.size))
    return replace(flight, velocity=replace(velocity, value=value, late=late), notes=notes)


def both_axes(flight: Flight) -> tuple[str, ...]:
    """The axes of which both pose and velocity are measured."""
    velocity = flight.velocity
    if velocity is None:
        return ()
    return tuple(axis for axis in AXES if axis not in velocity.alone and velocity.of((axis,)))


def latency_of(flight: Flight, axes: Sequence[str]) -> Latency | None:
    """How late the velocity of a flight is against its pose.

    Args:
        flight: With both.
        axes: Of which both are measured. They share the latency; each has noise and motion of its own.

    Returns:
        The latency; None where no segment is long enough.
    """
    part = _inside(excerpt(flight, axes))
    points = {axis: _point(part, axis, 0.0) for axis in axes}
    levels = {axis: point for axis, point in points.items() if point is not None}
    if not levels:
        return None
    grid = np.arange(LATENCY_RANGE[0], LATENCY_RANGE[1] + GRID / 2, GRID)
    best = float(grid[int(np.argmax([_height(part, levels, float(at)) for at in grid]))])
    for reach in (2 * GRID, GRID):
        levels = {axis: _settled(part, axis, point, best) for axis, point in levels.items()}
        best = _top(part, levels, max(best - reach, LATENCY_RANGE[0]), min(best + reach, LATENCY_RANGE[1]))
    height = _height(part, levels, best)
    low, high = (_end(part, levels, best, height - FALL, edge) for edge in LATENCY_RANGE)
    return Latency(best, low, high)


def _inside(flight: Flight) -> Flight:
    """The flight with those velocities only that lie inside a segment whatever the latency: all see the same data."""
    assert flight.velocity is not None
    time = flight.velocity.time
    keep = np.zeros(time.size, bool)
    for part in flight.segments:
        low = part.start + DELAY_RANGE[1] + HALF_STEP + LATENCY_RANGE[1]
        high = part.end + DELAY_RANGE[0] - HALF_STEP + LATENCY_RANGE[0]
        keep |= (time > low) & (time < high)
    return replace(flight, velocity=replace(flight.velocity, time=time[keep], value=flight.velocity.value[keep]))


def _late(flight: Flight, latency: float) -> Flight:
    assert flight.velocity is not None
    return replace(flight, velocity=replace(flight.velocity, late=np.full(len(AXES), latency)))


def _point(flight: Flight, axis: str, latency: float) -> Point | None:
    """Settled levels of the motion of an axis, as if the commands were unknown; None where it is too short."""
    rec = record(_late(flight, latency), (axis,))
    if rec is None or rec.measured != "both":
        return None
    point = start_point([rec], 0.0, 1.0, start_levels("both")[None])
    idle = replace(point, gain=np.zeros(1), log_damping=np.zeros(1), start=np.zeros_like(point.start))
    return _settled(flight, axis, idle, latency)


def _settled(flight: Flight, axis: str, point: Point, latency: float) -> Point:
    """The levels where they are likeliest at a latency."""
    records = [rec for rec in [record(_late(flight, latency), (axis,))] if rec]
    free = free_of(records, [False])
    free[: point.n] = False
    return maximise(records, point, free, tolerance=0.01, most=40).point


def _height(flight: Flight, points: dict[str, Point], latency: float) -> float:
    """Log-likelihood of all axes together."""
    late = _late(flight, latency)
    records = {axis: record(late, (axis,)) for axis in points}
    return sum(score([rec], points[axis]).log_likelihood for axis, rec in records.items() if rec)


def _top(flight: Flight, points: dict[str, Point], low: float, high: float) -> float:
    from scipy.optimize import minimize_scalar

    found = minimize_scalar(
        lambda at: -_height(flight, points, float(at)), bounds=(low, high), method="bounded", options={"xatol": ENOUGH}
    )
    return float(found.x)


def _end(flight: Flight, points: dict[str, Point], top: float, height: float, edge: float) -> float | None:
    """Where the log-likelihood falls to a height between the top and an edge of the range; None where it does not."""
    from scipy.optimize import brentq

    if abs(edge - top) < ENOUGH or _height(flight, points, edge) > height:
        return None
    return float(brentq(lambda at: _height(flight, points, float(at)) - height, top, edge, xtol=ENOUGH))
