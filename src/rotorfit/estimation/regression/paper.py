"""The paper's estimator: accelerations by differentiation, then the stacked linear regressions (8), (9) and (10).

It is kept exactly as published, linear and without a delay, as the method named `paper`. For a vehicle with a delay its
damping is near zero or negative; that is a property of the method and is not corrected here.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from rotorfit.core.flight_data import Flight
from rotorfit.core.frames import AXES, Array, Mask, heading_from_world, world_from_heading
from rotorfit.core.results import Motion, PaperFit, PaperStatus
from rotorfit.dynamics.kinematics import DEGREE, HALF_WIDTH, LEAST, motion_from_flight

SHORTEST = 4
"""Smallest amount of data of an axis, in windows: the lag of the standard errors is one window to a quarter of it."""

EQUATIONS = {(0, 1): slice(0, 8), (2,): slice(8, 10), (3,): slice(10, 12)}
"""Indices of the axes in eqs. (8), (9) and (10), to their columns among alpha_1 .. alpha_12."""


def paper_regression(
    flights: Sequence[Flight],
    axes: Sequence[str] = AXES,
    half_width: float = HALF_WIDTH,
    degree: int = DEGREE,
    least: int = LEAST,
) -> PaperFit:
    """Estimates gamma_1 .. gamma_8 as the paper does, from one or several flights together.

    Pose and command are aligned by stamp, differentiated by local polynomials, and stacked into eqs. (8), (9), (10),
    which have no intercept: their column of ones multiplies a parameter that is fixed at 0. Each is solved by a QR
    factorisation of its columns scaled to unit length.

    A flight enters the equation of an axis only if it commands that axis: three training flights (x with y, z, yaw)
    give the same result together as one by one. Where a flight commands x but not y, the columns of y (alpha_3,
    alpha_4, alpha_7, alpha_8) are left out of (8) and both world rows stay. The estimate of x is unchanged: the two
    rows of a stamp are its heading-frame rows under a rotation, so the columns of x and of y are orthogonal at any yaw,
    and the motion of y stays in the residual. The damping of y is then not given: without a command it is a fit to
    wind.

    The published covariance is that of Newey and West, with the Bartlett kernel on the differences of the stamps.
    Neighbouring windows share most of their poses and disturbances last for seconds, so residuals are autocorrelated
    over hundreds of rows, while the textbook covariance treats each row as independent: with a wind of 0.03 m/s^2 in
    simulation its standard errors are 7 to 10 times too small, where these are within 20 % of the scatter. With mocap
    noise alone, whose second difference cancels over time, both are too large, these by 3 to 15 times. Neither covers
    the BIAS of this method due to delay, noisy velocity and feedback.

    Args:
        flights: One or more flights of one vehicle and setting.
        axes: The axes to estimate.
        half_width: Half the width of the differentiating window [s].
        degree: Degree of its polynomial.
        least: Smallest number of poses in a window.

    Returns:
        The estimate. An axis whose command is always zero, or that has too little data or dependent columns, gets NaN,
        a status and a reason.

    Source: paper, section 5, eqs. (8), (9), (10). W. K. Newey, K. D. West, Econometrica 55 (1987), pp. 703-708.
    """
    motions = tuple(motion_from_flight(flight, half_width, degree, least) for flight in flights)
    commanded = np.array([_commanded(f, m) for f, m in zip(flights, motions, strict=True)]).reshape(-1, len(AXES))
    verdicts = {axis: _verdict(AXES.index(axis), flights, motions, commanded, 2 * half_width) for axis in axes}
    gamma, covariance, covariance_ols = np.full(8, np.nan), np.full((8, 8), np.nan), np.full((8, 8), np.nan)
    solutions: dict[str, _Solution] = {}
    for equation in EQUATIONS:
        solved = [i for i in equation if AXES[i] in verdicts and verdicts[AXES[i]][0] == "ok"]
        if not solved:
            continue
        solution = _solve(_stack(motions, commanded, equation, solved), 2 * half_width)
        at = np.concatenate([[2 * i, 2 * i + 1] for i in solved])
        gamma[at] = solution.theta
        covariance[np.ix_(at, at)] = solution.covariance
        covariance_ols[np.ix_(at, at)] = solution.covariance_ols
        solutions |= {AXES[i]: solution for i in solved}
    return PaperFit(
        gamma=gamma,
        stderr=np.sqrt(np.diag(covariance)),
        covariance=covariance,
        covariance_ols=covariance_ols,
        status={axis: status for axis, (status, _) in verdicts.items()},
        reason={axis: reason for axis, (_, reason) in verdicts.items() if reason},
        r_squared={axis: solution.r_squared[axis] for axis, solution in solutions.items()},
        condition={axis: solution.condition for axis, solution in solutions.items()},
        lag={axis: solution.lag for axis, solution in solutions.items()},
        rows={axis: solution.rows[axis] for axis, solution in solutions.items()},
        half_width=half_width,
        degree=degree,
        motions=motions,
        modelled=tuple(modelled_acceleration(motion, gamma) for motion in motions),
    )


def alpha(motion: Motion) -> Array:
    """The regressors alpha_1 .. alpha_12 of a flight, shape (N, 12). Source: paper, section 5."""
    c, s = np.cos(motion.yaw), np.sin(motion.yaw)
    u_x, u_y, u_z, u_yaw = motion.command.T
    v_x, v_y, v_z, v_yaw = motion.velocity.T
    world_x = [u_x * c, -v_x * c, -u_y * s, v_y * s]
    world_y = [u_x * s, -v_x * s, u_y * c, -v_y * c]
    return np.column_stack([*world_x, *world_y, u_z, -v_z, u_yaw, -v_yaw])


def modelled_acceleration(motion: Motion, gamma: Array) -> Array:
    """Acceleration in the world by eq. (6), from the commands and the measured velocity.

    Args:
        motion: A flight, fitted or not.
        gamma: gamma_1 .. gamma_8, shape (8,), NaN for axes without numbers.

    Returns:
        World x, y, z, yaw, shape (N, 4) [m/s^2, rad/s^2]. z and yaw without numbers are NaN. x and y are both NaN if
        neither has numbers; if one of them has, they are the contribution of that one.

    Source: paper, eq. (6), its last line read as a second derivative.
    """
    along = gamma[0::2] * motion.command - gamma[1::2] * motion.velocity
    unknown = np.isnan(gamma[[0, 2]])
    if not unknown.all():
        along[:, :2][:, unknown] = 0.0
    along[:, :2] = world_from_heading(along[:, :2], motion.yaw)
    return along


def _commanded(flight: Flight, motion: Motion) -> Mask:
    """Which axes have a non-zero command at the stamps that are used, shape (4,)."""
    return np.array([axis in flight.axes and bool(np.any(motion.command[:, i])) for i, axis in enumerate(AXES)])


def _verdict(
    axis: int, flights: Sequence[Flight], motions: Sequence[Motion], commanded: Mask, window: float
) -> tuple[PaperStatus, str]:
    """Status of an axis before the regression, and the reason where it is not `ok`."""
    if not any(AXES[axis] in flight.axes for flight in flights):
        return "not_excited", "no flight has a command of this axis"
    covered = np.array([np.minimum(np.diff(motion.time), window).sum() for motion in motions])
    needed, excited = SHORTEST * window, float(covered[commanded[:, axis]].sum())
    if covered.sum() >= needed and not commanded[:, axis].any():
        return "not_excited", "the command is zero at every pose that is used"
    if excited < needed:
        return "too_short", f"{excited:.1f} s of poses under commands can be differentiated, {needed:.1f} s are needed"
    equation = next(equation for equation in EQUATIONS if axis in equation)
    design = _stack(motions, commanded, equation, [axis]).design
    if np.linalg.matrix_rank(design.reshape(-1, 2) / _lengths(design), tol=1e-9) < 2:
        return "not_identifiable", "command and velocity are proportional, or the vehicle did not move"
    return "ok", ""


@dataclass(frozen=True)
class _Stack:
    """One of eqs. (8)-(10): N stamps of several flights, R world axes, P coefficients of the axes with status `ok`."""

    times: Sequence[Array]  # one per flight, N together
    yaw: Array  # (N,)
    design: Array  # (N, R, P); a column is 0 where the flight does not command its axis
    target: Array  # (N, R)
    own: Mapping[str, tuple[int, Mask]]  # axis -> its place in R, and the stamps at which it is commanded, (N,)


@dataclass(frozen=True)
class _Solution:
    """An equation solved for its P coefficients; see `PaperFit`."""

    theta: Array
    covariance: Array
    covariance_ols: Array
    condition: float
    lag: float
    r_squared: Mapping[str, float]
    rows: Mapping[str, int]


def _stack(motions: Sequence[Motion], commanded: Mask, equation: tuple[int, ...], solved: Sequence[int]) -> _Stack:
    """Stacks the rows of all flights that command one of the axes `solved`."""
    flights = [(m, c[list(equation)]) for m, c in zip(motions, commanded, strict=True) if c[list(solved)].any()]
    shape = (-1, len(equation), 2 * len(equation))
    design = [alpha(m)[:, EQUATIONS[equation]].reshape(shape) * np.repeat(c, 2) for m, c in flights]
    columns = np.concatenate([[2 * equation.index(i), 2 * equation.index(i) + 1] for i in solved])
    active = np.repeat([c for _, c in flights], [len(m.time) for m, _ in flights], axis=0)
    return _Stack(
        times=[m.time for m, _ in flights],
        yaw=np.concatenate([m.yaw for m, _ in flights]),
        design=np.concatenate(design)[:, :, columns],
        target=np.concatenate([m.acceleration[:, list(equation)] for m, _ in flights]),
        own={AXES[i]: (equation.index(i), active[:, equation.index(i)]) for i in solved},
    )


def _lengths(design: Array) -> Array:
    """Lengths of the columns of a design, shape (P,); 1 for a column of zeros."""
    length = np.sqrt(np.sum(design**2, axis=(0, 1)))
    return np.where(length > 0, length, 1.0)


def _solve(stack: _Stack, window: float) -> _Solution:
    """Least squares by QR, both covariances, and the explained share of the variance."""
    scale = _lengths(stack.design)
    design, unscale = stack.design / scale, np.outer(scale, scale)
    q, r = np.linalg.qr(design.reshape(-1, len(scale)))
    singular = np.linalg.svd(r, compute_uv=False)
    theta = np.linalg.solve(r, q.T @ stack.target.reshape(-1))
    del q  # half an hour takes 13 MB
    residual = stack.target - design @ theta
    inverse = np.linalg.inv(r)
    bread = inverse @ inverse.T
    scores = np.einsum("nrp,nr->np", design, residual)
    by_flight = np.split(scores, np.cumsum([len(time) for time in stack.times])[:-1])
    lag = bartlett_lag(stack.times, by_flight, window)
    middle = np.sum([newey_west(t, g, lag) for t, g in zip(stack.times, by_flight, strict=True)], axis=0)
    # In the heading frame the residual of x belongs to x alone; that of an axis without commands is not used.
    measured, left = _along_heading(stack.target, stack.yaw), _along_heading(residual, stack.yaw)
    pairs = {axis: (measured[mine, place], left[mine, place]) for axis, (place, mine) in stack.own.items()}
    rows = {axis: len(rest) for axis, (_, rest) in pairs.items()}
    variance = sum(float(rest @ rest) for _, rest in pairs.values()) / (sum(rows.values()) - len(theta))
    return _Solution(
        theta=theta / scale,
        covariance=bread @ middle @ bread / unscale,
        covariance_ols=variance * bread / unscale,
        condition=float(singular[0] / singular[-1]),
        lag=lag,
        r_squared={axis: 1 - float(rest @ rest / np.sum((y - y.mean()) ** 2)) for axis, (y, rest) in pairs.items()},
        rows=rows,
    )


def _along_heading(rows: Array, yaw: Array) -> Array:
    """World x and y resolved in the heading frame; z or yaw as they are."""
    return heading_from_world(rows, yaw) if rows.shape[1] == 2 else rows


def newey_west(time: Array, score: Array, lag: float) -> Array:
    """Sum over all pairs of stamps of (1 - |t_i - t_j| / lag)+ g_i g_j^T, shape (P, P), from scores g of shape (N, P).

    The triangle is a positive definite function of time, so the sum is positive semidefinite on irregular stamps, too.
    Running sums of g and of t g make the cost linear in N. Stamps and lag are in seconds.
    """
    zero = np.zeros((1, score.shape[1]))
    time = time - time[0]
    g = np.concatenate([zero, np.cumsum(score, axis=0)])
    tg = np.concatenate([zero, np.cumsum(time[:, None] * score, axis=0)])
    first = np.searchsorted(time, time - lag)
    earlier = (1 - time / lag)[:, None] * (g[:-1] - g[first]) + (tg[:-1] - tg[first]) / lag
    cross = score.T @ earlier
    return np.asarray(score.T @ score + cross + cross.T)


def bartlett_lag(times: Sequence[Array], scores: Sequence[Array], window: float) -> float:
    """Lag of the Bartlett kernel [s]: at least a window, at most a quarter of the longest flight.

    In between, it is the plug-in of Andrews for a first-order autoregression of the scores summed over blocks of one
    window: within a block the scores are dependent through the window itself, which is not an autoregression. The
    coefficient is limited to +-0.97, as in the source. Longer lags would shrink the result, since the scores of a
    least-squares fit sum to zero.

    Source: D. W. K. Andrews, Econometrica 59 (1991), pp. 817-858, section 6.
    """
    blocks = []
    for time, score in zip(times, scores, strict=True):
        block = ((time - time[0]) / window).astype(np.int64)
        blocks.append(np.array([np.bincount(block, weights=column) for column in score.T]).T)
    power = np.sum([np.sum(b**2, axis=0) for b in blocks], axis=0)
    product = np.sum([np.sum(b[1:] * b[:-1], axis=0) for b in blocks], axis=0)
    rho = np.clip(np.divide(product, power, out=np.zeros_like(power), where=power > 0), -0.97, 0.97)
    innovation = power * (1 - rho**2)
    curvature = np.sum(4 * rho**2 * innovation**2 / ((1 - rho) ** 6 * (1 + rho) ** 2))
    alpha_1 = curvature / np.sum(innovation**2 / (1 - rho) ** 4)
    plug_in = 1.1447 * float(alpha_1 * sum(len(b) for b in blocks)) ** (1 / 3) * window
    longest = max(float(time[-1] - time[0]) for time in times)
    return float(max(window, min(plug_in, longest / SHORTEST)))
