"""Tracker: samples in, and at any moment what is known of the vehicle; the flight so far is all that it remembers.

Every sample goes into the growing flight and costs no more than that. Once a second (`look`) the estimates of all axes
take a step, the last seconds are compared with the rest, and the state is put together: at once, or live in a process
beside. It never commands a vehicle.
"""

import json
from collections import deque
from collections.abc import Mapping
from dataclasses import replace
from os import PathLike
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np

from rotorfit.core.card import Card
from rotorfit.core.errors import CardError
from rotorfit.core.flight_data import Flight
from rotorfit.core.frames import AXES
from rotorfit.core.laws import AVERAGED
from rotorfit.core.log import Sample
from rotorfit.core.model import Model
from rotorfit.core.results import Fit
from rotorfit.core.tracked import Motion, Regime, Tracked, TrackedAxis
from rotorfit.files.cards import load_card
from rotorfit.tracking.earlier import Earlier, check_earlier, earlier_of, until_known
from rotorfit.tracking.following import FALSE_ALARMS_PER_HOUR, Following, next_look
from rotorfit.tracking.growing_flight import GrowingFlight
from rotorfit.tracking.looks import Looks, LooksHere
from rotorfit.tracking.looks_beside import LooksBeside
from rotorfit.tracking.motion_stream import MotionStream

UNTOLD = 1000
"""States that wait for `Tracker.news` at the most."""

MOST_FALSE_ALARMS = 60.0
"""The most an hour that can be asked for: one a minute."""


class Tracker:
    """Follows one vehicle.

    Args:
        card: Meaning of commands and poses; the name of a built-in card, or a file.
        structure: As `fit` takes it.
        false_alarms_per_hour: The expected number that is promised not to be passed.
        origin: Stamp of second 0 of the flight [ns]; by default that of the first sample.
        after: The model of an earlier flight of the vehicle, the fit that holds it, or a model file: what it was, until
            this flight tells.
        live: Look in a process beside, so that `update` never waits: states come when they are ready, with the time
            that they speak of. They are those of a tracker that looks at once, on a machine that keeps up. End it by
            `finish`, by `close`, or as a context manager.
        paced: Live, let `update` wait where the machine does not keep up, rather than leave looks out.

    Raises:
        TypeError: The card is none, or the earlier model.
        ValueError: A number of false alarms that cannot be promised.
        CardError: No such card, or commands mean something else to the earlier model.
        ModelError: The model file cannot be used.
    """

    def __init__(
        self,
        card: Card | str | PathLike[str],
        structure: str = AVERAGED,
        false_alarms_per_hour: float = FALSE_ALARMS_PER_HOUR,
        origin: int | None = None,
        after: Model | Fit | Earlier | str | PathLike[str] | None = None,
        live: bool = False,
        paced: bool = False,
    ) -> None:
        if not isinstance(card, Card | str | PathLike):
            raise TypeError(f"a card, its name or its file is wanted, not {type(card).__name__}")
        card = card if isinstance(card, Card) else load_card(Path(card))
        if not 0 < false_alarms_per_hour <= MOST_FALSE_ALARMS:
            raise ValueError(f"false alarms an hour are above 0 and at most {MOST_FALSE_ALARMS:g}")
        self._card, self._growing = card, GrowingFlight(card, origin)
        earlier = after if after is None or isinstance(after, Earlier) else earlier_of(after)
        if earlier:
            check_earlier(earlier, card)
        promised = structure, false_alarms_per_hour, earlier
        following = Following(*promised)
        self._looks: Looks = LooksBeside(card, promised, paced) if live else LooksHere(following)
        self._due = following.next_look
        self._memory: Mapping[str, Any] = following.memory()
        begin = TrackedAxis()
        axes = {axis: until_known(begin, earlier, axis) if earlier else begin for axis in AXES}
        self._state = Tracked(0.0, axes)
        self._untold: deque[Tracked] = deque(maxlen=UNTOLD)
        self._stream = MotionStream(*self._growing.rows)

    def update(self, sample: Sample) -> None:
        """Takes a sample: a pose, or a command as it was sent."""
        took, now = self._growing.add(sample), self._growing.now
        if took and sample.stream == "pose":
            self._stream.follow()
        if took and now >= self._due:
            self._due = next_look(self._due, now)
            self._looks.ask(self._growing)
        self._take_in()

    def _take_in(self) -> None:
        """Looks that are ready; what the pose raised by itself in the same instant stands before their alarms."""
        alarms = self._growing.alarms()
        if any(alarm.cause == "pose_jumped" for alarm in alarms):
            self._stream.end()
        for looked in self._looks.answers():
            self._memory = looked.memory
            self._stream.begin(looked.courses, looked.doubt)
            self._tell(replace(looked.state, alarms=(*alarms, *looked.state.alarms)))
            alarms = ()
        if alarms:
            self._tell(replace(self._state, alarms=alarms))

    def _tell(self, state: Tracked) -> None:
        self._state = state
        self._untold.append(state)

    def state(self) -> Tracked:
        """What was known at the last look that is ready: at most a second of flight ago, and what a look takes."""
        return self._state

    def motion(self) -> Motion | None:
        """Velocity, wind, gusts and the second ahead at the last pose, by what the last look that is ready knew.

        None before an axis is told, and from a jump of the pose until the next look.
        """
        return self._stream.motion()

    def news(self) -> list[Tracked]:
        """All states since the last call, in order: none is missed, and no alarm."""
        self._take_in()
        return [self._untold.popleft() for _ in range(len(self._untold))]

    def flight(self) -> Flight | None:
        """The flight so far, as far as it is remembered; None before the first command and pose."""
        return self._growing.flight()

    def memory(self) -> dict[str, Any]:
        """What `recall` of another tracker goes on from, as arrays: the flight so far, its regimes, and the card."""
        following = {**self._memory, "next_look": float(self._due), "card": [self._card.name, self._card.raw]}
        return {**self._growing.memory(), "following": np.array(json.dumps(following))}

    def recall(self, memory: Mapping[str, Any]) -> None:
        """Goes on from what `memory` gave; before the first sample.

        Raises:
            CardError: It was learnt with another card.
        """
        told = json.loads(str(memory["following"]))
        name, raw = told.pop("card")
        if raw != json.loads(json.dumps(self._card.raw)):
            raise CardError(f"was learnt with the card {name}, not with {self._card.name}; name another file")
        self._growing.recall(memory)
        self._memory = told
        self._due = float(self._memory["next_look"])
        self._looks.recall(self._memory)

    def finish(self) -> tuple[Tracked, tuple[Regime, ...]]:
        """What is known at the end, by a last fit, and every regime with its model."""
        end = self._looks.finish(self._growing)
        self._take_in()
        self.close()
        return end or (replace(self._state, alarms=()), ())

    def close(self) -> None:
        """Leaves nothing behind, whether or not it was finished."""
        self._looks.close()

    def __enter__(self) -> "Tracker":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()
