"""Commands of one axis that are most informative about its coefficients within a room: optimal experiment design.

Over levels c held for one step each, and commands u that are these levels convolved with a window,

    maximise   J(M(u)),  M_ij = u' Q_ij u,  u = window * c        (`axis_information`)
    such that  |c| <= command, lower <= p <= upper, |v| <= speed at every step, from rest at 0 to rest at 0

with p, v the motion under c by the believed dynamics. The motion under u is a weighted mean of it over the window, so
it stays inside, too. The window removes fast content: a vehicle with inner loops follows hard steps less than its model
does. M is a convex quadratic form of u, so J rises towards the corners of the convex set of flights that stay inside.
A linear programme finds the best corner by the gradient of J; a line search towards it, on the exact J, can only climb;
the climb ends where no corner is better to first order. That is one of many local optima: several signals start the
climb, then parts of the best are perturbed and the climb is repeated; first on longer levels, then on single steps.

Source: G. C. Goodwin, R. L. Payne, Dynamic System Identification (1977), ch. 6; L. Ljung, System Identification, 2nd
ed. (1999), ch. 13; M. Frank, P. Wolfe, Naval Research Logistics Quarterly 3 (1956), pp. 95-110, for the climb; I. R.
Manchester, Input design for system identification via convex relaxation (2010), arXiv 1009.5614, for how the same
problem is bounded from above (`bench/bench_optimal.py`).
"""

import functools
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Literal

import numpy as np

from rotorfit.core.errors import PlanError
from rotorfit.core.flight_plan import AxisExcitation, Feedback, Steps
from rotorfit.core.frames import AXES, Array
from rotorfit.core.progress import Progress, part_of
from rotorfit.planning.axis_information import (
    EARLY,
    AxisBelief,
    AxisInformation,
    against_feedback,
    axis_information,
    extremes,
    transitions,
)
from rotorfit.planning.belief import Belief, levels_of

if TYPE_CHECKING:
    from highspy import Highs

Criterion = Literal["d", "a"]

TARGETS = np.array([0.05, 0.10, 0.03])
"""Standard errors of input and damping (relative) and delay [s] that criterion A counts as equally bad: the limits
below which the benchmarks call an axis well excited. D does not depend on them."""

LONGEST = 60.0
"""Longest flight that is designed in one piece [s]; a longer one chains equal pieces, which start and end at rest."""

SHORTEST = 4.0
"""Shortest flight that is designed [s]."""

STARTS, ROUNDS = 9, 27
"""Number of signals that start the climb, and of perturbations of the best afterwards."""

STEP = 0.1
"""Shortest time for which a command is held by default [s]."""

HELD = 2
"""Steps for which the levels are held at first, which takes a quarter of the time. The best is perturbed as often again
on levels of single steps."""

SETTLED = 1e-4
"""A climb ends where the linear programme promises less than this share of the standard errors."""

SHARES = np.concatenate([[0.0], np.geomspace(1e-4, 1, 121)])
"""Shares of the way to a corner that the line search tries."""

LONGEST_CLIMB = 100
"""Largest number of steps of a climb; 5 to 20 are usual."""

PRIMAL = 4
"""Number by which the solver knows the primal simplex: the last corner stays feasible when only the objective changes,
and its neighbours are tried next."""


@dataclass(frozen=True)
class AxisLimits:
    """Limits for the motion and commands of one axis.

    Attributes:
        command: Largest size of the command, in its unit.
        lower: Lowest position relative to the start, negative [m, rad].
        upper: Highest position relative to the start, positive [m, rad].
        speed: Largest speed [m/s, rad/s]; may be infinite.
    """

    command: float
    lower: float
    upper: float
    speed: float


@dataclass(frozen=True)
class OptimalSignal:
    """An optimal design for one axis.

    Attributes:
        signal: The commands, in their unit; 0 at the end.
        criterion: Criterion that was optimised: `d` or `a`.
        score: -log of the mean standard error, in units of `TARGETS`: geometric mean for D, root mean square for A.
        gap: Improvement of the score that the last linear programme still promised: 0 at a local optimum.
        history: Score after each step of the climb that led to the best, increasing.
        scores: Local optima found, in order.
        errors: Predicted standard errors of input and damping (relative) and delay [s], with disturbance levels known.
        pieces: Number of equal pieces that are chained.
    """

    signal: Steps
    criterion: Criterion
    score: float
    gap: float
    history: tuple[float, ...]
    scores: tuple[float, ...]
    errors: tuple[float, float, float]
    pieces: int


def optimal_signal(
    dynamics: tuple[float, float, float],
    levels: Array,
    limits: AxisLimits,
    duration: float,
    criterion: Criterion = "d",
    seed: int = 0,
    progress: Progress | None = None,
    *,
    step: float = STEP,
    smooth: float = 0.0,
    pose_rate: float = 120.0,
) -> OptimalSignal:
    """Designs the commands of one axis.

    Args:
        dynamics: Believed input, damping and delay; the damping positive.
        levels: log of the believed q, r, alpha, kappa of the disturbance, shape (4,), as in
            `estimation.likelihood.parameters.Point`.
        limits: Limits for the motion by the believed dynamics, without wind. Reduce them by the effect of wind and of
            uncertain dynamics.
        duration: Duration of the signal [s]; the vehicle is at rest again at most one delay after its end.
        criterion: `d` for the smallest volume of the confidence ellipsoid of input, damping and delay, `a` for the
            smallest sum of their variances in units of `TARGETS`.
        seed: Seed of starts and perturbations. Different seeds give different signals of nearly the same score.
        progress: Receives the share of the climbs that is done; raising in it cancels.
        step: Shortest time for which a command is held [s].
        smooth: Width of the Hann window applied to the levels [s]: content faster than 2 pi over it loses more than
            half of its amplitude, content twice as fast nearly all. Up to one step: none, the commands are hard steps.
        pose_rate: Rate of fresh poses [Hz].

    Raises:
        PlanError: Limits without room, a flight that is too short, or a failed linear programme.
    """
    _check(dynamics, limits, duration)
    pieces = int(np.ceil(duration / LONGEST - 1e-9))
    belief = AxisBelief(*dynamics)
    window = _window(smooth, step)
    form = axis_information(belief, levels, duration / pieces, step, pose_rate, window)
    problem = _Problem(form, limits, criterion, window)
    rough, rng = replace(problem, form=form.held(HELD)), np.random.default_rng(seed)
    best, scores = _search(rough, rng, None, part_of(progress, 0, 2))
    same = np.zeros(problem.n)
    same[: HELD * rough.n] = np.repeat(best.command, HELD)
    best, finer = _search(problem, rng, same, part_of(progress, 1, 2))
    level = problem.inside(best.command)
    errors = np.sqrt(np.diag(np.linalg.inv(pieces * form.information(level))))
    return OptimalSignal(
        signal=_chained(np.convolve(level, window), step, duration / pieces, pieces),
        criterion=criterion,
        score=float(problem.score(form.information(level))) + 0.5 * float(np.log(pieces)),
        gap=best.gap,
        history=best.history,
        scores=(*scores, *finer),
        errors=(float(errors[0]), float(errors[1]), float(errors[2])),
        pieces=pieces,
    )


def optimal_excitations(
    belief: Belief,
    room: Mapping[str, AxisLimits],
    start: float,
    duration: float,
    feedback: Feedback | None,
    criterion: Criterion = "d",
    seed: int = 0,
    progress: Progress | None = None,
    smooth: Mapping[str, float] | None = None,
) -> tuple[AxisExcitation, ...]:
    """Designs several axes that are flown together, ready for a plan without a ramp.

    Each axis has its own seed, so that the commands differ. On an axis with feedback the signal also compensates the
    feedback, which would otherwise undo the motion (`axis_information.against_feedback`).

    Args:
        belief: Belief about the vehicle, its air and its room.
        room: Axis to its limits.
        start: Start of the signals in the plan [s].
        duration: Duration of the signals [s].
        feedback: Feedback of the plan; it must believe in the same input gains.
        criterion: As for `optimal_signal`.
        seed: Seed of the searches.
        progress: Called with a fraction and a text; raising in it cancels.
        smooth: Axis to the width of its window [s], see `optimal_signal`; None for hard steps.

    Raises:
        PlanError: As `optimal_signal`.
    """
    truth, out = belief.truth, []
    for place, (axis, limits) in enumerate(room.items()):
        a = AXES.index(axis)
        dynamics = AxisBelief(truth.gamma[2 * a], truth.gamma[2 * a + 1], truth.delay[a])
        part = part_of(progress, place, len(room))
        signal = optimal_signal(
            dynamics, np.log(levels_of(belief, truth, axis)), limits, duration, criterion, seed * len(AXES) + a, part,
            smooth=smooth[axis] if smooth else 0.0, pose_rate=truth.pose_rate * (1 - truth.stale_share),
        ).signal  # fmt: skip
        if feedback is not None and axis in feedback.axes:
            signal = against_feedback(signal, axis, dynamics, feedback, duration, STEP)
        out.append(AxisExcitation(axis, "command", start, duration, signal))
    return tuple(out)


def _check(dynamics: tuple[float, float, float], limits: AxisLimits, duration: float) -> None:
    gain, damping, delay = dynamics
    if not (gain != 0 and damping > 0 and delay >= 0):
        raise PlanError(
            f"an optimal design needs an input gain, a positive damping and a delay, not {gain:g}, {damping:g} 1/s, "
            f"{delay:g} s: correct what is believed of the axis, or choose another design"
        )
    if not (limits.lower < 0 < limits.upper and limits.command > 0 and limits.speed > 0):
        raise PlanError(
            f"no room to fly: positions {limits.lower:g} to {limits.upper:g} about the start, commands to "
            f"{limits.command:g}, speeds to {limits.speed:g}: start further inside the room, or raise the limits"
        )
    if duration < SHORTEST:
        raise PlanError(f"{duration:g} s is too short for an optimal design: give it {SHORTEST:g} s or more")


@dataclass(frozen=True)
class _Climb:
    """Result of a climb, with the levels before their window."""

    command: Array
    gap: float
    history: tuple[float, ...]


@dataclass(frozen=True)
class _Problem:
    """One piece of a flight: the information of its windowed levels, and their limits."""

    form: AxisInformation
    limits: AxisLimits
    criterion: Criterion
    window: Array

    @property
    def n(self) -> int:
        """Number of levels."""
        return int(self.form.form.shape[-1])

    def score(self, information: Array) -> Array:
        """-log of the mean standard error in units of `TARGETS`; -inf where the information (..., 3, 3) is singular."""
        scaled = information * np.outer(TARGETS, TARGETS)
        sign, log_determinant = np.linalg.slogdet(scaled)
        regular = sign > 0
        if self.criterion == "d":
            return np.where(regular, log_determinant / 6, -np.inf)
        out = np.full(sign.shape, -np.inf)
        out[regular] = -0.5 * np.log(np.trace(np.linalg.inv(scaled[regular]), axis1=-2, axis2=-1) / 3)
        return out

    def slope(self, information: Array) -> Array:
        """Derivative of the score by the information, shape (3, 3)."""
        scale = np.outer(TARGETS, TARGETS)
        inverse = np.linalg.inv(information * scale)
        if self.criterion == "d":
            return np.asarray(inverse * scale / 6)
        return np.asarray(inverse @ inverse * scale / (2 * np.trace(inverse)))

    @functools.cached_property
    def programme(self) -> "Highs":
        """The linear programme of `corner`, without its objective.

        Variables are N commands, and the positions and speeds after each of them, each in units of its limit, which
        suits the solver better than SI. The solver keeps its last corner and starts the next search there.
        """
        import highspy
        from scipy.sparse import csc_array, eye_array, hstack, vstack

        class Silent(highspy.Highs):
            """The solver without the banner that it prints from its own initialisation."""

            def enableCallbacks(self) -> None:  # noqa: N802 (the name is theirs)
                self.silent()
                super().enableCallbacks()  # type: ignore[no-untyped-call]

        N, limits = self.n, self.limits
        gain, damping, _ = self.form.dynamics
        f, k, h = transitions(damping, np.array(self.form.step))
        room = max(limits.upper, -limits.lower)
        fastest = limits.speed if np.isfinite(limits.speed) else (limits.upper - limits.lower) / self.form.step
        push = gain * limits.command
        one, before = eye_array(N), eye_array(N, k=-1)
        position = hstack([-h * push / room * one, one - before, -k * fastest / room * before])
        speed = hstack([-k * push / fastest * one, 0 * one, one - f * before])
        equations = csc_array(vstack([position, speed]))
        bounds = np.repeat([[-1.0, 1.0], [limits.lower / room, limits.upper / room], [-1.0, 1.0]], N, axis=0)
        bounds[[2 * N - 1, 3 * N - 1]] = 0.0  # at rest at the start position
        model = highspy.HighsLp()
        model.num_row_, model.num_col_ = equations.shape
        model.col_cost_, (model.col_lower_, model.col_upper_) = np.zeros(3 * N), bounds.T
        model.row_lower_ = model.row_upper_ = np.zeros(2 * N)
        model.a_matrix_.format_ = highspy.MatrixFormat.kColwise
        model.a_matrix_.start_, model.a_matrix_.index_ = equations.indptr, equations.indices
        model.a_matrix_.value_ = equations.data
        solver = Silent()  # type: ignore[no-untyped-call]
        for option, value in (("solver", "simplex"), ("simplex_strategy", PRIMAL), ("presolve", "off"), ("threads", 1)):
            solver.setOptionValue(option, value)
        solver.passModel(model)
        return solver

    def corner(self, direction: Array) -> Array:
        """The flight inside the limits that maximises the projection of its commands on a direction, shape (N,).

        Raises:
            PlanError: The linear programme failed.
        """
        from highspy import HighsModelStatus

        solver, N = self.programme, self.n
        solver.changeColsCost(N, np.arange(N, dtype=np.int32), -direction / np.abs(direction).max())
        for _ in range(2):
            solver.run()
            if solver.getModelStatus() == HighsModelStatus.kOptimal:
                return np.asarray(self.limits.command * np.array(solver.getSolution().col_value[:N]))
            solver.clearSolver()  # a degenerate corner can end a search from the last one: once more from the beginning
        status = solver.modelStatusToString(solver.getModelStatus())
        raise PlanError(f"the linear programme of the optimal design failed ({status}): change the limits")

    def climb(self, command: Array) -> _Climb:
        """Climbs from a flight inside the limits to a local optimum; the score never falls."""
        history: list[float] = []
        products, gap = self.form.products(command), np.inf
        for _ in range(LONGEST_CLIMB):
            information = products @ command
            history.append(float(self.score(information)))
            gradient = 2 * np.einsum("ij,ijk->k", self.slope(information), products)
            direction = self.corner(gradient) - command
            gap = max(float(gradient @ direction), 0.0)
            if gap < SETTLED:
                break
            ahead = self.form.products(direction)
            s = SHARES[:, None, None]
            way = information + s * 2 * (products @ direction) + s * s * (ahead @ direction)
            best = int(np.argmax(self.score(way)))
            if best == 0:
                break
            command, products = command + SHARES[best] * direction, products + SHARES[best] * ahead
        return _Climb(command, gap, tuple(history))

    def inside(self, level: Array) -> Array:
        """The levels, slightly reduced where the motion between the steps, or rounding, exceeds the limits."""
        limits, command = self.limits, np.convolve(level, self.window)
        low, high, speed = extremes(self.form.dynamics, command, self.form.step)
        reach = (np.abs(command).max() / limits.command, low / limits.lower, high / limits.upper, speed / limits.speed)
        return np.asarray(level / max(1.0, *reach))


def _window(width: float, step: float) -> Array:
    """Hann window with sum 1, sampled at the steps; a single 1 where it is no wider than one step."""
    count = max(1, round(width / step))
    window = np.sin(np.pi * (np.arange(count) + 0.5) / count) ** 2
    return np.asarray(window / window.sum())


def _search(
    problem: _Problem, rng: np.random.Generator, first: Array | None, progress: Progress | None
) -> tuple[_Climb, tuple[float, ...]]:
    """Climbs from several signals, or from a first one, then repeatedly from the best with a part of it perturbed."""
    starts, scores = STARTS if first is None else 1, []
    best: _Climb | None = None
    for i in range(starts + ROUNDS):
        if progress is not None:
            progress(i / (starts + ROUNDS), f"optimal design: climb {i + 1} of {starts + ROUNDS}")
        if best is not None and i >= starts:
            begin = problem.corner(_disturbed(problem, best.command, rng))
        else:
            begin = problem.corner(_start(problem, rng, i)) if first is None else first
        climb = problem.climb(begin)
        scores.append(climb.history[-1])
        if best is None or scores[-1] > best.history[-1]:
            best = climb
    assert best is not None
    return best, tuple(scores)


def _start(problem: _Problem, rng: np.random.Generator, i: int) -> Array:
    """A start direction; in turn square waves of any period, random walks, binary noise."""
    if i % 3 == 0:
        period = np.exp(rng.uniform(np.log(0.5), np.log(12.0)))
        t = problem.form.step * np.arange(problem.n)
        return np.asarray(np.sin(2 * np.pi * (t / period + rng.random())))
    if i % 3 == 1:
        return np.asarray(np.cumsum(rng.standard_normal(problem.n)))
    return np.asarray(rng.choice([-1.0, 1.0], problem.n))


def _disturbed(problem: _Problem, command: Array, rng: np.random.Generator) -> Array:
    """The gradient at a flight, with a random walk added over a thirtieth to a quarter of its length."""
    products = problem.form.products(command)
    gradient = np.einsum("ij,ijk->k", problem.slope(products @ command), products)
    length = int(rng.integers(problem.n // 30 + 1, problem.n // 4 + 2))
    first = int(rng.integers(0, problem.n - length + 1))
    walk = np.cumsum(rng.standard_normal(length)) / np.sqrt(length)
    gradient[first : first + length] += rng.uniform(1, 6) * np.abs(gradient).mean() * walk
    return np.asarray(gradient)


def _chained(command: Array, step: float, period: float, pieces: int) -> Steps:
    """Chains equal pieces; a level equal to the previous one is left out."""
    level = np.append(command, 0.0)
    kept = np.flatnonzero(np.diff(level, prepend=0.0))
    time = np.concatenate([piece * period + step * kept for piece in range(pieces)])
    return Steps(tuple(np.maximum(time - EARLY, 0.0).tolist()), tuple(np.tile(level[kept], pieces).tolist()))
