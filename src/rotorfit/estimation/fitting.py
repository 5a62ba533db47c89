"""Flights -> Fit: coefficients with intervals, statuses and profiles, by one of the methods in `METHODS`."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from rotorfit.core import parallel
from rotorfit.core.card import Card, Prior
from rotorfit.core.errors import CardError, FlightError, ModelError
from rotorfit.core.flight_data import Flight, Note
from rotorfit.core.frames import AXES
from rotorfit.core.laws import AVERAGED, DELAY_RANGE, FIRST_ORDER_DELAY, given_by_law, structure_named
from rotorfit.core.model import NORMAL, STRUCTURE, Axis, Model, Plain, Predictor, Source, first_order, unknown_axis
from rotorfit.core.progress import Progress
from rotorfit.core.results import Fit, Outliers, PaperFit
from rotorfit.diagnosis.position_loop import MotionOf, restored_axes
from rotorfit.dynamics.kinematics import motion_from_flight
from rotorfit.estimation.clock_placement import placed_alike
from rotorfit.estimation.clock_uncertainty import check_clocks, with_clock_error, with_delay_error
from rotorfit.estimation.grouping import commands_axis, groups_of, serving_flights, without_held_axes
from rotorfit.estimation.identifiability import LEAST_TIME
from rotorfit.estimation.judgement.judge import judged
from rotorfit.estimation.likelihood.axis_estimate import Estimate, couple_axes, estimate_axis, estimate_plane
from rotorfit.estimation.likelihood.blocks import record
from rotorfit.estimation.likelihood.coefficients import (
    Blocks,
    axis_of_estimate,
    block_diagonal,
    covariances,
    holds_zero,
)
from rotorfit.estimation.likelihood.extra_parameters import separable, structure_at
from rotorfit.estimation.likelihood.fisher_scoring import on_stretches
from rotorfit.estimation.likelihood.latency import GROUPS, align_velocity, both_axes, delay_error
from rotorfit.estimation.likelihood.law_average import averaged, families, united
from rotorfit.estimation.likelihood.law_selection import AUTO, Choice, select_laws, unidentifiable_candidate
from rotorfit.estimation.likelihood.noise_levels import with_levels
from rotorfit.estimation.likelihood.outliers import without_outliers
from rotorfit.estimation.likelihood.prior import gaussian_prior
from rotorfit.estimation.likelihood.profile import height, hold
from rotorfit.estimation.likelihood.richer_laws import estimate_laws
from rotorfit.estimation.methods import BEST, METHODS
from rotorfit.estimation.regression.axes_by_method import axes_by_method
from rotorfit.estimation.regression.paper import paper_regression
from rotorfit.estimation.zero_command import braking, commanded_parts
from rotorfit.flights.distinct import check_distinct, check_flights, landmarks

Priors = Mapping[str, Mapping[str, Prior]]

PROFILE_DELAYS = np.linspace(DELAY_RANGE[0], DELAY_RANGE[1], 15)
"""Delays at which the profile is drawn besides those that the interval required [s]."""

HELD = "the command is only a response to the motion, as from a position controller"
SILENT = "with the command the motion is predicted no better than without it"
"""Why a regression gives no numbers of an axis whose commands seem to explain its motion."""

IMPOSSIBLE, ROUGH = 100.0, 10.0
"""Fall of the log-likelihood beyond which a drawn delay counts as impossible, and the expected gain at which its climb
stops: most of the climbing would be spent there, and no chart shows the difference."""


def fit(
    flights: Sequence[Flight],
    method: str = BEST,
    axes: Sequence[str] = AXES,
    progress: Progress | None = None,
    structure: str = AVERAGED,
    prior: bool = False,
) -> Fit:
    """Estimates the coefficients of the axes from one or several flights.

    Args:
        flights: Flights of one vehicle, read with one card. An axis is fitted to the flights that excite it, see
            `without_held_axes`.
        method: A key of `METHODS`: `ml`, the likelihood; `robust`, the likelihood without outlier poses; `paper`, the
            paper's regression; or one of the regressions between.
        axes: Axes to fit.
        progress: Called with a fraction and a text; an exception raised in it cancels the fit.
        structure: `averaged`, the default: delay and lag, or another law where the data require it, see `law_average`;
            the name of one law for every axis; or `auto`: the law that the data support, axis by axis. `coupled`
            applies to x and y together and leaves every other axis at the first-order law with a delay. Methods other
            than `ml` accept `averaged` and that law only.
        prior: Whether to use the priors of the card; with the default structure or the first-order law only.

    Returns:
        The fit. A coefficient that is not identifiable has a status and no number.

    Raises:
        TypeError: An argument is not a flight.
        FlightError: No flight is given, one is given twice, their cards differ, the clock offsets of only some include
            the delay, or the method needs positions of an axis that has only a velocity.
        CardError: Priors are requested and the card has none, or the method does not use the likelihood.
        ModelError: There is no such method or structure, or the structure does not go with the method or with priors.
    """
    check_fit(flights, method, axes, structure, prior)
    flights = without_held_axes(flights)
    flights = [align_velocity(f, axes) for f in flights] if method == "ml" else _of_poses(flights, axes)
    priors = flights[0].card.prior if prior else {}
    wanted = [axis for axis in AXES if axis in axes]
    flights = placed_alike(flights, lambda some: _estimates(some, wanted))
    report = progress or (lambda _fraction, _text: None)
    outliers: Outliers = ()
    if method == "robust":
        report(0.0, "looking for outliers")
        flights, outliers = without_outliers(flights, lambda some: _estimates(some, wanted))
    report(0.0, "the paper's regression")
    paper = paper_regression(flights, wanted)
    found = _found(flights, wanted, method, structure, priors, paper, report, _motion_of(flights, paper))
    tested = {axis: test for axis, e in found.estimates.items() if (test := braking(e)) and test.acts}
    parts = {axis: [commanded_parts(f, (axis,), test.late) for f in flights] for axis, test in tested.items()}
    for axis, some in parts.items():
        report(0.9, f"{axis} while it is commanded")
        apart = _found(some, [axis], method, structure, priors, paper, lambda _fraction, _text: None)
        found, parts[axis] = (
            (_with_axis(found, apart, axis), some) if _gain_known(apart, axis) else (found, list(flights))
        )
    report(1.0, "done")
    serving = {
        axis: serving_flights(parts.get(axis, flights), e.records[0].axes) for axis, e in found.estimates.items()
    }
    model = _of_the_vehicle(_model(flights, method, paper, found), found.estimates, flights, serving)
    model = _with_plain(model, found.plain, flights, serving)
    braked = {axis: (test, _duration(parts[axis])) for axis, test in tested.items()}
    return Fit(model, tuple(flights), paper, found.estimates, found.remarks, outliers, braked)


def _duration(flights: Sequence[Flight]) -> float:
    """Duration of the flights together [s]."""
    return sum(f.duration for f in flights)


def _of_the_vehicle(
    model: Model,
    estimates: Mapping[str, Estimate],
    flights: Sequence[Flight],
    serving: Mapping[str, Sequence[Flight]],
    tested: bool = True,
) -> Model:
    """The model with the intervals of the vehicle, and with the errors of clocks and latencies in the delays."""
    late = {axis: delay_error(serving[axis], estimate) for axis, estimate in estimates.items()}
    return with_delay_error(with_clock_error(judged(model, estimates, tested), flights), late, GROUPS)


def _with_plain(
    model: Model,
    plain: Mapping[str, tuple[Axis, Estimate]],
    flights: Sequence[Flight],
    serving: Mapping[str, Sequence[Flight]],
) -> Model:
    """The model with the first-order law beside that of every axis with another law, with the intervals of the vehicle.

    Plans and controller gains are computed from it. It is not tested: the axis is known to have another law, which the
    first-order coefficients cannot express.
    """
    known = {axis: pair for axis, pair in plain.items() if model.axes[axis].structure != STRUCTURE}
    if not known:
        return model
    axes = {axis: one for axis, (one, _) in known.items()}
    estimates = {axis: estimate for axis, (_, estimate) in known.items()}
    blocks: Blocks = {}
    for axis, estimate in estimates.items():
        blocks |= covariances((axis,), [estimate], axes)
    names, matrix = block_diagonal(blocks)
    alone = replace(model, axes={**model.axes, **axes}, covariance_names=names, covariance=matrix)
    alone = _of_the_vehicle(alone, estimates, flights, serving, tested=False)
    beside = {axis: replace(model.axes[axis], plain=_plain_of(alone, axis)) for axis in known}
    return replace(model, axes={**model.axes, **beside})


def _plain_of(alone: Model, axis: str) -> Plain:
    """The first-order law of an axis, for publication beside another law."""
    known = alone.axes[axis]
    law = first_order(alone, axis) if known.predictor else None
    return Plain(known.input, known.damping, known.delay, known.stderr, known.ci95, known.status, law)


def _gain_known(found: "_Found", axis: str) -> bool:
    """Whether the input gain of an axis was estimated with status `ok`."""
    return axis in found.axes and found.axes[axis].status["input"] == "ok"


def _only(blocks: Blocks, axes: Sequence[str]) -> Blocks:
    """The rows and columns of some axes; x and y may share a block where only one of them is wanted."""
    out: Blocks = {}
    for names, matrix in blocks.items():
        keep = [i for i, name in enumerate(names) if name.split(".")[0] in axes]
        if keep:
            out[tuple(names[i] for i in keep)] = matrix[np.ix_(keep, keep)]
    return out


def _with_axis(found: "_Found", apart: "_Found", axis: str) -> "_Found":
    """The results, with one axis replaced by that of another fit."""
    covariance = _only(found.covariance, [other for other in AXES if other != axis]) | _only(apart.covariance, [axis])
    return replace(
        found,
        axes={**found.axes, axis: apart.axes[axis]},
        covariance=covariance,
        estimates={**found.estimates, axis: apart.estimates[axis]},
        plain={
            **{name: one for name, one in found.plain.items() if name != axis},
            **{name: one for name, one in apart.plain.items() if name == axis},
        },
    )


@dataclass(frozen=True)
class _Found:
    """Results for some axes: `estimates` and `remarks` as in `Fit`; `plain` is the first-order law beside another."""

    axes: Mapping[str, Axis]
    covariance: Blocks
    estimates: Mapping[str, Estimate] = field(default_factory=dict)
    remarks: Mapping[str, str] = field(default_factory=dict)
    plain: Mapping[str, tuple[Axis, Estimate]] = field(default_factory=dict)


def _found(
    flights: Sequence[Flight],
    wanted: Sequence[str],
    method: str,
    structure: str,
    priors: Priors,
    paper: PaperFit,
    report: Progress,
    motion_of: MotionOf = motion_from_flight,
) -> _Found:
    """Fits the requested axes, group by group."""
    groups, parts = groups_of(flights, wanted), list[_Found]()

    def found_of(group: Sequence[str]) -> _Found:
        if METHODS[method].likelihood:
            return _likelihood_group(flights, group, priors, structure, motion_of)
        regression = METHODS[method].estimator
        found = _regression_group(flights, group, method) if regression else _paper_group(flights, group, paper)
        return _without_idle(found, flights, group, method, motion_of)

    every = parallel.each(found_of, groups, _duration(flights))
    for number, group in enumerate(groups):
        report(0.1 + 0.9 * number / len(groups), f"likelihood of {', '.join(group)}")
        parts.append(next(every))
    return _Found(  # x and y may be fitted together where only one of them is wanted
        {axis: known for part in parts for axis, known in part.axes.items() if axis in wanted},
        _only({names: matrix for part in parts for names, matrix in part.covariance.items()}, wanted),
        {axis: estimate for part in parts for axis, estimate in part.estimates.items() if axis in wanted},
        {axis: remark for part in parts for axis, remark in part.remarks.items() if axis in wanted},
        {axis: one for part in parts for axis, one in part.plain.items() if axis in wanted},
    )


def _model(flights: Sequence[Flight], method: str, paper: PaperFit, found: _Found) -> Model:
    """The model of the results; axes that were not requested or not commanded are unknown in it."""
    names, matrix = block_diagonal(found.covariance)
    commanded = {axis for axis in AXES for flight in flights if commands_axis(flight, axis)}
    left_out = {axis: unknown_axis("not_fitted" if axis in commanded else "not_excited") for axis in AXES}
    return Model(
        card=flights[0].card,
        structure=_common_structure(found.axes),
        method=method,
        axes={**left_out, **found.axes},
        covariance_names=names,
        covariance=matrix,
        paper=tuple(float(g) if np.isfinite(g) else None for g in paper.gamma),
        paper_noise=_paper_noise(flights, tuple(found.axes), paper),
        findings=(),
        flights=tuple(
            Source(f.path, f.sha256, f.span, f.notes, f.moved, landmarks(f), f.pose_rate, f.commanded) for f in flights
        ),
    )


def check_fit(flights: Sequence[Flight], method: str, axes: Sequence[str], structure: str, prior: bool) -> None:
    """Refuses what `fit` refuses, with the same errors, and calls no kernel: nothing is compiled for an error."""
    if method not in METHODS:
        raise ModelError(f"no such method: {method!r}; methods are {', '.join(METHODS)}")
    if structure not in (AUTO, AVERAGED):
        structure_named(structure)
    if method != "ml" and structure not in (AVERAGED, STRUCTURE):
        raise ModelError(f"--method {method} supports no other structure: leave --structure out, or use --method ml")
    if prior and structure not in (AVERAGED, STRUCTURE):
        raise ModelError("priors are for the default laws: leave --prior or --structure out")
    check_flights(flights)
    if not flights:
        raise FlightError("no flight to fit: give at least one log")
    if any(_but_errors(f.card) != _but_errors(flights[0].card) for f in flights):
        raise FlightError("the logs were read with different cards: fit them apart, or give one --card for all")
    check_clocks(flights)
    check_distinct(flights)
    if prior and not METHODS[method].likelihood:
        raise CardError(f"the method {method} takes no prior: leave --prior out, or use --method ml")
    if prior and not flights[0].card.prior:
        raise CardError(
            "the card has no [prior] to use: leave --prior out, or write x = { input = { mean, sd } } there"
        )
    for flight in flights:
        lost = [axis for axis in AXES if axis in axes and axis in flight.velocity_only]
        if lost and method not in ("ml", "paper"):  # the paper's needs derivatives alone: an integrated velocity does
            raise FlightError(
                f"{flight.path}: the method {method} needs positions, but {', '.join(lost)} "
                f"{'has' if len(lost) == 1 else 'have'} only a velocity: use --method ml, or other --axes"
            )


def _but_errors(card: Card) -> Mapping[str, Any]:
    """The raw card without the errors of its stamps, which each recording of a radio link has of its own."""
    raw = dict(card.raw)
    for part in ("command", "pose"):
        time = raw[part].get("time")
        if isinstance(time, Mapping):
            kept = {key: value for key, value in time.items() if key != "error"}
            raw[part] = {**raw[part], "time": kept["from"] if kept.keys() == {"from"} else kept}
    return raw


def _of_poses(flights: Sequence[Flight], axes: Sequence[str]) -> list[Flight]:
    """The flights without velocities that were measured in addition to poses, with a note: only `ml` can use them."""
    return [_without_velocity(f, axes) for f in flights]


def _without_velocity(flight: Flight, axes: Sequence[str]) -> Flight:
    """The flight without the velocities of axes that have a pose, with a note where one of them will be fitted."""
    velocity, both = flight.velocity, both_axes(flight)
    if velocity is None or not both:
        return flight
    value = velocity.value.copy()
    value[:, [AXES.index(axis) for axis in both]] = np.nan
    used = replace(velocity, value=value) if velocity.alone else None
    if not set(both) & set(axes):
        return replace(flight, velocity=used)
    text = f"the vehicle's own velocity of {', '.join(both)} is not used: only the method ml uses it beside a pose"
    return replace(flight, velocity=used, notes=(*flight.notes, Note("velocity_unused", text, velocity.time.size)))


def _motion_of(flights: Sequence[Flight], paper: PaperFit) -> MotionOf:
    """Gives the motion of a flight of the paper's regression, which has computed it."""
    known = {id(flight): motion for flight, motion in zip(flights, paper.motions, strict=True)}
    return lambda flight: known[id(flight)]


def _likelihood_group(
    flights: Sequence[Flight], group: Sequence[str], priors: Priors, structure: str, motion_of: MotionOf
) -> _Found:
    """The axes of one group by the likelihood, under the requested structure."""
    estimates = estimate_group(flights, group, priors, motion_of)
    if structure == AVERAGED and estimates:
        return _averaged(flights, group, estimates, priors)
    axes, covariance = _group_axes(flights, group, estimates)
    if structure == STRUCTURE or not estimates:
        return _Found(axes, covariance, estimates)
    return _other_structures(flights, group, estimates, axes, covariance, structure)


def _averaged(
    flights: Sequence[Flight], group: Sequence[str], estimates: Mapping[str, Estimate], priors: Priors
) -> _Found:
    """The axes of a group under the default laws, with the first-order law beside them."""
    known = families(serving_flights(flights, group), estimates, priors)
    chosen, axes, plain = {}, {}, {}
    for axis, family in known.items():
        said = [_group_axes(flights, group, {axis: law.estimate})[0][axis] for law in family.laws]
        family = family.with_other_reading(said)
        said += [_group_axes(flights, group, {axis: law.estimate})[0][axis] for law in family.laws[len(said) :]]
        beside = [one for law, one in zip(family.laws, said, strict=True) if law.estimate is family.plain]
        telling = [place for place, one in enumerate(said) if one.predictor]
        if telling:  # drop laws under which the input may be zero if it is not under another
            family = family.of([family.laws[place] for place in telling])
            axes[axis] = averaged([said[place] for place in telling], family, axis)
        else:
            axes[axis] = said[0]
        chosen[axis] = family.laws[0].estimate
        if axes[axis].predictor and axes[axis].structure != STRUCTURE:
            one = beside[0] if beside else _group_axes(flights, group, {axis: family.plain})[0][axis]
            plain[axis] = one, family.plain
    covariance = covariances(group, [chosen[axis] for axis in group], axes)
    return _Found(axes, covariance, chosen, plain=plain)


def _estimates(flights: Sequence[Flight], wanted: Sequence[str]) -> dict[str, Estimate]:
    """Maximum-likelihood estimates of the requested axes under the first-order law, without intervals."""
    return {a: e for group in groups_of(flights, wanted) for a, e in estimate_group(flights, group, {}).items()}


def _common_structure(axes: Mapping[str, Axis]) -> str:
    """Name of the structure that all axes with numbers share; `mixed` if they differ."""
    names = {axis.structure for axis in axes.values() if axis.predictor}
    return "mixed" if len(names) > 1 else next(iter(names), STRUCTURE)


def _other_structures(
    flights: Sequence[Flight],
    group: Sequence[str],
    estimates: dict[str, Estimate],
    plain: dict[str, Axis],
    covariance: Blocks,
    structure: str,
) -> _Found:
    """The axes of a group under another structure or the selected one, with the first-order law beside them."""
    serving = serving_flights(flights, group)
    known = [axis for axis in group if plain[axis].predictor]
    wanted = dict.fromkeys(group, FIRST_ORDER_DELAY)
    choices: dict[str, Choice] = {}
    if structure == AUTO:
        choices = select_laws(serving, estimates, known)
        wanted |= {axis: choice.structure for axis, choice in choices.items()}
    else:
        wanted |= dict.fromkeys(known, structure_named(structure))
    found = estimate_laws(serving, estimates, wanted)
    lost = [axis for axis, e in found.items() if not separable(e.optimum, e.place)]
    if lost:
        found = estimate_laws(serving, estimates, wanted | dict.fromkeys(lost, FIRST_ORDER_DELAY))
    if any(structure_at(e.optimum, e.place) != FIRST_ORDER_DELAY for e in found.values()):
        axes, covariance = _group_axes(flights, group, found)
    else:
        found, axes = estimates, plain
    for axis in known:
        if _contradicts(found[axis], axes[axis], estimates[axis], plain[axis]):
            lawful = given_by_law(axes[axis].structure)
            status = {name: one if name in lawful else "refuted" for name, one in axes[axis].status.items()}
            axes[axis] = replace(axes[axis], status=status)
        elif axes[axis].status["input"] == "not_excited" and found[axis].excited:  # by its plain law, and its own
            axes[axis] = replace(axes[axis], status=dict.fromkeys(axes[axis].status, "not_identifiable"))
        if _may_have_no_lag(axes[axis]):
            axes[axis] = united(axes[axis], [plain[axis]])
        if axis in lost:
            axes[axis] = replace(axes[axis], candidates=(unidentifiable_candidate(wanted[axis].name),))
        if axis in choices:
            choice = choices[axis]
            combined = {"delay_plus_lag": choice.delay_plus_lag, **axes[axis].combinations}
            axes[axis] = replace(
                axes[axis], candidates=choice.candidates, samples=choice.samples, combinations=combined
            )
    return _Found(axes, covariance, found, plain={axis: (plain[axis], estimates[axis]) for axis in known})


def _contradicts(estimate: Estimate, axis: Axis, beside: Estimate, plain: Axis) -> bool:
    """Whether a law contradicts the likelier first-order law with a delay, under which the commands explain the motion.

    Its commands explain nothing, or the opposite. A law without a delay does that, since it is judged by what follows
    a step at once, when the vehicle still does what it did before.
    """
    if plain.predictor is None or not _height(estimate) < _height(beside):
        return False
    if axis.predictor is None:
        return axis.status["input"] == "not_excited"
    return axis.predictor.input * plain.predictor.input < 0


def _height(estimate: Estimate) -> float:
    return float(estimate.optimum.score.log_likelihood)


def _may_have_no_lag(axis: Axis) -> bool:
    """Whether the lag of an axis has no lower end: then its law may be the first-order one, which the search excludes.

    The search ends at a small lag, which leaves the delay too short by as much, and too sure.
    """
    return structure_named(axis.structure).delayed and "lag" in axis.ci95 and axis.ci95["lag"][0] is None


def estimate_group(
    flights: Sequence[Flight], group: Sequence[str], priors: Priors, motion_of: MotionOf = motion_from_flight
) -> dict[str, Estimate]:
    """Maximum-likelihood estimates of the axes of one group; empty where the flights are too short."""
    serving = serving_flights(flights, group)
    records = [rec for f in serving if (rec := record(f, group))]
    if sum(float(np.sum(np.diff(rec.block_time)[~rec.fresh[1:]])) for rec in records) < LEAST_TIME:
        return {}
    # Commands that only hold the position excite nothing, even where the stamps of different clocks place them before
    # the motion to which they respond.
    held = restored_axes(serving, group, motion_of=motion_of)
    moving = [any(commands_axis(f, axis) for f in serving) and axis not in held for axis in group]
    if all(rec.held for rec in records):
        estimates = [
            estimate_axis(serving, a, moves, gaussian_prior(priors, [a]))
            for a, moves in zip(group, moving, strict=True)
        ]
        if len(group) == 2:
            estimates = couple_axes(records, estimates)
    else:
        estimates = estimate_plane(serving, records, group, moving, gaussian_prior(priors, group))
    return dict(zip(group, estimates, strict=True))


def _group_axes(
    flights: Sequence[Flight], group: Sequence[str], estimates: Mapping[str, Estimate]
) -> tuple[dict[str, Axis], Blocks]:
    """The axes of one group as published from their estimates, and their covariance."""
    if not estimates:
        return {axis: unknown_axis("too_short") for axis in group}, {}
    serving = serving_flights(flights, group)
    places = [next((i for i, s in enumerate(serving) if s is f), None) for f in flights]
    results = {axis: axis_of_estimate(estimate, places) for axis, estimate in estimates.items()}
    return results, covariances(list(estimates), list(estimates.values()), results)


def with_delay_profiles(fit: Fit) -> Fit:
    """The fit with delay profiles over the whole range of the search, not only where the intervals required them."""
    axes = dict(fit.model.axes)
    known = [name for name, one in fit.estimates.items() if axes[name].predictor and _has_delay(one)]
    drawn = parallel.each(lambda name: _delay_profile(fit.estimates[name]), known, _duration(fit.flights))
    for name, beyond in zip(known, drawn, strict=True):
        axes[name] = replace(axes[name], profile=tuple(sorted([*axes[name].profile, *beyond])))
    return replace(fit, model=replace(fit.model, axes=axes))


def _has_delay(estimate: Estimate) -> bool:
    return structure_at(estimate.optimum, estimate.place).delayed


def _delay_profile(estimate: Estimate) -> list[tuple[float, float]]:
    """Delays over the range of the search, and how much lower the likelihood is at each than at its maximum.

    All other parameters are re-maximised, moving outwards from the maximum; where a delay is impossible, only roughly.
    Where stretches of long flights deny it, it is drawn as low as by these: the whole denies it about as much, or more.
    """
    records, optimum, drawn = estimate.records, estimate.optimum, []
    index = 2 * optimum.point.gain.size + estimate.place
    best, least = float(optimum.point.flat()[index]), height(optimum) - IMPOSSIBLE
    part = on_stretches(records, optimum.point, optimum.free, optimum.prior)
    for side in (-1.0, 1.0):
        here, there = optimum, part[1] if part else optimum
        beyond = PROFILE_DELAYS[side * (PROFILE_DELAYS - best) > 0]
        for target in map(float, beyond[np.argsort(side * beyond)]):
            if part:
                there = hold(part[0], there, index, target, ROUGH)
                fall = height(part[1]) - height(there)
                if fall > IMPOSSIBLE:
                    drawn.append((target, -fall))
                    continue
            if height(here) < least:
                here = hold(records, here, index, target, ROUGH)
            if height(here) >= least:
                here = hold(records, here, index, target)
            drawn.append((target, height(here) - height(optimum)))
    return drawn


def _paper_group(flights: Sequence[Flight], group: Sequence[str], paper: PaperFit) -> _Found:
    """Axes by the paper's regression, with the disturbance levels for prediction estimated at its coefficients."""
    results: dict[str, Axis] = {}
    covariance: Blocks = {}
    for axis in group:
        i = AXES.index(axis)
        if paper.status.get(axis) != "ok":
            results[axis] = unknown_axis(paper.status.get(axis, "not_excited"))
            continue
        g, b = paper.gamma[2 * i : 2 * i + 2]
        error = paper.stderr[2 * i : 2 * i + 2]
        names = ("input", "damping")
        value = dict(zip(names, (float(g), float(b)), strict=True))
        spread = dict(zip(names, (float(e) for e in error), strict=True))
        ends = {name: (value[name] - NORMAL * spread[name], value[name] + NORMAL * spread[name]) for name in names}
        excited = not holds_zero(ends["input"])
        if not excited:
            results[axis] = unknown_axis("not_excited")
            continue
        results[axis] = Axis(
            input=value["input"],
            damping=value["damping"],
            delay=None,
            stderr={**spread, "delay": None},
            ci95={**ends, "delay": (None, None)},
            status={"input": "ok", "damping": "ok", "delay": "not_identifiable"},
            trim=(None,) * len(flights),
            predictor=Predictor(value["input"], value["damping"], 0.0),
        )
        covariance[(f"{axis}.input", f"{axis}.damping")] = paper.covariance[2 * i : 2 * i + 2, 2 * i : 2 * i + 2]
    serving = [f for f in flights if any(commands_axis(f, axis) for axis in results if results[axis].predictor)]
    return _Found(with_levels(serving, results), covariance)


def _paper_noise(flights: Sequence[Flight], axes: Sequence[str], paper: PaperFit) -> dict[str, Mapping[str, float]]:
    """Disturbance levels at the paper's coefficients, for the axes that have them; see `Model.paper_noise`."""
    groups = groups_of(flights, axes)
    parts = parallel.each(lambda group: _paper_group(flights, group, paper).axes, groups, _duration(flights))
    return {axis: known.noise for part in parts for axis, known in part.items() if known.noise}


def _without_idle(
    found: _Found, flights: Sequence[Flight], group: Sequence[str], method: str, motion_of: MotionOf
) -> _Found:
    """The results of a method without the axes that are not excited by the tests of the likelihood.

    On an axis that a position controller only holds, every regression finds that controller's numbers, and sure ones.
    The paper's regression, which is there for comparison, is not judged by the predictions of the likelihood.
    """
    held = restored_axes(serving_flights(flights, group), group, motion_of=motion_of)
    told = [axis for axis in group if found.axes[axis].predictor and axis not in held]
    searched = estimate_group(flights, group, {}, motion_of) if told and METHODS[method].estimator else {}
    silent = {axis: searched[axis] for axis in told if axis in searched and not searched[axis].excited}
    if not (held or silent):
        return found
    idle = dict.fromkeys(held, replace(unknown_axis("not_excited"), trim=(None,) * len(flights)))
    if silent:
        idle |= _group_axes(flights, group, silent)[0]
    return replace(
        found,
        axes={**found.axes, **idle},
        covariance=_only(found.covariance, [axis for axis in group if axis not in idle]),
        remarks={**found.remarks, **dict.fromkeys(held, HELD), **dict.fromkeys(silent, SILENT)},
    )


def _regression_group(flights: Sequence[Flight], group: Sequence[str], method: str) -> _Found:
    """Axes by one of the regressions in `METHODS`, their covariance, and its remarks."""
    serving = [f for f in flights if any(commands_axis(f, axis) for axis in group)]
    found, covariance, remarks = axes_by_method(serving, group, method)
    places = [next((i for i, s in enumerate(serving) if s is f), None) for f in flights]
    results = {
        axis: replace(known, trim=tuple(None if place is None else known.trim[place] for place in places))
        for axis, known in found.items()
    }
    return _Found(results, covariance, remarks=remarks)
