"""Model -> Model: every number with two intervals, that of its flights and that of the vehicle.

Beside the noise that the likelihood knows stand

- innovations that are not as the filter believes (`residual_variance`): they widen the intervals of the flights;
- the law (`refutation`): as far as its tests find it wrong, it widens the intervals of the vehicle, or refutes them;
- what other flights of the same vehicle differ by (`random_effects`): several tell it, of one a prior does
  (`spread_prior`), which is apart and visible in `Axis.spread`.

The intervals of the flights become `ci95_flight`, those of the vehicle `ci95`; statuses follow the latter.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from rotorfit.core.laws import structure_named
from rotorfit.core.model import COEFFICIENTS, Axis, Combination, Evidence, Interval, Model, Spread
from rotorfit.estimation.judgement.cross_check import between_filters
from rotorfit.estimation.judgement.each_flight import each_flight
from rotorfit.estimation.judgement.estimand import Estimand, estimands, half_widths, interval, moved
from rotorfit.estimation.judgement.random_effects import NORMAL, RandomEffects, random_effects
from rotorfit.estimation.judgement.refutation import doubt
from rotorfit.estimation.judgement.residual_variance import weighted_innovations, widening
from rotorfit.estimation.judgement.spread_prior import spread_scale
from rotorfit.estimation.likelihood.axis_estimate import Estimate
from rotorfit.estimation.likelihood.coefficients import statuses
from rotorfit.estimation.likelihood.extra_parameters import extra_status

Said = tuple[float, float] | None
"""What a flight says of a quantity and its standard error, on its scale; None where it says nothing."""

WIDEST_ERROR = {True: 1.0, False: 0.3}
"""Standard error of one flight, of a logarithm or else [s], beyond which it says nothing of how flights differ."""

TOLERABLE = {True: 0.25, False: 0.05}
"""Half width on the scale of a quantity, a logarithm or else [s], up to which a law that is wrong is near enough: what
the tests find is in the interval, and the interval still says something."""


@dataclass(frozen=True)
class Judged:
    """One quantity after judgement.

    Attributes:
        estimand: What it is.
        shift: Of the vehicle's value from that of the likelihood of all flights together, on its scale.
        flight: Interval of these flights.
        vehicle: Interval of the vehicle.
        ratio: Of its standard error to that of the likelihood.
        spread: Between flights.
        refuted: Whether tests found the law so wrong that no interval holds the quantity.
    """

    estimand: Estimand
    shift: float
    flight: Interval
    vehicle: Interval
    ratio: float
    spread: Spread
    refuted: bool


def judged(model: Model, estimates: Mapping[str, Estimate], tested: bool = True) -> Model:
    """The model with the intervals of the vehicle, and those of its flights beside.

    Args:
        model: As fitted by the likelihood; its intervals are those of its flights.
        estimates: Axis name to the maximum of its likelihood.
        tested: Whether the law is asked, too; else only what flights differ by and the innovations count.
    """
    axes, ratios = dict(model.axes), np.ones(len(model.covariance_names))
    for name, estimate in estimates.items():
        if axes[name].predictor is None:
            continue
        found, evidence = judged_axis(axes[name], estimate, tested)
        axes[name] = _axis(axes[name], found, evidence)
        for i, entry in enumerate(model.covariance_names):
            axis, part = entry.split(".")
            if axis == name and part in found:
                ratios[i] = found[part].ratio
    return replace(model, axes=axes, covariance=model.covariance * np.outer(ratios, ratios))


def judged_axis(axis: Axis, estimate: Estimate, tested: bool = True) -> tuple[dict[str, Judged], tuple[Evidence, ...]]:
    """Everything of an axis that has an interval, judged, by name, and what spoke against its law if tested."""
    wanted = {
        name: one
        for name, one in estimands(estimate.optimum, estimate.place).items()
        if name in axis.ci95 or name in axis.combinations
    }
    weighted = weighted_innovations(estimate, list(wanted.values()))
    wider = widening(weighted, list(wanted))
    errors = {name: one.error(estimate.optimum) * wider[name] for name, one in wanted.items()}
    against = None
    if tested:
        method = between_filters(estimate, weighted, wanted, errors)
        against = doubt(estimate.records, weighted, estimate.place, errors, wider, method)
    alone = _each(estimate, list(wanted)) if len(estimate.records) > 1 else {}
    out = {}
    for part, one in wanted.items():
        ends = axis.ci95[part] if part in axis.ci95 else axis.combinations[part].ci95
        below, above = half_widths(one, ends)
        own = (_times(below, wider[part]), _times(above, wider[part]))
        told = _told(one, errors[part], alone.get(part, ()))
        factor = against.factor[part] if against else 1.0
        vague = NORMAL * errors[part] * factor > TOLERABLE[one.logarithmic]
        refuted = against is not None and vague and part in against.refuted
        out[part] = _judged(one, own, told, wider[part], factor, refuted)
    return out, against.evidence if against else ()


@dataclass(frozen=True)
class _Told:
    """What flights say of a quantity: their number, the error of all together as one, the random effects, each."""

    flights: int
    error: float
    scale: float
    effects: RandomEffects
    each: tuple[Said, ...]


def _told(one: Estimand, error: float, alone: Sequence[Said]) -> _Told:
    """The flights that tell a quantity, or all of them as one where only one does."""
    known = np.array([said for said in alone if said]).reshape(-1, 2)
    if len(known) < 2:
        known = np.array([[0.0, error]])
    together = float(1 / np.sqrt(np.sum(known[:, 1] ** -2.0)))
    scale = spread_scale(one.name) * together * float(np.sqrt(len(known)))
    return _Told(len(known), together, scale, random_effects(known[:, 0], known[:, 1], scale), tuple(alone))


def _judged(one: Estimand, own: Interval, told: _Told, wider: float, doubtful: float, refuted: bool) -> Judged:
    """Both intervals: what flights differ by and what the law leaves widen that of these flights, side by side.

    What the law leaves is not less for more flights: its tests find it the more surely, and their factor grows as the
    error falls.
    """
    effects = told.effects
    unfit = doubtful**2 - 1
    ratio = float(np.sqrt((effects.sd / told.error) ** 2 + unfit))
    following = float(np.sqrt((effects.next_sd / told.error) ** 2 + unfit))
    shift = effects.mean - effects.common
    vehicle = interval(one, shift, (_times(own[0], ratio), _times(own[1], ratio)))
    spread = Spread(
        source="flights" if told.flights > 1 else "prior",
        sd=effects.spread,
        prior_sd=told.scale,
        flights_sd=effects.reml,
        flights=told.flights,
        p_value=effects.p_value,
        next_flight=interval(one, shift, (_times(own[0], following), _times(own[1], following))),
        logarithmic=one.logarithmic,
        each=told.each,
    )
    return Judged(one, shift, interval(one, 0.0, own), vehicle, wider * ratio, spread, refuted)


def _each(estimate: Estimate, names: Sequence[str]) -> dict[str, list[Said]]:
    """What each flight says of quantities, with its standard error, on their scales."""
    whole = estimands(estimate.optimum, estimate.place)
    out: dict[str, list[Said]] = {name: [] for name in names}
    for one in each_flight(estimate):
        told = estimands(one.optimum, one.place) if one else {}
        wider = widening(weighted_innovations(one, [told[name] for name in names]), names) if one else {}
        for name in names:
            error = told[name].error(one.optimum) * wider[name] if one else np.inf
            good = 0 < error < WIDEST_ERROR[whole[name].logarithmic]
            same = good and (not whole[name].logarithmic or told[name].value * whole[name].value > 0)
            out[name].append((told[name].scaled(), float(error)) if same else None)
    return out


def _times(half: float | None, factor: float) -> float | None:
    return None if half is None else half * factor


def _axis(axis: Axis, found: Mapping[str, Judged], evidence: tuple[Evidence, ...]) -> Axis:
    """The axis with both intervals, and statuses and values that follow from the vehicle's."""
    assert axis.predictor is not None
    ends = {name: found[name].vehicle if name in found else ends for name, ends in axis.ci95.items()}
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


def _statuses(axis: Axis, ends: Mapping[str, Interval], refuted: Sequence[str]) -> dict[str, str]:
    """Statuses by the intervals of the vehicle; what was not known of the flights is not known of it."""
    now = statuses(ends)
    now |= {
        extra.name: extra_status(extra, ends[extra.name])
        for extra in structure_named(axis.structure).extras
        if extra.name in axis.status
    }
    now |= {name: "refuted" for name in refuted if name in axis.status}
    return {name: now.get(name, before) if before == "ok" else before for name, before in axis.status.items()}


def _combination(name: str, part: Combination, found: Mapping[str, Judged]) -> Combination:
    if name not in found:
        return part
    one = found[name]
    return Combination(moved(one.estimand, one.shift), one.vehicle, one.flight)
