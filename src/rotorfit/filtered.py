"""The rungs `svf` and `weak`: least squares on filtered regressors, with the delay that simulates best.

The paper differentiates the pose and takes the command as it is. Here commands and motion pass through the same filter:
a state-variable filter (`svf`), or means over windows under a smooth test function, which is the integral or weak form
of the equation (`weak`). Unequal smoothing then biases nothing, and the delay is searched for. What is left is what
least squares cannot help: the velocity on the right-hand side is noisy, and wind and feedback are correlated with it.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from rotorfit.equation import (
    Layout,
    LowPass,
    delay_columns,
    input_columns,
    layout_of,
    motion_columns,
    row_times,
    state_variable_filter,
    target_rows,
    test_function,
)
from rotorfit.flight import Flight
from rotorfit.frames import Array, Mask
from rotorfit.freerun import Coefficients, simulation_error, windowed
from rotorfit.record import DELAY_RANGE, Record
from rotorfit.rung import LEAST_TIME, RungFit, without_numbers
from rotorfit.sandwich import SINGULAR, sandwich
from rotorfit.stretch import Stretch, stretches

CUT_OFF = 4.0
"""Poles of the state-variable filter, of third order [1/s]."""

WIDTH = 1.5
"""Width of the window of the weak form [s]."""

POWER = 4
"""Power of its test function: three smooth derivatives."""

COARSE = 0.035
"""Spacing of the delays of the first search [s]; a golden section ends it."""

DELAYS = np.arange(DELAY_RANGE[0], DELAY_RANGE[1] + 1e-9, COARSE)
"""Those delays [s]."""

VALLEYS = 3
"""Local minima of the first search that are followed: over a short delay a narrow one can hide between two of them."""


@dataclass(frozen=True)
class Problem:
    """One equation to be solved at any delay: stretches of several flights under one low-pass, for C axes.

    Attributes:
        axes: Names of the C axes.
        parts: The stretches.
        low_pass: The operator on every term.
        layout: The parameters.
        motion: Per stretch, columns of b and of what is accounted for.
        target: Per stretch, the left-hand side.
        basis: Orthonormal basis of the columns of `motion` that are not zero, all rows, shape (rows, m).
        triangle: What they are in that basis, shape (m, m).
        used: Which columns those are.
        records: Per flight the windows in which positions are compared; None where it has none.
    """

    axes: tuple[str, ...]
    parts: tuple[Stretch, ...]
    low_pass: LowPass
    layout: Layout
    motion: tuple[Array, ...]
    target: tuple[Array, ...]
    basis: Array
    triangle: Array
    used: Mask
    records: tuple[Record | None, ...]


@dataclass(frozen=True)
class Solution:
    """An equation solved at a delay: g, tau, b of the A active axes and the rest, in the order of its columns.

    Attributes:
        gain: Shape (A,).
        delay: Shape (A,) [s].
        rest: b of the active axes, then trims, idle dampings and first velocities.
    """

    gain: Array
    delay: Array
    rest: Array


def svf(flights: Sequence[Flight], axes: tuple[str, ...]) -> RungFit:
    """Least squares on commands and motion through the same state-variable filter, with delay and trim.

    Args:
        flights: One or more flights of one vehicle and setting.
        axes: `("z",)`, `("yaw",)` or `("x", "y")`.

    Source: P. C. Young, Automatica 17 (1981), pp. 23-39; H. Garnier, L. Wang (eds.), Identification of Continuous-time
    Models from Sampled Data, Springer 2008, ch. 1. Products with the turning heading are filtered as products.
    """
    return _least_squares("svf", flights, axes, state_variable_filter((CUT_OFF,) * 3))


def weak(flights: Sequence[Flight], axes: tuple[str, ...]) -> RungFit:
    """Least squares on the integral form: means under test functions on overlapping windows, with delay and trim.

    Args:
        flights: One or more flights of one vehicle and setting.
        axes: `("z",)`, `("yaw",)` or `("x", "y")`.

    Source: M. Shinbrot, Trans. ASME 79 (1957), pp. 547-552 (modulating functions); D. A. Messenger, D. M. Bortz,
    J. Comput. Phys. 443 (2021), 110525 (the test functions and their name).
    """
    return _least_squares("weak", flights, axes, test_function(WIDTH, POWER))


def _least_squares(method: str, flights: Sequence[Flight], axes: tuple[str, ...], low_pass: LowPass) -> RungFit:
    problem = problem_of(flights, axes, low_pass)
    failed = unfit(problem)
    if failed:
        return without_numbers(method, axes, len(flights), failed)
    solution = best_delay(problem)
    if solution is None:
        reason = ("not_identifiable", "command and velocity are proportional, or nothing that is finite fits")
        return without_numbers(method, axes, len(flights), dict.fromkeys(axes, reason))
    return rung_of(method, problem, solution, all_columns(problem, solution), len(flights))


def problem_of(flights: Sequence[Flight], axes: tuple[str, ...], low_pass: LowPass) -> Problem:
    """Stacks the flights under a low-pass, without the stretches that are too short for it."""
    parts = tuple(part for part in stretches(flights, axes) if part.size > low_pass.skip)
    records = tuple(windowed(flight, axes) for flight in flights)
    nothing = np.zeros((0, 0))
    if not parts:
        return Problem(axes, (), low_pass, Layout((), (), (), ()), (), (), nothing, nothing, nothing[0] > 0, records)
    layout = layout_of(parts, low_pass)
    motion = tuple(motion_columns(part, place, low_pass, layout) for place, part in enumerate(parts))
    target = tuple(target_rows(part, low_pass) for part in parts)
    stacked = np.concatenate([m.reshape(-1, m.shape[-1]) for m in motion])
    used = np.abs(stacked).max(axis=0) > 0  # a flight that never moves along an axis has no damping to account for
    basis, triangle = np.linalg.qr(stacked[:, used])
    return Problem(axes, parts, low_pass, layout, motion, target, basis, triangle, used, records)


def unfit(problem: Problem) -> dict[str, tuple[str, str]]:
    """Status and reason of the axes that cannot be solved for, where all are such; else nothing."""
    used = sum(float(np.ptp(row_times(part, problem.low_pass))) for part in problem.parts)
    if used < LEAST_TIME:
        reason = f"{used:.1f} s of poses under known commands can be filtered, {LEAST_TIME:g} s are needed"
        return dict.fromkeys(problem.axes, ("too_short", reason))
    if not problem.layout.active:
        return dict.fromkeys(problem.axes, ("not_excited", "the command is zero wherever it could be used"))
    return {}


def all_columns(problem: Problem, at: Solution) -> list[Array]:
    """Regressors of all parameters at a solution, per stretch, (N, C, P)."""
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
    """Least squares at given delays of the active axes; None where columns are dependent."""
    A, Q = len(problem.layout.active), problem.basis
    columns = [input_columns(part, problem.low_pass, problem.layout, delay) for part in problem.parts]
    command, target = np.concatenate([x.reshape(-1, A) for x in columns]), np.concatenate([y.ravel() for y in problem.target])
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
    """A solution as a flight's own coefficients; an axis that nobody commands only has the damping it was given."""
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


def output_error_of(problem: Problem, at: Solution | None) -> float:
    """The output-space criterion at a solution: squared position errors of simulations, all flights together."""
    if at is None:
        return float("inf")
    pairs = [(rec, coefficients(problem, at, number)) for number, rec in enumerate(problem.records) if rec]
    return sum(simulation_error(rec, point) for rec, point in pairs)


def best_delay(problem: Problem) -> Solution | None:
    """The solution at the delays, inside the searched range, whose simulated positions are nearest; None if none is.

    All delays are first moved together over a coarse grid; from the best of its valleys each axis then moves on its
    own, and a golden section ends it.
    """
    A = len(problem.layout.active)

    def cost(delay: Array) -> float:
        return output_error_of(problem, solve_at(problem, delay))

    together = [cost(np.full(A, d)) for d in DELAYS]
    ends = []
    for place in _valleys(together):
        delay = np.full(A, DELAYS[place])
        for _ in range(2 if A > 1 else 1):
            for a in range(A):
                delay[a] = _golden(lambda d, a=a, delay=delay: cost(_with(delay, a, d)), delay[a])
        ends.append((cost(delay), tuple(delay)))
    if not ends or not np.isfinite(min(ends)[0]):
        return None
    return solve_at(problem, np.array(min(ends)[1]))


def _valleys(cost: Sequence[float]) -> list[int]:
    """Places of the lowest three local minima, the lowest first."""
    padded = np.array([np.inf, *cost, np.inf])
    lowest = (padded[1:-1] <= padded[:-2]) & (padded[1:-1] <= padded[2:]) & np.isfinite(cost)
    return sorted(np.flatnonzero(lowest).tolist(), key=lambda i: cost[i])[:VALLEYS]


def _with(delay: Array, a: int, value: float) -> Array:
    out = delay.copy()
    out[a] = value
    return out


def _golden(cost: Callable[[float], float], middle: float) -> float:
    """Golden section around a point of the coarse grid, inside the range."""
    low, high = max(DELAY_RANGE[0], middle - COARSE), min(DELAY_RANGE[1], middle + COARSE)
    share = (np.sqrt(5) - 1) / 2
    left, right = high - share * (high - low), low + share * (high - low)
    at_left, at_right = cost(left), cost(right)
    while high - low > 2e-4:
        if at_left <= at_right:
            high, right, at_right = right, left, at_left
            left = high - share * (high - low)
            at_left = cost(left)
        else:
            low, left, at_left = left, right, at_right
            right = low + share * (high - low)
            at_right = cost(right)
    return float((low + high) / 2)


def rung_of(method: str, problem: Problem, at: Solution, instruments: Sequence[Array], flights: int) -> RungFit:
    """A solution with its sandwich covariance; the delay counts as a parameter of the equation.

    Args:
        method: Name of the rung.
        problem: What was solved.
        at: The solution.
        instruments: Per stretch, (N, C, P); for least squares the columns themselves.
        flights: Number of flights.
    """
    A, K, columns = len(problem.layout.active), len(problem.axes), all_columns(problem, at)
    theta = np.concatenate([at.gain, np.zeros(A), at.rest])
    residuals = [y - x @ theta for x, y in zip(columns, problem.target, strict=True)]
    scores = [np.einsum("ncp,nc->np", z, e) for z, e in zip(instruments, residuals, strict=True)]
    slope = np.sum([np.einsum("ncp,ncq->pq", z, x) for z, x in zip(instruments, columns, strict=True)], axis=0)
    used = np.diag(slope) != 0
    times = [row_times(part, problem.low_pass) for part in problem.parts]
    found = sandwich(times, [g[:, used] for g in scores], slope[np.ix_(used, used)], problem.low_pass.memory)
    active = list(problem.layout.active)
    if found is None or not used[: 3 * A].all():
        reason = ("not_identifiable", "the regressors are dependent")
        return without_numbers(method, problem.axes, flights, dict.fromkeys(problem.axes, reason))
    values = np.full((3, K), np.nan)
    values[:, active] = at.gain, at.rest[:A], at.delay
    places = np.concatenate([active, 2 * K + np.array(active), K + np.array(active)])
    covariance = np.full((3 * K, 3 * K), np.nan)
    covariance[np.ix_(places, places)] = found.covariance[: 3 * A, : 3 * A]
    idle = ("not_excited", "the command is zero wherever it could be used")
    return RungFit(
        method, problem.axes, *values, np.stack([coefficients(problem, at, n).trim for n in range(flights)]),
        covariance, found.quantile, {axis: idle for k, axis in enumerate(problem.axes) if k not in active},
    )  # fmt: skip
