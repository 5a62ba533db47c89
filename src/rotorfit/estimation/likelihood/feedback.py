"""Does a command answer the motion? The mark of a feedback loop, told by what nobody foresaw.

Whatever predicts the motion leaves surprises. In an open loop the command knows nothing of them; in a loop its next
changes follow them. Steps of a flight are its blocks under a fitted law, or those of any other prediction.

Source: C. W. J. Granger, Econometrica 37 (1969), pp. 424-438; P. E. Caines, C. W. Chan, IEEE Trans. Autom. Control 20
(1975), pp. 498-508; the variance after H. White, Econometrica 48 (1980), pp. 817-838.
"""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from rotorfit.core.frames import Array

LOOP_STEPS = 15
"""Steps after a surprise in which an answer is looked for."""

LOOP_MEMORY = 45
"""Steps of its past that may foretell a change of the command."""

EXCITATION_STEP = 6.0
"""A change of so many times the usual one is a step of the excitation, not the answer of a loop."""

LOOP_SIGMAS = 4.5
"""Standard deviations beyond which the answer is a feedback loop's."""

LEAST_CHANCE = 1e-300
"""Smallest probability that is told."""

FORETOLD = 1e-12
"""Share of the power of the changes below which the command's past tells all of them: the rest is rounding."""


@dataclass(frozen=True)
class LoopEvidence:
    """How far changes of a command follow what was not foreseen of the motion.

    Attributes:
        correlation: Of a surprise with what the command's own past does not tell of its next change, where it is
            largest; 0 where nothing can be told.
        lag: Steps by which the change comes later.
        sigmas: How surprising all lags together are in an open loop, as standard deviations of a normal variable.
    """

    correlation: float
    lag: int
    sigmas: float

    @property
    def closed(self) -> bool:
        """Whether changes of the command follow what was not foreseen: the mark of a feedback loop."""
        return self.sigmas > LOOP_SIGMAS


def loop_evidence(parts: Iterable[tuple[Array, Array]]) -> LoopEvidence:
    """How far changes of the command follow surprises, beyond what they follow of their own past.

    Where the prediction leaves out part of the vehicle, its surprises hold some of the commands before. Of a command
    that its own past foretells, as sines are, they then go with what comes after, in an open loop too. So the next
    change of the command and the surprises are both freed from the command's past; in an open loop no more is left
    between them than chance. The test allows for changes that are few or of unequal size, as steps are.

    Args:
        parts: Of each stretch of a flight the command that acts in each step, and the surprise of that step, each of
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
    alike = total / np.sqrt(np.sum(change**2) * np.sum(before**2, axis=0))
    at = int(np.argmax(np.abs(alike)))
    return LoopEvidence(float(alike[at]), at + 1, float(-ndtri(chance / 2)))


def _unforeseen(command: Array, surprise: Array) -> tuple[Array, Array] | None:
    """The next change of a command, shape (N,), and the surprises 0, 1, ... steps before, (N, `LOOP_STEPS`).

    Both less what the command's own past tells of them, and without the steps of an excitation, which hide the small
    changes of a loop; None where the command never changes in a way that it did not foretell, or there are few steps.
    """
    reach = min(LOOP_MEMORY, command.size // 8)
    if not np.ptp(command) or reach < LOOP_STEPS:
        return None
    change = np.diff(command)[reach:]
    size = np.abs(change)
    quiet = size <= EXCITATION_STEP * np.median(size[size > 0]) if size.any() else size > 0
    past = np.lib.stride_tricks.sliding_window_view(command, reach + 1)[:-1][quiet]
    before = np.lib.stride_tricks.sliding_window_view(surprise, LOOP_STEPS)[reach + 1 - LOOP_STEPS : -1, ::-1][quiet]
    change = change[quiet]
    if len(past) <= 2 * reach:
        return None
    known = np.linalg.qr(np.column_stack([np.ones(len(past)), past]))[0]
    new = change - known @ (known.T @ change)
    if float(new @ new) <= FORETOLD * float(change @ change):
        return None
    return new, before - known @ (known.T @ before)
