"""Fit -> findings: velocity commands that ask for more acceleration than the card's tilt limit gives.

A velocity loop asks for the acceleration g u(t - tau) - b v and tilts as far, up to its limit. But for
`limited_acceleration` no structure has such a bound, so what it cuts off enters delay, lag, damping and input. How much
it cuts follows from the law and the commands.
Whether the vehicle obeys it is shown by the measured acceleration: of what exceeds the limit, an unbounded vehicle
shows all, a bounded one little, as far as the fit has not bent to it.
"""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from rotorfit.core.display import counted
from rotorfit.core.finding import Finding
from rotorfit.core.flight_data import Flight, Segment
from rotorfit.core.frames import Array, heading_from_world, world_from_heading
from rotorfit.core.laws import STRUCTURES, law_of, structure_named
from rotorfit.core.limits import GRAVITY, limit_text, meaning_of
from rotorfit.core.model import STRUCTURE, Model, Predictor, first_order
from rotorfit.core.results import Fit, student_quantile
from rotorfit.dynamics.first_order_low_pass import first_order_low_pass
from rotorfit.dynamics.predictor import free_run

LEAST_CUT = 0.005
"""Share of the acceleration asked for along an axis that the limit cuts off, from which on it matters: in simulated
flights of 90 s with 0.4 % the input gain was 1.3 % too low, with 0.7 % by 4 to 7 %, two to four of its standard errors;
from 1.5 % on a lag came out that is not there."""

OBEYED = 0.8
"""Share of what exceeds the limit below which a vehicle obeys it, if the 95 % interval excludes 1, too. In simulated
flights it was 0.77 to 1.05 without a limit, -0.3 to 0.75 with one that biased the fit."""

MARGIN = 0.8
"""Share of the limit that proposed steps use: the limit makes the input gain come out up to a sixth too low."""

GRID, HALF, REACH, LINKED = 0.02, 0.1, 0.2, 2.0
"""Step of the grid; half the time over which a velocity is taken, and least one for an acceleration; and length of the
parts of a flight that count as independent [s]."""

WITH_LAG = "first_order_delay_lag"


@dataclass(frozen=True)
class Asked:
    """Horizontal accelerations on a grid of N times; the last three as second differences of the position show them.

    Attributes:
        wanted: Asked for while the velocity is what the law makes of the commands, heading frame, shape (N, 2) [m/s^2].
        excess: What of it exceeds the limit, likewise.
        cut: The same excess, world frame, shape (N, 2) [m/s^2]. It is free of the wind, an instrument for the next two.
        expected: The excess while the velocity is the measured one, likewise.
        measured: Acceleration measured beyond that of the law less the excess, likewise.
    """

    wanted: Array
    excess: Array
    cut: Array
    expected: Array
    measured: Array


def findings_of_tilt(fit: Fit) -> Iterator[Finding]:
    """Axes under velocity commands of which the card's tilt limit cuts off a share that matters.

    Args:
        fit: By any method. Axes whose gain or damping the data do not tell are left out.
    """
    model, tilt = fit.model, fit.model.card.limits.get("tilt")
    points = {k: _point(model, axis) for k, axis in enumerate("xy") if _looped(model, axis)}
    if not points or not tilt:
        return
    bound = GRAVITY * math.tan(tilt)
    parts = [
        _asked(flight, segment, points, bound)
        for flight in fit.flights
        for segment in flight.segments
        if set(flight.axes) & {"x", "y"} and segment.end - segment.start > 4 * _reach(flight) + LINKED
    ]
    if not parts:
        return
    wanted, excess = (np.concatenate([getattr(part, name) for part in parts]) for name in ("wanted", "excess"))
    size, (shown, half) = np.hypot(*wanted.T), _shown(parts)
    obeyed = shown < OBEYED and shown + half < 1.0
    if not obeyed and shown > half:
        return  # the vehicle tilts further than its card says
    times = sum(int(np.diff(np.hypot(*part.wanted.T) > bound, prepend=False).sum() + 1) // 2 for part in parts)
    seen = "too seldom, or in too much wind, to see whether the vehicle obeys it"
    if obeyed:
        seen = f"the motion shows {100 * shown:.0f} +- {100 * half:.0f} % of the excess, without the limit it is 100 %"
    for k, point in points.items():
        name, asked = "xy"[k], float(np.abs(wanted[:, k]).sum())
        cut = float(np.abs(excess[:, k]).sum()) / asked if asked else 0.0
        if cut < LEAST_CUT:
            continue
        step = MARGIN * bound / abs(point.input)
        yield Finding(
            "tilt_limit_reached",
            "warning" if obeyed else "info",
            f"the commands of {name} ask for more acceleration than the {bound:.3g} m/s^2 of the card's tilt limit, "
            f"{limit_text('tilt', tilt)}: {counted(times, 'time')}, {100 * np.mean(size > bound):.2g} % of the time, "
            f"by up to {100 * (size.max() / bound - 1):.0f} %, so that {100 * cut:.2g} % of what they ask is cut off; "
            + seen,
            f"{'' if obeyed else 'if the vehicle obeys this limit, '}delay, lag, damping and input of {name} describe "
            "the limit, too: for small commands they are others, and the intervals do not cover that",
            "fit with --structure limited_acceleration; or "
            f"fly commands of {name} that change by {step:.2g} at most, by {step / math.sqrt(2):.2g} where x and y "
            "change together; or correct tilt in [limits] of the card, if the vehicle tilts further",
            name,
        )


def _looped(model: Model, axis: str) -> bool:
    """Whether a velocity loop tilts the vehicle along an axis whose gain and damping the data tell."""
    known = model.axes[axis]
    told = "not_identifiable" not in (known.status["input"], known.status["damping"])
    velocity = meaning_of(model.card, axis).asked == "velocity"
    free = not structure_named(known.structure).limited
    return told and velocity and free and known.predictor is not None and known.predictor.damping > 0


def _reach(flight: Flight) -> float:
    """Time over which second differences of the position are taken [s]."""
    return GRID * round(max(REACH, 2 * float(np.median(np.diff(flight.pose_time)))) / GRID)


def _point(model: Model, axis: str) -> Predictor:
    """Coefficients of an axis under its law if that is of the first order, with or without a lag, else of a delay."""
    known = model.axes[axis]
    own = known.structure.startswith("first_order") and known.predictor
    return own or first_order(model, axis).predictor


def _asked(flight: Flight, segment: Segment, points: Mapping[int, Predictor], bound: float) -> Asked:
    """Accelerations of one segment; `points` has the coefficients of x (0) and y (1)."""
    reach = _reach(flight)
    time = np.arange(segment.start + reach, segment.end - reach, GRID)
    yaw = np.interp(time, flight.pose_time, flight.yaw)
    world = (_place(flight, time + HALF) - _place(flight, time - HALF)) / (2 * HALF)
    velocity, driven = (heading_from_world(one, yaw) for one in (world, _driven(flight, time, yaw, points)))
    wanted, excess = _beyond(flight, time, driven, points, bound)
    asked, cut = _beyond(flight, time, velocity, points, bound)
    late = _lagged(asked + _damping(points) * velocity, points) - _damping(points) * velocity  # as the law has it
    seen, cut, expected = (_seen(one, yaw, reach) for one in (late, _lagged(excess, points), _lagged(cut, points)))
    acceleration = (_place(flight, time + reach) - 2 * _place(flight, time) + _place(flight, time - reach)) / reach**2
    measured = acceleration - seen + expected
    return Asked(wanted, excess, cut, expected, measured - measured.mean(axis=0))


def _place(flight: Flight, time: Array) -> Array:
    return np.column_stack([np.interp(time, flight.pose_time, flight.position[:, i]) for i in (0, 1)])


def _damping(points: Mapping[int, Predictor]) -> Array:
    return np.array([points[k].damping if k in points else 0.0 for k in (0, 1)])


def _driven(flight: Flight, time: Array, yaw: Array, points: Mapping[int, Predictor]) -> Array:
    """World velocity that the commands alone give, from rest, shape (N, 2)."""
    none = Predictor(0.0, 0.0, 0.0)
    laws = [
        law_of(STRUCTURES[WITH_LAG if point.extra else STRUCTURE], point.input, point.damping, point.delay, point.extra)
        for point in (points.get(k, none) for k in (0, 1))
    ]
    rest = np.zeros(2)
    return free_run(flight.command_time, flight.command[:, :2], np.array(laws), rest, rest, time, yaw)[:, 2:]


def _beyond(
    flight: Flight, time: Array, velocity: Array, points: Mapping[int, Predictor], bound: float
) -> tuple[Array, Array]:
    """Acceleration asked for at a velocity (N, 2), and what of it exceeds the limit, all in the heading frame."""
    wanted = -_damping(points) * velocity
    for k, point in points.items():
        held = np.searchsorted(flight.command_time, time - point.delay + 1e-9, side="right") - 1
        wanted[:, k] += point.input * flight.command[np.maximum(held, 0), k]
    return wanted, wanted * (1 - bound / np.maximum(np.hypot(*wanted.T), bound)[:, None])


def _lagged(wanted: Array, points: Mapping[int, Predictor]) -> Array:
    """What an attitude loop makes of an acceleration that is asked for."""
    out = wanted.copy()
    for k, lag in ((k, point.extra["lag"]) for k, point in points.items() if point.extra):
        out[:, k] = first_order_low_pass(wanted[:, k : k + 1], math.exp(-GRID / lag))[:, 0]
    return out


def _seen(acceleration: Array, yaw: Array, reach: float) -> Array:
    """An acceleration in the heading frame, as second differences of the world position over `reach` show it."""
    half = round(reach / GRID)
    weight = (1.0 - np.abs(np.arange(-half, half + 1)) / half) / half
    return np.column_stack([np.convolve(one, weight, "same") for one in world_from_heading(acceleration, yaw).T])


def _shown(parts: list[Asked]) -> tuple[float, float]:
    """Share of the excess that the measured acceleration shows, and half its 95 % interval; infinite if that is open.

    The variance is that between parts of a flight, of which as many count as hold much of the excess.
    """
    weight: list[Array] = []
    product: list[Array] = []
    count = round(LINKED / GRID)
    for part in parts:
        begins = np.arange(0, len(part.cut), count)
        both = ((part.cut * one).sum(axis=1) for one in (part.expected, part.measured))
        for sums, one in zip((weight, product), both, strict=True):
            sums.append(np.add.reduceat(one, begins))
    scales, seen = np.concatenate(weight), np.concatenate(product)
    scale, square = float(scales.sum()), float(np.sum(scales**2))
    if scale <= 0 or scale**2 < 2 * square:
        return 0.0, math.inf
    share = float(seen.sum()) / scale
    freedom = scale**2 / square - 1
    error = math.sqrt((1 + 1 / freedom) * float(np.sum((seen - share * scales) ** 2))) / scale
    return share, student_quantile(freedom) * error
