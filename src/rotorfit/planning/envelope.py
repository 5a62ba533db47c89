"""Envelope: the expected path and speeds of a plan, and whether it stays in its space if the belief is off.

The plan is flown by the likeliest vehicle in still air, and by vehicles drawn from the belief, each with its own trim
and wind; the feedback believes in the likeliest in all cases. Amplitudes are sought with one fleet and judged by
another: those that just fit one fleet fit it better than the belief.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from rotorfit.core.errors import PlanError
from rotorfit.core.flight_plan import Plan
from rotorfit.core.frames import AXES, Array
from rotorfit.core.progress import Progress
from rotorfit.planning.belief import Belief, sample_vehicles
from rotorfit.planning.plan_control import Tracker, tracker_of
from rotorfit.planning.precision import draw_path, fly_draws, path
from rotorfit.planning.signals import scaled
from rotorfit.planning.stopping import braking_of
from rotorfit.simulation.paper_vehicle import Draw, SimulatedFlight, noise_free

DRAWS = 50
"""Number of vehicles with which amplitudes are sought."""

JUDGES = 100
"""Number of vehicles by which a plan is judged."""

SHRUNK = 0.97
"""Factor on the amplitudes of a plan that does not fit its judges: it seldom takes more than five, and a plan that
leaves is soon known to."""

_FRESH = 1_000_000
"""Added to the seed of a plan for the judges."""

ALLOWED = 0.05
"""Share of them that may leave the space or exceed a speed limit."""

FINENESS = 0.02
"""Relative precision of the largest amplitude."""

LIMITS = ("x", "y", "z", "speed", "climb")
"""Limits that a flight can violate: a side of the box, the horizontal speed, the vertical speed."""

_GRID = 0.1  # s between the points of the predicted path


@dataclass(frozen=True)
class Envelope:
    """Predicted motion at N times, from D draws.

    Attributes:
        time: From the start of the plan, shape (N,) [s].
        nominal: Path of the likeliest vehicle in still air, shape (N, 4) [m, rad].
        low: 2.5 % quantile of the draws at each time, shape (N, 4).
        high: 97.5 % quantile of the draws at each time, shape (N, 4).
        extent: 2.5 % quantile of the minimum and 97.5 % quantile of the maximum over a whole flight, shape (2, 4).
        speed: Largest horizontal speed, vertical speed and yaw rate of the nominal flight, shape (3,) [m/s, rad/s].
        speed_high: 95 % quantile of the same over the draws, shape (3,).
        outside: Share of the draws that violate each of `LIMITS`, shape (5,).
        hasty: Share of the draws whose speed along x, or y, exceeds the limit over the root of 2, shape (2,).
        leaving: Share of the draws that violate any limit.
        saturated: Share of the commands, over all draws, that are clipped at full scale on some axis.
        draws: D.
    """

    time: Array
    nominal: Array
    low: Array
    high: Array
    extent: Array
    speed: Array
    speed_high: Array
    outside: Array
    hasty: Array
    leaving: float
    saturated: float
    draws: int

    @property
    def fits(self) -> bool:
        """Whether at most the allowed share of the draws leaves the space."""
        return self.leaving <= ALLOWED


def fleet_of(belief: Belief, rate: float, duration: float, draws: int = DRAWS, seed: int = 0) -> tuple[Draw, ...]:
    """The likeliest vehicle in still air, and drawn vehicles with their trims and winds, which fly any number of plans.

    Args:
        belief: Belief about the vehicle, its air and its room.
        rate: Command rate of the plans [Hz].
        duration: Their duration [s].
        draws: Vehicles besides the likeliest, at least 1.
        seed: Seed of the draws and their wind.
    """
    vehicles = [noise_free(belief.truth), *sample_vehicles(belief, draws, seed)]
    return tuple(draw_path(truth, rate, duration, seed + number) for number, truth in enumerate(vehicles))


def judges_of(belief: Belief, rate: float, duration: float, seed: int) -> tuple[Draw, ...]:
    """Vehicles that judge a plan: other ones than those with which its amplitudes were sought, as of `fleet_of`."""
    return fleet_of(belief, rate, duration, JUDGES, seed + _FRESH)


def predicted_path(plan: Plan, fleet: Sequence[Draw], progress: Progress | None = None) -> Envelope:
    """Predicts the motion of a plan.

    Args:
        plan: The plan.
        fleet: The vehicles that fly it, from `fleet_of`.
        progress: Called with a fraction and a text; raising in it cancels.
    """
    time = np.arange(0.0, plan.duration, _GRID)
    paths, speeds, broken, saturated, tracker = [], [], [], [], tracker_of(plan)
    for number, flight in enumerate(fly_draws(tracker, fleet)):
        if progress:
            progress(number / len(fleet), "predicting the path")
        where, fastest, violated, bounded = _one(tracker, flight, time)
        paths.append(where)
        speeds.append(fastest)
        broken.append(violated)
        saturated.append(bounded)
    others, ends = np.array(paths[1:]), np.array([[each.min(axis=0), each.max(axis=0)] for each in paths[1:]])
    low, high = np.quantile(others, [0.025, 0.975], axis=0)
    shares = np.mean(broken[1:], axis=0)
    return Envelope(
        time=time, nominal=paths[0], low=low, high=high,
        extent=np.stack([np.quantile(ends[:, 0], 0.025, axis=0), np.quantile(ends[:, 1], 0.975, axis=0)]),
        speed=speeds[0], speed_high=np.quantile(np.array(speeds[1:]), 0.95, axis=0),
        outside=shares[:5], hasty=shares[5:], leaving=float(np.mean(np.any(np.array(broken[1:])[:, :5] > 0, axis=1))),
        saturated=float(np.mean(saturated[1:])), draws=len(others),
    )  # fmt: skip


def _one(tracker: Tracker, flight: SimulatedFlight, time: Array) -> tuple[Array, Array, Array, float]:
    """One flight: path (N, 4), largest speeds (3,), violated limits and haste (7,), share of clipped commands."""
    pose, stamp = path(tracker.plan, flight), flight.pose_stamp * 1e-9
    fastest, violated = _violated(tracker.plan, flight)
    bounded = float(np.mean(np.any(np.abs(flight.command) >= tracker.full_scale * (1 - 1e-12), axis=1)))
    where = np.stack([np.interp(time, stamp, pose[:, a]) for a in range(4)], axis=1)
    return where, fastest, violated, bounded


def _violated(plan: Plan, flight: SimulatedFlight) -> tuple[Array, Array]:
    """Largest speeds of a flight (3,); 1 where it violates one of `LIMITS`, or is hasty along x or y, else 0 (7,)."""
    space, velocity, position = plan.space, flight.velocity, path(plan, flight)[:, :3]
    flat = np.hypot(velocity[:, 0], velocity[:, 1])
    fastest = np.array([flat.max(), np.abs(velocity[:, 2]).max(), np.abs(velocity[:, 3]).max()])
    calm = np.abs(velocity[:, :2]).max(axis=0) <= space.speed / np.sqrt(2)
    slow = fastest[:2] <= np.array([space.speed, space.climb])
    inside = (position >= np.array(space.lower)) & (position <= np.array(space.upper))
    violated = np.concatenate([~inside.all(axis=0), ~slow, ~calm])  # a path that is not finite violates all
    return fastest, violated.astype(float)


class _Trial:
    """The drawn vehicles of a fleet, on which one plan after another is tried.

    A vehicle that violated a limit flies first the next time, and as soon as the answer is certain no other one flies.
    """

    def __init__(self, vehicles: Sequence[Draw]) -> None:
        self._vehicles = list(vehicles)

    def half(self) -> "_Trial":
        """The first half of the vehicles, at least one."""
        return _Trial(self._vehicles[: max(len(self._vehicles) // 2, 1)])

    def fits(self, plan: Plan) -> bool:
        """Whether no more vehicles leave the space than are allowed: `Envelope.fits`."""
        return bool(self._shares(plan, lambda shares: bool(shares[7] > ALLOWED))[7] <= ALLOWED)

    def guilty(self, plan: Plan, axes: Sequence[str]) -> set[str]:
        """The axes that violate a limit themselves."""
        shares = self._shares(plan, lambda shares: all(_guilty(axis, axes, shares) for axis in axes))
        return {axis for axis in axes if _guilty(axis, axes, shares)}

    def _shares(self, plan: Plan, certain: Callable[[Array], bool]) -> Array:
        """Share of vehicles for each entry of `_violated`, and that of those that violate any limit, shape (8,).

        Where the answer was certain before all had flown, the shares are lower bounds.
        """
        count, shares = np.zeros(8), np.zeros(8)
        for place, flight in enumerate(fly_draws(tracker_of(plan), tuple(self._vehicles))):
            _, violated = _violated(plan, flight)
            if violated.any():
                self._vehicles.insert(0, self._vehicles.pop(place))
                count += [*violated, violated[:5].any()]
                shares = count / len(self._vehicles)
                if certain(shares):
                    break
        return shares


def with_amplitudes(plan: Plan, factors: Mapping[str, float]) -> Plan:
    """The plan with the signals of each axis multiplied by a factor."""
    signals = (replace(each, signal=scaled(each.signal, factors[each.axis])) for each in plan.excitations)
    return replace(plan, excitations=tuple(signals))


def largest_amplitudes(
    plan: Plan, fleet: Sequence[Draw], upper: float = 1.0, progress: Progress | None = None
) -> dict[str, float]:
    """The largest factors on the signals with which the plan stays in its space, axis by axis, by bisection.

    An axis shrinks only where it violates a limit itself: x and y the sides of the box along them and the speed, z its
    side and the climb rate. If the plan still leaves, as where the heading turns, all axes shrink together.

    Args:
        plan: The plan at factor 1.
        fleet: As for `predicted_path`; it is flown with every factor. The search first uses half of it.
        upper: Largest factor considered.
        progress: Called with a fraction and a text; raising in it cancels.

    Returns:
        Axis to factor, accurate to 2 %; all 0 where even the hover leaves.
    """
    axes = [axis for axis in AXES if any(each.axis == axis for each in plan.excitations)]
    hover = dict.fromkeys(axes, 0.0)
    low, high = dict(hover), dict.fromkeys(axes, upper)
    trial = _Trial(fleet[1:])
    half, factors = trial.half(), dict(high)
    for step in range(_STEPS):
        if progress:
            progress(0.5 * step / _STEPS, "looking for the largest amplitude")
        if step == 1 and not any(trial.fits(with_amplitudes(plan, each)) for each in (low, hover)):
            return hover
        guilty = half.guilty(with_amplitudes(plan, factors), axes)
        high |= {axis: factors[axis] for axis in guilty}
        low |= {axis: factors[axis] for axis in axes if axis not in guilty}
        if all(high[axis] - low[axis] <= FINENESS * low[axis] for axis in axes):
            break
        factors = {axis: (low[axis] + high[axis]) / 2 for axis in axes}
    rest = _second_half(progress)
    if min(low.values()) <= 0:  # what is left for this axis, the others use up together
        return dict.fromkeys(axes, _largest_common(plan, trial, upper, rest))
    plan = with_amplitudes(plan, low)
    if not trial.fits(plan):
        common = _largest_common(plan, trial, 1.0, rest)
        return {axis: common * factor for axis, factor in low.items()}
    plane = [axis for axis in axes if axis in ("x", "y")]
    if len(plane) < 2:
        return low
    spare = min(np.sqrt(2), upper / max(low[axis] for axis in plane))  # they need not be fastest at the same time
    more = _largest_common(plan, trial, spare, rest, plane) if spare > 1 else 1.0
    return {axis: (max(more, 1.0) if axis in plane else 1.0) * factor for axis, factor in low.items()}


def _guilty(axis: str, axes: Sequence[str], shares: Array) -> bool:
    """Whether an axis itself violates a limit; x and y flown together share the speed limit equally."""
    outside = dict(zip(LIMITS, shares[:5], strict=True))
    if axis == "yaw":
        return False
    if axis == "z":
        return bool(max(outside["z"], outside["climb"]) > ALLOWED)
    speed = shares[5 + "xy".index(axis)] if {"x", "y"} <= set(axes) else outside["speed"]
    return bool(max(outside[axis], speed) > ALLOWED)


_STEPS, _MOST_STEPS = 12, 80

_LITTLE, _PATIENCE, _AT_ONCE = 0.8, 8, 1e-6
"""A factor that leaves is cut to this share, for usually only little has to be taken off; after so many cuts to the
square of the last share, so that any amplitude comes down to one that fits, but not at once to less than this."""


def _second_half(progress: Progress | None) -> Progress | None:
    if progress is None:
        return None
    outer = progress
    return lambda fraction, text: outer(0.5 + 0.5 * fraction, text)


def largest_amplitude(plan: Plan, fleet: Sequence[Draw]) -> float:
    """The largest common factor up to 1 on all signals with which the plan stays in its space; 0 if none does."""
    return _largest_common(plan, _Trial(fleet[1:]), 1.0, None)


def judged_amplitude(plan: Plan, judges: Sequence[Draw]) -> float:
    """The largest common factor up to 1, in steps of `SHRUNK`, with which a plan stays in its space for its judges."""
    trial = _Trial(judges[1:])
    for factor in SHRUNK ** np.arange(10):
        if trial.fits(with_amplitudes(plan, dict.fromkeys(AXES, float(factor)))):
            return float(factor)
    return _largest_common(plan, trial, float(factor), None)


def braking_amplitude(plan: Plan, judges: Sequence[Draw]) -> float:
    """The largest factor up to 1, in steps of `SHRUNK`, with which the guard stops no more judges than may leave.

    The guard ends a flight where braking would lead out of the box. Where no factor helps, as beside a wall, it is 1,
    and the preflight check says why the plan is not flown.
    """
    reaction, deceleration = np.array(braking_of(plan))
    for factor in SHRUNK ** np.arange(20):
        tracker = tracker_of(with_amplitudes(plan, dict.fromkeys(AXES, float(factor))))
        stopped = [_stopped(tracker.plan, flight, reaction, deceleration) for flight in fly_draws(tracker, judges)]
        if not stopped[0] and np.mean(stopped[1:]) <= ALLOWED:
            return float(factor)
    return 1.0


def _stopped(plan: Plan, flight: SimulatedFlight, reaction: Array, deceleration: Array) -> bool:
    """Whether braking would lead out of the box somewhere."""
    speed = flight.velocity[:, :3]
    rest = path(plan, flight)[:, :3] + speed * reaction + speed * np.abs(speed) / (2 * deceleration)
    return not bool(np.all((rest >= plan.space.lower) & (rest <= plan.space.upper)))


def _largest_common(
    plan: Plan, trial: _Trial, upper: float, progress: Progress | None, axes: Sequence[str] = AXES
) -> float:
    """As `largest_amplitude`, on the signals of some axes."""

    def stays(factor: float, step: int) -> bool:
        if progress:
            progress(step / _MOST_STEPS, f"looking for the largest amplitude: {factor:.2f}")
        return trial.fits(with_amplitudes(plan, {axis: factor if axis in axes else 1.0 for axis in AXES}))

    if stays(upper, 0):
        return upper
    if not stays(0.0, 0):
        return 0.0
    low, high, cut = 0.0, upper, _LITTLE
    for step in range(1, _MOST_STEPS):
        middle = _between(low, high) if low else cut * high
        low, high = (middle, high) if stays(middle, step) else (low, middle)
        if low and high - low <= FINENESS * low:
            break
        if step >= _PATIENCE:
            cut = max(cut**2, _AT_ONCE)
    return low


def _between(low: float, high: float) -> float:
    """The mean; the geometric one where the ends are of different sizes."""
    return (low + high) / 2 if high < 2 * low else float(np.sqrt(low) * np.sqrt(high))


def refuse_if_outside(plan: Plan, fleet: Sequence[Draw], envelope: Envelope, amplitude: float = 1.0) -> None:
    """Refuses a plan that leaves its space under the uncertainty of the belief.

    Args:
        plan: The plan.
        fleet: The vehicles that fly it, from `fleet_of`.
        envelope: Its prediction.
        amplitude: The plan's present amplitude.

    Raises:
        PlanError: It leaves; the message gives the largest amplitude that fits.
    """
    if envelope.fits:
        return
    fitting = amplitude * largest_amplitude(plan, fleet)
    worst = LIMITS[int(np.argmax(envelope.outside))]
    share = f"{100 * envelope.leaving:.0f} % of {envelope.draws} vehicles that are believed possible"
    where = f"break the limit of {worst}" if worst in ("speed", "climb") else f"leave the box along {worst}"
    remedy = (
        f"the largest amplitude that fits is {_floored(fitting)}: give --amplitude {_floored(fitting)}, or none to "
        "have it scaled axis by axis"
        if fitting > 0
        else "no amplitude fits, even the hover drifts out: give a larger box, a shorter duration, or feedback"
    )
    raise PlanError(f"plan {plan.name}: {share} {where}, at most {100 * ALLOWED:.0f} % may; {remedy}")


def _floored(value: float) -> str:
    """Three significant digits, never more than the value, so that the suggested amplitude fits."""
    grain = 10.0 ** (np.floor(np.log10(value)) - 2)
    return f"{np.floor(value / grain + 1e-9) * grain:.3g}"
