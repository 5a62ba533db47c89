"""Belief: expected properties of a vehicle, its air and its room before a flight, with their uncertainty.

From a card and its limits, from a model file, or from a published set; converted to and from the plain types of a plan.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from rotorfit.core.card import Card
from rotorfit.core.errors import PlanError
from rotorfit.core.flight_plan import Four
from rotorfit.core.frames import AXES, POSE_UNITS, Array
from rotorfit.core.frozen import frozen_axes
from rotorfit.core.laws import USUAL_TRIM
from rotorfit.core.limits import Meaning, expectation, meaning_of
from rotorfit.core.model import (
    COEFFICIENTS,
    FROZEN,
    MEND,
    NORMAL,
    STRUCTURE,
    Axis,
    Model,
    Weighed,
    by_velocity_alone,
    first_order,
    pose_rates,
)
from rotorfit.simulation.paper_vehicle import Truth
from rotorfit.simulation.published import PUBLISHED, vehicle_of

DAMPING: Mapping[str, tuple[float, float]] = {
    "tilt": (0.40, 0.27), "vertical_speed": (2.9, 0.8), "velocity": (2.0, 1.0), "yaw_rate": (3.2, 1.4)
}  # fmt: skip
"""Mean and standard deviation of the damping for each meaning of a command [1/s].

Source: mean and spread, rounded, of the published sets for tilt (without set G), vertical speed and yaw rate; for a
velocity loop it is an assumption, a time constant of half a second within a factor of 1.6.
"""

DELAY = (0.15, 0.10)
"""Mean and standard deviation of the delay [s]. Source: 0.15 to 0.20 s on Bebop 2 flights, 0.26 s published for one."""

GAIN_SHARE = 0.15
"""Relative standard deviation of the response to a full command about the expectation from the card's limits."""

UNKNOWN_SHARE = (0.5, 0.7)
"""Relative standard deviations of input and damping where nothing is known; a model's are never taken to be larger."""

QUIET = "those of a quiet motion-capture room (0.5 mm, 0.02 m/s^2)"
"""Note where no flight has revealed noise and wind."""

POSES = f"{Truth().pose_rate:g} poses a second"
"""Assumption where no flight has revealed the rate of the poses."""

FEWEST_POSES = 1.0
"""Fewest poses a second that are planned with: across longer gaps nothing is fitted."""

MOST_POSES = 1000.0
"""Most poses a second that are planned with: their jitter is 0.2 ms, and each costs time."""

NAMES = tuple(f"{axis}.{name}" for axis in AXES for name in COEFFICIENTS)
"""Order of the twelve coefficients in a covariance."""


@dataclass(frozen=True)
class Belief:
    """Belief about a vehicle.

    Attributes:
        truth: The likeliest vehicle, air and room.
        covariance: Covariance of input, damping and delay of x, y, z, yaw in turn, shape (12, 12). 0 between axes: what
            a fit finds there is small.
        trim_sigma: Standard deviation of the trim about that of the likeliest [m/s^2; rad/s^2 for yaw].
        levels: Axis to the four levels of its disturbance as in the likelihood (`disturbance.LEVELS`), for the axes of
            a model; for the others they follow from the wind of `truth`.
        widening: How many times as wide the intervals of a model are as under the law that is planned for, shape (12,);
            not kept in a plan.
        source: Origin, for people.
        notes: Assumptions, one line each.
    """

    truth: Truth
    covariance: Array
    trim_sigma: Four
    levels: Mapping[str, tuple[float, ...]] = field(default_factory=dict)
    widening: Array = field(default_factory=lambda: np.ones(12))
    source: str = ""
    notes: tuple[str, ...] = ()

    @property
    def coefficients(self) -> Array:
        """Input, damping and delay of x, y, z, yaw in turn, shape (12,)."""
        return coefficients_of(self.truth)


def coefficients_of(truth: Truth) -> Array:
    """Input, damping and delay of x, y, z, yaw in turn, shape (12,)."""
    return np.column_stack([truth.gamma[::2], truth.gamma[1::2], truth.delay]).ravel()


def with_coefficients(truth: Truth, values: Array) -> Truth:
    """Another vehicle in the same air and room, from twelve coefficients in that order."""
    table = values.reshape(4, 3)
    return replace(
        truth,
        gamma=tuple(map(float, table[:, :2].ravel())),
        delay=_four(table[:, 2]),
    )


def belief_from_card(card: Card) -> Belief:
    """The belief about a vehicle from the limits and priors of its card.

    A full tilt accelerates by g tan(tilt), a full speed or rate is eventually reached. The damping is that of published
    sets, the delay that of a Bebop 2. Where the card has no limit but names a vehicle with published sets, their mean
    and spread are used. A prior of a coefficient in the card takes precedence.

    Raises:
        PlanError: The card does not say what a command reaches, and its vehicle is not known.
    """
    belief = _assembled([_expected(card, axis) for axis in AXES], f"card {card.name}")
    note = f"noise and wind: {QUIET}; {POSES} are assumed; a first flight tells more"
    return _checked(replace(belief, notes=(*belief.notes, note)))


def _assembled(parts: Sequence[tuple[Array, Array, str]], source: str) -> Belief:
    """A belief from input, damping and delay of each axis, their covariance and a note."""
    truth = with_coefficients(Truth(), np.concatenate([mean for mean, _, _ in parts]))
    notes = tuple(note for _, _, note in parts if note)
    return Belief(truth, _blocks([covariance for _, covariance, _ in parts]), USUAL_TRIM, source=source, notes=notes)


def _expected(card: Card, axis: str) -> tuple[Array, Array, str]:
    """Input, damping, delay of one axis, their covariance (3, 3), and a note on assumptions."""
    if axis not in card.command:
        return np.array([1.0, 1.0, DELAY[0]]), np.diag([0.01, 0.01, DELAY[1] ** 2]), ""
    meaning, prior, note = meaning_of(card, axis), card.prior.get(axis, {}), ""
    reach = expectation(meaning)
    vehicle = vehicle_of(card.name)
    if reach is not None or "input" in prior:
        damping, spread = DAMPING[meaning.asked or "velocity"]
        mean, covariance = _product(reach or 1.0, meaning, damping, spread)
    elif vehicle and len(sets := _stable(vehicle, axis)) > 1:
        mean, covariance = np.array([*np.mean(sets, axis=0), DELAY[0]]), np.diag([0.0, 0.0, DELAY[1] ** 2])
        covariance[:2, :2] = np.diag(np.var(sets, axis=0, ddof=1))
        note = f"{axis}: the card has no limit, so the mean and spread of {len(sets)} published sets of the {vehicle}"
    else:
        raise PlanError(f"card {card.name}: {_unsaid(card, axis, meaning)}, or plan --after a model of a first flight")
    for i, name in enumerate(COEFFICIENTS):
        if one := prior.get(name):
            mean[i], covariance[i], covariance[:, i] = one.mean, 0.0, 0.0
            covariance[i, i] = one.sd**2
    if not (mean[0] and mean[1] > 0 and mean[2] >= 0):
        raise PlanError(
            f"card {card.name}, [prior] {axis}: no flight can be planned for an input of {mean[0]:g}, a damping of "
            f"{mean[1]:g} and a delay of {mean[2]:g}: give one that is not 0, one above 0, and one of 0 or more"
        )
    return mean, covariance, note


def _unsaid(card: Card, axis: str, meaning: Meaning) -> str:
    """Why a card does not tell what a command of 1 on an axis reaches, and what to give."""
    channel = card.command[axis]
    if meaning.asked is None and (channel.meaning or channel.full_scale or channel.unit):
        return f"{meaning.reason}; correct that"
    wanted = f"give [limits] {meaning.limit}" if meaning.limit else "give the channel a meaning and a limit"
    return f"it does not say what a command of 1 on {axis} reaches; {wanted}"


def _stable(vehicle: str, axis: str) -> Array:
    """Input and damping of an axis in a vehicle's published sets in fractions with positive damping, shape (S, 2)."""
    a = 2 * AXES.index(axis)
    pairs = [one.gamma[a : a + 2] for one in PUBLISHED if one.vehicle == vehicle and one.command == "fraction"]
    return np.array([pair for pair in pairs if pair[1] is not None and pair[1] > 0], float)


def _product(reach: float, meaning: Meaning, damping: float, spread: float) -> tuple[Array, Array]:
    """Input, damping, delay and their covariance from the response to a full command.

    That response is an acceleration for a tilt, else a speed: input over damping, so that the two vary together.
    """
    if meaning.asked == "tilt":
        return np.array([reach, damping, DELAY[0]]), np.diag([(reach * GAIN_SHARE) ** 2, spread**2, DELAY[1] ** 2])
    mean, share = np.array([reach * damping, damping, DELAY[0]]), (spread / damping) ** 2
    shares = np.array(
        [[share + GAIN_SHARE**2, share, 0.0], [share, share, 0.0], [0.0, 0.0, (DELAY[1] / DELAY[0]) ** 2]]
    )
    return mean, np.outer(mean, mean) * shares


def belief_from_model(model: Model, where: str) -> Belief:
    """The belief about a vehicle, its air and its room from a fitted model, completed by the model's card.

    It uses the likelihood's own estimates with their covariance, as wide as the intervals where these are of another
    law or cover several, the levels of the disturbance, the fewest fresh poses a second of its flights, and the spread
    of the trims over them. No uncertainty exceeds `UNKNOWN_SHARE`.

    Args:
        model: From a fit by the likelihood.
        where: Its file, for messages.

    Raises:
        PlanError: No axis has numbers, and the card has no limits; or an axis is unstable.
    """
    from rotorfit.dynamics.disturbance import LEVELS  # on use: it brings numba

    known = [axis for axis in AXES if model.axes[axis].predictor]
    rest = _rest(model, known, where)
    values, covariance = rest.coefficients.reshape(4, 3).copy(), rest.covariance.copy()
    sigma, wind, noise = (np.array(four) for four in (rest.trim_sigma, rest.truth.wind_sigma, rest.truth.mocap_noise))
    time, levels, notes = np.array(rest.truth.wind_time), {}, list(rest.notes)
    for axis in known:
        a, one = AXES.index(axis), model.axes[axis]
        law = first_order(model, axis)
        point = law.predictor
        values[a, :2] = point.input, point.damping
        if "delay" in law.stderr or not law.stderr:
            values[a, 2] = point.delay
        else:
            notes.append(f"the model does not know the delay of {axis}: {DELAY[0]:g} +- {DELAY[1]:g} s are expected")
            values[a, 2] = DELAY[0]
        if values[a, 2] < 0:
            notes.append(f"the model's delay of {axis} is negative: planned with 0")
            values[a, 2] = 0.0
        if set(LEVELS) <= set(one.noise):
            levels[axis] = tuple(one.noise[name] for name in LEVELS)
            wind[a], time[a] = _wind(levels[axis], values[a, 1])
            noise[a] = np.sqrt(levels[axis][1])
        if trims := [trim for trim in one.trim if trim is not None]:
            sigma[a] = max(float(np.sqrt(np.mean(np.square(trims)))), USUAL_TRIM[a] / 2)

    def air(axis: str) -> str:
        """Noise of the pose and standard deviation of the wind of an axis, in words."""
        a, unit = AXES.index(axis), POSE_UNITS[axis]
        return f"{axis} {1e3 * noise[a]:.2g} m{unit} and {wind[a]:.2g} {unit}/s^2"

    richer = {axis: model.axes[axis].structure for axis in known if model.axes[axis].structure != STRUCTURE}
    if richer:
        laws = ", ".join(dict.fromkeys(richer.values()))
        notes.append(
            f"{', '.join(richer)}: planned for the first-order law with a delay, not for {laws}; errors before the "
            "flight are those of the model's intervals, and after it those of the planned law, as many times as wide "
            "as they are now"
        )
    refuted = [axis for axis in known if "refuted" in model.axes[axis].status.values()]
    if refuted:
        notes.append(
            f"{', '.join(refuted)}: the flights refute the law; the errors here are those of more data under it, and "
            "the model's intervals, which cover what the law leaves out, will not shrink by as much"
        )
    unsure = [axis for axis in AXES if len(model.axes[axis].laws) > 1]
    if unsure:
        notes.append(
            f"{', '.join(unsure)}: the model does not decide between laws; errors before the flight are those of its "
            "intervals, which cover all, and after it those of the planned law, as many times as wide as they are now"
        )
    if levels:
        notes.append(f"noise and wind are those of the model's flights: {', '.join(map(air, levels))}")
    if alone := [axis for axis in known if by_velocity_alone(model, axis)]:
        notes.append(
            f"{', '.join(alone)}: the model's flights had a velocity and no position; the errors after this flight are "
            f"those of positions, noise and wind {QUIET}"
        )
    rates = pose_rates(model, known)
    notes.append(_told_rate(rates))
    wrong = [one for one in model.findings if one.severity == "error" and one.code != FROZEN]
    notes[:0] = [f"this plan rests on numbers that must not be used: {one.evidence}; {one.remedy}" for one in wrong]
    if frozen := frozen_axes(model.findings):
        notes.insert(0, f"{', '.join(frozen)}: {MEND}")
    covariance = _known_covariance(model, values.ravel(), covariance)
    truth = replace(
        with_coefficients(rest.truth, values.ravel()),
        wind_sigma=_four(wind), wind_time=_four(time), mocap_noise=_four(noise),
    )  # fmt: skip
    if rates:
        truth = replace(truth, pose_rate=min(max(rates[0], FEWEST_POSES), MOST_POSES), stale_share=0.0)
    widening = _widening(model, covariance)
    return _checked(Belief(truth, covariance, _four(sigma), levels, widening, f"model {where}", tuple(notes)))


def _told_rate(rates: Sequence[float]) -> str:
    """The rate of the poses that is planned with, in words, from those of the flights in ascending order."""
    if not rates:
        return f"{POSES} are assumed: the model does not tell those of its flights"
    whose = "as in" if rates[-1] <= 1.1 * rates[0] else f"the fewest, {rates[-1]:.3g} the most, of"
    return f"{rates[0]:.3g} fresh poses a second, {whose} the model's flights"


def _rest(model: Model, known: Sequence[str], where: str) -> Belief:
    """The belief about the axes that a model does not know: the card's expectation, if it has any.

    The notes concern these axes only, since the card's expectation of the others no longer matters.
    """
    parts = []
    for axis in AXES:
        try:
            mean, covariance, note = _expected(model.card, axis)
        except PlanError as error:
            if not known:
                raise PlanError(f"model {where}: it has numbers for no axis, and {error}") from None
            mean, covariance = np.array([1.0, 1.0, DELAY[0]]), np.diag([1.0, 1.0, DELAY[1] ** 2])
            note = str(error)
        parts.append((mean, covariance, "" if axis in known else note))
    belief = _assembled(parts, "")
    quiet = [axis for axis in AXES if axis in model.card.command and axis not in known]
    notes = [f"noise and wind of {', '.join(quiet)}: {QUIET}"] if quiet else []
    return replace(belief, notes=(*belief.notes, *notes))


def _known_covariance(model: Model, values: Array, covariance: Array) -> Array:
    """The covariance with the blocks of the axes that a model knows, bounded by `UNKNOWN_SHARE`."""
    out = covariance.copy()
    for a, axis in enumerate(AXES):
        law = first_order(model, axis) if model.axes[axis].predictor else None
        if law is None or not {"input", "damping"} <= set(law.stderr):
            continue
        at = slice(3 * a, 3 * a + 3)
        known = np.diag([0.0, 0.0, 1e6 * DELAY[1] ** 2])
        known[: len(law.stderr), : len(law.stderr)] = law.covariance
        bound = np.array([*UNKNOWN_SHARE, np.nan]) * values[at]
        bound[2] = DELAY[1]
        if _beyond(model.axes[axis]):
            out[at, at] = _as_its_intervals(model.axes[axis], law, values[at], np.abs(bound))
            continue
        out[at, at] = np.linalg.inv(np.linalg.inv(known) + np.diag(1 / bound**2))
    return out


def _widening(model: Model, covariance: Array) -> Array:
    """`Belief.widening` of a model with the covariance of the belief about it, shape (12, 12)."""
    out: Array = np.ones(12)
    for a, axis in enumerate(AXES):
        law = first_order(model, axis) if model.axes[axis].predictor and _beyond(model.axes[axis]) else None
        if law is None or not {"input", "damping"} <= set(law.stderr):
            continue
        own = np.sqrt(np.diag(law.covariance))
        at = slice(3 * a, 3 * a + own.size)
        out[at] = np.maximum(np.sqrt(np.diag(covariance)[at]) / own, 1.0)
    return out


def _beyond(axis: Axis) -> bool:
    """Whether the intervals of an axis are those of another law than the planned one, or of several."""
    return len(axis.laws) > 1 or axis.structure != STRUCTURE


def _as_its_intervals(axis: Axis, law: Weighed, values: Array, bound: Array) -> Array:
    """Covariance as wide as the intervals of an axis, correlated as in the planned law, shape (3, 3).

    The tests of a law widen the intervals of the one that is published, not those of the one stored beside it. Input
    and damping of the two differ: their intervals are as wide in proportion.

    Args:
        axis: The axis.
        law: Its first-order law.
        values: Input, damping and delay of that, shape (3,).
        bound: Largest standard errors, shape (3,).
    """
    assert axis.predictor is not None
    correlation = np.eye(3)
    correlation[: len(law.stderr), : len(law.stderr)] = law.correlation
    ends = [axis.ci95[name] for name in COEFFICIENTS]
    half = np.array([np.inf if low is None or high is None else (high - low) / 2 for low, high in ends])
    own = np.abs([axis.predictor.input, axis.predictor.damping])
    half[:2] *= np.abs(values[:2]) / np.maximum(own, np.finfo(float).tiny)
    error = np.minimum(half / NORMAL, bound)
    return np.asarray(correlation * np.outer(error, error))


def _wind(levels: Sequence[float], damping: float) -> tuple[float, float]:
    """Standard deviation [m/s^2] and correlation time [s] of the wind whose response through drag has these levels.

    The pole of the disturbance nearer to the vehicle's damping is attributed to the drag; the other is 1 / T.
    """
    power, _, total, overlap = levels
    half = total / 2 * np.sqrt(1 - overlap)
    poles = total / 2 + half, total / 2 - half
    rate = poles[0] if abs(poles[1] - damping) <= abs(poles[0] - damping) else poles[1]
    rate = float(np.clip(rate, 0.05, 50.0))
    return float(np.sqrt(power / (2 * rate))), 1 / rate


def levels_of(belief: Belief, truth: Truth, axis: str) -> Array:
    """The four levels of an axis's disturbance as in the likelihood, for a possible vehicle; shape (4,)."""
    if axis in belief.levels:
        return np.array(belief.levels[axis])
    a = AXES.index(axis)
    damping, rate = truth.gamma[2 * a + 1], 1 / truth.wind_time[a]
    return np.array([
        2 * truth.wind_sigma[a] ** 2 * rate, truth.mocap_noise[a] ** 2, damping + rate,
        4 * damping * rate / (damping + rate) ** 2,
    ])  # fmt: skip


def sample_vehicles(belief: Belief, count: int, seed: int) -> list[Truth]:
    """Draws possible vehicles from the belief.

    Coefficients are log-normal with the mean and the standard deviations of the belief, and its correlations for the
    logarithms of their sizes, so that none changes its sign. A delay that may be near 0 is normal instead, and 0 where
    that is negative; the trim is normal.
    """
    rng = np.random.default_rng(seed)
    mean, sd = belief.coefficients, np.sqrt(np.diag(belief.covariance))
    signed = np.where(mean < 0, -sd, sd)
    with np.errstate(invalid="ignore", divide="ignore"):
        correlation = np.nan_to_num(belief.covariance / np.outer(signed, signed))
        spread = np.where(mean != 0, np.sqrt(np.log1p((sd / mean) ** 2)), 0.0)
    np.fill_diagonal(correlation, 1 + 1e-9)  # no effect where sd is 0; singular matrices become just definite
    # Cholesky's factor is continuous in the covariance, so a plan read from its file has the same vehicles
    normal = rng.standard_normal((count, 12)) @ np.linalg.cholesky(correlation).T
    values = mean * np.exp(spread * normal - spread**2 / 2)
    near = (np.arange(mean.size) % 3 == COEFFICIENTS.index("delay")) & (sd > np.abs(mean))
    values[:, near] = np.maximum(mean + sd * normal, 0.0)[:, near]
    trims = np.array(belief.truth.trim) + np.array(belief.trim_sigma) * rng.standard_normal((count, 4))
    return [
        replace(with_coefficients(belief.truth, row), trim=_four(trim)) for row, trim in zip(values, trims, strict=True)
    ]


def belief_mapping(belief: Belief) -> dict[str, Any]:
    """The belief in the plain types of a plan."""
    truth = belief.truth
    return {
        "source": belief.source,
        "notes": list(belief.notes),
        "gamma": _plain(truth.gamma),
        **{name: _plain(getattr(truth, name)) for name in ("delay", "trim", "wind_sigma", "wind_time", "mocap_noise")},
        "pose_rate": float(truth.pose_rate),
        "stale_share": float(truth.stale_share),
        "trim_sigma": _plain(belief.trim_sigma),
        "levels": {axis: _plain(levels) for axis, levels in belief.levels.items()},
        "covariance": {
            axis: [_plain(row) for row in belief.covariance[3 * a : 3 * a + 3, 3 * a : 3 * a + 3]]
            for a, axis in enumerate(AXES)
        },
    }


def belief_from_mapping(raw: Mapping[str, Any], where: str) -> Belief:
    """The inverse of `belief_mapping`.

    Raises:
        PlanError: A value is missing, of the wrong size, or impossible.
    """
    try:
        numbers = {name: _four(raw[name]) for name in ("delay", "trim", "wind_sigma", "wind_time", "mocap_noise")}
        truth = Truth(
            gamma=tuple(map(float, raw["gamma"])), pose_rate=float(raw["pose_rate"]),
            stale_share=float(raw["stale_share"]), **numbers,  # type: ignore[arg-type]
        )  # fmt: skip
        belief = Belief(
            truth=truth,
            covariance=_blocks([np.array(raw["covariance"][axis], float).reshape(3, 3) for axis in AXES]),
            trim_sigma=_four(raw["trim_sigma"]),
            levels={axis: tuple(map(float, raw["levels"][axis])) for axis in AXES if axis in raw["levels"]},
            source=str(raw["source"]),
            notes=tuple(map(str, raw["notes"])),
        )
    except KeyError as error:
        raise PlanError(f"{where}, [belief]: {error} is missing; plan it again") from None
    except (TypeError, ValueError) as error:
        raise PlanError(f"{where}, [belief]: {error}; plan it again") from None
    return _checked(belief)


def _blocks(parts: Sequence[Array]) -> Array:
    """A block-diagonal matrix of the axes' blocks, shape (12, 12)."""
    out = np.zeros((12, 12))
    for a, part in enumerate(parts):
        out[3 * a : 3 * a + 3, 3 * a : 3 * a + 3] = part
    return out


def _checked(belief: Belief) -> Belief:
    """Refuses a belief for which no flight can be planned.

    Raises:
        PlanError: A damping that is not positive, or an invalid covariance.
    """
    for axis, damping in zip(AXES, belief.truth.gamma[1::2], strict=True):
        if not damping > 0:
            raise PlanError(
                f"{belief.source}: the damping of {axis} is {damping:g}: such a vehicle is unstable, no flight of it "
                "can be planned; give a model fitted by --method ml, which keeps it positive"
            )
    if not (np.all(np.isfinite(belief.covariance)) and np.all(np.diag(belief.covariance) >= 0)):
        raise PlanError(f"{belief.source}: its covariance is invalid; plan from a model that was fitted")
    return belief


def _four(values: Sequence[float] | Array) -> Four:
    if len(values) != 4:
        raise ValueError(f"{len(values)} values where there must be one for each of x, y, z, yaw")
    x, y, z, yaw = map(float, values)
    return x, y, z, yaw


def _plain(values: Sequence[float] | Array) -> list[float]:
    return [float(f"{value:.6g}") for value in values]
