"""Test for a feedback loop: does a command respond to the prediction errors of the motion?

In an open loop a command is independent of the errors of any prediction of the motion; in a feedback loop its next
changes depend on them. The steps of a flight are the blocks of a fitted law, or those of any other prediction; their
prediction errors are called surprises here.

Source: C. W. J. Granger, Econometrica 37 (1969), pp. 424-438; P. E. Caines, C. W. Chan, IEEE Trans. Autom. Control 20
(1975), pp. 498-508; the variance after H. White, Econometrica 48 (1980), pp. 817-838.
"""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from rotorfit.core.frames import Array

LOOP_STEPS = 15
"""Number of steps after a surprise in which a response of the command is tested."""

LOOP_MEMORY = 45
"""Number of steps of its past from which a change of the command is predicted."""

EXCITATION_STEP = 6.0
"""Ratio to the median change above which a change is a step of the excitation, not the response of a loop."""

LOOP_SIGMAS = 4.5
"""Standard deviations beyond which a response is attributed to a feedback loop."""

SUSPICIOUS_SIGMAS = 2.5
"""Standard deviations beyond which a loop is suspected: one open loop in eighty."""

LEAST_CHANCE = 1e-300
"""Lower limit of the probability, to keep its normal quantile finite."""

UNPREDICTED = 1e-12
"""Unpredicted share of the power of the changes below which it counts as rounding."""


@dataclass(frozen=True)
class LoopEvidence:
    """Evidence that changes of a command respond to surprises in the motion.

    Attributes:
        correlation: Correlation of a surprise with the part of a later change that the command's own past does not
            predict, at the lag where it is largest; 0 where the test cannot be made.
        lag: That lag, in steps from the surprise to the change.
        sigmas: p-value of all lags together in an open loop, as standard deviations of a normal variable.
    """

    correlation: float
    lag: int
    sigmas: float

    @property
    def closed(self) -> bool:
        """Whether changes of the command respond to surprises, as in a feedback loop."""
        return self.sigmas > LOOP_SIGMAS

    @property
    def suspected(self) -> bool:
        """Whether they may: a short flight in a feedback loop cannot show more."""
        return self.sigmas > SUSPICIOUS_SIGMAS


def loop_evidence(parts: Iterable[tuple[Array, Array]]) -> LoopEvidence:
    """Tests whether changes of the command depend on surprises, beyond their dependence on the command's own past.

    Where the law of the prediction is incomplete, surprises contain some of the earlier commands. If the command is
    predictable from its own past, as sines are, surprises then correlate with later commands in an open loop, too. So
    the command's past is projected out of both its next change and the surprises; in an open loop the rest is
    uncorrelated. The test allows for changes that are few or of unequal size, such as steps.

    Args:
        parts: For each stretch of a flight the command in force in each step and the surprise of that step, each of
            shape (N,), at regular times.
    """
    from scipy.special import chdtrc, ndtri

    pairs = [pair for command, surprise in parts if (pair := _unforeseen(command, surprise))]
    if not pairs:
        return LoopEvidence(0.0, 0, 0.0)
    change, before = (np.concatenate(each) for each in zip(*pairs, strict=True))
    scores = before * change[:, None]
    total = scores.sum(axis=0)
    square = float(total @ np.linalg.pinv(scores.T @ scores, hermitian=True) @ total)
    chance = max(float(chdtrc(LOOP_STEPS, square)), LEAST_CHANCE)
    scale = np.sqrt(np.sum(change**2) * np.sum(before**2, axis=0))
    alike = np.divide(total, scale, out=np.zeros_like(total), where=scale > 0)  # poses that stand still surprise nobody
    at = int(np.argmax(np.abs(alike)))
    return LoopEvidence(float(alike[at]), at + 1, float(-ndtri(chance / 2)))


def _unforeseen(command: Array, surprise: Array) -> tuple[Array, Array] | None:
    """The next change of a command, shape (N,), and the surprises 0, 1, ... steps before, shape (N, `LOOP_STEPS`).

    The command's own past is projected out of both. Steps of an excitation are left out, since they hide the small
    changes of a loop. None where the changes are completely predictable, or where there are too few steps.
    """
    reach = min(LOOP_MEMORY, command.size // 8)
    if not np.ptp(command) or reach < LOOP_STEPS:
        return None
    from scipy.linalg import qr

    change = np.diff(command)[reach:]
    size = np.abs(change)
    quiet = size <= EXCITATION_STEP * np.median(size[size > 0]) if size.any() else size > 0
    before = np.lib.stride_tricks.sliding_window_view(surprise, LOOP_STEPS)[reach + 1 - LOOP_STEPS : -1, ::-1][quiet]
    change = change[quiet]
    if change.size <= 2 * reach:
        return None
    past = np.ones((change.size, reach + 2), order="F")
    for step in range(reach + 1):
        past[:, 1 + step] = command[step : step + quiet.size][quiet]
    known = qr(past, overwrite_a=True, mode="economic", check_finite=False)[0]  # in place: it is large
    new = change - known @ (known.T @ change)
    if float(new @ new) <= UNPREDICTED * float(change @ change):
        return None
    return new, before - known @ (known.T @ before)
