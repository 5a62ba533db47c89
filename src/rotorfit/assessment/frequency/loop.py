"""Does a command respond to the motion, and what does that do to scores? Tested without any law of the vehicle.

Velocity is predicted from its own past and that of the command, up to a second back, by least squares: valid in a
feedback loop, too. The errors of the prediction are the innovations for the likelihood's test of feedback.

Source: L. Ljung, System Identification, 2nd ed., 1999, section 13.4 (direct method).
"""

from collections.abc import Iterator, Sequence

import numpy as np

from rotorfit.assessment.frequency.spectra import Window, windows_of
from rotorfit.core.finding import Finding
from rotorfit.core.flight_data import Flight
from rotorfit.core.frames import AXES, Array
from rotorfit.estimation.likelihood.feedback import LoopEvidence, loop_evidence

STEP = 0.04
"""Minimum time over which a velocity is taken [s]."""

PAST = 1.0
"""How far back the prediction looks [s]."""

SOONEST = 0.02
"""Time in which a vehicle is taken not to show a command yet [s]: radio, attitude loop and rotors take longer."""

LEAST = 4
"""Samples for each coefficient of the prediction below which there is no test."""

REVEALED = 1.0
"""Horizon up to which scores prefer the true input gain although commands answer the motion [s]."""


def findings_of_loops(flights: Sequence[Flight], axes: Sequence[str], horizon: float) -> Iterator[Finding]:
    """A finding for each axis whose commands answer the motion, where predictions reach beyond `REVEALED`.

    A prediction uses the recorded commands after its start. In a loop they oppose the wind that came, -wind / g: the
    error of the prediction is correlated with the response, and a response that is too small errs less.

    Args:
        flights: Flights on which a model is scored.
        axes: The axes that the model predicts.
        horizon: Longest horizon of the predictions [s].
    """
    if horizon <= REVEALED:
        return
    for axis in axes:
        if seem_to_answer(flights, axis):
            yield Finding(
                "commands_reveal_wind",
                "info",
                f"the commands of {axis} seem to answer the motion, as in a position loop",
                f"beyond {REVEALED:g} s ahead recorded commands reveal the wind, so scores prefer an input gain a few "
                "per cent too low",
                f"compare models by their errors up to {REVEALED:g} s, or on flights without a position loop",
                axis,
            )


def seem_to_answer(flights: Sequence[Flight], axis: str) -> bool:
    """Whether the commands of an axis may follow its motion; False where no flight can show it.

    Only suspected, by chance of one open loop in eighty: a minute of sines beside a soft loop hardly shows more.
    """
    windows = [window for flight in flights if _commands(flight, axis) for window in windows_of(flight, axis)]
    return bool(windows) and _evidence(windows).suspected


def _commands(flight: Flight, axis: str) -> bool:
    return axis in flight.axes and bool(np.ptp(flight.command[:, AXES.index(axis)]) > 0)


def answers_motion(windows: Sequence[Window]) -> bool:
    """Whether changes of the command follow motion that the past of command and motion did not predict."""
    return _evidence(windows).closed


def _evidence(windows: Sequence[Window]) -> LoopEvidence:
    """The evidence of one axis, from one or several flights of a vehicle; none where there are too few samples."""
    step = max(STEP, *(1.5 * float(np.median(np.diff(window.time))) for window in windows))
    past = max(1, round(PAST / step))
    parts = [_lagged(window, step, past) for window in windows if window.duration > 2 * PAST]
    target, columns = (np.concatenate(each) for each in zip(*((y, X) for y, X, _ in parts), strict=True))
    if target.size < LEAST * np.sum(columns.any(axis=0)) or not np.ptp(columns[:, past + 1]) > 0:
        return loop_evidence(())
    scale = np.maximum(np.sqrt(np.mean(columns**2, axis=0)), 1e-12)
    weights = np.linalg.lstsq(columns / scale, target, rcond=1e-9)[0] / scale
    return loop_evidence((command, y - X @ weights) for y, X, command in parts)


def _lagged(window: Window, step: float, past: int) -> tuple[Array, Array, Array]:
    """Velocity over each step (S,), its predictors (S, C), and the command that may respond to it (S,).

    That is the command as sent, the last that the step cannot show yet. One along the mean heading turns with the
    vehicle, and of an earlier one the step shows a part of the next change: both follow the motion in an open loop.

    Where the heading turns within a window, what it brings in of the other command is a predictor, too: the command is
    that along the mean heading, and would seem to respond to what it leaves out. Elsewhere these columns are 0.
    """
    edge = np.arange(window.time[0], window.time[-1], step)
    velocity = np.diff(np.interp(edge, window.time, window.position)) / step
    row = np.searchsorted(window.switch, (edge[:-1] + edge[1:]) / 2, side="right") - 1
    command = window.command[np.clip(row, 0, window.command.size - 1)]
    rows = np.arange(past, velocity.size)
    back = rows[:, None] - np.arange(past + 1)
    across = [np.asarray(one)[np.clip(row, 0, window.command.size - 1)] for one in (window.turned, window.turning)]
    beside = [one[back] for one in across]
    X = np.hstack([velocity[back[:, 1:]], command[back], *beside, np.ones((rows.size, 1))])
    last = np.searchsorted(window.switch, edge[1:] - min(SOONEST, step / 2), side="right") - 1
    return velocity[rows], X, window.sent[np.clip(last, 0, window.sent.size - 1)][rows]
