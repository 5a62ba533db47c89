"""Stamps of a sender to times of the flight, one sample at a time: implausible stamps, other clocks, clocks that step.

Samples are timed by the sender's stamps. A sample whose stamp is implausible given its arrival is left out; after
`STRANGE` of them in a row, over a second or more, the sender's clock is another one, and from then on its samples are
timed by their arrival.

At a step of the clock the stamps jump, the arrivals do not, and the difference lasts, as where a log is read
(`flights.clocks.sender_drift`). The samples after such a jump wait until ten of them have shown it for a second, and
are then moved by its size; one that comes as before shows that there was none.
"""

from collections import deque
from collections.abc import Sequence
from dataclasses import replace
from itertools import islice

import numpy as np

from rotorfit.core.frames import Array
from rotorfit.core.log import Sample
from rotorfit.flights.clocks.sender_drift import AROUND, EARLY, LEAST_STEP

ONE_CLOCK = (-0.05, 2.0)
"""Plausible times from stamp to arrival if sender and receiver share a clock [s]. A radio may hold a sample back."""

STRANGE, LASTING = 10, 1.0
"""Number of implausible stamps in a row after which the arrivals count, or of stamps after a jump that make it a step,
and how long they must have arrived [s]: what a stalled link delivers at once is late, and its clock is right."""

PROMPT = 60.0
"""Time in which some samples arrived promptly [s]: who sets the clock on gets ahead of all of them, which a queue that
empties, or drops what it holds, does not."""

USUAL = 100
"""Number of samples whose intervals are the usual ones."""


class SenderClock:
    """Assigns times to the samples of one sender.

    Args:
        by_arrival: Whether the arrivals count.
        shift: What is added to its stamps, for the steps so far [ns].

    Attributes:
        steps: Sizes of the steps found since this was last emptied, positive where the clock was set on [s].
    """

    def __init__(self, by_arrival: bool = False, shift: int = 0) -> None:
        self.by_arrival, self.shift = by_arrival, shift
        self.steps: list[float] = []
        self._strange, self._since = 0, 0
        self._past: deque[tuple[int, int]] = deque()  # stamps and arrivals, without strange ones
        self._waiting: list[Sample] = []
        self._jump = self._base = 0.0

    def take(self, sample: Sample) -> list[tuple[int | None, Sample]]:
        """Takes a sample as it arrives.

        Returns:
            The samples whose turn it is, and when each was measured or sent [ns]; None if its stamp is implausible.
        """
        if sample.received <= 0:  # the time of arrival is unknown
            return [(sample.stamp, sample)]
        if self.by_arrival:
            return [(sample.received, sample)]
        moved = replace(sample, stamp=sample.stamp + self.shift)
        return [(self._stamp(one), one) for one in self._in_step(moved)]

    def _stamp(self, sample: Sample) -> int | None:
        """The time of a sample by its clock, if that is plausible, or by its arrival."""
        if self.by_arrival:
            return sample.received
        if ONE_CLOCK[0] <= _late(sample.stamp, sample.received) <= ONE_CLOCK[1]:
            self._strange = 0
            self._past.append((sample.stamp, sample.received))
            while sample.received - self._past[0][1] > PROMPT * 1e9:
                self._past.popleft()
            return sample.stamp
        self._since = self._since if self._strange else sample.received
        self._strange += 1
        self.by_arrival = self._strange >= STRANGE and sample.received - self._since >= 1e9 * LASTING
        return sample.received if self.by_arrival else None

    def _in_step(self, sample: Sample) -> Sequence[Sample]:
        """The samples whose turn it is, moved by the step that they show, if any."""
        if not self._waiting:
            self._jump = self._jumped(sample)
            if not self._jump:
                return (sample,)
            self._base = self._early()
        self._waiting.append(sample)
        late = np.array([_late(one.stamp, one.received) for one in self._waiting]) - self._base
        if late[-1] * -np.sign(self._jump) < 0.5 * abs(self._jump):  # it comes as before
            return self._released(0.0)
        if len(late) < STRANGE or sample.received - self._waiting[0].received < 1e9 * LASTING:
            return ()
        size = float(np.quantile(late, EARLY))
        step = abs(size + self._jump) < 0.5 * abs(size) and not self._caught_up(size)
        return self._released(size if step else 0.0)

    def _caught_up(self, size: float) -> bool:
        """Whether samples that come earlier now, by `size` < 0 [s], may show a queue that dropped what it held.

        A clock that was set on makes samples arrive before they were sent, or earlier than in a minute before.
        """
        heard = (self._past[-1][1] - self._past[0][1]) / 1e9
        return size < 0 <= self._base + size and heard < 0.9 * PROMPT

    def _released(self, size: float) -> Sequence[Sample]:
        """The samples that wait, moved by a step of the lateness [s]; 0 if it is none."""
        waiting, self._waiting, shift = self._waiting, [], round(size * 1e9)
        if not shift:
            return waiting
        self.shift += shift
        self.steps.append(-size)
        return [replace(one, stamp=one.stamp + shift) for one in waiting]

    def _jumped(self, sample: Sample) -> float:
        """By how much the stamps jump with a sample while the arrivals do not [s]; 0 if they do not."""
        if len(self._past) < STRANGE:
            return 0.0
        stamp, arrival = self._past[-1]
        sent, came = (sample.stamp - stamp) / 1e9, (sample.received - arrival) / 1e9
        if abs(sent - came) < 0.5 * LEAST_STEP:
            return 0.0
        usual = np.array(list(islice(reversed(self._past), USUAL)))[::-1]
        jump, jolt = np.array([sent, came]) - np.median(np.diff(usual, axis=0), axis=0) / 1e9
        return float(jump) if abs(jump) > LEAST_STEP and abs(jolt) < 0.5 * abs(jump) else 0.0

    def _early(self) -> float:
        """Time from stamp to arrival of the prompt samples before a jump [s]."""
        past = np.array(self._past)
        within = PROMPT if self._jump > 0 else AROUND
        past = past[past[:, 1] >= past[-1, 1] - within * 1e9]
        late: Array = (past[:, 1] - past[:, 0]) / 1e9
        return float(np.quantile(late, EARLY))


def _late(stamp: int, arrival: int) -> float:
    """Time from stamp to arrival [s]."""
    return (arrival - stamp) / 1e9
