"""The estimate of one group of axes while the flight grows: batch refits, with single steps in between.

A refit is `estimation.fitting.fit` on the flight so far: search, laws, profiles, judgement. It is made each time the
excited time has grown by `REFIT`, and by `REFIT_SETTLED` while the last one stands, so that all refits together cost
about as much as the last one. Between refits the estimate takes a step or two of Fisher scoring on the data so far; its
intervals keep the shape that the refit gave them and shrink with the information. The last estimate of a flight is that
of the batch.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from rotorfit.core.flight_data import Flight
from rotorfit.core.frames import AXES
from rotorfit.core.laws import structure_named
from rotorfit.core.model import COEFFICIENTS, STRUCTURE, Axis, Interval, Model, unknown_axis
from rotorfit.core.results import Fit
from rotorfit.core.tracked import QUANTITIES
from rotorfit.estimation.clock_uncertainty import DELAYS, Ends, clock_half_width, lateness, narrower, wider
from rotorfit.estimation.fitting import fit
from rotorfit.estimation.likelihood.axis_estimate import Estimate, coupled_records
from rotorfit.estimation.likelihood.blocks import Record, record
from rotorfit.estimation.likelihood.coefficients import statuses
from rotorfit.estimation.likelihood.estimand import estimands, half_widths, interval
from rotorfit.estimation.likelihood.extra_parameters import conditional_covariance, estimated_extras, extra_status
from rotorfit.estimation.likelihood.fisher_scoring import maximise
from rotorfit.estimation.likelihood.law_average import LAGGED, WORLD
from rotorfit.estimation.likelihood.optima import start_point
from rotorfit.estimation.likelihood.parameters import Point
from rotorfit.estimation.zero_command import commanded_parts
from rotorfit.tracking.excited_time import LONGEST

REFIT, REFIT_SETTLED = 1.5, 2.5
"""Growth of the excited time that calls for a refit, and the same as long as the last refit is `_settled`."""

LOST = 1.2
"""Ratio of a standard error to that of the last refit above which no step is taken: what the refit knew has slid out of
the time that the estimate looks back over."""

REFIT_UNKNOWN = 1.2
"""As `REFIT`, as long as the last refit gave no numbers."""

CLEAR = 0.75
"""Weight of a law below which another one may soon be likelier: odds of 3 (Kass and Raftery)."""

PASSES = 3
"""Passes over the data that a step may take: one to evaluate, two to move."""

GROWN = 1.015
"""Growth of the excited time that calls for a step: each look of the first minute has one."""

LEVELS_EVERY = 5
"""Every how many steps the levels of the disturbance move too: they change slowly, and cost as much as the rest."""

Half = tuple[float | None, float | None]
"""Half widths of an interval, below and above; None where it is open."""


@dataclass(frozen=True)
class Widths:
    """Half widths of the intervals of a quantity at a refit, on its scale, without what stamps leave unknown.

    Attributes:
        flight: Of the interval of this flight.
        vehicle: Of the interval of the vehicle.
        error: Standard error by curvature, see `_curvature_errors`.
    """

    flight: Half
    vehicle: Half
    error: float


@dataclass(frozen=True)
class GroupEstimate:
    """The estimate of a group of axes that are fitted together.

    Attributes:
        group: Names of the axes.
        fit: The last refit.
        seen: Excited time at the refit [s].
        estimates: Axis name to the current estimate; an axis without numbers is missing.
        half: Axis and quantity to the half widths at the refit.
        steps: Number of steps since the refit.
        stepped: Excited time at the last step, or at the refit [s].
    """

    group: tuple[str, ...]
    fit: Fit
    seen: float
    estimates: Mapping[str, Estimate]
    half: Mapping[str, Mapping[str, Widths]]
    steps: int = 0
    stepped: float = 0.0


@dataclass(frozen=True)
class AxisReport:
    """What is reported of one axis.

    Attributes:
        values: Name of `QUANTITIES` to its estimate; None if it is not told.
        ci95: Name to the 95 % interval of the vehicle.
        ci95_flight: Name to the 95 % interval of this flight.
    """

    values: Mapping[str, float | None]
    ci95: Mapping[str, Interval]
    ci95_flight: Mapping[str, Interval]


def refitted(flight: Flight, group: Sequence[str], structure: str, seen: float) -> GroupEstimate:
    """The batch estimator on the flight so far.

    Args:
        flight: The flight so far.
        group: Axes that are fitted together.
        structure: Model structure, as `fit` takes it.
        seen: Excited time so far [s].
    """
    return group_estimate(fit([flight], axes=group, structure=structure), group, seen)


def group_estimate(found: Fit, group: Sequence[str], seen: float) -> GroupEstimate:
    """The estimate that starts from a fit of one flight.

    Args:
        found: The fit of these axes, and perhaps others.
        group: Axes that are fitted together.
        seen: Excited time of the flight [s].
    """
    estimates = {axis: e for axis, e in found.estimates.items() if axis in group and found.model.axes[axis].predictor}
    half = {axis: _widths(found, axis) for axis in estimates}
    return GroupEstimate(tuple(group), found, seen, estimates, half, stepped=seen)


def _of_stamps(found: Fit, axis: str) -> tuple[float, Ends]:
    """What stamps leave unknown of the delay of an axis, however long the flight is, as `wider` takes it [s]."""
    return clock_half_width(found.flights, axis), lateness(found.flights, axis)


def _widths(found: Fit, axis: str) -> dict[str, Widths]:
    """Quantity to the half widths of its intervals."""
    estimate, known, stamps = found.estimates[axis], found.model.axes[axis], _of_stamps(found, axis)
    errors, out = _curvature_errors(estimate), {}
    for name, one in estimands(estimate.optimum, estimate.place).items():
        vehicle, flight = _ends(known, name)
        if name in DELAYS:
            vehicle, flight = (narrower(ends, one.value, *stamps) for ends in (vehicle, flight))
        out[name] = Widths(half_widths(one, flight), half_widths(one, vehicle), errors[name])
    return out


def _curvature_errors(estimate: Estimate) -> dict[str, float]:
    """Quantity to its standard error, on its scale, by curvature for the further parameters of the law as they are.

    Of a further parameter it is that for the coefficients as they are, see `conditional_covariance`.
    """
    optimum, k = estimate.optimum, estimate.place
    extras = [extra.name for extra in estimated_extras(optimum, k)]
    names = (*COEFFICIENTS, *extras)
    usual = conditional_covariance(optimum, k, extras)
    of_extra = {one: conditional_covariance(optimum, k, [name for name in names if name != one]) for one in extras}
    return {name: one.error(optimum, of_extra.get(name, usual)) for name, one in estimands(optimum, k).items()}


def _ends(axis: Axis, name: str) -> tuple[Interval, Interval]:
    """The two intervals of a coefficient or combination: of the vehicle, and of this flight."""
    if name in axis.combinations:
        part = axis.combinations[name]
        return part.ci95, part.ci95_flight or part.ci95
    ends = axis.ci95.get(name, (None, None))
    return ends, axis.ci95_flight.get(name, ends)


def together(parts: Sequence[GroupEstimate]) -> Model | None:
    """The last refits, combined into one model; None before the first.

    Args:
        parts: The estimate of each group of axes that has been fitted, each to one flight, or to a part of one.
    """
    if not parts:
        return None
    if all(part.fit is parts[0].fit for part in parts):
        return parts[0].fit.model
    models = {axis: part.fit.model for part in parts for axis in part.group}
    names = tuple(
        name for part in parts for name in part.fit.model.covariance_names if name.partition(".")[0] in part.group
    )
    covariance = np.zeros((len(names), len(names)))
    for part in parts:
        own = [k for k, name in enumerate(names) if name.partition(".")[0] in part.group]
        there = [part.fit.model.covariance_names.index(names[k]) for k in own]
        covariance[np.ix_(own, own)] = part.fit.model.covariance[np.ix_(there, there)]
    sources = {axis: model.flights[0] for axis, model in models.items()}
    spans = tuple(dict.fromkeys(source.span for source in sources.values()))
    flights = []
    for span in spans:
        served = [axis for axis, source in sources.items() if source.span == span and axis in source.axes]
        source = next(source for source in sources.values() if source.span == span)
        flights.append(replace(source, axes=tuple(axis for axis in AXES if axis in served)))
    commanded = {axis for source in sources.values() for axis in source.axes}
    axes = {axis: unknown_axis("too_short" if axis in commanded else "not_excited") for axis in AXES}
    for axis, model in models.items():
        one = model.axes[axis]
        axes[axis] = replace(
            one, trim=tuple(t for s in spans for t in (one.trim or (None,) if s == sources[axis].span else (None,)))
        )
    structures = {one.structure for one in axes.values() if one.predictor}
    first = parts[0].fit.model
    return replace(
        first,
        structure="mixed" if len(structures) > 1 else next(iter(structures), STRUCTURE),
        axes=axes,
        flights=tuple(flights),
        covariance_names=names,
        covariance=covariance,
        paper=tuple(models.get(axis, first).paper[2 * k + j] for k, axis in enumerate(AXES) for j in range(2)),
        paper_noise={axis: noise for axis, one in models.items() if (noise := one.paper_noise.get(axis))},
    )


def doubt_of(axis: Axis) -> dict[str, float]:
    """Coefficient to the standard deviation by which it varies without a change; the variances of tests add.

    What tests found to vary with time is no such variation: it may be the change.
    """
    tests = [test for test in axis.evidence if test.test not in ("time", "quarter")]
    names = {name for test in tests for name in test.sd}
    return {name: float(np.sqrt(sum(test.sd.get(name, 0.0) ** 2 for test in tests))) for name in names}


def believed_laws(fitted: GroupEstimate) -> tuple[str, ...]:
    """The laws that the axes of a group may obey instead of those that are held, the likeliest first.

    They are those that the refit did not rule out. On a flight that held its heading it tried a lag in one frame only:
    in both a lag is the same there.
    """
    axes = [fitted.fit.model.axes[axis] for axis in fitted.estimates]
    laws = [law.structure for law in sorted((law for axis in axes for law in axis.laws), key=lambda law: -law.weight)]
    straight = all(one.optimum.point.gain.size == 1 for one in fitted.estimates.values())
    if straight and LAGGED.name in laws and set(fitted.group) <= {"x", "y"}:
        laws.append(WORLD.name)
    return tuple(law for law in dict.fromkeys(laws) if any(axis.structure != law for axis in axes))


def growth(fitted: GroupEstimate) -> float:
    """Growth of the excited time since the last refit that calls for the next."""
    if not fitted.estimates:
        return REFIT_UNKNOWN
    return REFIT_SETTLED if _settled(fitted) else REFIT


def _settled(fitted: GroupEstimate) -> bool:
    """Whether the last refit knew every axis of the group and its law, and its intervals still hold the values.

    Steps then follow the data, and the intervals the information. Only a refit weighs the laws, closes an open
    interval, or shapes one anew around a value far from where it was profiled.
    """
    laws = (fitted.fit.model.axes[axis].laws for axis in fitted.group)
    if any(weighed and weighed[0].weight < CLEAR for weighed in laws):
        return False
    return all(axis in fitted.estimates and _within(fitted, axis) for axis in fitted.group)


def _within(fitted: GroupEstimate, axis: str) -> bool:
    """Whether an axis is known, and its coefficients lie in the intervals of this flight at the last refit."""
    told = axis_report(fitted, axis).values
    then, now = (estimands(one.optimum, one.place) for one in (fitted.fit.estimates[axis], fitted.estimates[axis]))
    moved = {name: now[name].scaled() - then[name].scaled() for name in COEFFICIENTS if told[name] is not None}
    half = {name: fitted.half[axis][name].flight[int(by > 0)] for name, by in moved.items()}
    return len(moved) == len(COEFFICIENTS) and all(abs(by) < (half[name] or 0.0) for name, by in moved.items())


def grown(seen: float, excited: float, growth: float) -> bool:
    """Whether enough excited time is new for the estimate to move: a share of the time that it looks back over.

    Args:
        seen: Excited time when the estimate last moved [s].
        excited: Excited time now [s].
        growth: Required ratio of the two; for times beyond `LONGEST`, the increase is that of `LONGEST`.
    """
    return excited - seen >= (growth - 1) * min(seen, LONGEST)


def stepped(fitted: GroupEstimate, flight: Flight, excited: float) -> GroupEstimate:
    """The estimate after a step of Fisher scoring on the flight so far, if enough data are new; else as `renewed`.

    It is also left as it is where the flight that it looks back over has come to tell less than at the last refit: a
    step would follow the little that is left, within intervals of what has been lost. So is an axis of which the refit
    left a coefficient open: nothing stops its steps there.

    Args:
        fitted: The estimate before.
        flight: The flight so far; segments that the estimate has seen keep their starts.
        excited: Excited time since the regime began [s].
    """
    new = renewed(fitted, flight)
    if not new.estimates or not grown(fitted.stepped, excited, GROWN):
        return new
    held = [axis for axis in new.estimates if _open(fitted, axis)]
    moved = _moved(new.estimates, (fitted.steps + 1) % LEVELS_EVERY == 0, held)
    slid = flight.span[0] > fitted.fit.flights[0].span[0]
    lost = slid and any(_lost(one, fitted.half[axis]) for axis, one in moved.items())
    return replace(new, estimates=new.estimates if lost else moved, steps=fitted.steps + 1, stepped=excited)


def _open(fitted: GroupEstimate, axis: str) -> bool:
    """Whether the interval of a coefficient has an open end since the refit."""
    return any(None in fitted.half[axis][name].flight for name in COEFFICIENTS if name in fitted.half[axis])


def _lost(estimate: Estimate, then: Mapping[str, Widths]) -> bool:
    """Whether a quantity is told less surely than at the refit."""
    return any(error > LOST * then[name].error for name, error in _curvature_errors(estimate).items())


def renewed(fitted: GroupEstimate, flight: Flight) -> GroupEstimate:
    """The estimate, applied to the flight so far; of it only the start velocities of new segments move.

    Args:
        fitted: The estimate before.
        flight: The flight so far.
    """
    new = applied(fitted, flight)
    before = {axis: one.optimum.point.start.size for axis, one in fitted.estimates.items()}
    if all(one.optimum.point.start.size == before[axis] for axis, one in new.estimates.items()):
        return new
    return replace(new, estimates=_moved(new.estimates, False, tuple(new.estimates), trims=False))


def applied(fitted: GroupEstimate, flight: Flight) -> GroupEstimate:
    """The unmoved estimate with the records of a flight: each axis those of the same kind of parts as its fit.

    Args:
        fitted: The estimate before.
        flight: The flight, or the part of it that counts.

    Returns:
        The estimate; start velocities that it does not know are guesses, and its score is that of before.
    """
    known = _renewed_on(fitted, flight)
    whole = sum(part.duration for part in fitted.fit.flights)
    for axis, (test, time) in fitted.fit.braking.items():
        if axis in known and time < whole:  # it brakes at rest: its law was fitted to answers to commands only
            known[axis] = _renewed_on(fitted, commanded_parts(flight, (axis,), test.late))[axis]
    return replace(fitted, estimates=known)


def _renewed_on(fitted: GroupEstimate, flight: Flight) -> dict[str, Estimate]:
    new: dict[int, Estimate] = {}
    for one in fitted.estimates.values():
        if id(one.optimum) not in new:
            new[id(one.optimum)] = _renewed(one, _records(flight, _seen_by(one)))
    estimates = {axis: replace(new[id(one.optimum)], place=one.place) for axis, one in fitted.estimates.items()}
    if len(estimates) == 2 and all(one.optimum.point.gain.size == 1 for one in estimates.values()):
        pair = coupled_records(_records(flight, fitted.group), list(estimates.values()))
        estimates = dict(zip(estimates, pair, strict=True))
    return estimates


def _seen_by(estimate: Estimate) -> tuple[str, ...]:
    return tuple(estimate.records[0].axes)


def _records(flight: Flight, axes: Sequence[str]) -> list[Record]:
    found = record(flight, axes)
    return [found] if found else []


def _renewed(estimate: Estimate, records: list[Record]) -> Estimate:
    """An estimate applied to newer records, its coefficients unmoved; unchanged if there are no records."""
    if not records:
        return estimate
    optimum = estimate.optimum
    point = _grown(optimum.point, estimate.records, records)
    known = point.coefficients + point.trim.size
    starts = np.ones(point.start.size, bool)
    free = np.concatenate([optimum.free[:known], starts, optimum.free[optimum.point.n :]])
    return replace(estimate, records=records, optimum=replace(optimum, point=point, free=free))


def _moved(
    estimates: Mapping[str, Estimate], levels: bool, held: Sequence[str] = (), trims: bool = True
) -> dict[str, Estimate]:
    """The estimates after a step, in which levels of the disturbance, coefficients and trims may move.

    Args:
        estimates: Axis name to its estimate.
        levels: Whether levels move.
        held: Axes whose coefficients do not.
        trims: Whether trims move.
    """
    places = [one.place for axis, one in estimates.items() if axis in held]
    if len({id(one.optimum) for one in estimates.values()}) < len(estimates):  # x and y share a likelihood
        one = _moved_alone(next(iter(estimates.values())), levels, places, trims)
        return {axis: replace(each, optimum=one.optimum) for axis, each in estimates.items()}
    return {
        axis: _moved_alone(one, levels, [one.place] if axis in held else [], trims) for axis, one in estimates.items()
    }


def _moved_alone(estimate: Estimate, levels: bool, held: Sequence[int], trims: bool) -> Estimate:
    """An estimate after a step of its own likelihood; coefficients of the axes at the places `held` do not move."""
    optimum, point = estimate.optimum, estimate.optimum.point
    moving = optimum.free.copy()
    moving[: point.coefficients].reshape(-1, point.gain.size)[:, held] = False
    moving[point.coefficients : point.coefficients + point.trim.size] &= trims
    moving[point.n :] &= levels
    found = maximise(estimate.records, point, moving, most=PASSES, prior=optimum.prior)
    return replace(estimate, optimum=replace(found, free=optimum.free))


def _grown(point: Point, before: Sequence[Record], records: Sequence[Record]) -> Point:
    """A point with a start velocity for each segment of newer records: the old one where there is one."""
    fresh = start_point(records, 0.0, 1.0, point.levels).start
    known = {float(t): v for t, v in zip(np.concatenate([rec.starts for rec in before]), point.start, strict=True)}
    starts = np.concatenate([rec.starts for rec in records])
    start = np.array([known.get(float(t), v) for t, v in zip(starts, fresh, strict=True)])
    return replace(point, start=start)


def axis_report(fitted: GroupEstimate, axis: str) -> AxisReport:
    """What is reported of an axis now.

    Args:
        fitted: The estimate of its group.
        axis: Its name.
    """
    nothing = dict.fromkeys(QUANTITIES)
    if axis not in fitted.estimates:
        return AxisReport(nothing, {}, {})
    estimate, then, stamps = fitted.estimates[axis], fitted.half[axis], _of_stamps(fitted.fit, axis)
    share = _shares(fitted, axis)
    flight: dict[str, Interval] = {}
    vehicle: dict[str, Interval] = {}
    values: dict[str, float | None] = dict(nothing)
    for name, one in estimands(estimate.optimum, estimate.place).items():
        if name not in QUANTITIES or name not in then:
            continue
        own = _times(then[name].flight, share[name])
        flight[name] = interval(one, 0.0, own)
        vehicle[name] = interval(one, 0.0, _between(own, then[name].flight, then[name].vehicle))
        if name in DELAYS:
            flight[name], vehicle[name] = (wider(ends, one.value, *stamps) for ends in (flight[name], vehicle[name]))
        values[name] = one.value
    status = statuses({name: vehicle.get(name, (0.0, 0.0)) for name in ("input", "damping", "delay")})
    if read_backwards(vehicle, status):
        return AxisReport(nothing, {}, {})
    law, judged = structure_named(fitted.fit.model.axes[axis].structure), fitted.fit.model.axes[axis].status
    status |= {one.name: extra_status(one, vehicle[one.name]) for one in law.extras if one.name in vehicle}
    for name in QUANTITIES:
        refuted = judged.get(name) == "refuted"  # by the last refit: only a refit tests the law
        if refuted or status.get(name, "ok") != "ok" or None in vehicle.get(name, (None, None)):
            values[name] = None
    return AxisReport(values, vehicle, flight)


def read_backwards(ends: Mapping[str, Interval], status: Mapping[str, str]) -> bool:
    """Whether the fit found the feedback that makes the commands, not the vehicle.

    If only its own feedback moves an axis, the commands follow the motion: the delay is negative and the input is not
    identifiable. Clocks that disagree can shift the delay as far, but leave the input identifiable.

    Args:
        ends: Quantity to its interval.
        status: Coefficient to its status.
    """
    latest = ends.get("delay", (None, None))[1]
    return latest is not None and latest < 0 and status["input"] != "ok"


def _shares(fitted: GroupEstimate, axis: str) -> Mapping[str, float]:
    """Quantity to its standard error now as a share of what it was at the refit.

    Data never take information away, and the excited time brings it at most in proportion. Where several laws remain,
    an interval is as wide as these are apart, which is no error of the data: it stands until the next refit, and so do
    those of an axis that takes no steps.
    """
    then, several = fitted.half[axis], len(fitted.fit.model.axes[axis].laws) > 1
    if several or fitted.stepped <= fitted.seen or _open(fitted, axis):
        return dict.fromkeys(then, 1.0)
    now, least = _curvature_errors(fitted.estimates[axis]), math.sqrt(fitted.seen / fitted.stepped)
    return {name: min(max(now[name] / one.error, least), 1.0) if one.error > 0 else 1.0 for name, one in then.items()}


def _times(half: Half, share: float) -> Half:
    below, above = half
    return (None if below is None else below * share, None if above is None else above * share)


def _between(now: Half, own: Half, vehicle: Half) -> Half:
    """Half widths of the vehicle's interval now: only this flight's part shrinks, not the spread between flights."""
    ends: list[float | None] = []
    for here, then, wide in zip(now, own, vehicle, strict=True):
        if here is None or then is None or wide is None:
            ends.append(None)
        else:
            ends.append(float(np.sqrt(here**2 + max(wide**2 - then**2, 0.0))))
    return ends[0], ends[1]
