"""Profile likelihood: the best log-likelihood with one coefficient held, and intervals from it."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from rotorfit.core.frames import Array
from rotorfit.core.model import Interval
from rotorfit.core.results import student_quantile
from rotorfit.estimation.likelihood.blocks import Record
from rotorfit.estimation.likelihood.fisher_scoring import Optimum, maximise
from rotorfit.estimation.likelihood.likelihood import degrees_of_freedom, inverted, level_share
from rotorfit.estimation.likelihood.parameters import Point

NOT_WALKED = 0.1
"""Expected gain in log-likelihood at which a re-maximisation stops; the gain is then added to the objective."""


LONGEST_IN_VALLEY = 1.5
"""Largest change of the logarithm of a gain in a step along a valley."""


def hold(
    records: Sequence[Record], optimum: Optimum, index: int, target: float, tolerance: float = NOT_WALKED
) -> Optimum:
    """Re-maximises over all other free parameters with one parameter held at a target.

    The start is the linear prediction of the other parameters from the information, with the information conditional on
    the held parameter. From a neighbouring target it follows the valley, with gains by their logarithms. From the
    maximum itself it goes straight: further off the valley the climb finds other maxima more often.

    Args:
        records: The flights.
        optimum: A maximum, free or at a neighbouring target.
        index: Index of the held parameter in `Point.flat`.
        target: Value at which it is held.
        tolerance: Expected gain in log-likelihood below which to stop.
    """
    free = optimum.free.copy()
    free[index] = False
    point, inverse = optimum.point, optimum.inverse.copy()
    distance = target - float(point.flat()[index])
    if inverse[index, index] > 0:
        along = inverse[:, index] / inverse[index, index]
        inverse = inverse - np.outer(along, inverse[index])
        step = distance * along
    else:
        moving = np.diag(inverse) > 0
        moving[index] = True
        together = inverted(optimum.score.information, moving)[:, index]
        step = _in_valley(point, distance * together / together[index], index)
    point = point.moved(step).held_at(index, target)
    inverse[index, :] = inverse[:, index] = 0.0
    linear = optimum.score.linear
    return maximise(
        records, point, free, inverse, optimum.restricted, tolerance=tolerance, prior=optimum.prior, linear=linear
    )


def _in_valley(point: Point, step: Array, index: int) -> Array:
    """A step with gains by their logarithms: flights determine best the ratio of gain and damping.

    Args:
        point: Where it starts.
        step: In the order of `Point.flat`, shape (n + L K,).
        index: Index of the parameter that is taken to a target.

    Returns:
        The step, which reaches the target of a gain up to `LONGEST_IN_VALLEY`; of the same shape.
    """
    gain, moved = point.gain, step.copy()
    if index < gain.size and step[index] and gain[index] * (gain[index] + step[index]) > 0:
        moved *= gain[index] / step[index] * np.log1p(step[index] / gain[index])
    share = np.divide(moved[: gain.size], gain, out=np.zeros_like(gain), where=gain != 0)
    moved[: gain.size] = gain * np.expm1(np.clip(share, -LONGEST_IN_VALLEY, LONGEST_IN_VALLEY))
    return moved


def height(optimum: Optimum) -> float:
    """Objective of an optimum plus the expected gain of the last step, which was not taken."""
    return optimum.score.objective + min(optimum.gain, NOT_WALKED)


def quantile(optimum: Optimum, direction: Array) -> float:
    """97.5 % point of the signed root of twice the fall of the profile along a direction, shape (n,).

    It is that of Student's t, with the degrees of freedom at estimated levels. It is widened because the information at
    estimated levels is too large by the variance that their uncertainty adds; the profile includes that variance once.

    Source: M. G. Kenward, J. H. Roger, Biometrics 53 (1997), pp. 983-997, the factor 2 of the adjusted covariance.
    """
    share = min(level_share(optimum.score, optimum.free, direction), MOST_SHARE)
    widened = float(np.sqrt((1 + 2 * share) / (1 + share)))
    return student_quantile(degrees_of_freedom(optimum.score, optimum.free, direction)) * widened


MOST_SHARE = 1.0
"""Upper limit of the share of the levels' uncertainty: beyond it the expansion is not valid."""

CLOSE = 0.04
"""Largest difference of the root of the fall at an end of an interval from the value looked for."""

FURTHER = 4.0
"""Largest factor on the distance from the maximum between two evaluations."""

NARROW = 0.01
"""Width of a bracket, relative to its distance from the maximum, at which its outer end is taken."""

FIRST, FIRST_DELAY = 0.5, 0.05
"""Longest first step from the maximum: share of a gain and change of a logarithm; change of a delay [s]. A climb from
far outside takes many passes, and most of a wide interval's ends are not where the information places them."""

SECOND = 1.2
"""Factor on the distance from the maximum with which the search continues from an end that was not confirmed."""


@dataclass(frozen=True)
class Profile:
    """Profile of one parameter.

    Attributes:
        ci95: The 95 % interval; an end that a bound of the search cuts off is None.
        points: Increasing values of the parameter, each with the re-maximised objective less its maximum.
        fall: Fall of the objective at the ends of the interval.
    """

    ci95: Interval
    points: tuple[tuple[float, float], ...]
    fall: float


def profile(records: Sequence[Record], optimum: Optimum, index: int) -> Profile:
    """95 % interval of a parameter from its profile.

    The signed root of twice the fall is compared with Student's t rather than with 1.96, because the levels of the
    disturbance are estimates too.

    Args:
        records: The flights.
        optimum: The free maximum.
        index: Index of the parameter in `Point.flat`.
    """
    values = optimum.point.flat()
    direction = np.zeros(values.size - optimum.point.levels.size)
    direction[index] = 1.0
    best, reach = float(values[index]), quantile(optimum, direction)
    error = float(np.sqrt(optimum.covariance[index, index]))
    low, high = (float(bound[index]) for bound in optimum.point.bounds())
    first = _first_step(optimum.point, index, reach * error)
    sides = [_Side(records, optimum, index, reach) for _ in range(2)]
    ends = [
        _crossing(side.root, side.holds, best, best + sign * first, bound, reach)
        for side, sign, bound in zip(sides, (-1.0, 1.0), (low, high), strict=True)
    ]
    points = dict(point for side in sides for point in side.points()) | {best: 0.0}
    return Profile((ends[0], ends[1]), tuple(sorted(points.items())), 0.5 * reach**2)


class _Side:
    """One side of a profile: the maxima with the parameter held that were climbed to there.

    Args:
        records, optimum, index: As for `profile`.
        reach: Signed root at the end of the interval.
    """

    def __init__(self, records: Sequence[Record], optimum: Optimum, index: int, reach: float) -> None:
        self._records, self._free, self._index, self._reach = records, optimum, index, reach
        self._best = float(optimum.point.flat()[index])
        self._looks = [(self._best, optimum)]

    def root(self, target: float) -> float:
        """Signed root of the likelihood ratio at a value, climbed to from the nearest one between it and the best."""
        within = [look for look in self._looks if abs(look[0] - self._best) <= abs(target - self._best)]
        near = min(within, key=lambda look: abs(look[0] - target))[1]
        there = hold(self._records, near, self._index, target)
        self._looks.append((target, there))
        return float(np.sqrt(2 * self._fall(there)))

    def holds(self, inside: float, outside: float) -> bool:
        """Whether a crossing stands: climbed to from inside, the value outside lies beyond the reach, too.

        If not, what was found further out is forgotten: it belongs to a lower maximum.
        """
        near = next(look for place, look in self._looks if place == inside)
        there = hold(self._records, near, self._index, outside)
        if np.sqrt(2 * self._fall(there)) > self._reach:
            return True
        kept = [look for look in self._looks if abs(look[0] - self._best) <= abs(inside - self._best)]
        self._looks = [*kept, (outside, there)]
        return False

    def points(self) -> list[tuple[float, float]]:
        """Values, and how far the log-likelihood lies below its maximum there."""
        return [(value, -self._fall(there)) for value, there in self._looks]

    def _fall(self, there: Optimum) -> float:
        return max(height(self._free) - height(there), 0.0)


def _first_step(point: Point, index: int, expected: float) -> float:
    """First step of a parameter from the maximum, at most `expected`, the distance that the information gives.

    A gain near 0 counts as a thousandth of that distance at least: it must be left in few steps, too.
    """
    K = point.gain.size
    if index < K:
        return min(expected, FIRST * max(abs(float(point.gain[index])), 1e-3 * expected))
    return min(expected, FIRST_DELAY if 2 * K <= index < 3 * K else FIRST)


def _crossing(
    root: Callable[[float], float],
    holds: Callable[[float, float], bool],
    best: float,
    guess: float,
    bound: float,
    reach: float,
) -> float | None:
    """Where the root of the fall crosses `reach` between `best` and `bound`; None where it does not.

    After twelve evaluations, or where the bracket is narrow, its outer end is returned, if the fall there is confirmed
    by re-maximising from the inner end: after a long step the maximisation may have missed the maximum. If it is not
    confirmed, the search continues from there.
    """
    if best == bound:
        return None
    end, inside, outside = _walk(root, best, best, guess, bound, reach)
    if end is not None or outside is None:
        return end
    if holds(inside, outside):
        return outside
    further = best + SECOND * (outside - best)
    end, inside, outside = _walk(root, best, outside, further, bound, reach)
    return end if end is not None or outside is None or not holds(inside, outside) else outside


def _walk(
    root: Callable[[float], float], best: float, inside: float, target: float, bound: float, reach: float
) -> tuple[float | None, float, float | None]:
    """Where the root of the fall equals `reach`, or None; and the bracket around it, with None for no outer end.

    The root is nearly linear where the likelihood is nearly quadratic: steps outwards follow its last slope, and a
    bracket is divided where the line between its ends crosses. Where that leaves more than half of it, as where the
    root is flat beyond the end, it is bisected next. Where the profile jumps from one maximum to another, the bracket
    becomes narrow without an end in it.
    """
    outside: float | None = None
    below, above, width = -reach, 0.0, np.inf
    last = best, -reach
    for _ in range(12):
        target = min(target, bound) if bound > best else max(target, bound)
        off = root(target) - reach
        if abs(off) < CLOSE:
            return target, inside, outside
        if off > 0:
            outside, above = target, off
        elif target == bound:
            return None, inside, None
        else:
            inside, below = target, off
        if outside is None:
            slope, last = (off - last[1]) / (target - last[0]), (target, off)
            longest = (FURTHER - 1) * (target - best)
            step = -off / slope if slope * longest > 0 else longest
            target += step if abs(step) < abs(longest) else longest
            continue
        before, width = width, abs(outside - inside)
        if width < NARROW * abs(outside - best):
            break
        share = 0.5 if width > 0.5 * before else float(np.clip(below / (below - above), 0.1, 0.9))
        target = inside + (outside - inside) * share
    return None, inside, outside
