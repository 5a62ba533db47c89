"""The estimate of one group of axes while the flight grows: the batch estimator, followed from second to second.

A refit is `estimation.fitting.fit` on the flight so far: search, laws, profiles, judgement. It is made each time the
excited time has grown by `REFIT`, so that all refits together cost a few times the last one. In between the estimate
takes a step or two of the same climb on the data that have come, from where it stands; intervals keep the shape that
the refit gave them and shrink with the information. So the last estimate of a flight is that of the batch.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from rotorfit.core.flight_data import Flight
from rotorfit.core.frames import AXES
from rotorfit.core.model import STRUCTURE, Axis, Interval, Model, unknown_axis
from rotorfit.core.results import Fit
from rotorfit.core.tracked import QUANTITIES
from rotorfit.estimation.fitting import fit
from rotorfit.estimation.judgement.estimand import Estimand, estimands, half_widths, interval
from rotorfit.estimation.likelihood.axis_estimate import Estimate, coupled_records
from rotorfit.estimation.likelihood.blocks import Record, record
from rotorfit.estimation.likelihood.coefficients import statuses
from rotorfit.estimation.likelihood.fisher_scoring import maximise
from rotorfit.estimation.likelihood.optima import start_point
from rotorfit.estimation.likelihood.parameters import Point
from rotorfit.estimation.zero_command import commanded_parts

REFIT = 1.5
"""Growth of the time that a fit saw after which the batch estimator looks again."""

LONGEST = 300.0
"""Time that an estimate looks back over [s]: of a longer regime the oldest part is left to itself."""

SILENT = 1.2
"""The same as long as it has found nothing."""

PASSES = 3
"""Passes over the data that a step may take: one to see, two to move."""

EARLY, GROWN = 30.0, 1.03
"""A step is taken each second for so long [s], then whenever the excited time has grown by this."""

LEVELS_EVERY = 5
"""Every so many steps the levels of the disturbance move, too: they change slowly, and cost as much as the rest."""

Half = tuple[float | None, float | None]


@dataclass(frozen=True)
class Followed:
    """The estimate of a group of axes that are fitted together, or of axes that are not told.

    Attributes:
        group: Names.
        fit: The last refit.
        seen: Excited time that it saw [s].
        estimates: Axis name to the estimate now; none of axes without numbers.
        half: Axis and quantity to the half widths of the intervals at the refit, of these flights and of the vehicle,
            and the standard error then, all on the scale of the quantity.
        steps: Since the refit.
        stepped: Excited time at the last of them [s].
    """

    group: tuple[str, ...]
    fit: Fit
    seen: float
    estimates: Mapping[str, Estimate]
    half: Mapping[str, Mapping[str, tuple[Half, Half, float]]]
    steps: int = 0
    stepped: float = 0.0


@dataclass(frozen=True)
class Said:
    """What is said of one axis: values and intervals by name, of the vehicle and of this flight."""

    values: Mapping[str, float | None]
    ci95: Mapping[str, Interval]
    ci95_flight: Mapping[str, Interval]


def refitted(flight: Flight, group: Sequence[str], structure: str, seen: float) -> Followed:
    """The batch estimator on the flight so far.

    Args:
        flight: So far.
        group: Axes that are fitted together.
        structure: As `fit` takes it.
        seen: Excited time of the flight so far [s].
    """
    return followed_of(fit([flight], axes=group, structure=structure), group, seen)


def followed_of(found: Fit, group: Sequence[str], seen: float) -> Followed:
    """A fit of one flight, as it is followed.

    Args:
        found: Of these axes, and perhaps others.
        group: Axes that are fitted together.
        seen: Excited time that it saw [s].
    """
    estimates = {axis: e for axis, e in found.estimates.items() if axis in group and found.model.axes[axis].predictor}
    half = {axis: _half_widths(found.model.axes[axis], estimate) for axis, estimate in estimates.items()}
    return Followed(tuple(group), found, seen, estimates, half, stepped=seen)


def _half_widths(axis: Axis, estimate: Estimate) -> dict[str, tuple[Half, Half, float]]:
    """Half widths of both intervals of everything of an axis, and its standard error, on its scale."""
    out = {}
    for name, one in estimands(estimate.optimum, estimate.place).items():
        vehicle, flight = _ends(axis, name)
        out[name] = half_widths(one, flight), half_widths(one, vehicle), one.error(estimate.optimum)
    return out


def _ends(axis: Axis, name: str) -> tuple[Interval, Interval]:
    """The two intervals of a coefficient or combination: the vehicle's, and that of these flights."""
    if name in axis.combinations:
        part = axis.combinations[name]
        return part.ci95, part.ci95_flight or part.ci95
    ends = axis.ci95.get(name, (None, None))
    return ends, axis.ci95_flight.get(name, ends)


def together(parts: Sequence[Followed]) -> Model | None:
    """The last refits as one model; None before the first.

    Args:
        parts: Of each group of axes that has been fitted.
    """
    if not parts:
        return None
    models = {axis: part.fit.model for part in parts for axis in part.group}
    names = tuple(
        name for part in parts for name in part.fit.model.covariance_names if name.partition(".")[0] in part.group
    )
    covariance = np.zeros((len(names), len(names)))
    for part in parts:
        own = [k for k, name in enumerate(names) if name.partition(".")[0] in part.group]
        there = [part.fit.model.covariance_names.index(names[k]) for k in own]
        covariance[np.ix_(own, own)] = part.fit.model.covariance[np.ix_(there, there)]
    axes = {axis: models[axis].axes[axis] if axis in models else unknown_axis("too_short") for axis in AXES}
    structures = {one.structure for one in axes.values() if one.predictor}
    first = parts[0].fit.model
    return replace(
        first,
        structure="mixed" if len(structures) > 1 else next(iter(structures), STRUCTURE),
        axes=axes,
        covariance_names=names,
        covariance=covariance,
        paper=tuple(models.get(axis, first).paper[2 * k + j] for k, axis in enumerate(AXES) for j in range(2)),
        paper_noise={axis: noise for axis, one in models.items() if (noise := one.paper_noise.get(axis))},
    )


def doubt_of(axis: Axis) -> dict[str, float]:
    """By how much tests found each coefficient of an axis to vary under its law, as a standard deviation."""
    names = {name for test in axis.evidence for name in test.sd}
    return {name: float(np.sqrt(sum(test.sd.get(name, 0.0) ** 2 for test in axis.evidence))) for name in names}


def grown(seen: float, excited: float, growth: float) -> bool:
    """Whether so much excited time is new that the estimate would move: a share of what it looks back over.

    Args:
        seen: Excited time when it last moved [s].
        excited: Excited time now [s].
        growth: Ratio of the two from which it would.
    """
    return excited - seen >= (growth - 1) * min(seen, LONGEST)


def stepped(followed: Followed, flight: Flight, excited: float) -> Followed:
    """The estimate on the flight so far: a step or two of the climb, from where it stands, once that tells something.

    Args:
        followed: Before.
        flight: So far; its first segments are those that the estimate saw.
        excited: Excited time since the regime began [s].
    """
    new = renewed(followed, flight)
    if not new.estimates or (excited > EARLY and not grown(followed.stepped, excited, GROWN)):
        return new
    levels = (followed.steps + 1) % LEVELS_EVERY == 0
    if len({id(one.optimum) for one in new.estimates.values()}) < len(new.estimates):  # x and y by one likelihood
        one = _moved(next(iter(new.estimates.values())), levels)
        moved = {axis: replace(each, optimum=one.optimum) for axis, each in new.estimates.items()}
    else:
        moved = {axis: _moved(one, levels) for axis, one in new.estimates.items()}
    return replace(new, estimates=moved, steps=followed.steps + 1, stepped=excited)


def renewed(followed: Followed, flight: Flight) -> Followed:
    """The estimate where it stands, on the flight so far: each axis on what its fit was made of.

    Args:
        followed: Before.
        flight: So far.
    """
    known = _renewed_on(followed, flight)
    whole = sum(part.duration for part in followed.fit.flights)
    for axis, (test, time) in followed.fit.braking.items():
        if axis in known and time < whole:  # at rest it brakes, and the law is of its answers to commands only
            known[axis] = _renewed_on(followed, commanded_parts(flight, (axis,), test.delay))[axis]
    return replace(followed, estimates=known)


def _renewed_on(followed: Followed, flight: Flight) -> dict[str, Estimate]:
    new: dict[int, Estimate] = {}
    for one in followed.estimates.values():
        if id(one.optimum) not in new:
            new[id(one.optimum)] = _renewed(one, _records(flight, _seen_by(one)))
    estimates = {axis: replace(new[id(one.optimum)], place=one.place) for axis, one in followed.estimates.items()}
    if len(estimates) == 2 and all(one.optimum.point.gain.size == 1 for one in estimates.values()):
        pair = coupled_records(_records(flight, followed.group), list(estimates.values()))
        estimates = dict(zip(estimates, pair, strict=True))
    return estimates


def _seen_by(estimate: Estimate) -> tuple[str, ...]:
    return tuple(estimate.records[0].axes)


def _records(flight: Flight, axes: Sequence[str]) -> list[Record]:
    found = record(flight, axes)
    return [found] if found else []


def _renewed(estimate: Estimate, records: list[Record]) -> Estimate:
    """An estimate on newer records, where it stands; as it was where there are none."""
    if not records:
        return estimate
    optimum = estimate.optimum
    point = _grown(optimum.point, estimate.records, records)
    known = point.coefficients + point.trim.size
    starts = np.ones(point.start.size, bool)
    free = np.concatenate([optimum.free[:known], starts, optimum.free[optimum.point.n :]])
    new = replace(estimate, records=records, optimum=replace(optimum, point=point, free=free))
    return new if point.start.size == optimum.point.start.size else _moved(new, False)  # scored with the new start


def _moved(estimate: Estimate, levels: bool) -> Estimate:
    """An estimate after a step."""
    optimum = estimate.optimum
    moving = optimum.free.copy()
    moving[optimum.point.n :] &= levels
    found = maximise(estimate.records, optimum.point, moving, most=PASSES, prior=optimum.prior)
    return replace(estimate, optimum=replace(found, free=optimum.free))


def _grown(point: Point, before: Sequence[Record], records: Sequence[Record]) -> Point:
    """A point with the start velocities of the segments that newer records have."""
    fresh = start_point(records, 0.0, 1.0, point.levels).start
    known = {float(t): v for t, v in zip(np.concatenate([rec.starts for rec in before]), point.start, strict=True)}
    starts = np.concatenate([rec.starts for rec in records])
    start = np.array([known.get(float(t), v) for t, v in zip(starts, fresh, strict=True)])
    return replace(point, start=start)


def said(followed: Followed, axis: str) -> Said:
    """What is said of an axis now.

    Args:
        followed: The estimate of its group.
        axis: Its name.
    """
    nothing = dict.fromkeys(QUANTITIES)
    if axis not in followed.estimates:
        return Said(nothing, {}, {})
    estimate, then = followed.estimates[axis], followed.half[axis]
    flight: dict[str, Interval] = {}
    vehicle: dict[str, Interval] = {}
    values: dict[str, float | None] = dict(nothing)
    for name, one in estimands(estimate.optimum, estimate.place).items():
        if name not in QUANTITIES or name not in then:
            continue
        own, others, error = then[name]
        share = _shrunk(one, estimate, error)
        flight[name] = interval(one, 0.0, _times(own, share))
        vehicle[name] = interval(one, 0.0, _between(_times(own, share), own, others))
        values[name] = one.value
    told = statuses({name: vehicle.get(name, (0.0, 0.0)) for name in ("input", "damping", "delay")})
    if read_backwards(vehicle, told):
        return Said(nothing, {}, {})
    for name in QUANTITIES:
        if told.get(name, "ok") != "ok" or None in vehicle.get(name, (None, None)):
            values[name] = None
    return Said(values, vehicle, flight)


def read_backwards(ends: Mapping[str, Interval], told: Mapping[str, str]) -> bool:
    """Whether what was found is the feedback that gives the commands, not the vehicle.

    Where nobody moves an axis but its own feedback, the commands follow the motion: an answer that comes before its
    command, of a size that cannot be told. Clocks that disagree move a delay as far, but leave the input as it is.

    Args:
        ends: Quantity to its interval.
        told: Coefficient to its status.
    """
    latest = ends.get("delay", (None, None))[1]
    return latest is not None and latest < 0 and told["input"] != "ok"


def _shrunk(one: Estimand, estimate: Estimate, error: float) -> float:
    """The standard error now as a share of what it was at the refit."""
    return one.error(estimate.optimum) / error if error > 0 else 1.0


def _times(half: Half, share: float) -> Half:
    below, above = half
    return (None if below is None else below * share, None if above is None else above * share)


def _between(now: Half, own: Half, vehicle: Half) -> Half:
    """Half widths of the vehicle's interval: what other flights add to that of this flight does not shrink with it."""
    ends: list[float | None] = []
    for here, then, wide in zip(now, own, vehicle, strict=True):
        if here is None or then is None or wide is None:
            ends.append(None)
        else:
            ends.append(float(np.sqrt(here**2 + max(wide**2 - then**2, 0.0))))
    return ends[0], ends[1]
