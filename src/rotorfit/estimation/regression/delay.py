"""The delay of a regression: the one whose simulated positions are nearest to the measured ones, and its uncertainty.

The delay is not a parameter of the linear equation. It is searched for in output space, inside a bounded range; its
variance follows from the curvature of the criterion and is propagated to gain and damping.
"""

from collections.abc import Callable, Sequence

import numpy as np

from rotorfit.core.frames import Array
from rotorfit.core.laws import DELAY_RANGE
from rotorfit.estimation.regression.problem import Problem, Solution, coefficients, solve_at
from rotorfit.estimation.regression.sandwich import Sandwich, sandwich
from rotorfit.estimation.regression.simulation_error import WINDOW, simulation_errors

COARSE = 0.035
"""Spacing of the delays of the coarse search [s]; a golden-section search refines it."""

DELAYS = np.arange(DELAY_RANGE[0], DELAY_RANGE[1] + 1e-9, COARSE)
"""Delays of the coarse search [s]."""

FINE = 2e-4
"""Bracket width at which the golden-section search ends [s]."""

VALLEYS = 3
"""Number of local minima of the coarse search that are refined: a narrow one can hide between two of its delays."""

STEP = 0.01
"""Step of the finite differences by the delay [s]: held commands make the criterion ragged at a finer scale."""


def _window_errors(problem: Problem, at: Solution | None) -> list[Array] | None:
    """Squared position errors of simulations, shape (W,) for each flight with windows; None without a solution."""
    if at is None:
        return None
    pairs = [(rec, coefficients(problem, at, number)) for number, rec in enumerate(problem.records) if rec]
    return [simulation_errors(rec, point) for rec, point in pairs]


def criterion(problem: Problem, delay: Array) -> float:
    """The output-space criterion at delays of the active axes, shape (A,) [s]: sum of squared position errors [unit^2].

    Infinite where the equation has no solution.
    """
    errors = _window_errors(problem, solve_at(problem, delay))
    return float("inf") if errors is None else float(sum(error.sum() for error in errors))


def best_delay(problem: Problem) -> Solution | None:
    """The solution at the delays, inside `DELAY_RANGE`, that minimise the criterion; None if it is nowhere finite.

    First all axes share a delay on a coarse grid. From the best local minima, the delay of each axis is then refined by
    golden-section search.
    """
    A = len(problem.layout.active)

    def cost(delay: Array) -> float:
        return criterion(problem, delay)

    together = [cost(np.full(A, d)) for d in DELAYS]
    ends = []
    for place in _valleys(together):
        delay = np.full(A, DELAYS[place])
        for _ in range(2 if A > 1 else 1):
            for a in range(A):
                delay[a] = _golden(cost, delay, a)
        ends.append((cost(delay), tuple(delay)))
    if not ends or not np.isfinite(min(ends)[0]):
        return None
    return solve_at(problem, np.array(min(ends)[1]))


def _valleys(cost: Sequence[float]) -> list[int]:
    """Indices of the lowest `VALLEYS` local minima, the lowest first."""
    padded = np.array([np.inf, *cost, np.inf])
    lowest = (padded[1:-1] <= padded[:-2]) & (padded[1:-1] <= padded[2:]) & np.isfinite(cost)
    return sorted(np.flatnonzero(lowest).tolist(), key=lambda i: cost[i])[:VALLEYS]


def _with(delay: Array, a: int, value: float) -> Array:
    out = delay.copy()
    out[a] = value
    return out


def _golden(cost: Callable[[Array], float], delay: Array, a: int) -> float:
    """Golden-section search over the delay of axis a, around its present value, inside `DELAY_RANGE` [s]."""
    low, high = max(DELAY_RANGE[0], delay[a] - COARSE), min(DELAY_RANGE[1], delay[a] + COARSE)
    share = (np.sqrt(5) - 1) / 2
    left, right = high - share * (high - low), low + share * (high - low)
    at_left, at_right = cost(_with(delay, a, left)), cost(_with(delay, a, right))
    while high - low > FINE:
        if at_left <= at_right:
            high, right, at_right = right, left, at_left
            left = high - share * (high - low)
            at_left = cost(_with(delay, a, left))
        else:
            low, left, at_left = left, right, at_right
            right = low + share * (high - low)
            at_right = cost(_with(delay, a, right))
    return float((low + high) / 2)


def delay_spread(problem: Problem, at: Solution) -> tuple[Sandwich, Array] | None:
    """Covariance of the delays of the active axes, and the derivatives of g and b with respect to them.

    Args:
        problem: The problem that was solved.
        at: The solution at the best delays.

    Returns:
        The sandwich from the slopes of the windows' errors, covariance of shape (A, A) [s^2], and d(g, b)/d tau, shape
        (2 A, A); None where the criterion has no minimum at the solution.
    """
    A = len(at.gain)
    steps = STEP * np.eye(A)
    sides = [[solve_at(problem, at.delay + sign * step) for sign in (1, -1)] for step in steps]
    errors = [[_window_errors(problem, side) for side in pair] for pair in sides]
    if any(error is None for pair in errors for error in pair):
        return None
    slopes = [
        np.stack([(up[f] - down[f]) / (2 * STEP) for up, down in errors], axis=-1)  # type: ignore[index]
        for f in range(len(errors[0][0] or ()))
    ]
    curvature = np.empty((A, A))
    for i in range(A):
        for j in range(A):
            corners = [criterion(problem, at.delay + p * steps[i] + q * steps[j]) for p in (1, -1) for q in (1, -1)]
            curvature[i, j] = (corners[0] - corners[1] - corners[2] + corners[3]) / (4 * STEP**2)
    if not np.isfinite(curvature).all() or np.linalg.eigvalsh(curvature)[0] <= 0:
        return None
    found = sandwich([rec.starts for rec in problem.records if rec], slopes, curvature, WINDOW)
    ends = [[np.concatenate([side.gain, side.rest[:A]]) for side in pair if side] for pair in sides]
    return None if found is None else (found, np.stack([(up - down) / (2 * STEP) for up, down in ends], axis=-1))
