"""Does a command answer the motion? Told without any law of the vehicle.

Velocity is predicted from its own past and that of the command, as far back as a second, by least squares: right in a
loop, too. What the prediction misses is white, so in an open loop it is not correlated with any later change of the
command, however these are correlated among themselves.

Source: L. Ljung, System Identification, 2nd ed., 1999, section 13.4 (direct method); C. W. J. Granger, Econometrica 37
(1969), pp. 424-438.
"""

import numpy as np

from rotorfit.assessment.frequency.spectra import Window
from rotorfit.core.frames import Array
from rotorfit.estimation.likelihood.axis_estimate import LOOP_SIGMAS

STEP = 0.04
"""Least time over which velocities are taken [s]."""

PAST = 1.0
"""How far back the prediction looks [s]."""

REACH = 0.6
"""How long after a surprise an answer is looked for [s]."""

LEAST = 4
"""Samples for each number of the prediction, below which nothing is said."""


def answers_motion(windows: tuple[Window, ...]) -> bool:
    """Whether changes of the command follow what its past and that of the motion did not foresee."""
    step = max(STEP, *(1.5 * float(np.median(np.diff(window.time))) for window in windows))
    past = max(1, round(PAST / step))
    parts = [_lagged(window, step, past) for window in windows if window.duration > 2 * PAST]
    target, columns = (np.concatenate(each) for each in zip(*((y, X) for y, X, _ in parts), strict=True))
    if target.size < LEAST * columns.shape[1] or not np.ptp(columns[:, past + 1]) > 0:
        return False
    scale = np.maximum(np.sqrt(np.mean(columns**2, axis=0)), 1e-12)
    weights = np.linalg.lstsq(columns / scale, target, rcond=1e-9)[0] / scale
    lags = np.arange(1, max(1, round(REACH / step)) + 1)
    products, number, surprise = np.zeros(lags.size), 0.0, 0.0
    for y, X, command in parts:
        missed = y - X @ weights
        change = np.diff(command, append=command[-1])  # after the step that is predicted
        products += [float(missed[: missed.size - lag] @ change[lag - 1 : missed.size - 1]) for lag in lags]
        number += float(change @ change)
        surprise += float(np.mean(missed**2))
    spread = np.sqrt(number * surprise / len(parts))
    return bool(spread > 0 and np.abs(products).max() > LOOP_SIGMAS * spread)


def _lagged(window: Window, step: float, past: int) -> tuple[Array, Array, Array]:
    """Velocity over each step (S,), what predicts it (S, 2 past + 2), and the command in that step (S,)."""
    edge = np.arange(window.time[0], window.time[-1], step)
    velocity = np.diff(np.interp(edge, window.time, window.position)) / step
    row = np.searchsorted(window.switch, (edge[:-1] + edge[1:]) / 2, side="right") - 1
    command = window.command[np.clip(row, 0, window.command.size - 1)]
    rows = np.arange(past, velocity.size)
    back = rows[:, None] - np.arange(past + 1)
    X = np.hstack([velocity[back[:, 1:]], command[back], np.ones((rows.size, 1))])
    return velocity[rows], X, command[rows]
