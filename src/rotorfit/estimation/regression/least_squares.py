"""The rungs `svf` and `weak`: least squares on filtered regressors, at the delay with the best simulation.

The paper differentiates the pose and leaves the command unfiltered. Here commands and motion pass through the same
filter: a state-variable filter (`svf`), or means over windows under a smooth test function, which is the integral or
weak form of the equation (`weak`). This removes the bias from unequal smoothing, and the delay is searched for. The
bias inherent to least squares remains: the velocity on the right-hand side is noisy, and correlated with wind and
feedback.
"""

from collections.abc import Sequence

import numpy as np

from rotorfit.core.flight_data import Flight
from rotorfit.core.frames import Array
from rotorfit.estimation.regression.delay import best_delay, delay_spread
from rotorfit.estimation.regression.equation import LowPass, modulating_function, state_variable_filter
from rotorfit.estimation.regression.problem import (
    Problem,
    Solution,
    all_columns,
    bounded_covariance,
    problem_of,
    rung_of,
    unfit,
)
from rotorfit.estimation.regression.result import MethodResult, without_numbers

CUT_OFF = 6.0
"""Poles of the state-variable filter, of third order [1/s].

Chosen on simulated flights, set B, 60 s, in light wind: the RMS error of g of x is 0.025 at 3 1/s, 0.016 at 6, 0.013 at
10. Faster poles gain little there and pass more uncommanded motion on real flights.
"""

WIDTH = 1.5
"""Width of the window of the weak form [s]: the mean passes the same band as the state-variable filter."""

POWER = 4
"""Power of the test function: three continuous derivatives."""


def svf(flights: Sequence[Flight], axes: tuple[str, ...]) -> MethodResult:
    """Least squares on commands and motion through the same state-variable filter, with delay and trim.

    Args:
        flights: One or more flights of one vehicle and setting.
        axes: `("z",)`, `("yaw",)` or `("x", "y")`.

    Source: P. C. Young, Automatica 17 (1981), pp. 23-39; H. Garnier, L. Wang (eds.), Identification of Continuous-time
    Models from Sampled Data, Springer 2008, ch. 1. Products with the turning heading are filtered as products.
    """
    return _least_squares("svf", flights, axes, state_variable_filter((CUT_OFF,) * 3))


def weak(flights: Sequence[Flight], axes: tuple[str, ...]) -> MethodResult:
    """Least squares on the integral form: means under test functions on overlapping windows, with delay and trim.

    Args:
        flights: One or more flights of one vehicle and setting.
        axes: `("z",)`, `("yaw",)` or `("x", "y")`.

    Source: M. Shinbrot, Trans. ASME 79 (1957), pp. 547-552 (modulating functions); D. A. Messenger, D. M. Bortz,
    J. Comput. Phys. 443 (2021), 110525 (the test functions and their name).
    """
    return _least_squares("weak", flights, axes, modulating_function(WIDTH, POWER))


def _least_squares(method: str, flights: Sequence[Flight], axes: tuple[str, ...], low_pass: LowPass) -> MethodResult:
    problem = problem_of(flights, axes, low_pass)
    failed = unfit(problem)
    if failed:
        return without_numbers(method, axes, len(flights), failed)
    solution = best_delay(problem)
    if solution is None:
        return without_numbers(method, axes, len(flights), dict.fromkeys(axes, NOTHING_FITS))
    found = _covariance(problem, solution)
    if found is None:
        reason = ("not_identifiable", "regressors are dependent, or no delay is better than its neighbours")
        return without_numbers(method, axes, len(flights), dict.fromkeys(axes, reason))
    return rung_of(method, problem, solution, *found, len(flights))


NOTHING_FITS = (
    "not_identifiable",
    "command and velocity are proportional, or no delay gives a motion that stays finite",
)
"""Status and reason where the search for a delay finds nothing."""


def _covariance(problem: Problem, at: Solution) -> tuple[Array, float] | None:
    """Covariance of g, tau, b of the active axes, shape (3 A, 3 A), and the quantile; None if not identifiable.

    It is the covariance of least squares at a fixed delay plus that due to the delay. Their correlation is neglected:
    one comes from the band of the filter, the other from positions.
    """
    A = len(at.gain)
    columns = [np.delete(x, np.s_[A : 2 * A], axis=-1) for x in all_columns(problem, at)]
    found, spread = bounded_covariance(problem, at, columns, columns), delay_spread(problem, at)
    if found is None or spread is None:
        return None
    delays, follows = spread
    own = found.covariance[: 2 * A, : 2 * A] + follows @ delays.covariance @ follows.T
    across = follows @ delays.covariance
    whole = np.block([[own, across], [across.T, delays.covariance]])
    order = np.r_[:A, 2 * A : 3 * A, A : 2 * A]  # g, b, tau -> g, tau, b
    return whole[np.ix_(order, order)], max(found.quantile, delays.quantile)
