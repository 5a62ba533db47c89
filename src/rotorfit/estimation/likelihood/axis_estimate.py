"""Maximum-likelihood estimate of one axis, or of x and y of a vehicle that turns: search, test of excitation, climb."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from rotorfit.core.flight_data import Flight
from rotorfit.core.frames import Array, Mask, heading_from_world, world_from_heading
from rotorfit.core.laws import FIRST_ORDER_DELAY, Structure, start_levels
from rotorfit.estimation.likelihood.block_response import response
from rotorfit.estimation.likelihood.blocks import Record, measured_by, record
from rotorfit.estimation.likelihood.feedback import LoopEvidence, loop_evidence
from rotorfit.estimation.likelihood.fisher_scoring import Optimum, climb, maximise
from rotorfit.estimation.likelihood.likelihood import segments
from rotorfit.estimation.likelihood.optima import (
    CandidateOptimum,
    are_same,
    excerpt,
    is_inverse_loop,
    prediction_error,
    search,
    start_point,
    without_gain,
    without_input,
)
from rotorfit.estimation.likelihood.parameters import Point
from rotorfit.estimation.likelihood.prior import GaussianPrior

EXPLAINS = 0.82
"""In what may be a feedback loop the commands must reduce the 1 s prediction error on the training flights below this
share of the error without them; else the axis counts as not excited, whatever the likelihood. On flights of a minute in
a simulated room, and on recorded ones, it is at most 0.76 for excited axes and at least 0.88 for axes that are only
held; in 15 s one excited axis came to 0.88, and held ones to 0.92 at least."""

SHORT, EXPLAINS_SHORT = 15.0, 0.6
"""Duration below which the share must be smaller [s], and that share: in 9 s of flight one held axis came to 0.45, all
others to 0.62 at least, and two excited ones to 0.8."""

HELPS = 0.99
"""The same in an open loop, where the likelihood can be trusted."""

PLAINLY = 0.5
"""Prediction error relative to that of constant velocity below which the axis counts as excited without comparison."""

FINAL = 1e-4
"""Expected gain in log-likelihood at which the climb to a published maximum stops: 1.4 % of a standard error."""

COUPLING_ROUNDS = 2
"""Number of iterations that account for the coupling of x and y under a held heading."""


@dataclass(frozen=True)
class Estimate:
    """Maximum-likelihood estimate of one axis.

    Attributes:
        records: Input of its likelihood.
        optimum: The selected maximum.
        place: Index of the axis in the optimum.
        found: Optima of the search, the selected one first; empty for an axis that no flight commands.
        excited: Whether its commands explain any of the motion.
    """

    records: Sequence[Record]
    optimum: Optimum
    place: int
    found: tuple[CandidateOptimum, ...]
    excited: bool

    @cached_property
    def loop(self) -> LoopEvidence:
        """Evidence that the command of the axis responds to its motion."""
        return answer(self.records, self.optimum, self.place)


def estimate_axis(serving: Sequence[Flight], axis: str, moves: bool, prior: GaussianPrior | None = None) -> Estimate:
    """Estimates one axis by itself.

    Args:
        serving: Flights that command the axis.
        axis: Name of the axis.
        moves: Whether its coefficients are estimated; if not, the gain is 0.
        prior: Prior on the coefficients; it is used only in the climb after the search has selected an optimum.
    """
    records = [rec for f in serving if (rec := record(f, (axis,)))]
    if not moves:
        point = start_point(records, 0.0, 1.0, start_levels(measured_by(records))[None])
        return Estimate(records, _idle(records, point), 0, (), False)
    parts, short = _excerpts(serving, records, (axis,))
    found = search(short, parts, free_of(short, [True]))
    start = _moved_to(records, found[0].optimum.point)
    if _explains(parts, (axis,), short, found[0], 0):
        optimum = maximise_restricted(records, start, [True], prior)
        if _excited(serving, (axis,), records, optimum, start)[0]:
            return Estimate(records, optimum, 0, found, True)
    return Estimate(records, _idle(records, start), 0, found, False)


def _excerpts(
    serving: Sequence[Flight], records: Sequence[Record], axes: Sequence[str]
) -> tuple[Sequence[Flight], Sequence[Record]]:
    """The stretches of long flights in which optima are searched, and their records; the flights if none has one."""
    parts = [excerpt(f, axes) for f in serving]
    short = [rec for f in parts if (rec := record(f, axes))]
    return (parts, short) if short else (serving, records)


def _idle(records: Sequence[Record], point: Point) -> Optimum:
    """The maximum of the likelihood of one axis without its commands."""
    return climb(records, without_gain(point, np.array([True])), free_of(records, [False]))


def maximise_restricted(
    records: Sequence[Record],
    start: Point,
    moving: Sequence[bool],
    prior: GaussianPrior | None = None,
    hopeless: Callable[[Optimum], bool] = lambda _first: False,
) -> Optimum:
    """The maximum of the restricted likelihood, with the maximum of a first climb as its reference.

    Args:
        records: The flights.
        start: Where to start.
        moving: Whether the coefficients of each axis are estimated.
        prior: Added to the objective.
        hopeless: Whether the maximum of the first climb will do, since its law will be left out.
    """
    first = climb(records, start, free_of(records, moving, start.structures), prior=prior)
    if hopeless(first):
        return first
    return maximise(records, first.point, first.free, first.inverse, tolerance=FINAL, prior=prior)


def _moved_to(records: Sequence[Record], point: Point) -> Point:
    """Coefficients and levels of a point found on excerpts, with zero trims and the start velocities of the records."""
    whole = start_point(records, 0.0, 1.0, point.levels)
    return replace(whole, gain=point.gain, log_damping=point.log_damping, delay=point.delay)


def couple_axes(records: Sequence[Record], estimates: Sequence[Estimate]) -> list[Estimate]:
    """Accounts for the coupling of x and y through the small turns of a held heading.

    The joint response less that of each axis alone is subtracted from the data of that axis, which is then maximised
    again. At the fixed point the residual is exactly that of the joint response; only the sensitivities neglect the
    turns.

    Args:
        records: Records of both axes together.
        estimates: Of each axis alone, in the order of the records' axes.
    """
    out = list(estimates)
    for _ in range(COUPLING_ROUNDS):
        out = [replace(one, records=each.records) for one, each in zip(out, estimates, strict=True)]
        out = [
            replace(
                one, optimum=maximise(one.records, top.point, top.free, top.inverse, tolerance=FINAL, prior=top.prior)
            )
            for one in coupled_records(records, out)
            for top in (one.optimum,)
        ]
    return out


def coupled_records(records: Sequence[Record], estimates: Sequence[Estimate]) -> list[Estimate]:
    """The estimates with the coupling of the axes, at their points, subtracted from their data.

    Args:
        records: Records of both axes together.
        estimates: Of each axis alone, on data from which nothing was subtracted.
    """
    points = [estimate.optimum.point for estimate in estimates]
    joint, rows = _joined(points), segments(records)
    offsets = [_offset(rec, joint, points, j, rows[j]) for j, rec in enumerate(records)]
    return [
        replace(
            estimate,
            records=[
                replace(rec, position=rec.position - offset[:, k : k + 1])
                for rec, offset in zip(estimate.records, offsets, strict=True)
            ],
        )
        for k, estimate in enumerate(estimates)
    ]


_JOINT_AXES = (("gain", 0), ("log_damping", 0), ("delay", 0), ("trim", 1), ("start", 1), ("levels", 0))


def _joined(points: Sequence[Point]) -> Point:
    """Points of single axes joined into one, start velocities in their heading frames."""
    parts: dict[str, Any] = {n: np.concatenate([getattr(p, n) for p in points], axis) for n, axis in _JOINT_AXES}
    joint = Point(**parts, measured=points[0].measured)
    if not any(point.structures for point in points):
        return joint
    extra = np.zeros((max(len(point.extra) for point in points), len(points)))
    for k, point in enumerate(points):
        extra[: len(point.extra), k] = point.extra[:, 0]
    structures = tuple(point.structures[0] if point.structures else FIRST_ORDER_DELAY for point in points)
    return replace(joint, structures=structures, extra=extra)


def _offset(rec: Record, joint: Point, points: Sequence[Point], flight: int, at: slice) -> Array:
    """Joint response less the response of each axis alone, along and across the mean heading, shape (B, 2)."""
    turn = np.full(len(joint.start), rec.heading)
    mean = response(rec, joint, flight, world_from_heading(joint.start, turn)[at])[0]
    along = heading_from_world(mean, np.full(len(mean), rec.heading))
    estimate_axis = [response(rec.only(k), point, flight, point.start[at])[0] for k, point in enumerate(points)]
    return along - np.hstack(estimate_axis)


def estimate_plane(
    serving: Sequence[Flight],
    records: Sequence[Record],
    group: Sequence[str],
    moving: Sequence[bool],
    prior: GaussianPrior | None = None,
) -> list[Estimate]:
    """Estimates x and y of a vehicle that turns, by their joint likelihood.

    Args:
        serving: Flights that command one of the axes.
        records: Their records.
        group: Names of the axes.
        moving: Whether the coefficients of each axis are estimated.
        prior: As for `estimate_axis`.
    """
    parts, short = _excerpts(serving, records, group)
    found = search(short, parts, free_of(short, moving))
    excited = [moves and _explains(parts, group, short, found[0], k) for k, moves in enumerate(moving)]
    start = without_gain(_moved_to(records, found[0].optimum.point), np.logical_not(excited))
    optimum = maximise_restricted(records, start, excited, prior)
    after = np.logical_and(excited, _excited(serving, group, records, optimum, start)).tolist()
    if after != excited:
        excited = after
        optimum = maximise_restricted(records, without_gain(start, np.logical_not(excited)), excited, prior)
    return [Estimate(records, optimum, k, found if moving[k] else (), excited[k]) for k in range(len(group))]


def _excited(
    serving: Sequence[Flight], group: Sequence[str], records: Sequence[Record], optimum: Optimum, start: Point
) -> list[bool]:
    """Whether the commands still explain the motion of each axis at the maximum over the whole flights.

    The climb can leave the optimum that was selected by its predictions for a likelier one that predicts worse.
    """
    same = [are_same(optimum.point, start, k) for k in range(len(group))]
    if all(same):
        return same
    there = CandidateOptimum(optimum, 1, *prediction_error(serving, group, optimum))
    return [same[k] or _explains(serving, group, records, there, k) for k in range(len(group))]


def answer(records: Sequence[Record], optimum: Optimum, k: int) -> LoopEvidence:
    """Evidence that changes of the command of axis k follow the innovations of its likelihood."""
    parts = []
    for rec, innovation in zip(records, optimum.score.innovations, strict=True):
        place = np.searchsorted(rec.command_time, rec.block_time, side="right") - 1
        parts.append((rec.command[place, k], innovation[:, k]))
    return loop_evidence(parts)


def _explains(
    serving: Sequence[Flight], group: Sequence[str], records: Sequence[Record], found: CandidateOptimum, k: int
) -> bool:
    """Whether the commands of an axis explain its motion.

    In an open loop the interval of the gain decides later, and predictions must only not contradict it. In a feedback
    loop, if only a suspected one, the likelihood can be confidently wrong, so the commands must improve predictions.
    Flights that are too short for predictions count as excited.
    """
    error = found.prediction[k]
    if is_inverse_loop(found.optimum, k):
        return False
    if not np.isfinite(error) or error < PLAINLY * found.held[k]:
        return True
    idle, _ = prediction_error(serving, group, without_input(records, found.optimum, [k]))
    if not answer(records, found.optimum, k).suspected:
        return bool(error < HELPS * idle[k])
    return bool(error < _explains_below(serving) * idle[k])


def _explains_below(serving: Sequence[Flight]) -> float:
    """Share of the error without commands below which the commands explain the motion, in a feedback loop, too."""
    return EXPLAINS_SHORT if sum(flight.duration for flight in serving) < SHORT else EXPLAINS


def explains_plainly(serving: Sequence[Flight], estimate: Estimate) -> bool:
    """Whether the commands improve predictions by as much as is required of them in a feedback loop, in whatever loop.

    Args:
        serving: Flights of the estimate.
        estimate: The estimate of an axis that counts as excited.
    """
    axes, k = estimate.records[0].axes, estimate.place
    idle = without_input(estimate.records, estimate.optimum, [k])
    (error, _), (alone, _) = (prediction_error(serving, axes, one) for one in (estimate.optimum, idle))
    return bool(error[k] < _explains_below(serving) * alone[k])


def free_of(records: Sequence[Record], moving: Sequence[bool], structures: Sequence[Structure] = ()) -> Mask:
    """Which parameters are free, in the order of `Point.flat`, shape (n + L K,).

    These are the coefficients of the moving axes, and all trims, start velocities and levels.

    Args:
        records: The flights.
        moving: Whether the coefficients of each axis are estimated.
        structures: Structure of each axis; empty for the first-order law with a delay.
    """
    K, flights, parts = len(moving), len(records), sum(rec.starts.size for rec in records)
    coefficients = np.tile(moving, (3, 1))
    extra = np.zeros((max((len(structure.extras) for structure in structures), default=0), K), bool)
    for k, structure in enumerate(structures):
        coefficients[2, k] &= structure.delayed
        for e, one in enumerate(structure.extras):
            extra[e, k] = moving[k] and one.estimated
    others = np.ones((flights + parts + start_levels(measured_by(records)).size) * K, bool)
    return np.concatenate([coefficients.ravel(), extra.ravel(), others])
