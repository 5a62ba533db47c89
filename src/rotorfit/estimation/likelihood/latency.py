"""Latency of the vehicle's own velocity relative to its pose, estimated from the motion by the likelihood.

First the commands are ignored: the whole motion is a disturbance, a velocity coloured by two poles, in the filter of
`velocity_fusion`, and the latency is that at which pose and velocity agree best. Then, where the commands explain the
motion, the latency follows from the profile of the likelihood with commands, near the first estimate: steps of a
command are not coloured noise, and an interval that treats them as such is too short.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from rotorfit.core.flight_data import Flight, Note
from rotorfit.core.frames import AXES
from rotorfit.core.laws import DELAY_RANGE, start_levels
from rotorfit.core.model import NORMAL
from rotorfit.estimation.likelihood.axis_estimate import Estimate, estimate_axis, estimate_plane, free_of
from rotorfit.estimation.likelihood.blocks import HALF_STEP, Record, record
from rotorfit.estimation.likelihood.fisher_scoring import Optimum, maximise
from rotorfit.estimation.likelihood.likelihood import score
from rotorfit.estimation.likelihood.optima import excerpt, start_point
from rotorfit.estimation.likelihood.parameters import Point
from rotorfit.flights.onboard_velocity import moved

LATENCY_RANGE = (-0.1, 0.5)
"""Range of latencies that is searched [s]."""

GRID = 0.02
"""Step of the grid search [s]: a fraction of the time in which a multirotor changes its velocity."""

ENOUGH = 1e-4
"""Tolerance of the maximum and of the ends of the interval [s]."""

FALL = 0.5 * NORMAL**2
"""Fall of the log-likelihood at the ends of the 95 % interval of one parameter."""

GROUPS = (("x", "y"), ("z",), ("yaw",))
"""Groups of axes that share a latency."""

WIDEST = 0.1
"""Width of the interval [s] from which on the latency is not identifiable and the velocity is left out."""


@dataclass(frozen=True)
class Latency:
    """Latency of a velocity relative to the pose; positive if the velocity is late.

    Attributes:
        value: Estimate [s].
        low: Lower end of its 95 % interval [s]; None where the range of the search cuts it off.
        high: Upper end, likewise.
    """

    value: float
    low: float | None
    high: float | None

    @property
    def known(self) -> bool:
        """Whether the interval is narrow enough for the velocity to be used."""
        return self.low is not None and self.high is not None and self.high - self.low < WIDEST


def align_velocity(flight: Flight, wanted: Sequence[str] = AXES) -> Flight:
    """The flight with its velocity on the clock of the poses, with a note for each group.

    Horizontal velocity, climb rate and yaw rate often come from different sensors and filters, so each has a latency of
    its own. A velocity whose latency is not identifiable is left out. Axes with a velocity only have no latency.

    Args:
        flight: Any flight; without velocities, or with latencies known already, it is returned as it is.
        wanted: Axes that will be fitted; velocities of groups without any of them are left out without a note.
    """
    velocity, both = flight.velocity, both_axes(flight)
    if velocity is None or not both or velocity.late is not None:
        return flight
    late, error, value, notes = np.zeros(len(AXES)), np.zeros(len(AXES)), velocity.value.copy(), flight.notes
    for group in GROUPS:
        axes = tuple(axis for axis in group if axis in both)
        if not axes:
            continue
        places, named = [AXES.index(axis) for axis in axes], ", ".join(axes)
        if not set(axes) & set(wanted):
            value[:, places] = np.nan
            continue
        latency = latency_of(flight, axes)
        if latency is not None and latency.low is not None and latency.high is not None and latency.known:
            late[places], error[places] = latency.value, 0.5 * (latency.high - latency.low)
            text = (
                f"the vehicle's own velocity of {named} is {1e3 * latency.value:.0f} ms later than the pose (95 %: "
                f"{1e3 * latency.low:.0f} to {1e3 * latency.high:.0f}): its stamps were shifted accordingly"
            )
        else:
            value[:, places] = np.nan
            text = (
                f"the latency of the vehicle's own velocity of {named} is not identifiable from this flight: the "
                "velocity is not used"
            )
        notes = (*notes, Note("velocity_latency", text, velocity.time.size))
    on_time = moved(replace(velocity, value=value), late, flight.pose_time, flight.yaw)
    return replace(flight, velocity=replace(on_time, late_error=error), notes=notes)


def both_axes(flight: Flight) -> tuple[str, ...]:
    """The axes with both a measured pose and a measured velocity."""
    velocity = flight.velocity
    if velocity is None:
        return ()
    return tuple(axis for axis in AXES if axis not in velocity.alone and velocity.of((axis,)))


def latency_of(flight: Flight, axes: Sequence[str]) -> Latency | None:
    """Latency of the velocity of a flight relative to its pose.

    Args:
        flight: Flight with a velocity.
        axes: Axes with both. They share the latency; each has its own noise and disturbance levels.

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
    found = Latency(best, low, high)
    if not found.known:
        return found
    assert part.velocity is not None
    # rotate by the heading at the right time once, since likelihoods of different data cannot be compared
    turned = moved(part.velocity, np.full(len(AXES), best), part.pose_time, part.yaw)
    return _by_the_commands(replace(part, velocity=turned), axes, found)


def _by_the_commands(flight: Flight, axes: Sequence[str], found: Latency) -> Latency:
    """The latency from the profile of the likelihood with commands around a first estimate; else the first estimate.

    The first estimate is kept where no axis is excited or the profile has no maximum.
    """
    assert found.low is not None
    assert found.high is not None
    reach = (found.high - found.low) / NORMAL
    flown = _late(flight, found.value)
    rec = record(flown, axes)
    moving = [axis in flight.axes and bool(np.ptp(flight.command[:, AXES.index(axis)])) for axis in axes]
    if rec is None or not any(moving):
        return found
    if rec.held:
        estimates = [estimate_axis([flown], axis, moves) for axis, moves in zip(axes, moving, strict=True)]
    else:
        estimates = estimate_plane([flown], [rec], axes, moving)
    if not any(estimate.excited for estimate in estimates):
        return found
    offsets = np.array([-1.0, 0.0, 1.0]) * reach
    heights = [_profile(flight, estimates, found.value + float(offset)) for offset in offsets]
    bend = (heights[0] - 2 * heights[1] + heights[2]) / reach**2
    if bend >= 0:
        return found
    best = found.value + float(np.clip(-(heights[2] - heights[0]) / (2 * reach * bend), -2 * reach, 2 * reach))
    half = NORMAL / float(np.sqrt(-bend))
    return Latency(best, best - half, best + half)


def _profile(flight: Flight, estimates: Sequence[Estimate], latency: float) -> float:
    """Log-likelihood of all axes together at a latency [s], maximised over the coefficients, with levels held."""
    late, height = _late(flight, latency), 0.0
    for estimate in estimates:
        names = estimate.records[0].axes
        if estimate.place == 0:  # x and y together have one likelihood
            height += _at_best([rec for rec in [record(late, names)] if rec], estimate).score.log_likelihood
    return height


def _at_best(records: Sequence[Record], estimate: Estimate) -> Optimum:
    """The maximum on other records, from the point of the estimate, with its levels held."""
    free = estimate.optimum.free.copy()
    free[estimate.optimum.point.n :] = False
    return maximise(records, estimate.optimum.point, free, prior=estimate.optimum.prior)


def delay_error(flights: Sequence[Flight], estimate: Estimate) -> float:
    """Half the 95 % interval of the delay of an axis that is due to the latencies of the velocities alone [s].

    Args:
        flights: The flights of the estimate, in its order.
        estimate: Estimate of the axis, alone or x with y.
    """
    axes, place = estimate.records[0].axes, estimate.place
    axis, total = axes[place], 0.0
    for j, flight in enumerate(flights):
        velocity = flight.velocity
        if velocity is None or velocity.late is None or velocity.late_error is None:
            continue
        error = float(velocity.late_error[AXES.index(axis)])
        if error == 0:
            continue
        ends = []
        for late in (velocity.late - error, velocity.late + error):
            shifted = record(replace(flight, velocity=replace(velocity, late=late)), axes)
            others = [record(f, axes) for f in flights]
            records = [rec for rec in (*others[:j], shifted, *others[j + 1 :]) if rec]
            ends.append(float(_at_best(records, estimate).point.delay[place]))
        total += (0.5 * (ends[1] - ends[0])) ** 2
    return float(np.sqrt(total))


def _inside(flight: Flight) -> Flight:
    """The flight with only those velocities that are inside a segment at every latency: the data are then the same."""
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
    """Point of an axis without input, with estimated levels, at a latency [s]; None where the flight is too short."""
    rec = record(_late(flight, latency), (axis,))
    if rec is None or rec.measured != "both":
        return None
    point = start_point([rec], 0.0, 1.0, start_levels("both")[None])
    idle = replace(point, gain=np.zeros(1), log_damping=np.zeros(1), start=np.zeros_like(point.start))
    return _settled(flight, axis, idle, latency)


def _settled(flight: Flight, axis: str, point: Point, latency: float) -> Point:
    """The point with its levels re-estimated at a latency [s]."""
    records = [rec for rec in [record(_late(flight, latency), (axis,))] if rec]
    free = free_of(records, [False])
    free[: point.n] = False
    return maximise(records, point, free, tolerance=0.01, most=40).point


def _height(flight: Flight, points: dict[str, Point], latency: float) -> float:
    """Log-likelihood of all axes together, without input, at a latency [s]."""
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
    """Latency between the maximum and an edge of the range at which the log-likelihood is `height`; None if none."""
    from scipy.optimize import brentq

    if abs(edge - top) < ENOUGH or _height(flight, points, edge) > height:
        return None
    return float(brentq(lambda at: _height(flight, points, float(at)) - height, top, edge, xtol=ENOUGH))
