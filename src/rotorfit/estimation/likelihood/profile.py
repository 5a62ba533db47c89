"""Profile likelihood: the best log-likelihood with one coefficient held, and intervals from it."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from rotorfit.core.frames import Array
from rotorfit.core.model import Interval
from rotorfit.estimation.likelihood.blocks import Record
from rotorfit.estimation.likelihood.fisher_scoring import Optimum, maximise
from rotorfit.estimation.likelihood.likelihood import degrees_of_freedom, inverted, level_share

NOT_WALKED = 0.1
"""Expected gain in log-likelihood that a re-maximisation leaves to be added rather than walked."""


def hold(
    records: Sequence[Record], optimum: Optimum, index: int, target: float, tolerance: float = NOT_WALKED
) -> Optimum:
    """Re-maximises over everything else with one parameter held at a target.

    Starts where the information expects the others to go, with the information conditional on the held one.

    Args:
        records: The flights.
        optimum: A maximum, free or at a neighbouring target.
        index: Of the held parameter in the order of `Point.flat`.
        target: Where it is held.
        tolerance: Expected gain in log-likelihood below which to stop.
    """
    free = optimum.free.copy()
    free[index] = False
    values = optimum.point.flat()
    inverse = optimum.inverse.copy()
    if inverse[index, index] > 0:
        along = inverse[:, index] / inverse[index, index]
        values = values + along * (target - values[index])
        inverse = inverse - np.outer(along, inverse[index])
    values[index] = target
    inverse[index, :] = inverse[:, index] = 0.0
    point = optimum.point.with_flat(np.clip(values, *optimum.point.bounds()))
    return maximise(records, point, free, inverse, optimum.restricted, tolerance=tolerance, prior=optimum.prior)


def height(optimum: Optimum) -> float:
    """Objective of an optimum with the expected gain of the step that was not worth walking."""
    return optimum.score.objective + min(optimum.gain, NOT_WALKED)


def quantile(optimum: Optimum, direction: Array) -> float:
    """97.5 % point for the signed root of twice the fall of the profile along a combination of coefficients.

    Student's t at the degrees of freedom that the levels leave; widened because the information at estimated levels is
    too large, by as much as their uncertainty adds to the variance. The profile itself holds what it adds, once.

    Source: M. G. Kenward, J. H. Roger, Biometrics 53 (1997), pp. 983-997, the factor 2 of the adjusted covariance.
    """
    from scipy.special import stdtrit

    share = min(level_share(optimum.score, optimum.free, direction), MOST_SHARE)
    widened = float(np.sqrt((1 + 2 * share) / (1 + share)))
    return float(stdtrit(degrees_of_freedom(optimum.score, optimum.free, direction), 0.975)) * widened


MOST_SHARE = 1.0
"""Largest share of the levels' uncertainty that is believed: beyond it the expansion says nothing."""

SCALED = 5
"""Looks by scaled steps before a bracket is halved."""

SECOND = 1.2
"""Step, as a share of the way so far, by which a walk goes on from an end that did not hold."""


@dataclass(frozen=True)
class Profile:
    """What holding one parameter showed.

    Attributes:
        ci95: The 95 % interval; an end that the searched range cuts off is None.
        points: Values looked at, increasing, and the objective there, re-maximised, less its maximum.
        fall: How far the objective falls to the ends of the interval.
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
        index: Of the parameter in the order of `Point.flat`.
    """
    values = optimum.point.flat()
    direction = np.zeros(values.size - optimum.point.levels.size)
    direction[index] = 1.0
    best, reach = float(values[index]), quantile(optimum, direction)
    error = float(np.sqrt(inverted(optimum.score.information, optimum.free)[index, index]))
    low, high = (float(bound[index]) for bound in optimum.point.bounds())
    points = [(best, 0.0)]
    ends = []
    for side, bound in ((-1.0, low), (1.0, high)):
        looks = [(best, optimum)]

        def root(target: float, looks: list[tuple[float, Optimum]] = looks) -> float:
            within = [look for look in looks if abs(look[0] - best) <= abs(target - best)]
            near = min(within, key=lambda look: abs(look[0] - target))[1]
            there = hold(records, near, index, target)
            looks.append((target, there))
            fall = max(height(optimum) - height(there), 0.0)
            points.append((target, -fall))
            return float(np.sqrt(2 * fall))

        def holds(inside: float, outside: float, looks: list[tuple[float, Optimum]] = looks) -> bool:
            near = hold(records, optimum, index, inside)
            there = hold(records, near, index, outside)
            fall = max(height(optimum) - height(there), 0.0)
            if np.sqrt(2 * fall) > reach:
                return True
            looks[:] = [look for look in looks if abs(look[0] - best) <= abs(inside - best)] + [(outside, there)]
            points[:] = [point for point in points if (point[0] - inside) * (outside - inside) <= 0] + [
                (outside, -fall)
            ]
            return False

        ends.append(_crossing(root, holds, best, best + side * reach * error, bound, reach))
    return Profile((ends[0], ends[1]), tuple(sorted(points)), 0.5 * reach**2)


def _crossing(
    root: Callable[[float], float],
    holds: Callable[[float, float], bool],
    best: float,
    guess: float,
    bound: float,
    reach: float,
) -> float | None:
    """Where the root of the fall passes `reach` on the way from `best` to `bound`; None where it does not.

    After twelve looks the outer end of the bracket is taken, if the fall holds there when it is reached from the inner
    end: a leap so far may have failed to come back to the top. Where it does not hold, the way goes on from there.
    """
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
    """Where the root of the fall is `reach`, if that was met, and the bracket around it; no outer end for none.

    The root is nearly linear where the likelihood is nearly quadratic, so the steps scale with it; a bracket keeps them
    honest where it is not and is halved where they are slow, as where the root is flat beyond the end: a level that no
    command reaches.
    """
    outside = None
    side = 1.0 if bound > best else -1.0
    for look in range(12):
        target = min(target, bound) if side > 0 else max(target, bound)
        value = root(target)
        if abs(value - reach) < 0.04:
            return target, inside, outside
        if value > reach:
            outside = target
        elif target == bound:
            return None, inside, None
        else:
            inside = target
        share = float(np.clip(reach / max(value, 1e-6), 0.3, 4.0))
        target = best + (target - best) * share
        if outside is not None and (look >= SCALED or not min(inside, outside) < target < max(inside, outside)):
            target = 0.5 * (inside + outside)
    return None, inside, outside
