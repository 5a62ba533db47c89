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

NOT_WALKED = 0.1
"""Expected gain in log-likelihood at which a re-maximisation stops; the gain is then added to the objective."""


def hold(
    records: Sequence[Record], optimum: Optimum, index: int, target: float, tolerance: float = NOT_WALKED
) -> Optimum:
    """Re-maximises over all other free parameters with one parameter held at a target.

    The start is the linear prediction of the other parameters from the information, with the information conditional on
    the held parameter.

    Args:
        records: The flights.
        optimum: A maximum, free or at a neighbouring target.
        index: Index of the held parameter in `Point.flat`.
        target: Value at which it is held.
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

SCALED = 5
"""Number of evaluations by scaled steps before the bracket is bisected."""

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
    """Where the root of the fall crosses `reach` between `best` and `bound`; None where it does not.

    After twelve evaluations the outer end of the bracket is returned, if the fall there is confirmed by re-maximising
    from the inner end: after a long step the maximisation may have missed the maximum. If it is not confirmed, the
    search continues from there.
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
    """Where the root of the fall equals `reach`, or None; and the bracket around it, with None for no outer end.

    The root is nearly linear where the likelihood is nearly quadratic, so steps scale with it. A bracket safeguards
    them; it is bisected where they converge slowly, for example where the root is flat beyond the end, as for a
    saturation level that no command reaches.
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
