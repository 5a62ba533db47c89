"""Commands -> the time in which they tell something of the vehicle: a few seconds after each new one."""

import numpy as np

from rotorfit.core.frames import Array

QUIET = 5.0
"""Time without a new command after which an axis is `holding` [s]: by then it has answered the last one."""

LONGEST = 300.0
"""Excited time that an estimate looks back over [s]; older parts of a regime are not used."""


def excited_time(time: Array, command: Array, since: float, now: float) -> float:
    """Excited time between two instants [s]: at most `QUIET` after each new command of some axes.

    Args:
        time: Of the commands, shape (N,) [s].
        command: Of these axes, shape (N, K).
        since: The first instant [s].
        now: The second [s].
    """
    return float(_answered(time, command, since, now)[1].sum())


def excited_since(time: Array, command: Array, since: float, now: float) -> float:
    """Time since which there is `LONGEST` of excited time [s]; `since` where there is less; arguments as above."""
    begin, length = _answered(time, command, since, now)
    after = np.cumsum(length[::-1])[::-1]  # from each command on
    enough = np.flatnonzero(after >= LONGEST)
    return float(begin[enough[-1]] + after[enough[-1]] - LONGEST) if enough.size else since


def _answered(time: Array, command: Array, since: float, now: float) -> tuple[Array, Array]:
    """Begin of each stretch of excited time, and its length, both (N,) [s]."""
    new = time[1:][np.any(np.diff(command, axis=0) != 0, axis=1)]
    begin, end = np.maximum(new, since), np.minimum(np.append(new[1:], now), np.minimum(new + QUIET, now))
    return begin, np.maximum(end - begin, 0.0)
