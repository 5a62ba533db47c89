"""Estimates under another law than first order with a delay, climbed from the optimum that the search selected.

Search and selection of an optimum use the first-order law; other laws start from its estimate, with some starts that
trade delay, gain or damping against their further parameters. A law with a lag has optima far from there: it starts
from the best points of a grid.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from rotorfit.core.flight_data import Flight
from rotorfit.core.frames import Array, heading_from_world, world_from_heading
from rotorfit.core.laws import DELAY_RANGE, FIRST_ORDER_DELAY, STRUCTURES, Structure, start_levels
from rotorfit.estimation.likelihood.axis_estimate import Estimate, couple_axes, free_of, maximise_restricted
from rotorfit.estimation.likelihood.blocks import Record, record
from rotorfit.estimation.likelihood.fisher_scoring import Optimum, maximise
from rotorfit.estimation.likelihood.law_search import law_starts, swapped
from rotorfit.estimation.likelihood.likelihood import segments
from rotorfit.estimation.likelihood.parameters import Point
from rotorfit.estimation.likelihood.prior import GaussianPrior

SPEED_BLOCKS = 6
"""Number of blocks over which speeds are measured for the reference speed of the quadratic drag."""

NEAR = 3.0
"""Fall of the objective below the best of the short climbs within which a start is climbed to its maximum: levels that
are held shift the order of maxima so close."""

SAME_MAXIMUM = 0.3
"""Distance within which two short climbs count as on their way to one maximum [standard errors]: all of nine pairs on
two flights ended there; of pairs 0.5 to 1 apart one did not."""

LIMITED = (1.0, 0.5), (1.7, 0.2)
"""Starts of a law with a limit of the acceleration: how much faster than the law without it, and the limit over what
the largest command asks for at rest."""

FAR_ABOVE = 20.0
"""Rise of the log-likelihood over the first-order law from which a second order is sought from the usual levels, too:
the levels of a law so far from true rank its starts wrongly."""

Start = tuple[float, float, float, tuple[float, ...]]
"""Factors of a start on gain and damping, its delay [s] and its further parameters."""

PriorOf = Callable[[Sequence[str], Sequence[Structure]], GaussianPrior | None]
"""From axes and their laws to the prior of their parameters."""


Hopeless = Callable[[Sequence[str], Optimum], bool]
"""From axes and where a climb under their laws stands to whether it may be given up."""


def nothing_believed(_axes: Sequence[str], _structures: Sequence[Structure]) -> None:
    """No prior."""


def never(_axes: Sequence[str], _begun: Optimum) -> bool:
    """Every climb goes on to its maximum."""
    return False


def estimate_laws(
    serving: Sequence[Flight],
    estimates: Mapping[str, Estimate],
    structures: Mapping[str, Structure],
    prior_of: PriorOf = nothing_believed,
    hopeless: Hopeless = never,
) -> dict[str, Estimate]:
    """Estimates of the axes of one group under other structures.

    Args:
        serving: The flights of the group.
        estimates: Estimates under the first-order law with a delay, by axis.
        structures: Requested structure of each axis; an axis that is not excited keeps the first-order law.
        prior_of: Gives the prior of the laws.
        hopeless: Which climbs of the joint likelihood of x and y are given up; their laws stay where the climb stood.
    """
    group = tuple(estimates)
    wanted = {
        axis: applicable_structure(structures[axis], group) if estimates[axis].excited else FIRST_ORDER_DELAY
        for axis in group
    }
    if all(structure == FIRST_ORDER_DELAY for structure in wanted.values()):
        return dict(estimates)
    laws = list(wanted.values())
    crossed = any(one.coupled for one in laws) or all(one.limited for one in laws)  # a limit of both together
    if len(group) == 2 and (crossed or estimates[group[0]].optimum.point.gain.size == 2):
        return _together(serving, group, estimates, wanted, prior_of, hopeless)
    out = {axis: under_law(estimates[axis], axis, wanted[axis], prior_of) for axis in group}
    if len(group) == 2:
        joint = _records(serving, group)
        plain = [replace(out[axis], records=_records(serving, (axis,))) for axis in group]
        out = dict(zip(group, couple_axes(joint, plain), strict=True))
    return out


def single(
    serving: Sequence[Flight], estimates: Mapping[str, Estimate], axis: str, structure: Structure
) -> tuple[Estimate, Estimate]:
    """Estimates of one axis under another structure, while the other axes keep the first-order law.

    Returns:
        The estimates under the first-order law and under the structure, on the same data, so that their likelihoods are
        comparable: where the vehicle turns or the structure couples x and y, both are from the joint likelihood.
    """
    before = estimates[axis]
    if before.optimum.point.gain.size == 1 and not structure.coupled:
        return before, under_law(before, axis, structure)
    plain = dict.fromkeys(estimates, FIRST_ORDER_DELAY)
    group = tuple(estimates)
    if before.optimum.point.gain.size == 1:
        before = _together(serving, group, estimates, plain)[axis]
    if structure == FIRST_ORDER_DELAY:
        return before, before
    return before, _together(serving, group, estimates, plain | {axis: structure})[axis]


def applicable_structure(structure: Structure, group: Sequence[str]) -> Structure:
    """The structure; the first-order law where it couples x and y and these are not one group; yaw has no limit."""
    lawless = (structure.coupled and tuple(group) != ("x", "y")) or (structure.limited and tuple(group) == ("yaw",))
    return FIRST_ORDER_DELAY if lawless else structure


def _records(serving: Sequence[Flight], axes: Sequence[str]) -> list[Record]:
    return [rec for flight in serving if (rec := record(flight, axes))]


def under_law(
    estimate: Estimate,
    axis: str,
    structure: Structure,
    prior_of: PriorOf = nothing_believed,
    hopeless: Hopeless = never,
) -> Estimate:
    """Estimate of one axis by itself under a structure; arguments as for `estimate_laws`."""
    if structure == FIRST_ORDER_DELAY:
        return estimate
    records, prior, start = estimate.records, prior_of((axis,), (structure,)), estimate.optimum.point
    top = _top(records, start, structure, prior, hopeless)
    if structure.order > 1 and posterior(top) > estimate.optimum.score.log_likelihood + FAR_ABOVE:
        usual = replace(start, levels=np.tile(start_levels(start.measured), (len(start.levels), 1)))
        top = max(top, _top(records, usual, structure, prior, hopeless), key=posterior)
    return replace(estimate, optimum=top)


def _top(
    records: Sequence[Record], point: Point, structure: Structure, prior: GaussianPrior | None, hopeless: Hopeless
) -> Optimum:
    """The highest maximum of one axis by itself that is reached from the starts of a structure."""
    found = [_begun(records, start, [True], prior) for start in _starts(records, point, 0, structure, prior)]
    highest = max(one.score.objective for one in found)
    found = _apart([one for one in found if one.score.objective > highest - NEAR])
    if all(hopeless(records[0].axes, one) for one in found):
        return found[0]
    return max((finished(records, one.point, [True], prior, hopeless) for one in found), key=posterior)


def _apart(found: Sequence[Optimum]) -> list[Optimum]:
    """The ends of short climbs, the highest first, without those that will end at the maximum of a higher one."""
    kept: list[Optimum] = []
    for one in sorted(found, key=lambda one: -one.score.objective):
        steps = [one.point.flat() - other.point.flat() for other in kept]
        if all(step @ one.score.information @ step > SAME_MAXIMUM**2 for step in steps):
            kept.append(one)
    return kept


def posterior(top: Optimum) -> float:
    """Log-likelihood and prior of a maximum; objectives differ by the reference of their restriction, too."""
    return top.score.log_likelihood + (top.prior.exponent(top.point) if top.prior else 0.0)


def finished(
    records: Sequence[Record],
    point: Point,
    moving: Sequence[bool],
    prior: GaussianPrior | None,
    hopeless: Hopeless = never,
) -> Optimum:
    """The maximum; where lag and damping ended swapped, the equivalent maximum with the two exchanged."""
    given_up = partial(hopeless, records[0].axes)
    optimum = maximise_restricted(records, point, moving, prior, given_up)
    for k in range(point.gain.size):
        if other := swapped(optimum.point, k):
            optimum = maximise_restricted(records, other, moving, prior, given_up)
    return optimum


def _starts(
    records: Sequence[Record], point: Point, k: int, structure: Structure, prior: GaussianPrior | None
) -> list[Point]:
    """Start points: near the first-order law, or the best points of a grid for a law with a lag."""
    if structure.limited:
        without = law_starts(records, point, k, STRUCTURES["second_order"], prior)
        return [start for one in without for start in _limited_starts(records, one, k, structure)]
    if structure.order:
        return law_starts(records, point, k, structure, prior)
    return starts(records, point, k, structure)


def _limited_starts(records: Sequence[Record], point: Point, k: int, structure: Structure) -> list[Point]:
    """Points under a limit of the acceleration, from one under the same law without it: that is too slow."""
    largest = max(float(np.abs(rec.command[:, k]).max()) for rec in records)
    laws = (*point.structures[:k], structure, *point.structures[k + 1 :])
    out = []
    for faster, share in LIMITED:
        gain, log_damping = point.gain.copy(), point.log_damping.copy()
        gain[k] *= faster
        log_damping[k] += np.log(faster)
        extra = np.zeros((max(len(point.extra), len(structure.extras)), gain.size))
        extra[: len(point.extra)] = point.extra
        extra[1, k] = np.log(share * abs(gain[k]) * largest)
        out.append(replace(point, gain=gain, log_damping=log_damping, extra=extra, structures=laws))
    return out


def _begun(records: Sequence[Record], point: Point, moving: Sequence[bool], prior: GaussianPrior | None) -> Optimum:
    """The end of a short climb with the levels of the start held."""
    free = free_of(records, moving, point.structures)
    free[point.n :] = False
    return maximise(records, point, free, tolerance=0.3, most=25, prior=prior)


def _together(
    serving: Sequence[Flight],
    group: Sequence[str],
    estimates: Mapping[str, Estimate],
    wanted: Mapping[str, Structure],
    prior_of: PriorOf = nothing_believed,
    hopeless: Hopeless = never,
) -> dict[str, Estimate]:
    """Estimates of x and y by their joint likelihood: each axis in turn takes its best start, then both climb."""
    first = estimates[group[0]]
    moving = [estimates[axis].excited for axis in group]
    if first.optimum.point.gain.size == 2:
        records, point = first.records, first.optimum.point
    else:
        records = _records(serving, group)
        point = _side_by_side(records, [estimates[axis] for axis in group])
    point, best = replace(point, structures=(FIRST_ORDER_DELAY,) * 2, extra=np.zeros((0, 2))), None
    for k, axis in enumerate(group):
        if wanted[axis] != FIRST_ORDER_DELAY:
            laws = (*point.structures[:k], wanted[axis], *point.structures[k + 1 :])
            prior = prior_of(group, laws)
            found = [_begun(records, start, moving, prior) for start in _starts(records, point, k, wanted[axis], prior)]
            best = max(found, key=lambda one: one.score.objective)
            point = best.point
    if not (best and hopeless(group, best)):
        best = finished(records, point, moving, prior_of(group, point.structures), hopeless)
    return {axis: replace(estimates[axis], records=records, optimum=best, place=k) for k, axis in enumerate(group)}


def _side_by_side(records: Sequence[Record], estimates: Sequence[Estimate]) -> Point:
    """Points of single axes joined into one, with start velocities in the world frame of the joint record."""
    points = [estimate.optimum.point for estimate in estimates]
    start = np.hstack([point.start for point in points])
    for rec, at in zip(records, segments(records), strict=True):
        start[at] = world_from_heading(start[at], np.full(len(start[at]), rec.heading))
    return Point(
        gain=np.concatenate([point.gain for point in points]),
        log_damping=np.concatenate([point.log_damping for point in points]),
        delay=np.concatenate([point.delay for point in points]),
        trim=np.hstack([point.trim for point in points]),
        start=start,
        levels=np.concatenate([point.levels for point in points]),
        measured=points[0].measured,
    )


def starts(records: Sequence[Record], point: Point, k: int, structure: Structure) -> list[Point]:
    """Start points of a structure on axis k, from a point with the first-order law on that axis."""
    delay = float(point.delay[k])
    out = []
    for gain_by, damping_by, tau, values in _start_values(records, k, structure, delay):
        gain, log_damping, delays = point.gain.copy(), point.log_damping.copy(), point.delay.copy()
        gain[k] *= gain_by
        log_damping[k] += np.log(damping_by)
        delays[k] = min(max(tau, DELAY_RANGE[0]), DELAY_RANGE[1])
        others = point.structures or (FIRST_ORDER_DELAY,) * point.gain.size
        extra = np.zeros((max(len(point.extra), len(structure.extras)), point.gain.size))
        extra[: len(point.extra)] = point.extra if point.extra.size else 0.0
        for e, (one, value) in enumerate(zip(structure.extras, values, strict=True)):
            extra[e, k] = one.coordinate(min(max(value, one.low), one.high))
        out.append(
            replace(
                point,
                gain=gain,
                log_damping=log_damping,
                delay=delays,
                extra=extra,
                structures=(*others[:k], structure, *others[k + 1 :]),
            )
        )
    return out


def _start_values(records: Sequence[Record], k: int, structure: Structure, delay: float) -> list[Start]:
    """Starts of a structure near the optimum of the first-order law; `delay` is that of the optimum [s]."""
    largest = max(float(np.abs(rec.command[:, k]).max()) for rec in records)
    match structure.name:
        case "first_order":
            return [(1.0, 1.0, 0.0, ()), (0.7, 0.4, 0.0, ())]
        case "quadratic_drag":
            speed = reference_speed(records, k)
            return [(1.0, 1.0, delay, (share, speed)) for share in (0.1, 0.7)]
        case "saturation":
            return [(1.1, 1.0, delay, (0.8 * largest,)), (1.5, 1.0, delay, (0.5 * largest,))]
        case "dead_zone":
            return [(1.0, 1.0, delay, (0.02 * largest,)), (1.2, 1.0, delay, (0.2 * largest,))]
        case _:  # further parameters start at 0, where they have no effect
            return [(1.0, 1.0, delay, (0.0,) * len(structure.extras))]


def reference_speed(records: Sequence[Record], k: int) -> float:
    """Root mean square speed along axis k [m/s or rad/s], from velocities or from differences over a fifth of a second.

    At least 1e-3.
    """
    squares, count = 0.0, 0
    for rec in records:
        ahead = np.arange(SPEED_BLOCKS, rec.count.size)
        whole = rec.segment[ahead] == rec.segment[ahead - SPEED_BLOCKS]
        i = ahead[whole]
        if rec.rate is not None:
            speeds = rec.position[rec.rate]
            if rec.position.shape[1] == 2:
                speeds = heading_from_world(speeds, rec.block_yaw[rec.rate])
            own = speeds[:, min(k, speeds.shape[1] - 1)]
            squares, count = squares + float(own @ own), count + own.size
            continue
        step: Array = rec.position[i] - rec.position[i - SPEED_BLOCKS]
        if rec.position.shape[1] == 2:
            step = heading_from_world(step, rec.block_yaw[i])
        speed = step[:, min(k, step.shape[1] - 1)] / (rec.block_time[i] - rec.block_time[i - SPEED_BLOCKS])
        squares, count = squares + float(speed @ speed), count + speed.size
    return max(float(np.sqrt(squares / max(count, 1))), 1e-3)
