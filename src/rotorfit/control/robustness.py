"""Margins under uncertainty: a law around each of many vehicles drawn from a model's covariance."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from rotorfit.control.control_law import AxisLaw
from rotorfit.control.loop_vehicle import (
    LoopVehicle,
    differs_at_hover,
    first_order_about,
    has_own_margins,
    has_quadratic_drag,
    loop_vehicle,
)
from rotorfit.control.margins import frequencies, law_response, spectral_radius, vehicle_response
from rotorfit.core.errors import ModelError
from rotorfit.core.frames import Array
from rotorfit.core.laws import LAG, ZERO, structure_named
from rotorfit.core.model import (
    NORMAL,
    PLANNED,
    STRUCTURE,
    Interval,
    Model,
    Predictor,
    Weighed,
    first_order,
    laws_of_vehicle,
    predictor_of,
)
from rotorfit.planning.axis_information import AxisBelief
from rotorfit.planning.belief import DELAY

TINY = float(np.finfo(float).tiny)
"""Lower limit of the size of a loop whose gain is so small that it counts as zero."""

NEAR = 0.5
"""Least share of the normal distribution's reach to which the side of a skewed interval narrows it."""

SLOWEST = 0.1
"""Least share of the damping at which a drawn vehicle keeps the total lag: with less, no delay makes up for it."""

LEAST = 0.1
"""Least share of the drawn vehicles that must agree with the intervals."""

DENSITY = 100
"""Number of frequencies in a decade at which the loops of the draws are evaluated."""


@dataclass(frozen=True)
class Robustness:
    """Margins of a law around the vehicles that a model considers possible.

    Attributes:
        unstable: Share of the vehicles with an unstable loop, by its eigenvalues.
        gain: Factors on the gain, below and above 1, between which 95 % of them are stable, each end by itself.
        peak: Peak of the sensitivity that 95 % of them do not exceed.
        phase: Phase margin that 95 % of them keep [rad].
        delay: Delay margin that 95 % of them keep, the phase margin over the frequency at |L| = 1 [s].
        draws: Number of vehicles.
        seed: Seed of the draws.
    """

    unstable: float
    gain: tuple[float, float]
    peak: float
    phase: float
    delay: float
    draws: int
    seed: int


@dataclass(frozen=True)
class Doubt:
    """Vehicles that are considered possible, and their frequency responses.

    Attributes:
        vehicles: D draws.
        frequency: Grid of the responses, shape (F,) [rad/s].
        response: From the command to the pose, complex, shape (D, F).
        seed: Seed of the draws.
    """

    vehicles: tuple[LoopVehicle, ...]
    frequency: Array
    response: np.ndarray
    seed: int


def known_dynamics(model: Model, axis: str) -> AxisBelief:
    """The axis as a first-order law with a delay: its own law, about hover where that differs, or that beside it.

    No vehicle moves before its command: a delay below 0, as where stamps are off, counts as none. So does one that the
    model does not know.

    Raises:
        ModelError: The axis was not excited.
    """
    own = differs_at_hover(structure_named(model.axes[axis].structure))
    law = laws_of_vehicle(model, axis)[0] if own else first_order(model, axis)
    point = law.predictor if _knows_the_delay(law) else replace(law.predictor, delay=0.0)
    vehicle = loop_vehicle(structure_named(law.structure), point)
    assert vehicle is not None  # of the first order, or about hover
    return first_order_about(vehicle)


def _knows_the_delay(law: Weighed) -> bool:
    """Whether a law has an error of the delay; one without any errors is taken at its word."""
    return "delay" in law.stderr or not law.stderr


def known_vehicle(model: Model, axis: str) -> LoopVehicle:
    """The axis under its own law, where margins follow from it; else under the first-order law with a delay.

    A delay that the model does not know is that of commercial quadrotors: without one, margins promise too much.

    Raises:
        ModelError: The axis was not excited.
    """
    point = predictor_of(model, axis)
    if model.axes[axis].delay is None and f"{axis}.delay" not in model.covariance_names:
        point = replace(point, delay=DELAY[0])
    own = loop_vehicle(structure_named(model.axes[axis].structure), point)
    if own:
        return own
    plain = known_dynamics(model, axis)
    return plain if _knows_the_delay(first_order(model, axis)) else plain._replace(delay=DELAY[0])


def believed_possible(model: Model, axis: str, count: int, seed: int) -> list[LoopVehicle]:
    """Vehicles drawn for an axis from the model: laws by their weights, parameters by their normal distributions.

    Where an interval reaches further to a side than the standard error does, that side is drawn wider; what lies far
    beyond the intervals is left out. No delay is below 0; one that the model does not know is drawn as that of
    commercial quadrotors, `belief.DELAY`. An axis whose law has no margins of its own is drawn under the first-order
    law beside them.

    Args:
        model: From a fit.
        axis: Name of the axis.
        count: Number of vehicles, some of which are left out.
        seed: Seed of the draws.

    Raises:
        ModelError: The axis was not excited, or the model does not say how well it is known, or contradicts itself.
    """
    rng = np.random.default_rng(seed)
    laws = _own_laws(model, axis)
    if not all(law.stderr for law in laws):
        raise ModelError(f"the model has no covariance of {axis}, so no margin can be stated: fit its flights again")
    weight = np.array([law.weight for law in laws])
    counts = rng.multinomial(count, weight / weight.sum()) if len(laws) > 1 else [count]
    known = model.axes[axis]
    beside = known.plain if len(laws) == 1 and laws[0].structure != known.structure else None
    ci95 = dict(beside.ci95 if beside else known.ci95)
    if not all("delay" in law.stderr for law in laws):
        ci95.pop("delay", None)
    reach = _reach(laws, ci95)
    if has_quadratic_drag(structure_named(laws[0].structure)):
        ci95.pop("damping", None)  # what is drawn is the damping at hover, which may be near 0
    drawn = [one for law, number in zip(laws, counts, strict=True) for one in _drawn(law, int(number), rng, reach)]
    possible = [one for one in drawn if not _is_far_out(one, ci95)]
    if len(possible) < LEAST * len(drawn):
        raise ModelError(
            f"of {len(drawn)} vehicles drawn for {axis} from the model's covariance {len(possible)} agree with its "
            f"intervals, so no margin can be stated: fit a flight that tells more of it{PLANNED}"
        )
    return possible


def _is_far_out(vehicle: LoopVehicle, ci95: Mapping[str, Interval]) -> bool:
    """Whether gain, damping or delay lie so far beyond their intervals that only a normal distribution goes there.

    That is beyond twice or half an end, or with the other sign; of the delay, by more than the width of its interval.
    """
    for name, value in (("input", vehicle.gain), ("damping", vehicle.damping)):
        low, high = ci95.get(name, (None, None))
        near, far = (high, low) if high is not None and high < 0 else (low, high)
        if near is None or (near is low and near <= 0):  # the interval has both signs
            continue
        if value / near < 0.5 or (far is not None and value / far > 2):
            return True
    least, most = ci95.get("delay", (None, None))
    if least is None or most is None:
        return False
    return not 2 * least - most <= vehicle.delay <= max(most, 0.0) + most - least  # a delay below 0 is drawn as 0


def _own_laws(model: Model, axis: str) -> tuple[Weighed, ...]:
    """The laws that an axis may have, with the uncertainty of the vehicle; first order where they do not serve."""
    known = model.axes[axis]
    if known.predictor is None or not has_own_margins(structure_named(known.structure)):
        return (first_order(model, axis),)
    laws = laws_of_vehicle(model, axis)
    return (first_order(model, axis),) if len(laws) == 1 and known.structure == STRUCTURE else laws


def _reach(laws: Sequence[Weighed], ci95: Mapping[str, Interval]) -> dict[str, tuple[float, float]]:
    """How far the interval of each parameter reaches down, and up, over the laws' normal distributions.

    Profiles of input and damping are skewed where a flight tells little. What another law accounts for is no skew.
    """
    out = {}
    for name, (low, high) in ci95.items():
        known = [(_value(law, name), law.stderr[name]) for law in laws if law.stderr.get(name)]
        out[name] = (_further(known, low, -1.0), _further(known, high, 1.0))
    return out


def _value(law: Weighed, name: str) -> float:
    point = law.predictor
    return {"input": point.input, "damping": point.damping, "delay": point.delay, **point.extra}[name]


def _further(known: Sequence[tuple[float, float]], end: float | None, side: float) -> float:
    """The end of an interval over that of the normal distribution that reaches furthest to its side; at least `NEAR`.

    Args:
        known: Estimate and standard error under each law.
        end: The end; None if it is open.
        side: 1 for the upper end, -1 for the lower one.
    """
    if end is None or not known:
        return 1.0
    point, error = max(known, key=lambda one: side * one[0] + NORMAL * one[1])
    return max(side * (end - point) / (NORMAL * error), NEAR)


def _drawn(
    law: Weighed, count: int, rng: np.random.Generator, reach: Mapping[str, tuple[float, float]]
) -> list[LoopVehicle]:
    """Vehicles drawn from the distribution of one law, further out to the sides that `reach` names.

    Of gain and steady gain, and of the delay, its sum with what else makes the answer late, and the total lag, the data
    may tell one much better than the others. The best known keeps its distribution where others are far out, and the
    gain, or the delay, is what is left.
    """
    structure, point = structure_named(law.structure), law.predictor
    names = ("input", "damping", "delay", *point.extra)
    usual, further = ({**dict.fromkeys(names, np.zeros(count)), **each} for each in _errors(law, count, rng, reach))
    b = point.damping
    damping, relative = b + further["damping"], usual["input"] / point.input
    steady = relative - usual["damping"] / b
    kept = np.std(steady) < np.std(relative)
    gain = damping * point.input / b * np.exp(steady) if kept else point.input + further["input"]
    late, extra = np.zeros((2, count)), {}  # what makes the answer late besides the delay: to first order, and as drawn
    for one in structure.extras:
        value = point.extra[one.name]
        extra[one.name] = np.clip(value + further[one.name], one.low, one.high)
        sign = 1.0 if one.place == LAG and structure.order == 1 else -1.0 if one.place == ZERO else 0.0
        late += sign * np.array([value + usual[one.name], extra[one.name]])
    slow = np.array([(1 - usual["damping"] / b) / b, 1 / np.maximum(damping, SLOWEST * b)])
    sums = ((0.0 * late, further), (late, usual), (late + slow, usual))
    rest, off = min(sums, key=lambda each: float(np.std(usual["delay"] + each[0][0])))
    delay = point.delay + off["delay"] + rest[0] - rest[1]
    if "delay" not in law.stderr:
        delay = rng.normal(*DELAY, count)
    early = np.minimum(delay, 0.0)  # no vehicle moves before its command: then a lag is shorter, or a zero larger
    for one in structure.extras:
        if one.place == ZERO or (one.place == LAG and structure.order == 1):
            extra[one.name] = np.clip(extra[one.name] + (early if one.place == LAG else -early), one.low, one.high)
    drawn = []
    for g, b, tau, *others in np.column_stack([gain, damping, delay, *extra.values()]).tolist():
        drawn.append(loop_vehicle(structure, Predictor(g, b, tau, dict(zip(extra, others, strict=True)))))
    return [one for one in drawn if one is not None]


def _errors(
    law: Weighed, count: int, rng: np.random.Generator, reach: Mapping[str, tuple[float, float]]
) -> tuple[dict[str, Array], dict[str, Array]]:
    """Errors of the parameters of a law by name, shape (count,): of their normal distribution, and further out.

    Where an interval reaches further to a side than its standard error, the parameter goes there and takes along what
    is correlated with it: gain and damping far out are possible together, at the steady gain that the data tell.
    """
    names = sorted(law.stderr, key=lambda name: -max(reach.get(name, (1.0, 1.0))))
    at = [list(law.stderr).index(name) for name in names]
    value, vector = np.linalg.eigh(np.array(law.correlation)[np.ix_(at, at)])  # a zero may do what the delay does
    R = np.linalg.qr((vector * np.sqrt(np.maximum(value, 0.0))).T, mode="r")
    R = R * np.copysign(1.0, np.diag(R))[:, None] * np.array([law.stderr[name] for name in names])
    own = rng.standard_normal((count, len(names)))  # of each parameter, given those before it
    down, up = np.array([reach.get(name, (1.0, 1.0)) for name in names]).T
    usual, further = (dict(zip(names, (each @ R).T, strict=True)) for each in (own, own * np.where(own < 0, down, up)))
    return usual, further


def doubt(vehicles: Sequence[LoopVehicle], period: float, latency: float, seed: int) -> Doubt:
    """Vehicles with their frequency responses, computed once for all laws that are tried.

    Args:
        vehicles: The draws.
        period: Time between commands [s].
        latency: Time from the exposure of a pose to the command that uses it [s].
        seed: Seed of the draws.
    """
    w = frequencies(period, DENSITY)
    return Doubt(tuple(vehicles), w, np.array([vehicle_response(one, period, latency, w) for one in vehicles]), seed)


def highest_peak(law: AxisLaw, possible: Doubt) -> float:
    """The peak of the sensitivity that 95 % of the vehicles do not exceed, if all loops are stable: no eigenvalues."""
    return _quantile(1 / np.abs(1 + _open_loops(law, possible)).min(axis=1), 0.95)


def robustness(law: AxisLaw, possible: Doubt) -> Robustness:
    """Margins of a law around every possible vehicle; an unstable loop has none."""
    L = _open_loops(law, possible)
    peak, phase, delay = _around_each(law, possible, L)
    below, above = np.where(np.isinf(peak), 1.0, _gains(L))
    return Robustness(
        float(np.mean(np.isinf(peak))),
        (_quantile(below, 0.95), _quantile(above, 0.05)),
        _quantile(peak, 0.95),
        _quantile(phase, 0.05),
        _quantile(delay, 0.05),
        len(possible.vehicles),
        possible.seed,
    )


def share_beyond(law: AxisLaw, possible: Doubt, peak: float, delay: float) -> float:
    """Share of the possible vehicles with a higher peak of the sensitivity or a smaller delay margin [s] than given."""
    peaks, _, delays = _around_each(law, possible, _open_loops(law, possible))
    return float(np.mean((peaks > peak) | (delays < delay)))


def _open_loops(law: AxisLaw, possible: Doubt) -> np.ndarray:
    """L of the law with each vehicle, complex, shape (D, F)."""
    return np.asarray(-law_response(law, possible.frequency) * possible.response)


def _around_each(law: AxisLaw, possible: Doubt, L: np.ndarray) -> tuple[Array, Array, Array]:
    """Peak, phase margin [rad] and delay margin [s] of each vehicle, shape (D,): infinite, 0 and 0 if unstable."""
    stable = np.array([spectral_radius(law, one) < 1 for one in possible.vehicles])
    phase, delay = _phase_and_delay(L, possible.frequency)
    peak = np.where(stable, 1 / np.abs(1 + L).min(axis=1), np.inf)
    return peak, np.where(stable, phase, 0.0), np.where(stable, delay, 0.0)


def _quantile(values: Array, share: float) -> float:
    """A quantile without interpolation: always one of the values, which may be infinite."""
    return float(np.quantile(values, share, method="inverted_cdf"))


def _gains(L: np.ndarray) -> Array:
    """Factors on each row, the largest below and the smallest above 1, with which it meets -1; shape (2, D).

    0 and infinite where there is none. Crossings of the negative axis are interpolated linearly; at the Nyquist
    frequency, the end of the grid, the loop is real.
    """
    re, im = L.real, L.imag
    crossing = im[:, :-1] * im[:, 1:] < 0
    share = np.where(crossing, im[:, :-1] / np.where(crossing, im[:, :-1] - im[:, 1:], 1.0), 0.0)
    at = np.where(crossing, re[:, :-1] + share * np.diff(re, axis=1), 0.0)
    met = -np.column_stack([at, re[:, -1]])
    factor = np.where(met > TINY, 1 / np.maximum(met, TINY), np.nan)
    return np.array([
        np.where(factor < 1, factor, 0.0).max(axis=1), np.where(factor > 1, factor, np.inf).min(axis=1)
    ])  # fmt: skip


def _phase_and_delay(L: np.ndarray, w: Array) -> tuple[Array, Array]:
    """Least phase [rad] and delay margin [s] of each row; crossings are interpolated linearly between grid points."""
    size, angle = np.log(np.maximum(np.abs(L), TINY)), np.mod(np.angle(-L), 2 * np.pi)
    crossing = size[:, :-1] * size[:, 1:] < 0
    share = np.where(crossing, size[:, :-1] / np.where(crossing, size[:, :-1] - size[:, 1:], 1.0), 0.0)
    turn = np.angle(L[:, 1:] * L[:, :-1].conj())
    at = np.mod(angle[:, :-1] + share * turn, 2 * np.pi)
    frequency = w[:-1] + share * np.diff(w)
    phase = np.where(crossing, np.minimum(at, 2 * np.pi - at), np.pi).min(axis=1)
    return phase, np.where(crossing, at / frequency, np.inf).min(axis=1)
