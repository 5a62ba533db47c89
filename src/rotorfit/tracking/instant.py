"""When did it change? The posterior distribution of the instant, from one likelihood.

With a change at t, the whitened innovations are y = X b + Z_t s + noise: X has the sensitivities of all rows, and b is
what the regime leaves unknown of its coefficients, trims and start velocities, with a flat prior. Z_t has those of the
rows after t to the parameters that may change, and s their shifts, normal with the sizes that a test looks for. On z
and yaw a push begins at t, too, that fades as the autopilot learns it. With b and s integrated out,

    log p(t) = -S(t) / 2 - log det(A(t)) / 2,

where S(t) is the least sum of squares of the residuals and of the shifts, in their standard deviations, and A(t) the
matrix of its normal equations. All instants of the grid are equally likely beforehand.

Source: A. F. M. Smith, "A Bayesian approach to inference about a change-point in a sequence of random variables",
Biometrika 62 (1975), pp. 407-416, applied to a linear regression with a proper prior of the shift.
"""

import numpy as np
from scipy.special import ndtr

from rotorfit.core.frames import Array
from rotorfit.tracking.scores import LASTS, Scores

SPACING = 0.05
"""Grid spacing of the instants [s]."""

PUSH = 3.0
"""Standard deviation of the push, in the unit of the jolts of the scores: a sixth of the weight."""

SLACK = 0.2
"""By how much the interval is widened at both ends [s]: rotors and radio pass a change on in 0.1 s, and in still air,
where a payload stands out a hundredfold, an autopilot that is not quite as assumed moves the instant by as much."""

FLAT = 1e-9
"""Ridge of the parameters with a flat prior, as a share of the largest: it decides only what the rows leave open."""

ENDS = 0.025, 0.975
"""Quantiles at the ends of an interval."""


def changed_when(scores: Scores, low: float) -> tuple[float, tuple[float, float]]:
    """The median of the instant of a change, and its central 95 % interval [s].

    Args:
        scores: Those of the likelihood that shows the change.
        low: Earliest instant that is considered [s].
    """
    now = now_of(scores)
    instants = np.arange(low, now.time[-1], SPACING)
    first, of_row = np.unique(np.searchsorted(now.time, instants), return_inverse=True)  # a pause of the log has one
    shifts = [_shifts(now, at) for at in first]
    products = np.array([products_of(now, at, each) for at, each in zip(first, shifts, strict=True)])
    known = now.rows.shape[1] - 1
    log, solution = log_posterior(products, known)
    best = int(np.argmax(log))
    products /= mean_square(now, first[best], shifts[best], solution[best])
    log, _ = log_posterior(products, known)
    share = np.exp(log - log.max())[of_row]
    early, median, late = instants[np.searchsorted(np.cumsum(share), np.array([0.025, 0.5, 0.975]) * share.sum())]
    return float(median), (float(early) - SLACK, min(float(late) + SLACK, float(now.time[-1])))


def now_of(scores: Scores) -> Scores:
    """The scores under the strength of the gusts now."""
    return (scores, *scores.under_gusts)[scores.gusts]


def _shifts(scores: Scores, at: int) -> Array:
    """Sensitivities of the rows from `at` on to shifts that begin there, shape (N - at, P), or (N - at, P + 1)."""
    shifts = scores.tested[at:]
    if not scores.jolts.size:
        return shifts
    shape = scores.jolts[int(np.searchsorted(scores.time, scores.time[-1] - LASTS)) :, 0]
    push = np.zeros(len(shifts))
    push[: shape.size] = PUSH * shape[: push.size]
    return np.column_stack([shifts, push])


def products_of(scores: Scores, at: int, shifts: Array) -> Array:
    """Inner products of the innovations, of the columns of X and of those of Z, for a change at a row.

    Args:
        scores: Those of one likelihood.
        at: The row.
        shifts: Z from that row on, in standard deviations of its parameters, shape (n, P); zero after n rows.
    """
    across = scores.rows[at : at + len(shifts)].T @ shifts
    return np.block([[scores.products, across], [across.T, shifts.T @ shifts]])


def log_posterior(products: Array, known: int) -> tuple[Array, Array]:
    """Log-density of each change, up to a constant of the regime, and its solution b, s.

    Args:
        products: From `products_of`, for each change, shape (n, 1 + Q, 1 + Q).
        known: Number of columns of X: their b has a flat prior.

    Returns:
        Log-densities, shape (n,), and solutions, shape (n, Q).
    """
    normal, right = products[:, 1:, 1:].copy(), products[:, 1:, 0]
    flat, shifted = np.arange(known), np.arange(known, right.shape[1])
    normal[:, flat, flat] += FLAT * normal[:, flat, flat].max(axis=1, keepdims=True) + np.finfo(float).tiny
    normal[:, shifted, shifted] += 1.0
    solution = np.linalg.solve(normal, right[:, :, None])[:, :, 0]
    squares = products[:, 0, 0] - (right * solution).sum(axis=1)
    return np.asarray(-0.5 * squares - 0.5 * np.linalg.slogdet(normal)[1]), np.asarray(solution)


def instants_of(scores: Scores, since: tuple[float, float]) -> Array:
    """Instants within an interval at which a change may have begun, shape (I,) [s]."""
    end = min(since[1], float(scores.time[-1]) - SPACING)
    return np.arange(min(since[0], end), end + 0.5 * SPACING, SPACING)


def unexplained(scores: Scores, shapes: Array) -> tuple[Array, Array]:
    """Inner products of shapes with the innovations, and with themselves, less what X explains.

    Args:
        scores: Those of one likelihood, of N rows.
        shapes: Shape (T, N).

    Returns:
        Two arrays of shape (T,).
    """
    return less_what_is_unknown(scores, (shapes @ scores.rows).T, (shapes**2).sum(axis=1))


def less_what_is_unknown(scores: Scores, across: Array, power: Array) -> tuple[Array, Array]:
    """Inner products of shapes with the innovations, and with themselves, less what X explains.

    Args:
        scores: Those of one likelihood.
        across: The inner products of T shapes with the columns of `Scores.rows`, shape (1 + P + Q, T).
        power: Those of the shapes with themselves, shape (T,).

    Returns:
        Two arrays of shape (T,).
    """
    normal, right = scores.products[1:, 1:], scores.products[1:, 0]
    ridge = FLAT * float(normal.diagonal().max()) + np.finfo(float).tiny
    explained = np.linalg.solve(normal + ridge * np.eye(len(normal)), across[1:])
    return across[0] - right @ explained, np.maximum(power - (across[1:] * explained).sum(axis=0), 0.0)


def mixture_interval(log: Array, mean: Array, error: Array) -> tuple[float, float]:
    """The 95 % interval of a mixture of normal distributions with some log-weights, all of one shape."""
    from scipy.optimize import brentq  # most flights end without an alarm

    weight = np.exp(log - log.max())
    weight /= weight.sum()
    least, most = float((mean - 6 * error).min()), float((mean + 6 * error).max())
    low, high = (
        float(brentq(lambda a, end=end: float((weight * ndtr((a - mean) / error)).sum()) - end, least, most))
        for end in ENDS
    )
    return low, high


def mean_square(scores: Scores, at: int, shifts: Array, solution: Array) -> float:
    """Mean square of the residuals before or after a change, the larger; at least 1.

    Args:
        scores, at, shifts: As for `products_of`.
        solution: b and s, from `log_posterior`, shape (Q,).
    """
    known = scores.rows.shape[1] - 1
    left = scores.innovation - scores.rows[:, 1:] @ solution[:known]
    left[at : at + len(shifts)] -= shifts @ solution[known:]
    return max(1.0, *(float(np.mean(part**2)) for part in np.split(left, [at]) if part.size > solution.size))
