"""Profile likelihood: the best log-likelihood with one coefficient held, and intervals from it."""

from collections.abc import Sequence

import numpy as np

from rotorfit.frames import Array
from rotorfit.likelihood import degrees_of_freedom, inverted
from rotorfit.maximum import Optimum, maximise
from rotorfit.model import Interval
from rotorfit.record import Record


def hold(records: Sequence[Record], optimum: Optimum, index: int, target: float) -> Optimum:
    """Re-maximises over everything else with one parameter held at a target.

    Starts where the information expects the others to go, with the information conditional on the held one.

    Args:
        records: The flights.
        optimum: A maximum, free or at a neighbouring target.
        index: Of the held parameter in the order of `Point.flat`.
        target: Where it is held.
    """
    free = optimum.free.copy()
    free[index] = False
    values = optimum.point.flat()
    inverse = optimum.inverse
    if inverse[index, index] > 0:
        along = inverse[:, index] / inverse[index, index]
        values = values + along * (target - values[index])
        inverse = inverse - np.outer(along, inverse[index])
    values[index] = target
    inverse[index, :] = inverse[:, index] = 0.0
    point = optimum.point.with_flat(np.clip(values, *optimum.point.bounds()))
    return maximise(records, point, free, inverse, optimum.adjusted, tolerance=0.02)


def height(optimum: Optimum) -> float:
    """Objective of an optimum with the expected gain of the step that was not worth walking."""
    return optimum.score.objective + optimum.gain


def quantile(optimum: Optimum, direction: Array) -> float:
    """97.5 % point of Student's t at the degrees of freedom that the levels leave for a combination of coefficients."""
    from scipy.special import stdtrit

    return float(stdtrit(degrees_of_freedom(optimum.score, optimum.free, direction), 0.975))


def interval(records: Sequence[Record], optimum: Optimum, index: int) -> tuple[Interval, list[tuple[float, float]]]:
    """95 % interval from the profile; an end that the searched range cuts off is None.

    The signed root of twice the fall is compared with Student's t rather than with 1.96, because the levels of the
    disturbance are estimates too.

    Args:
        records: The flights.
        optimum: The free maximum.
        index: Of the parameter in the order of `Point.flat`.

    Returns:
        The interval, and the profile's points (value, objective less the maximum).
    """
    values = optimum.point.flat()
    direction = np.zeros(values.size - optimum.point.levels.size)
    direction[index] = 1.0
    best, reach = float(values[index]), quantile(optimum, direction)
    error = float(np.sqrt(inverted(optimum.score.information, optimum.free)[index, index]))
    low, high = (float(bound[index]) for bound in optimum.point.bounds())
    points = [(best, 0.0)]
    ends: list[float | None] = []
    for side, bound in ((-1.0, low), (1.0, high)):
        target, end = best + side * reach * error, None
        for _ in range(10):
            target = max(low, min(high, target))
            fall = max(height(optimum) - height(hold(records, optimum, index, target)), 1e-9)
            points.append((target, -fall))
            root = np.sqrt(2 * fall)
            if abs(root - reach) < 0.04:
                end = target
                break
            if target == bound and root < reach:
                break
            target = best + (target - best) * float(np.clip(reach / root, 0.25, 4.0))
        ends.append(end)
    return (ends[0], ends[1]), sorted(points)
