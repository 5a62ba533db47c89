"""How often commands say something: a model's errors average out over events, and over one event they do not.

A likelihood counts every pose, and each of them tells of the one tap of a stick that the flight holds. Its interval is
right if the model is; what the model leaves out is another thing at the next tap, and only several of them show it.
"""

from collections.abc import Sequence

import numpy as np

from rotorfit.flight import Flight
from rotorfit.frames import AXES, Array
from rotorfit.long_run import quantile

NORMAL = 1.959964
"""97.5 % point of the normal distribution."""

EVENT = 1.0
"""Changes of a command within this time are one event [s]: the horizon by which models are judged, and the reach of the
tests of residuals. A tap, on and off, is one; a step that is held for longer, on and off, is two."""

ONE = 1.5
"""Events below which there is one: nothing can be told of how it differs from the next."""

TWICE = 2.0
"""How many times wider Student's interval over the events is, against that of many, from which on they are few."""


def command_events(flights: Sequence[Flight], axis: str) -> float:
    """How many events of equal size the commands of an axis are worth.

    Windows of `EVENT` begin at the first change outside of the one before; the size of an event is the range of the
    command in it, w its square, and the number is (sum w)^2 / sum w^2. Small corrections beside one large event count
    for little.

    Source: effective number of weighted observations: L. Kish, Survey Sampling (1965), section 11.7.

    Args:
        flights: That command the axis.
        axis: Name.
    """
    weights = np.concatenate([np.zeros(0), *(_ranges(f.command_time, f.command[:, AXES.index(axis)]) for f in flights)])
    weights = weights**2
    return float(weights.sum() ** 2 / (weights**2).sum()) if weights.any() else 0.0


def _ranges(time: Array, command: Array) -> Array:
    """Range of a held command in each window that begins with a change."""
    changes = np.flatnonzero(np.diff(command)) + 1
    ranges, first = [], 0
    while first < changes.size:
        end = int(np.searchsorted(time[changes], time[changes[first]] + EVENT))
        ranges.append(float(np.ptp(command[[changes[first] - 1, *changes[first:end]]])))
        first = end
    return np.array(ranges)


def widening(events: float) -> float:
    """How many times wider an interval over so many events is than the normal one, if what a model leaves out is
    another thing at each event; infinite for one.
    """
    return quantile(events - 1) / NORMAL if events >= ONE else float("inf")
