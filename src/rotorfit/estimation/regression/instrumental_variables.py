"""The rung `iv`: refined instrumental variables for continuous time, with the delay (SRIVC).

The regressors of least squares contain wind and pose noise; a motion simulated from the commands alone does not. That
motion is the instrument; it and the prefilter 1 / (s + b) are recomputed from every estimate until convergence. In a
feedback loop the commands respond to the wind, and so does a motion simulated from them: there the instrument must be
computed from the controller's reference, if that was recorded.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from rotorfit.core.flight_data import Flight
from rotorfit.core.frames import Array, Mask, heading_from_world
from rotorfit.core.laws import DELAY_RANGE
from rotorfit.dynamics.horizontal_response import plane_response
from rotorfit.dynamics.response import axis_response
from rotorfit.estimation.regression.delay import best_delay
from rotorfit.estimation.regression.equation import (
    GridSegment,
    delay_columns,
    input_columns,
    motion_columns,
    state_variable_filter,
)
from rotorfit.estimation.regression.least_squares import CUT_OFF, NOTHING_FITS
from rotorfit.estimation.regression.problem import (
    Problem,
    Solution,
    all_columns,
    bounded_covariance,
    coefficients,
    problem_of,
    rung_of,
    unfit,
)
from rotorfit.estimation.regression.result import FASTEST, MethodResult, without_numbers
from rotorfit.estimation.regression.sandwich import SINGULAR, Sandwich

SLOWEST = 3.0
"""Smallest pole of the prefilter [1/s]; the pole is b where that is larger. 1 / (s + b) would be best for white noise
on the velocity, but wind is not white: a slower filter passes its drift. In simulated flights, set B, 60 s, the RMS
error of g of x is 0.057 at 0.3 1/s, 0.030 at 1, 0.017 at 3."""

SMOOTHING = 12.0
"""Poles of the two further sections of the prefilter [1/s], required by the second derivative of a position."""

LEAST_DAMPING = 0.02
"""Least damping with which the instrument is simulated [1/s]: it need only resemble the motion, and stay finite."""

ROUNDS = 40
"""Number of iterations after which an iteration without convergence counts as diverged."""

SETTLED = 1e-4
"""Convergence threshold: largest change of gain and damping relative to their size, and of the delay in seconds."""

LONGEST_STEP = 0.05
"""Largest change of a delay in one iteration [s]."""

MEMORIES = (0.2, 0.5, 1.0, 2.0, 4.0)
"""Time constants of the filters on the reference by which the commands are predicted [s]."""

COMMAND = "the motion simulated from the commands, right in an open loop only"

REFERENCE = "the motion simulated from the recorded reference"


@dataclass(frozen=True)
class Instrument:
    """Source of the instruments.

    Attributes:
        commands: Commands from which the motion is simulated, shape (M, C) for each stretch.
        name: The source in words.
    """

    commands: tuple[Array, ...]
    name: str


def iv(flights: Sequence[Flight], axes: tuple[str, ...]) -> MethodResult:
    """Refined instrumental variables with delay and trim, started from the result of the state-variable filter.

    Args:
        flights: One or more flights of one vehicle and setting.
        axes: `("z",)`, `("yaw",)` or `("x", "y")`.

    Source: P. C. Young, A. J. Jakeman, Int. J. Control 31 (1980), pp. 741-764; H. Garnier, M. Gilson, P. C. Young,
    A. Padilla, Control Eng. Practice 15 (2007) (SRIVC, and the reference as instrument in a loop); F. Chen, H. Garnier,
    M. Gilson, IFAC-PapersOnLine 48-28 (2015), pp. 733-738 (the delay as a parameter of the iteration).
    """
    problem = problem_of(flights, axes, state_variable_filter((CUT_OFF,) * 3))
    failed = unfit(problem)
    if failed:
        return without_numbers("iv", axes, len(flights), failed)
    start = best_delay(problem)
    if start is None:
        return without_numbers("iv", axes, len(flights), dict.fromkeys(axes, NOTHING_FITS))
    source, active = instrument_of(problem), problem.layout.active
    held: list[int] = []  # axes whose iteration diverges: held at the least-squares estimate, without numbers
    while True:
        end, at, restless = _refined(flights, problem, start, source, held)
        if restless is None or len(held) + 1 == len(active):
            break
        held.append(restless)
    lost = [*held, *([] if restless is None else [restless])]
    spread = None if restless is not None else _spread(end, at, source, held)
    if spread is None:
        return without_numbers("iv", axes, len(flights), dict.fromkeys(axes, UNSETTLED))
    rung = rung_of(
        "iv", end, at, spread.covariance[: 3 * len(active), : 3 * len(active)], spread.quantile, len(flights)
    )
    return replace(
        rung,
        failed={**rung.failed, **{axes[active[a]]: UNSETTLED for a in lost}},
        remark=dict.fromkeys(axes, f"instrument: {source.name}"),
    )


UNSETTLED = ("diverged", f"the instruments did not settle in {ROUNDS} rounds")
"""Status and reason of an axis whose iteration does not converge."""


def _spread(problem: Problem, at: Solution, source: Instrument, held: Sequence[int]) -> Sandwich | None:
    """Covariance of the free parameters; None where columns are dependent."""
    columns, instruments = all_columns(problem, at), _instruments(problem, at, source)
    return bounded_covariance(problem, at, instruments, columns, _free(problem, held))


def _free(problem: Problem, held: Sequence[int]) -> Mask:
    """True for the estimated parameters of the equation, all but g, tau and b of the held axes; shape (P,)."""
    A = len(problem.layout.active)
    free = np.concatenate([np.ones(2 * A, bool), problem.used])
    free[[offset + a for a in held for offset in (0, A, 2 * A)]] = False
    return free


def instrument_of(problem: Problem) -> Instrument:
    """The commands themselves, or, where every stretch has a reference, their projection on the reference.

    The projection is a least-squares fit to the reference filtered by a bank of low-passes. It need not model the
    controller: it only has to depend on the reference alone and resemble the command.
    """
    if any(part.reference is None for part in problem.parts):
        return Instrument(tuple(part.command for part in problem.parts), COMMAND)
    banks = [_bank(part) for part in problem.parts]
    stacked, command = np.concatenate(banks), np.concatenate([part.command for part in problem.parts])
    weights, *_ = np.linalg.lstsq(stacked, command, rcond=1e-10)
    return Instrument(tuple(bank @ weights for bank in banks), REFERENCE)


def _bank(part: GridSegment) -> Array:
    """The reference, the reference less each of its B low-passes, and a constant: shape (M, (1 + B) C + 1).

    x and y are in the heading frame.
    """
    reference = np.asarray(part.reference)
    columns = [reference]
    step = np.diff(part.switch[:-1], prepend=part.switch[0])
    for memory in MEMORIES:
        slow = reference.copy()
        for i in range(1, len(slow)):
            slow[i] = reference[i - 1] + (slow[i - 1] - reference[i - 1]) * np.exp(-step[i] / memory)
        columns.append(reference - slow)
    if part.axes == 2:
        middle = (part.edge[1:] + part.edge[:-1]) / 2
        yaw = np.interp(part.switch[:-1], middle, part.heading)
        columns = [heading_from_world(column, yaw) for column in columns]
    return np.hstack([*columns, np.ones((len(reference), 1))])


def _refined(
    flights: Sequence[Flight], problem: Problem, at: Solution, source: Instrument, held: Sequence[int]
) -> tuple[Problem, Solution, int | None]:
    """Iterates to the fixed point.

    Returns:
        The problem under the last prefilter; the last solution; and None, or without convergence the index, among the
        active axes, of the one that changed most.
    """
    A, speed = len(at.gain), 0.0
    change = np.full((3, A), np.inf)
    for _ in range(ROUNDS):
        wanted = float(np.exp(np.mean(np.log(np.clip(at.rest[:A], SLOWEST, FASTEST)))))
        if wanted != speed:
            speed = wanted
            problem = problem_of(flights, problem.axes, state_variable_filter((speed, SMOOTHING, SMOOTHING)))
        step = _step(problem, at, _instruments(problem, at, source), _free(problem, held))
        if step is None:
            break
        moved = Solution(
            at.gain + step[:A],
            np.clip(at.delay + np.clip(step[A : 2 * A], -LONGEST_STEP, LONGEST_STEP), *DELAY_RANGE),
            at.rest + step[2 * A :],
        )
        change = np.abs(np.stack([moved.gain - at.gain, moved.delay - at.delay, moved.rest[:A] - at.rest[:A]]))
        change /= np.stack([np.abs(moved.gain) + 1e-12, np.ones(A), np.maximum(np.abs(moved.rest[:A]), 0.1)])
        at = moved
        if not np.isfinite(at.rest).all() or np.abs(at.rest[:A]).max() > FASTEST:
            break
        if change.max() < SETTLED:
            return problem, at, None
    worst = np.nan_to_num(change.max(axis=0), nan=np.inf)
    worst[list(held)] = -np.inf
    return problem, at, int(np.argmax(worst))


def _instruments(problem: Problem, at: Solution, source: Instrument) -> list[Array]:
    """Columns of the equation computed from the simulated motion, without wind and noise, per stretch (N, C, P)."""
    low_pass, layout, rows = problem.low_pass, problem.layout, []
    for place, (part, command) in enumerate(zip(problem.parts, source.commands, strict=True)):
        free = _simulated(problem, at, part, command)
        rows.append(
            np.concatenate(
                [
                    input_columns(part, low_pass, layout, at.delay, command),
                    delay_columns(part, low_pass, layout, at.gain, at.delay, command),
                    motion_columns(part, place, low_pass, layout, free),
                ],
                axis=-1,
            )
        )
    return rows


def _simulated(problem: Problem, at: Solution, part: GridSegment, command: Array) -> Array:
    """World position at the edges of a stretch simulated from given commands, from rest, shape (E + 2, C)."""
    point, K = coefficients(problem, at, part.flight), part.axes
    n, m = part.edge.size, len(command)
    switch = np.ascontiguousarray(part.switch[:-1])  # for another layout, the response would be compiled once more
    whole = (part.edge[:1], np.array([[0, n]]), np.array([[0, m]]), part.edge, np.arange(n), switch)
    damping = np.maximum(point.damping, LEAST_DAMPING)
    if K == 1:
        out = axis_response(
            *whole, np.ascontiguousarray(command[:, 0]), np.ones(n), point.gain[0], point.trim[0], damping[0],
            point.delay[0], np.zeros(1),
        )  # fmt: skip
    else:
        yaw = np.interp(part.edge, (part.edge[1:] + part.edge[:-1]) / 2, part.heading)
        out = plane_response(
            *whole, np.ascontiguousarray(command), np.ones(n), yaw, point.gain, point.trim, damping, point.delay,
            np.zeros((1, 2)),
        )  # fmt: skip
    trimmed = np.einsum("j,bjk->bk", point.trim, out[:, K : 2 * K])
    return np.einsum("j,bjk->bk", point.gain, out[:, :K]) + trimmed  # type: ignore[no-any-return]


def _step(problem: Problem, at: Solution, instruments: Sequence[Array], free: Mask) -> Array | None:
    """Newton step to the root of sum Z'(target - model) = 0, shape (P,); None where the system is singular."""
    A = len(at.gain)
    theta = np.concatenate([at.gain, np.zeros(A), at.rest])
    columns = all_columns(problem, at)
    slope = np.sum([np.einsum("ncp,ncq->pq", z, x) for z, x in zip(instruments, columns, strict=True)], axis=0)
    error = np.sum(
        [
            np.einsum("ncp,nc->p", z, y - x @ theta)
            for z, x, y in zip(instruments, columns, problem.target, strict=True)
        ],
        axis=0,
    )
    left = np.sqrt(np.sum([np.sum(z**2, axis=(0, 1)) for z in instruments], axis=0))
    right = np.sqrt(np.sum([np.sum(x**2, axis=(0, 1)) for x in columns], axis=0))
    if not ((left > 0) & (right > 0))[free].all():
        return None
    scaled = slope[np.ix_(free, free)] / np.outer(left[free], right[free])
    if not np.isfinite(scaled).all() or _smallest(scaled) < SINGULAR:
        return None
    step = np.zeros(theta.size)
    step[free] = np.linalg.solve(scaled, error[free] / left[free]) / right[free]
    return step


def _smallest(matrix: Array) -> float:
    return float(np.linalg.svd(matrix, compute_uv=False)[-1])
