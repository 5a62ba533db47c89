"""Responses that come earlier or later after their commands than any delay that the fit searches.

The velocity along an axis is modelled as in `command_response`, by the command of that axis alone, with delays far
beyond `DELAY_RANGE` at both ends. In a feedback loop the command responds to the motion, but in the opposite direction.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from rotorfit.core.card import Card
from rotorfit.core.finding import Finding
from rotorfit.core.flight_data import ANSWER
from rotorfit.core.frames import AXES, Array
from rotorfit.core.laws import DELAY_RANGE
from rotorfit.core.results import Motion
from rotorfit.diagnosis.command_response import CONSTANTS, EXPLAINED, LEAST_POSES, smoothed, thinned
from rotorfit.diagnosis.recording import Recording

DELAYS = np.arange(-20, 31) / 20
"""Delays that are tried [s]."""

ROUNDING = 1e-6
"""Tolerance of the ends of the range [s]."""

BETTER = 0.7
"""Largest residual variance beyond the range, as a share of the least inside it: 0.92 at least on 56 axes of recorded
flights, and 0.05 to 0.6 on 7 of 10 excited axes of four of them with commands stamped 0.7 s late."""

MORE = 0.1
"""Least further share of the variance that a response after the range must explain: time constants between those that
are tried look like delays. No vehicle responds before its command."""


def response_time_findings(recording: Recording) -> Iterator[Finding]:
    """Findings on the time from a command to its response: one on all that come too early, and one per late axis."""
    flight = recording.flight
    if len(recording.motion.time) < LEAST_POSES or (flight.clocks is not None and flight.clocks.includes_delay):
        return
    beyond = [found for axis in flight.axes if (found := _beyond(recording, axis))]
    early = [found for found in beyond if found.delay < DELAY_RANGE[0]]
    if early:
        yield _too_early(early, recording.card)
    for found in beyond:
        if found not in early:
            yield _too_late(found)


@dataclass(frozen=True)
class _Beyond:
    """An axis that responds beyond the delays that are searched.

    Attributes:
        axis: One of `AXES`.
        delay: Delay at which its command explains most of its velocity [s].
        left: Share of the variance of the velocity that is left there.
        inside: The least share that is left inside `DELAY_RANGE`, by a command of either sign.
    """

    axis: str
    delay: float
    left: float
    inside: float

    @property
    def evidence(self) -> str:
        """What the commands explain, as a clause."""
        return f"there they explain {100 * (1 - self.left):.1f} % of its velocity, else {100 * (1 - self.inside):.1f} %"


def _beyond(recording: Recording, axis: str) -> _Beyond | None:
    """The axis, if it responds clearly beyond the delays that are searched."""
    flight, column = recording.flight, AXES.index(axis)
    if np.ptp(flight.command[:, column]) == 0:
        return None
    motion = thinned(recording.motion, flight.duration)
    commands = np.array([one[:, 0] for _, one in smoothed(flight, motion.time, [column], DELAYS)])
    along = _along(commands, motion, column).reshape(len(CONSTANTS), len(DELAYS))
    left = 1 - np.maximum(along.max(axis=0), 0.0) ** 2
    searched = np.abs(DELAYS - np.mean(DELAY_RANGE)) < np.ptp(DELAY_RANGE) / 2 + ROUNDING
    inside = 1 - float(np.max(along[:, searched] ** 2))  # a reversed axis is left to the checks of signs
    best = int(np.argmin(left))
    if left[best] > min(1 - EXPLAINED, BETTER * inside):
        return None
    if DELAYS[best] > DELAY_RANGE[1] and inside - left[best] < MORE:
        return None
    return _Beyond(axis, float(DELAYS[best]), float(left[best]), inside)


def _along(commands: Array, motion: Motion, column: int) -> Array:
    """Correlation of a velocity with each smoothed command, shape (L,); straight lines in time are removed from both.

    Args:
        commands: Smoothed commands, shape (L, N).
        motion: The motion at the same N times.
        column: Its axis, as in `AXES`.
    """
    line = np.linalg.qr(np.column_stack([np.ones_like(motion.time), motion.time - motion.time.mean()]))[0]
    velocity = motion.velocity[:, column] - line @ (line.T @ motion.velocity[:, column])
    commands = commands - (commands @ line) @ line.T
    size = np.sqrt(np.sum(commands**2, axis=1) * np.sum(velocity**2))
    return np.asarray(np.divide(commands @ velocity, size, out=np.zeros_like(size), where=size > 0))


def _too_early(early: list[_Beyond], card: Card) -> Finding:
    time, first = card.command_time, min(early, key=lambda one: one.delay)
    each = (f"{one.axis} responds {-one.delay:.2f} s before its command is stamped: {one.evidence}" for one in early)
    offset = time.offset + (first.delay - ANSWER) / time.factor
    return Finding(
        "response_before_command",
        "error",
        "; ".join(each),
        "no coefficient of any axis is the vehicle's: the stamps of the commands and those of the poses do not agree",
        "stamp each command when it is sent, by the clock of the poses; where only this log is left, write "
        f"offset = {offset:.12g} (now {time.offset:.12g}) for time in [command] of the card: then input gain and "
        "damping are the vehicle's, and the delay is not",
    )


def _too_late(found: _Beyond) -> Finding:
    return Finding(
        "response_too_late",
        "error",
        f"{found.axis} responds {found.delay:.2f} s after its command is stamped: {found.evidence}",
        f"input gain, damping and delay of {found.axis} are not the vehicle's: delays beyond {DELAY_RANGE[1]:g} s are "
        "not searched",
        "check the clocks of commands and poses; where they are right, move the stamps of the commands by offset of "
        "time in [command] of the card, and add it to the delay",
        found.axis,
    )
