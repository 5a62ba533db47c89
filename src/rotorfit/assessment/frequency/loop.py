"""Does a command respond to the motion? Tested without any law of the vehicle.

Velocity is predicted from its own past and that of the command, up to a second back, by least squares: valid in a
feedback loop, too. The errors of the prediction are the innovations for the likelihood's test of feedback.

Source: L. Ljung, System Identification, 2nd ed., 1999, section 13.4 (direct method).
"""

import numpy as np

from rotorfit.assessment.frequency.spectra import Window
from rotorfit.core.frames import Array
from rotorfit.estimation.likelihood.feedback import loop_evidence

STEP = 0.04
"""Minimum time over which a velocity is taken [s]."""

PAST = 1.0
"""How far back the prediction looks [s]."""

LEAST = 4
"""Samples for each coefficient of the prediction below which there is no test."""


def answers_motion(windows: tuple[Window, ...]) -> bool:
    """Whether changes of the command follow motion that the past of command and motion did not predict."""
    step = max(STEP, *(1.5 * float(np.median(np.diff(window.time))) for window in windows))
    past = max(1, round(PAST / step))
    parts = [_lagged(window, step, past) for window in windows if window.duration > 2 * PAST]
    target, columns = (np.concatenate(each) for each in zip(*((y, X) for y, X, _ in parts), strict=True))
    if target.size < LEAST * columns.shape[1] or not np.ptp(columns[:, past + 1]) > 0:
        return False
    scale = np.maximum(np.sqrt(np.mean(columns**2, axis=0)), 1e-12)
    weights = np.linalg.lstsq(columns / scale, target, rcond=1e-9)[0] / scale
    return loop_evidence((command, y - X @ weights) for y, X, command in parts).closed


def _lagged(window: Window, step: float, past: int) -> tuple[Array, Array, Array]:
    """Velocity over each step (S,), its predictors (S, C), and the command in that step (S,).

    Where the heading turns within a window, what it brings in of the other command is a predictor, too: the command is
    that along the mean heading, and would seem to respond to what it leaves out.
    """
    edge = np.arange(window.time[0], window.time[-1], step)
    velocity = np.diff(np.interp(edge, window.time, window.position)) / step
    row = np.searchsorted(window.switch, (edge[:-1] + edge[1:]) / 2, side="right") - 1
    command = window.command[np.clip(row, 0, window.command.size - 1)]
    rows = np.arange(past, velocity.size)
    back = rows[:, None] - np.arange(past + 1)
    across = [np.asarray(one)[np.clip(row, 0, window.command.size - 1)] for one in (window.turned, window.turning)]
    beside = [one[back] for one in across if np.any(one)]
    X = np.hstack([velocity[back[:, 1:]], command[back], *beside, np.ones((rows.size, 1))])
    return velocity[rows], X, command[rows]
