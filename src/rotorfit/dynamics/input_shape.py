"""Laws that shape the commands of one axis before they act: a limit, a dead zone, a gain that differs by sign.

The same demand as in `general_step`, over the gain and for many commands at once.
"""

import numpy as np

from rotorfit.core.frames import Array
from rotorfit.core.laws import ASYMMETRY, DEAD, LEVEL

SHAPES = (ASYMMETRY, LEVEL, DEAD)
"""The elements of the law that shape commands."""


def shape_of(law: Array, command: Array) -> Array:
    """The command that acts, s(u), shape (M,), under the law of its axis, shape (LAW_SIZE,): the demand is g s(u)."""
    size = np.clip(np.abs(command) - law[DEAD], 0.0, law[LEVEL])
    return size * (_sign(command) + law[ASYMMETRY])  # type: ignore[no-any-return]


def shape_slope(law: Array, place: int, command: Array) -> Array:
    """Derivative of `shape_of` by an element of `SHAPES`, shape (M,)."""
    over = np.abs(command) - law[DEAD]
    if place == ASYMMETRY:
        return np.clip(over, 0.0, law[LEVEL])  # type: ignore[no-any-return]
    along = _sign(command) + law[ASYMMETRY]
    if place == LEVEL:
        return np.where(over > law[LEVEL], along, 0.0)
    return np.where((over > 0) & (over < law[LEVEL]), -along, 0.0)


def _sign(command: Array) -> Array:
    return np.where(command >= 0, 1.0, -1.0)
