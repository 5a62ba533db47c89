"""Model -> Model: every number gets two intervals, one for these flights and one for the vehicle.

The likelihood's intervals account for the noise that it models. Added to that are

- innovations that are not white and of unit variance (`residual_variance`): they widen the intervals of the flights;
- errors of the law (`refutation`): as far as tests detect them, they widen the intervals of the vehicle, or refute its
  numbers;
- the spread between flights of the same vehicle (`random_effects`), estimated from several flights; for a single one
  it comes from a prior (`spread_prior`). It is reported in `Axis.spread`.

The intervals of the flights become `ci95_flight`, those of the vehicle `ci95`; statuses follow from the latter.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from rotorfit.core.laws import Extra, structure_named
from rotorfit.core.model import COEFFICIENTS, NORMAL, Axis, Combination, Evidence, Interval, Model, Spread
from rotorfit.estimation.identifiability import TOLERABLE
from rotorfit.estimation.judgement.cross_check import with_instruments
from rotorfit.estimation.judgement.each_flight import each_flight
from rotorfit.estimation.judgement.omitted_terms import omitted_term
from rotorfit.estimation.judgement.other_laws import BetweenLaws, OtherLaw, between_laws, other_laws
from rotorfit.estimation.judgement.random_effects import RandomEffects, random_effects
from rotorfit.estimation.judgement.refutation import doubt
from rotorfit.estimation.judgement.residual_variance import weighted_innovations, widening
from rotorfit.estimation.judgement.spread_prior import spread_scale
from rotorfit.estimation.likelihood.axis_estimate import Estimate
from rotorfit.estimation.likelihood.coefficients import statuses
from rotorfit.estimation.likelihood.estimand import Estimand, estimands, half_widths, hull, interval, moved
from rotorfit.estimation.likelihood.extra_parameters import extra_status

FlightValue = tuple[float, float] | None
"""Estimate of a quantity from one flight and its standard error, on its scale; None where the flight gives none."""

WIDEST_ERROR = {True: 1.0, False: 0.3}
"""Standard error of one flight, of a logarithm (True) or else [s], beyond which the flight is not used for the spread
between flights."""


@dataclass(frozen=True)
class Judged:
    """One quantity after judgement.

    Attributes:
        estimand: The quantity.
        shift: Difference of the vehicle's value from the likelihood's for all flights together, on its scale.
        flight: Interval of these flights.
        vehicle: Interval of the vehicle.
        ratio: Ratio of its standard error to that of the likelihood.
        spread: Spread between flights.
        refuted: Whether tests found the law so wrong that no interval can express the error.
    """

    estimand: Estimand
    shift: float
    flight: Interval
    vehicle: Interval
    ratio: float
    spread: Spread
    refuted: bool


def judged(model: Model, estimates: Mapping[str, Estimate], tested: bool = True) -> Model:
    """The model with the intervals of the vehicle in addition to those of its flights.

    Args:
        model: As fitted by the likelihood; its intervals are those of its flights.
        estimates: Axis name to the maximum of its likelihood.
        tested: Whether the law is tested, too; else only innovations and the spread between flights widen intervals.
    """
    axes, ratios = dict(model.axes), np.ones(len(model.covariance_names))
    beside: dict[int, tuple[OtherLaw, ...]] = {}
    for name, estimate in estimates.items():
        if axes[name].predictor is None:
            continue
        optimum = id(estimate.optimum)
        if tested and optimum not in beside:
            beside[optimum] = other_laws(estimate)
        found, evidence = judged_axis(axes[name], estimate, tested, beside.get(optimum, ()))
        axes[name] = _axis(axes[name], found, evidence)
        for i, entry in enumerate(model.covariance_names):
            axis, part = entry.split(".")
            if axis == name and part in found:
                ratios[i] = found[part].ratio
    return replace(model, axes=axes, covariance=model.covariance * np.outer(ratios, ratios))


def judged_axis(
    axis: Axis, estimate: Estimate, tested: bool = True, beside: tuple[OtherLaw, ...] = ()
) -> tuple[dict[str, Judged], tuple[Evidence, ...]]:
    """Judges every quantity of an axis that has an interval.

    Args:
        axis: The axis as fitted.
        estimate: The maximum of its likelihood.
        tested: Whether the law is tested, too.
        beside: Other laws, fitted to the same data.

    Returns:
        The judged quantities by name; and the tests that contradict the law, empty if it was not tested.
    """
    wanted = {
        name: one
        for name, one in estimands(estimate.optimum, estimate.place).items()
        if name in axis.ci95 or name in axis.combinations
    }
    weighted = weighted_innovations(estimate, list(wanted.values()))
    wider = widening(weighted, list(wanted))
    errors = {name: one.error(estimate.optimum) * wider[name] for name, one in wanted.items()}
    against, between = None, between_laws(beside, estimate, wanted)
    if tested:
        method = with_instruments(estimate, weighted, wanted, errors)
        omitted = omitted_term(estimate, weighted, errors)
        against = doubt(
            estimate.records, weighted, estimate.place, errors, wider, method, estimate.loop.closed, omitted,
            between,
        )  # fmt: skip
    alone = _each(estimate, list(wanted)) if len(estimate.records) > 1 else {}
    out = {}
    for part, one in wanted.items():
        ends = axis.ci95[part] if part in axis.ci95 else axis.combinations[part].ci95
        own = _times(half_widths(one, ends), wider[part])
        factor = against.factor[part] if against else 1.0
        law = errors[part] * float(np.sqrt(factor**2 - 1))
        evidence = _evidence(one, errors[part], law, alone.get(part, ()))
        vague = NORMAL * errors[part] * factor > TOLERABLE[one.logarithmic]
        refuted = against is not None and vague and part in against.refuted
        alike = _judged(one, own, evidence, wider[part], factor, refuted)
        out[part] = _over_laws(alike, between) if between and part in between.shift else alike
    return out, against.evidence if against else ()


@dataclass(frozen=True)
class _Evidence:
    """Evidence of the flights on a quantity.

    Attributes:
        flights: Number of flights that estimate it.
        shift: Difference of the vehicle's value from the likelihood's for all flights together, on its scale.
        added: Variance that the spread adds to that of all flights together, relative to it.
        added_next: The same for the value on the next flight.
        scale: Scale of the prior on the spread.
        effects: Random effects.
        each: Estimate from each flight of the fit alone; empty for one flight.
    """

    flights: int
    shift: float
    added: float
    added_next: float
    scale: float
    effects: RandomEffects
    each: tuple[FlightValue, ...]


def _evidence(one: Estimand, error: float, law: float, alone: Sequence[FlightValue]) -> _Evidence:
    """Evidence of the flights that estimate a quantity; of all as one where fewer than two do.

    The fit to all flights weighs them by their information, under levels of the disturbance that they share. The more
    they differ, the less that is right: the vehicle's value moves from it to the mean of the random effects, by the
    share of the information of all flights that those with a value of their own hold and lose to the spread.

    Args:
        one: The quantity.
        error: Standard error of all flights together.
        law: Standard deviation by errors of the law.
        alone: Estimate from each flight of several.
    """
    known = np.array([value for value in alone if value]).reshape(-1, 2)
    known -= [one.scaled(), 0.0]
    if len(known) < 2:
        known = np.array([[0.0, error]])
    together = float(1 / np.sqrt(np.sum(known[:, 1] ** -2.0)))
    scale = spread_scale(one.name) * together * float(np.sqrt(len(known)))
    effects = random_effects(known[:, 0], known[:, 1], scale, law)
    lost = (together**-2 - effects.sd**-2) * min(error, together) ** 2
    added, added_next = (float((sd**2 - together**2) / error**2) for sd in (effects.sd, effects.next_sd))
    return _Evidence(len(known), float(lost * effects.mean), added, added_next, scale, effects, tuple(alone))


def _judged(one: Estimand, own: Interval, evidence: _Evidence, wider: float, doubtful: float, refuted: bool) -> Judged:
    """Both intervals; spread between flights and errors of the law widen the interval of the flights, in quadrature.

    The errors of the law do not average out over flights: with more of them the tests detect these errors more surely,
    and their factor grows as the standard error falls.
    """
    effects, shift = evidence.effects, evidence.shift
    ratio = float(np.sqrt(evidence.added + doubtful**2))
    following = float(np.sqrt(evidence.added_next + doubtful**2))
    longer = _times if evidence.flights == 1 else _with_spread
    vehicle = interval(one, shift, longer(own, ratio))
    spread = Spread(
        source="flights" if evidence.flights > 1 else "prior",
        sd=effects.spread,
        prior_sd=evidence.scale,
        flights_sd=effects.reml,
        flights=evidence.flights,
        p_value=effects.p_value,
        next_flight=interval(one, shift, longer(own, following)),
        logarithmic=one.logarithmic,
        each=evidence.each,
    )
    return Judged(one, shift, interval(one, 0.0, own), vehicle, wider * ratio, spread, refuted)


def _times(own: Interval, ratio: float) -> Interval:
    """Half widths, longer by a factor: without a second flight, the spread is expected in units of the error."""
    below, above = (None if half is None else half * ratio for half in own)
    return below, above


def _with_spread(own: Interval, ratio: float) -> Interval:
    """Half widths with a measured spread added, by which the shorter one becomes longer by a factor.

    A longer one has a tail of its own, such as another law's, to which the spread adds the same.
    """
    shorter = min((half for half in own if half is not None), default=0.0)
    added = shorter**2 * (ratio**2 - 1)
    below, above = (None if half is None else float(np.sqrt(half**2 + added)) for half in own)
    return below, above


def _over_laws(judged: Judged, between: BetweenLaws) -> Judged:
    """The quantity with intervals that contain those of its mean over several laws.

    Args:
        judged: Under its own law.
        between: What other laws say.
    """
    one, name = judged.estimand, judged.estimand.name
    shift, more = judged.shift + between.shift[name], float(np.sqrt(between.factor[name] ** 2 - 1))
    own = half_widths(one, judged.flight)

    def containing(ends: Interval) -> Interval:
        below, above = half_widths(one, ends)
        if own[0] is not None and below is not None:
            below = float(np.hypot(below + judged.shift, more * own[0]))
        if own[1] is not None and above is not None:
            above = float(np.hypot(above - judged.shift, more * own[1]))
        return hull((ends, interval(one, shift, (below, above))))

    spread = replace(judged.spread, next_flight=containing(judged.spread.next_flight))
    return replace(judged, vehicle=containing(judged.vehicle), spread=spread)


def _each(estimate: Estimate, names: Sequence[str]) -> dict[str, list[FlightValue]]:
    """Estimate of each quantity from each flight alone, with its standard error, on its scale."""
    whole = estimands(estimate.optimum, estimate.place)
    out: dict[str, list[FlightValue]] = {name: [] for name in names}
    for one in each_flight(estimate):
        told = estimands(one.optimum, one.place) if one else {}
        wider = widening(weighted_innovations(one, [told[name] for name in names]), names) if one else {}
        for name in names:
            error = told[name].error(one.optimum) * wider[name] if one else np.inf
            good = 0 < error < WIDEST_ERROR[whole[name].logarithmic]
            same = good and (not whole[name].logarithmic or told[name].value * whole[name].value > 0)
            out[name].append((told[name].scaled(), float(error)) if same else None)
    return out


def _axis(axis: Axis, found: Mapping[str, Judged], evidence: tuple[Evidence, ...]) -> Axis:
    """The axis with both intervals, and with statuses and values that follow from the interval of the vehicle."""
    assert axis.predictor is not None
    ends = {name: found[name].vehicle if name in found else ends for name, ends in axis.ci95.items()}
    ends |= {
        extra.name: _within(ends[extra.name], extra)
        for extra in structure_named(axis.structure).extras
        if extra.name in ends
    }
    flight = {name: found[name].flight if name in found else ends for name, ends in axis.ci95.items()}
    values = {name: getattr(axis.predictor, name) for name in COEFFICIENTS} | dict(axis.predictor.extra)
    values |= {name: moved(one.estimand, one.shift) for name, one in found.items()}
    status = _statuses(axis, ends, [name for name, one in found.items() if one.refuted])
    good = {name: values[name] if status.get(name, "ok") == "ok" else None for name in values}
    return replace(
        axis,
        input=good["input"],
        damping=good["damping"],
        delay=good["delay"],
        extra={name: good[name] for name in axis.extra},
        ci95=ends,
        ci95_flight=flight,
        status=status,
        stderr={
            name: None if error is None or good[name] is None else error * (found[name].ratio if name in found else 1)
            for name, error in axis.stderr.items()
        },
        combinations={name: _combination(name, part, found) for name, part in axis.combinations.items()},
        spread={name: one.spread for name, one in found.items()},
        evidence=evidence,
    )


def _within(ends: Interval, extra: Extra) -> Interval:
    """An interval without what its parameter cannot be; an end that is cut off is open, where it is no value itself."""
    low, high = ends
    if extra.closed:
        return (None if low is None else max(low, extra.low), None if high is None else min(high, extra.high))
    return (
        None if low is None or low < extra.low else low,
        None if high is None or high > extra.high else high,
    )


def _statuses(axis: Axis, ends: Mapping[str, Interval], refuted: Sequence[str]) -> dict[str, str]:
    """Statuses from the intervals of the vehicle; a status other than `ok` for the flights is kept."""
    now = statuses(ends)
    now |= {
        extra.name: extra_status(extra, ends[extra.name])
        for extra in structure_named(axis.structure).extras
        if extra.name in axis.status
    }
    now |= {name: "refuted" for name in refuted if name in axis.status}
    return {name: now.get(name, before) if before == "ok" else before for name, before in axis.status.items()}


def _combination(name: str, part: Combination, found: Mapping[str, Judged]) -> Combination:
    """A combination with both intervals.

    One that was not judged itself gets the largest widening of what was, delay and total lag apart: they are in none;
    but for the sum of delay and lag, which `auto` gives beside a law without a lag: the delay is in it.
    """
    if name in found:
        one = found[name]
        return Combination(moved(one.estimand, one.shift), one.vehicle, one.flight)
    apart = ("total_lag",) if name == "delay_plus_lag" else ("delay", "total_lag")
    ratios = [one.ratio for other, one in found.items() if other not in apart]
    wider, value = max(ratios, default=1.0), part.value
    low, high = (None if end is None else value + wider * (end - value) for end in part.ci95)
    return Combination(value, (low, high), part.ci95)
