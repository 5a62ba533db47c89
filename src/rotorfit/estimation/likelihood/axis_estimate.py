"""One axis, or x and y of a vehicle that turns: search, check that the commands explain anything, climb to the top."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from rotorfit.core.flight_data import Flight
from rotorfit.core.frames import Array, Mask, heading_from_world, world_from_heading
from rotorfit.core.laws import FIRST_ORDER_DELAY, Structure, start_levels
from rotorfit.diagnosis.position_loop import restored
from rotorfit.estimation.likelihood.blocks import Record, measured_by, record
from rotorfit.estimation.likelihood.feedback import LoopEvidence, loop_evidence
from rotorfit.estimation.likelihood.fisher_scoring import Optimum, climb, maximise
from rotorfit.estimation.likelihood.likelihood import response, segments
from rotorfit.estimation.likelihood.optima import (
    CandidateOptimum,
    excerpt,
    is_inverse_loop,
    prediction_error,
    search,
    start_point,
    without_input,
)
from rotorfit.estimation.likelihood.parameters import Point
from rotorfit.estimation.likelihood.prior import GaussianPrior

EXPLAINS = 0.9
"""In a feedback loop the commands must bring the 1 s prediction error on the training flights below this share of what
it is without them; else the axis was not excited, whatever the likelihood says."""

HELPS = 0.99
"""The same in an open loop, where the likelihood can be believed."""

PLAINLY = 0.5
"""Share of the error of holding the velocity below which they plainly do, and the comparison is not needed."""

COUPLING_ROUNDS = 2
"""Rounds in which x and y under a held heading take each other into account."""


@dataclass(frozen=True)
class Estimate:
    """One axis after the climb.

    Attributes:
        records: What its likelihood sees.
        optimum: The maximum that is believed.
        place: Which of the optimum's axes this is.
        found: Optima of the search, the believed one first; none for an axis that no flight moves.
        excited: Whether its commands explain anything.
    """

    records: Sequence[Record]
    optimum: Optimum
    place: int
    found: tuple[CandidateOptimum, ...]
    excited: bool

    @cached_property
    def loop(self) -> LoopEvidence:
        """Whether the command of the axis answers its motion."""
        return answer(self.records, self.optimum, self.place)


def estimate_axis(serving: Sequence[Flight], axis: str, moves: bool, prior: GaussianPrior | None = None) -> Estimate:
    """One axis by itself. A prior enters once the search has found the optimum that is believed."""
    records = [rec for f in serving if (rec := record(f, (axis,)))]
    if not moves:
        point = start_point(records, 0.0, 1.0, start_levels(measured_by(records))[None])
        return Estimate(
            records, maximise(records, replace(point, gain=np.zeros(1)), free_of(records, [False])), 0, (), False
        )
    parts = [excerpt(f, (axis,)) for f in serving]
    short = [rec for f in parts if (rec := record(f, (axis,)))]
    found = search(short, parts, free_of(short, [True]))
    start = _moved_to(records, found[0].optimum.point)
    if not _explains(parts, (axis,), short, found[0], 0):
        idle = replace(start, gain=np.zeros(1), log_damping=np.zeros(1), delay=np.zeros(1))
        return Estimate(records, climb(records, idle, free_of(records, [False])), 0, found, False)
    return Estimate(records, maximise_restricted(records, start, [True], prior), 0, found, True)


def maximise_restricted(
    records: Sequence[Record], start: Point, moving: Sequence[bool], prior: GaussianPrior | None = None
) -> Optimum:
    """The top, with itself as the reference of the restricted likelihood."""
    first = climb(records, start, free_of(records, moving, start.structures), prior=prior)
    return maximise(records, first.point, first.free, first.inverse, prior=prior)


def _moved_to(records: Sequence[Record], point: Point) -> Point:
    """A point found on excerpts, for the whole flights: their segments start at other velocities."""
    whole = start_point(records, 0.0, 1.0, point.levels)
    return replace(whole, gain=point.gain, log_damping=point.log_damping, delay=point.delay)


def couple_axes(records: Sequence[Record], estimates: Sequence[Estimate]) -> list[Estimate]:
    """Takes into account, exactly, what each axis does to the other through the small turns of a held heading.

    The response of both together less that of one alone is taken off its data, and it is climbed again. At the fixed
    point the residual is that of the joint response; only its sensitivities leave the turns out.
    """
    out = list(estimates)
    for _ in range(COUPLING_ROUNDS):
        out = [replace(one, records=each.records) for one, each in zip(out, estimates, strict=True)]
        out = [
            replace(one, optimum=maximise(one.records, top.point, top.free, top.inverse, prior=top.prior))
            for one in coupled_records(records, out)
            for top in (one.optimum,)
        ]
    return out


def coupled_records(records: Sequence[Record], estimates: Sequence[Estimate]) -> list[Estimate]:
    """The estimates with what each axis does to the other, at their points, taken off their data.

    Args:
        records: Of both axes.
        estimates: Of each alone, on data from which nothing was taken.
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
    """Points of single axes as one of all."""
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
    """Joint response less the two responses alone, along and across the mean heading, shape (B, 2)."""
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
    """x and y of vehicles that turn, by one likelihood."""
    parts = [excerpt(f, group) for f in serving]
    short = [rec for f in parts if (rec := record(f, group))]
    found = search(short, parts, free_of(short, moving))
    excited = [moves and _explains(parts, group, short, found[0], k) for k, moves in enumerate(moving)]
    start = _moved_to(records, found[0].optimum.point)
    idle = np.array([not good for good in excited])
    start = replace(
        start,
        gain=np.where(idle, 0.0, start.gain),
        log_damping=np.where(idle, 0.0, start.log_damping),
        delay=np.where(idle, 0.0, start.delay),
    )
    optimum = maximise_restricted(records, start, excited, prior)
    return [Estimate(records, optimum, k, found if moving[k] else (), excited[k]) for k in range(len(group))]


def answer(records: Sequence[Record], optimum: Optimum, k: int) -> LoopEvidence:
    """How far changes of the command of an axis follow the innovations of its likelihood."""
    parts = []
    for rec, innovation in zip(records, optimum.score.innovations, strict=True):
        place = np.searchsorted(rec.command_time, rec.block_time, side="right") - 1
        parts.append((rec.command[place, k], innovation[:, k]))
    return loop_evidence(parts)


def _explains(
    serving: Sequence[Flight], group: Sequence[str], records: Sequence[Record], found: CandidateOptimum, k: int
) -> bool:
    """Whether the commands of an axis explain its motion.

    In an open loop the interval of the gain decides, and prediction must only not deny it. In a feedback loop the
    likelihood can be sure of what is not so, and the commands must show their worth in prediction. Commands that are a
    controller's answer and nothing else excite nothing, even where stamps of clocks that disagree put them before the
    motion that they answer. Flights too short to predict get the benefit of the doubt.
    """
    error = found.prediction[k]
    if is_inverse_loop(found.optimum, k) or restored(serving, group[k]):
        return False
    if not np.isfinite(error) or error < PLAINLY * found.held[k]:
        return True
    idle, _ = prediction_error(serving, group, without_input(records, found.optimum, [k]))
    limit = EXPLAINS if answer(records, found.optimum, k).closed else HELPS
    return bool(error < limit * idle[k])


def free_of(records: Sequence[Record], moving: Sequence[bool], structures: Sequence[Structure] = ()) -> Mask:
    """Which parameters may move: the coefficients of the moving axes, all trims, start velocities and levels."""
    K, flights, parts = len(moving), len(records), sum(rec.starts.size for rec in records)
    coefficients = np.tile(moving, (3, 1))
    extra = np.zeros((max((len(structure.extras) for structure in structures), default=0), K), bool)
    for k, structure in enumerate(structures):
        coefficients[2, k] &= structure.delayed
        for e, one in enumerate(structure.extras):
            extra[e, k] = moving[k] and one.estimated
    others = np.ones((flights + parts + start_levels(measured_by(records)).size) * K, bool)
    return np.concatenate([coefficients.ravel(), extra.ravel(), others])
