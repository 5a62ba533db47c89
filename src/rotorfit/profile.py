"""Profile likelihood: the best log-likelihood with one coefficient held, and intervals from it."""

import numpy as np

from rotorfit.frames import Array
from rotorfit.likelihood import Optimum, Record, maximise
from rotorfit.model import Interval
from collections.abc import Sequence

ROOT_OF_CHI2 = 1.959963984540054
"""Square root of the 95 % point of chi-squared with one degree of freedom."""


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
    return maximise(records, optimum.point.with_flat(np.clip(values, *optimum.point.bounds())), free, inverse, tolerance=0.02)


def height(optimum: Optimum) -> float:
    """Log-likelihood of an optimum with the expected gain of the step that was not worth walking."""
    return optimum.score.log_likelihood + optimum.gain


def interval(records: Sequence[Record], optimum: Optimum, index: int, error: float) -> tuple[Interval, list[tuple[float, float]]]:
    """95 % interval where the profile falls by 1.92; an end that the searched range cuts off is None.

    Args:
        records: The flights.
        optimum: The free maximum.
        index: Of the parameter in the order of `Point.flat`.
        error: Its standard error, to begin with.

    Returns:
        The interval, and the profile's points (value, log-likelihood less the maximum).
    """
    best = float(optimum.point.flat()[index])
    low, high = (float(bound[index]) for bound in optimum.point.bounds())
    points = [(best, 0.0)]
    ends: list[float | None] = []
    for side, bound in ((-1.0, low), (1.0, high)):
        target, end = best + side * ROOT_OF_CHI2 * error, None
        for _ in range(10):
            target = max(low, min(high, target))
            fall = max(height(optimum) - height(hold(records, optimum, index, target)), 1e-9)
            points.append((target, -fall))
            root = np.sqrt(2 * fall)
            if abs(root - ROOT_OF_CHI2) < 0.04:
                end = target
                break
            if target == bound and root < ROOT_OF_CHI2:
                break
            target = best + (target - best) * float(np.clip(ROOT_OF_CHI2 / root, 0.25, 4.0))
        ends.append(end)
    return (ends[0], ends[1]), sorted(points)
