"""Maximisation of the likelihood: Fisher scoring with a secant correction, inside the bounds of the search."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from rotorfit.core.frames import Array, Mask
from rotorfit.core.laws import START_LEVELS, level_range
from rotorfit.estimation.likelihood.blocks import Record
from rotorfit.estimation.likelihood.likelihood import (
    LikelihoodScore,
    LinearAdjustment,
    Restriction,
    adjustment,
    inverted,
    restriction,
    score,
)
from rotorfit.estimation.likelihood.parameters import Point
from rotorfit.estimation.likelihood.prior import GaussianPrior, with_prior
from rotorfit.estimation.likelihood.stretches import stretches

LEVEL_DAMPING = 0.1
"""Added to the information of each level to limit the step in directions in which the likelihood is flat."""

EDGE = 1e-9
"""Distance from a bound at which a parameter counts as at the bound."""

FLAT_OVERLAP = np.log(0.05)
"""Logarithm of the overlap below which the likelihood hardly depends on the overlap."""

FAST_DISTURBANCE = np.log(50.0)
"""Logarithm of the disturbance's damping above which blocks of 1/30 s do not resolve it, and a climb can get stuck."""

MOST_TRIES = 8
"""Passes of a line search."""

SECANT_BELOW = 20.0
"""Expected gain in log-likelihood below which the secant correction is kept from pass to pass."""


CUT = 4
"""Passes of a line search from which the step counts as cut short: then the information is damped..."""

RIDGE = 0.01
"""... at first by this share of its diagonal. Where lag and damping are two equal poles, exchanging them has no effect
to first order: the information says nothing of their difference, and steps along it are far too long."""

MOST_RIDGE = 0.5
"""Share from which a step that raises nothing ends the climb."""

SHORTER = 0.5
"""Share of the blocks below which it pays to climb first on stretches of the flights..."""

NEAR_ENOUGH = 0.1
"""... and expected gain in log-likelihood at which that climb stops."""

HIGHER = 0.05
"""Rise of the log-likelihood by other levels alone from which all parameters are climbed there. In 18 second climbs
under richer laws on 8 recorded and simulated flights this missed no rise above 0.01."""

LINEAR = 0.3
"""Largest change of a log level over which the adjustment is taken to first order. Over longer ones a climb can go to
another maximum of the levels."""


@dataclass(frozen=True)
class Optimum:
    """A maximum of the likelihood over the free parameters.

    Attributes:
        point: The parameters.
        score: Objective, gradient and information there.
        free: True for the free parameters, shape (n + L K,).
        restricted: The restriction of the likelihood; None where levels were held.
        inverse: Inverse information with the secant corrections of the climb; zero for fixed parameters.
        gain: Expected gain in log-likelihood of one more step: a measure of convergence.
        passes: Number of passes over the flights.
        prior: The prior, if one was used; the score includes it.
    """

    point: Point
    score: LikelihoodScore
    free: Mask
    restricted: Restriction | None
    inverse: Array
    gain: float
    passes: int
    prior: GaussianPrior | None = None

    @cached_property
    def covariance(self) -> Array:
        """Inverse of the expected information over the free parameters, zero elsewhere, shape (n + L K, n + L K)."""
        return inverted(self.score.information, self.free)

    @property
    def promise(self) -> float:
        """Expected gain in log-likelihood of one step that moves the levels as well, where they were held."""
        free = self.free.copy()
        free[self.point.n :] = True
        movable = free & ~at_bound(self.point, self.score.gradient)
        step = inverted(_damped(self.score.information, self.point.n), movable) @ self.score.gradient
        return 0.5 * float(step @ self.score.gradient)


@dataclass
class _Objective:
    """What is maximised: with the adjustment to first order on the way, and exactly in the end.

    Attributes:
        records: The flights.
        restricted: The restriction of the likelihood; None where levels are held.
        prior: Added to the objective, if there is one.
        linear: The adjustment to first order, updated by every exact pass; None before the first.
        reach: Largest change of a log level over which it is used; negative where all passes are exact.
    """

    records: Sequence[Record]
    restricted: Restriction | None
    prior: GaussianPrior | None
    linear: LinearAdjustment | None
    reach: float

    def exact(self, point: Point) -> LikelihoodScore:
        """The score at a point."""
        there = score(self.records, point, self.restricted)
        self.linear = there.linear
        return with_prior(there, point, self.prior)

    def near(self, point: Point) -> LikelihoodScore:
        """The score at a point, with the adjustment to first order where that reaches so far."""
        if self.linear is None or not self.linear.reaches(point.levels, self.reach):
            return self.exact(point)
        return with_prior(score(self.records, point, self.linear), point, self.prior)

    def settled(self, there: LikelihoodScore, point: Point) -> LikelihoodScore:
        """A score at a point with the exact adjustment, if not with its exact derivatives."""
        if there.exact or self.restricted is None or there.linear is None:
            return there
        missing = adjustment(self.records, point, self.restricted) - there.linear.at(point.levels)
        return replace(there, adjustment=there.adjustment + missing)

    def readjusted(self, earlier: LikelihoodScore, point: Point) -> LikelihoodScore:
        """An earlier score at a point, with the adjustment as it is now, so that objectives can be compared."""
        if self.reach < 0 or self.linear is None or earlier.linear is None or earlier.linear is self.linear:
            return earlier
        gradient = earlier.gradient.copy()
        gradient[point.n :] += self.linear.slope - earlier.linear.slope
        change = self.linear.at(point.levels) - earlier.linear.at(point.levels)
        return replace(earlier, adjustment=earlier.adjustment + change, gradient=gradient, linear=self.linear)


def maximise(
    records: Sequence[Record],
    point: Point,
    free: Mask,
    inverse: Array | None = None,
    restricted: Restriction | None = None,
    tolerance: float = 1e-3,
    most: int = 80,
    prior: GaussianPrior | None = None,
    linear: LinearAdjustment | None = None,
) -> Optimum:
    """Maximises the likelihood: Fisher scoring, with a secant (BFGS) correction of the information near the top.

    Args:
        records: The flights.
        point: Where to start.
        free: True for the parameters that may move, shape (n + L K,).
        inverse: Inverse information to start with, if known.
        restricted: The restriction of the likelihood; by default that of the free parameters, with the start as
            reference, if levels are free.
        tolerance: Expected gain in log-likelihood below which to stop.
        most: Number of passes at which to stop.
        prior: Added to the objective.
        linear: The adjustment near the start, to first order, where its derivatives need not be exact in the end; by
            default the last pass is exact.
    """
    if restricted is None and free[-1]:
        restricted = restriction(records, point, free)
    rough = linear is not None
    objective = _Objective(records, restricted, prior, linear, LINEAR)
    best = objective.near(point)
    passes, active, fresh = 1, free & ~at_bound(point, best.gradient), inverse is None
    ridge = 0.0
    while True:
        movable = free & ~at_bound(point, best.gradient)
        if inverse is None or fresh or not np.array_equal(movable, active):
            inverse, active, fresh = inverted(_damped(best.information, point.n, ridge), movable), movable, True
        step = inverse @ best.gradient
        stuck = at_bound(point, step) & active
        if stuck.any():  # at a bound and pushed outwards by correlated parameters, not by its own gradient
            active = active & ~stuck
            inverse, fresh = inverted(_damped(best.information, point.n, ridge), active), True
            step = inverse @ best.gradient
        gain = 0.5 * float(step @ best.gradient)
        if gain < tolerance or passes >= most:
            if rough or best.exact:
                break
            best, passes, objective.reach = objective.exact(point), passes + 1, -1.0
            continue
        step = limit_step(step, point.gain.size, point.extra.size, point.levels.size)
        step = point.reach(step) * step
        trial, result, tried = _line_search(objective, point, best, step, active)
        passes += tried
        cut = tried >= CUT and gain > NEAR_ENOUGH
        ridge = max(10 * ridge, RIDGE) if cut else (0.1 * ridge if ridge > RIDGE else 0.0)
        best = objective.readjusted(best, point)
        if result.objective <= best.objective:
            damped = cut and ridge <= MOST_RIDGE
            if fresh and not damped and (rough or best.exact):
                break
            if fresh and not damped:
                best, passes, objective.reach = objective.exact(point), passes + 1, -1.0
            fresh = True
            continue
        fall = np.where(active, best.gradient - result.gradient, 0.0)
        fresh = gain > SECANT_BELOW or passes < 3 or cut
        inverse = _secant(inverse, trial.flat() - point.flat(), fall)
        point, best = trial, result
    return Optimum(point, objective.settled(best, point), free, restricted, inverse, gain, passes, prior)


def on_stretches(
    records: Sequence[Record], point: Point, free: Mask, prior: GaussianPrior | None = None
) -> tuple[list[Record], Optimum] | None:
    """Stretches of long flights, and roughly the maximum of their likelihood; None for others.

    Args:
        records: The flights.
        point: Where to start, apart from the start velocities.
        free: True for the parameters that may move, all start velocities among them.
        prior: Added to the objective.
    """
    short = [stretches(rec) for rec in records]
    if sum(rec.count.size for rec in short) > SHORTER * sum(rec.count.size for rec in records):
        return None
    parts, (K, L) = sum(rec.starts.size for rec in short), point.levels.shape
    begin = replace(point, start=np.zeros((parts, K)))
    moving = np.concatenate([free[: point.n - point.start.size], np.ones(parts * K, bool), free[-K * L :]])
    return short, maximise(short, begin, moving, tolerance=NEAR_ENOUGH, prior=prior)


def approached(records: Sequence[Record], point: Point, free: Mask, prior: GaussianPrior | None = None) -> Point:
    """A start nearer to the maximum, climbed on stretches of long flights; the point itself for others.

    A climb is mostly the way to the neighbourhood of the maximum, which a part of the data shows as well. Arguments as
    for `on_stretches`; start velocities are kept.
    """
    found = on_stretches(records, point, free, prior)
    return replace(found[1].point, start=point.start) if found else point


def climb(
    records: Sequence[Record],
    point: Point,
    free: Mask,
    tolerance: float = 1e-3,
    most: int = 80,
    prior: GaussianPrior | None = None,
) -> Optimum:
    """Maximises, and again from moderate poles of the disturbance where the first climb ended at extreme ones.

    The likelihood is flat where the overlap is far below one and where a pole is faster than the blocks: a climb that
    enters these regions stays there. The second start keeps the variance of the disturbance's velocity. A richer law
    comes from the maximum of a simpler one that was sought from both: there the levels alone are climbed first, and all
    parameters only where that ends higher. The better of the maxima is returned; arguments as for `maximise`.
    """
    first = maximise(records, point, free, tolerance=tolerance, most=most, prior=prior)
    fast, flat = first.point.levels[:, 2] > FAST_DISTURBANCE, first.point.levels[:, 3] < FLAT_OVERLAP
    if not (fast | flat).any() or not free[-1]:
        return first
    levels = first.point.levels.copy()
    levels[fast | flat, 3] = START_LEVELS[3]
    levels[fast, 2] = START_LEVELS[2]
    change = (levels - first.point.levels)[fast]
    levels[fast, 0] += 3 * change[:, 2] + change[:, 3]  # the velocity's variance is 2 q / (kappa alpha^3)
    moderate = replace(first.point, levels=np.maximum(levels, level_range(first.point.measured)[:, 0]))
    if point.structures:
        alone = free & (np.arange(free.size) >= point.n)
        other = maximise(
            records, moderate, alone, restricted=first.restricted, tolerance=NEAR_ENOUGH, most=most, prior=prior
        )
        if other.score.log_likelihood <= first.score.log_likelihood + HIGHER:
            return first
        moderate = other.point
    again = maximise(records, moderate, free, tolerance=tolerance, most=most, prior=prior)
    return again if again.score.log_likelihood > first.score.log_likelihood else first


def _line_search(
    objective: _Objective, point: Point, here: LikelihoodScore, step: Array, active: Mask
) -> tuple[Point, LikelihoodScore, int]:
    """Shortens a step until the objective rises, in at most eight tries; the last point, its score and their number.

    Where the objective falls only because the linear parameters do not go with the others, they are solved for.
    """
    tried = 0
    while True:
        trial = point.moved(step)
        result = objective.near(trial)
        tried += 1
        here = objective.readjusted(here, point)
        if result.objective > here.objective or tried >= MOST_TRIES:
            return trial, result, tried
        solved, expected = _solved(trial, result, active)
        if expected > here.objective and (np.sign(solved.gain) == np.sign(trial.gain)).all():
            result = objective.near(solved)
            tried += 1
            if result.objective > here.objective:
                return solved, result, tried
        step = 0.3 * step


def _solved(point: Point, there: LikelihoodScore, active: Mask) -> tuple[Point, float]:
    """The point with its active gains, trims and start velocities solved for, and the objective expected there.

    The motion is linear in them.

    Source: G. H. Golub, V. Pereyra, SIAM J. Numer. Anal. 10 (1973), pp. 413-432.
    """
    linear = active.copy()
    linear[point.gain.size : point.coefficients] = linear[point.n :] = False
    step = inverted(there.information, linear) @ there.gradient
    return point.moved(step), there.objective + 0.5 * float(step @ there.gradient)


def _damped(information: Array, n: int, ridge: float = 0.0) -> Array:
    """The information with a share of its diagonal added, and `LEVEL_DAMPING` for every level.

    Args:
        information: Shape (n + L K, n + L K).
        n: Number of parameters before the levels.
        ridge: The share.
    """
    out = information.copy()
    out[np.diag_indices(len(out))] *= 1 + ridge
    out[np.arange(n, len(out)), np.arange(n, len(out))] += LEVEL_DAMPING
    return out


def _secant(inverse: Array, step: Array, change: Array) -> Array:
    """BFGS update of an inverse information by a step and the fall of the gradient along it."""
    curvature = float(step @ change)
    if curvature <= 1e-12:
        return inverse
    left = np.eye(step.size) - np.outer(step, change) / curvature
    return left @ inverse @ left.T + np.outer(step, step) / curvature


def at_bound(point: Point, gradient: Array) -> Mask:
    """True where a parameter is at a bound and the gradient points outwards."""
    value, (low, high) = point.flat(), point.bounds()
    return ((value <= low + EDGE) & (gradient < 0)) | ((value >= high - EDGE) & (gradient > 0))


def limit_step(step: Array, K: int, extra: int = 0, levels: int = 4) -> Array:
    """Shortens a step that changes log b or a further parameter by more than 1.5, delay by 0.08 s, or log level by 2.

    Args:
        step: Step in the order of `Point.flat`.
        K: Number of axes.
        extra: Number of further parameters of all axes.
        levels: Number of levels of all axes.
    """
    further = step[3 * K : 3 * K + extra]
    parts = ((step[K : 2 * K], 1.5), (step[2 * K : 3 * K], 0.08), (further, 1.5), (step[-levels:], 2.0))
    return step / max(*(float(np.abs(part).max(initial=0.0)) / most for part, most in parts), 1.0)
