"""The equation of motion under a low-pass, stacked over flights, for solution at any delay."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from rotorfit.core.flight_data import Flight
from rotorfit.core.frames import Array, Mask
from rotorfit.estimation.identifiability import LEAST_TIME
from rotorfit.estimation.likelihood.blocks import Record
from rotorfit.estimation.regression.equation import (
    EquationLayout,
    GridSegment,
    LowPass,
    delay_columns,
    input_columns,
    layout_of,
    motion_columns,
    row_times,
    stretches,
    target_rows,
)
from rotorfit.estimation.regression.result import MethodResult
from rotorfit.estimation.regression.sandwich import SINGULAR, Sandwich, sandwich
from rotorfit.estimation.regression.simulation_error import Coefficients, windowed


@dataclass(frozen=True)
class Problem:
    """An equation that can be solved at any delay: stretches of several flights under one low-pass, for C axes.

    Attributes:
        axes: Names of the C axes.
        parts: The stretches.
        low_pass: The operator on every term.
        layout: The parameters.
        motion: Columns of b and of the nuisance parameters, shape (N, C, P - 2 A) for each stretch.
        target: The left-hand side, shape (N, C) for each stretch.
        basis: Orthonormal basis Q of the m non-zero columns of `motion`, stretches stacked, shape (rows, m).
        triangle: Their triangular factor R, shape (m, m).
        used: Which columns of `motion` are non-zero, shape (P - 2 A,).
        records: The windows of each flight in which positions are compared; None where it has none.
    """

    axes: tuple[str, ...]
    parts: tuple[GridSegment, ...]
    low_pass: LowPass
    layout: EquationLayout
    motion: tuple[Array, ...]
    target: tuple[Array, ...]
    basis: Array
    triangle: Array
    used: Mask
    records: tuple[Record | None, ...]


@dataclass(frozen=True)
class Solution:
    """An equation solved at given delays of the A active axes; parameters in the order of its columns.

    Attributes:
        gain: g, shape (A,).
        delay: tau, shape (A,) [s].
        rest: b of the active axes, then trims, idle dampings and initial velocities, shape (P - 2 A,).
    """

    gain: Array
    delay: Array
    rest: Array


def problem_of(flights: Sequence[Flight], axes: tuple[str, ...], low_pass: LowPass) -> Problem:
    """Stacks the flights under a low-pass; stretches that are too short for it are left out."""
    parts = tuple(part for part in stretches(flights, axes) if part.size > low_pass.skip)
    records = tuple(windowed(flight, axes) for flight in flights)
    if not parts:
        none = np.zeros((0, 0))
        return Problem(
            axes, (), low_pass, EquationLayout((), (), (), ()), (), (), none, none, np.zeros(0, bool), records
        )
    layout = layout_of(parts, low_pass)
    motion = tuple(motion_columns(part, place, low_pass, layout) for place, part in enumerate(parts))
    target = tuple(target_rows(part, low_pass) for part in parts)
    stacked = np.concatenate([m.reshape(-1, m.shape[-1]) for m in motion])
    used = np.abs(stacked).max(axis=0) > 0  # an idle damping has a zero column where the flight does not move
    basis, triangle = np.linalg.qr(stacked[:, used])
    return Problem(axes, parts, low_pass, layout, motion, target, basis, triangle, used, records)


def unfit(problem: Problem) -> dict[str, tuple[str, str]]:
    """Status and reason of every axis where the problem cannot be solved for any; else empty."""
    used = sum(float(np.ptp(row_times(part, problem.low_pass))) for part in problem.parts)
    if used < LEAST_TIME:
        reason = f"{used:.1f} s of poses under known commands can be filtered, {LEAST_TIME:g} s are needed"
        return dict.fromkeys(problem.axes, ("too_short", reason))
    if not problem.layout.active:
        return dict.fromkeys(problem.axes, ("not_excited", "the command is zero in all usable data"))
    return {}


def all_columns(problem: Problem, at: Solution) -> list[Array]:
    """Regressors of all parameters (g, tau, b, the rest) at a solution, shape (N, C, P) for each stretch."""
    low_pass, layout = problem.low_pass, problem.layout
    return [
        np.concatenate(
            [
                input_columns(part, low_pass, layout, at.delay),
                delay_columns(part, low_pass, layout, at.gain, at.delay),
                motion,
            ],
            axis=-1,
        )
        for part, motion in zip(problem.parts, problem.motion, strict=True)
    ]


def solve_at(problem: Problem, delay: Array) -> Solution | None:
    """Least squares at given delays of the active axes, shape (A,) [s]; None where columns are dependent."""
    A, Q = len(problem.layout.active), problem.basis
    columns = [input_columns(part, problem.low_pass, problem.layout, delay) for part in problem.parts]
    command, target = (
        np.concatenate([x.reshape(-1, A) for x in columns]),
        np.concatenate([y.ravel() for y in problem.target]),
    )
    length = np.sqrt(np.sum(command**2, axis=0))
    scale = np.abs(np.diag(problem.triangle))
    if not (length > 0).all() or not problem.used[:A].all() or not (scale > SINGULAR * scale.max()).all():
        return None
    own, triangle = np.linalg.qr(command / length - Q @ (Q.T @ (command / length)))
    if np.abs(np.diag(triangle)).min() < SINGULAR:
        return None
    gain = np.linalg.solve(triangle, own.T @ target) / length
    rest = np.zeros(problem.used.size)
    rest[problem.used] = np.linalg.solve(problem.triangle, Q.T @ (target - command @ gain))
    return Solution(gain, delay, rest)


def coefficients(problem: Problem, at: Solution, flight: int) -> Coefficients:
    """The coefficients of one flight at a solution; an axis that no flight commands has only its idle damping."""
    K, A, layout = len(problem.axes), len(problem.layout.active), problem.layout
    point = Coefficients(*(np.zeros(K) for _ in range(4)))
    active = list(layout.active)
    point.gain[active], point.damping[active], point.delay[active] = at.gain, at.rest[:A], at.delay
    own = list(zip(layout.trims, at.rest[A:], strict=False))
    given = list(zip(layout.idle, at.rest[A + len(layout.trims) :], strict=False))
    for pairs, values in ((own, point.trim), (given, point.damping)):
        for (number, k), value in pairs:
            if number == flight:
                values[k] = value
    return point


def bounded_covariance(
    problem: Problem, at: Solution, instruments: Sequence[Array], columns: Sequence[Array], free: Mask | None = None
) -> Sandwich | None:
    """Sandwich covariance of the root of sum Z'(target - model) = 0, over the parameters of the columns.

    Args:
        problem: The problem that was solved.
        at: The solution.
        instruments: Z, shape (N, C, P) for each stretch; for least squares the columns themselves.
        columns: Regressors, shape (N, C, P) for each stretch, in the order g, (tau,) b and the rest.
        free: Which of the P parameters were estimated; by default all with a non-zero column.

    Returns:
        The covariance, zero for parameters that were not estimated; None where columns are dependent.
    """
    A, low_pass = len(at.gain), problem.low_pass
    shifts = columns[0].shape[-1] - A - at.rest.size  # A where the delays are parameters of the equation, else 0
    theta = np.concatenate([at.gain, np.zeros(shifts), at.rest])
    residuals = [y - x @ theta for x, y in zip(columns, problem.target, strict=True)]
    scores = [np.einsum("ncp,nc->np", z, e) for z, e in zip(instruments, residuals, strict=True)]
    slope = np.sum([np.einsum("ncp,ncq->pq", z, x) for z, x in zip(instruments, columns, strict=True)], axis=0)
    used = np.concatenate([np.ones(A + shifts, bool), problem.used]) if free is None else free
    times = [row_times(part, low_pass) for part in problem.parts]
    found = sandwich(times, [g[:, used] for g in scores], slope[np.ix_(used, used)], low_pass.memory)
    if found is None:
        return None
    covariance = np.zeros(slope.shape)
    covariance[np.ix_(used, used)] = found.covariance
    return replace(found, covariance=covariance)


def rung_of(
    method: str, problem: Problem, at: Solution, covariance: Array, quantile: float, flights: int
) -> MethodResult:
    """A solution as the result of a rung.

    Args:
        method: Name of the rung.
        problem: The problem that was solved.
        at: The solution.
        covariance: Covariance of g, tau, b of the A active axes, shape (3 A, 3 A).
        quantile: Half width of a 95 % interval in standard errors.
        flights: Number of flights.
    """
    A, K, active = len(at.gain), len(problem.axes), list(problem.layout.active)
    values = np.full((3, K), np.nan)
    values[:, active] = at.gain, at.rest[:A], at.delay
    places = np.concatenate([active, 2 * K + np.array(active), K + np.array(active)])
    whole = np.full((3 * K, 3 * K), np.nan)
    whole[np.ix_(places, places)] = covariance
    idle = ("not_excited", "the command is zero in all usable data")
    return MethodResult(
        method=method,
        axes=problem.axes,
        gain=values[0],
        damping=values[1],
        delay=values[2],
        trim=np.stack([coefficients(problem, at, n).trim for n in range(flights)]),
        covariance=whole,
        quantile=quantile,
        failed={axis: idle for k, axis in enumerate(problem.axes) if k not in active},
    )
