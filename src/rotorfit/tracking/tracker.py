"""Tracker: takes samples, and reports at any moment what is known of the vehicle.

Each sample is appended to the growing flight, which costs little. Once a second a look updates the estimates of all
axes, tests the last seconds against the rest, and assembles the state: at once, or live in a process beside. Glances
between looks only test. The tracker never commands a vehicle.
"""

import json
from collections import deque
from collections.abc import Mapping
from dataclasses import replace
from numbers import Real
from os import PathLike
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np

from rotorfit.core.card import Card
from rotorfit.core.errors import CardError, LogError
from rotorfit.core.flight_data import Flight
from rotorfit.core.frames import AXES
from rotorfit.core.laws import AVERAGED
from rotorfit.core.log import NUMBERS, Sample
from rotorfit.core.model import Model
from rotorfit.core.results import Fit
from rotorfit.core.tracked import Alarm, Motion, Tracked, TrackedAxis, alarm_from_mapping
from rotorfit.files.cards import load_card
from rotorfit.tracking.change_watch import GLANCE
from rotorfit.tracking.earlier import Earlier, check_earlier, earlier_of, until_known
from rotorfit.tracking.flight_so_far import UNRECORDED
from rotorfit.tracking.following import FALSE_ALARMS_PER_HOUR, Following, next_look
from rotorfit.tracking.growing_flight import GrowingFlight, Part
from rotorfit.tracking.looks import End, Looks, LooksHere
from rotorfit.tracking.looks_beside import LooksBeside
from rotorfit.tracking.motion_stream import MotionStream

UNREAD = 1000
"""Largest number of states that wait for `Tracker.news`; the oldest is dropped."""

MOST_FALSE_ALARMS = 60.0
"""Largest rate of false alarms that may be asked for [1/h]: one a minute."""


def _check(sample: Sample) -> None:
    """Refuses what no link sends: an unknown stream, another number of values, or values of another type.

    Raises:
        LogError: It is such a sample.
    """
    if sample.stream not in NUMBERS:
        raise LogError(f"no stream {sample.stream!r}; a sample is one of {', '.join(NUMBERS)}")
    if len(sample.values) != NUMBERS[sample.stream]:
        raise LogError(
            f"a sample of {sample.stream!r} has {NUMBERS[sample.stream]} values, not {len(sample.values)}; a pose is "
            "x, y, z and the quaternion w, x, y, z, a command x, y, z, yaw"
        )
    given: tuple[object, ...] = sample.values  # by whoever wrote the link
    if wrong := [value for value in given if not isinstance(value, Real)]:
        raise LogError(
            f"a sample of {sample.stream!r} has the value {wrong[0]!r}; give numbers, NaN where one is unknown"
        )


class Tracker:
    """Follows one vehicle.

    Args:
        card: Meaning of commands and poses: a card, the name of a built-in one, or a file.
        structure: Model structure, as `fit` takes it.
        false_alarms_per_hour: Promised bound on their expected number [1/h], above 0 and at most `MOST_FALSE_ALARMS`.
        origin: Stamp of second 0 of the flight [ns]; by default that of the first command that is obeyed.
        after: The model of an earlier flight of the vehicle, a fit, or a model file; it is reported until this flight
            tells as much, and compared with it.
        live: Make the looks in a process beside, so that `update` never waits; states come when they are ready, each
            with its time. On a machine that keeps up they are those of a tracker that looks at once. End such a
            tracker by `finish`, by `close`, or as a context manager.
        paced: With `live`, let `update` wait for a machine that does not keep up, rather than skip looks.
        path: File of the recording, if there is one: models and gains name it as their flight.
        tuned: Whether gains are re-tuned from the models of the states, which are then refitted more often.

    Raises:
        TypeError: `card` is not a card, or `after` not a model.
        ValueError: `false_alarms_per_hour` is out of range.
        CardError: There is no such card, its commands are along the world axes, or those of the earlier model have
            another meaning.
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
        path: str = UNRECORDED,
        tuned: bool = False,
    ) -> None:
        if not isinstance(card, Card | str | PathLike):
            raise TypeError(f"expected a card, its name or its file, got {type(card).__name__}")
        card = card if isinstance(card, Card) else load_card(Path(card))
        if card.command_frame == "world":
            raise CardError(
                f"card {card.name}: its commands are along the world axes, but a tracker takes forward, left, up: turn "
                'them by the heading, and write frame = "heading"'
            )
        if not 0 < false_alarms_per_hour <= MOST_FALSE_ALARMS:
            raise ValueError(f"false alarms an hour are above 0 and at most {MOST_FALSE_ALARMS:g}")
        self._card, self._growing = card, GrowingFlight(card, origin, path)
        earlier = after if after is None or isinstance(after, Earlier) else earlier_of(after)
        if earlier:
            check_earlier(earlier, card)
        promised = structure, false_alarms_per_hour, earlier, tuned
        following = Following(*promised)
        self._looks: Looks = LooksBeside(card, path, promised, paced) if live else LooksHere(following)
        self._due = following.next_look
        self._memory: Mapping[str, Any] = following.memory()
        begin = TrackedAxis()
        axes = {axis: until_known(begin, earlier, axis) if earlier else begin for axis in AXES}
        self._state = Tracked(0.0, axes)
        self._unread: deque[Tracked] = deque(maxlen=UNREAD)
        self._begun, self._jumped = False, -np.inf  # when the pose last jumped
        self._asked: tuple[Alarm, ...] = ()  # alarms of the pose that no look has told
        self._early: tuple[Alarm, ...] = ()  # those of them that were told without one
        self._end: End | None = None
        self._stream = MotionStream(*self._growing.rows)

    def update(self, sample: Sample) -> None:
        """Takes a sample.

        Args:
            sample: A pose: x, y, z [m] in the world, then the quaternion w, x, y, z; a command: x, y, z, yaw as sent
                [unit of the card's command]; or whether the vehicle obeys. In the order of arrival.

        Raises:
            LogError: The sample is of no known stream, or its values are not numbers, or not as many as its stream has.
            RuntimeError: Live, the process beside has failed; the message has its traceback.
            LinkError: Live, the process beside was killed.
        """
        _check(sample)
        self._begun = True
        took, now = self._growing.add(sample), self._growing.now
        if took and sample.stream == "pose":
            self._stream.follow()
        due = took and now >= self._due
        if due:
            self._due = next_look(self._due, now, GLANCE)
        new = tuple(alarm for alarm in self._growing.raised if alarm not in self._asked)
        if any(alarm.cause == "pose_jumped" for alarm in new):
            self._stream.end()
            self._jumped = now
        if due or new:
            self._asked = (*self._asked, *new)
            self._looks.ask(self._growing)
        self._take_in()
        if late := tuple(alarm for alarm in new if alarm in self._asked):  # its look is not made yet
            self._early = (*self._early, *late)
            self._tell(replace(self._state, time=now, alarms=late))

    def _take_in(self) -> None:
        """Takes the looks that are ready."""
        for looked in self._looks.answers():
            self._memory = looked.memory
            if looked.state.time > self._jumped:  # before, or just after a jump, it tells no velocity of now
                self._stream.begin(looked.courses, looked.doubt)
            self._tell(self._not_told_early(looked.state))

    def _not_told_early(self, state: Tracked) -> Tracked:
        """A state without the alarms of the pose that were told before its look was made."""
        self._asked = tuple(alarm for alarm in self._asked if alarm not in state.alarms)
        told = replace(state, alarms=tuple(alarm for alarm in state.alarms if alarm not in self._early))
        self._early = tuple(alarm for alarm in self._early if alarm not in state.alarms)
        return told

    def _tell(self, state: Tracked) -> None:
        self._state = state
        self._unread.append(state)

    def state(self) -> Tracked:
        """The state at the last completed look: at most a second of flight ago, plus the time that a look takes."""
        return self._state

    def motion(self) -> Motion | None:
        """Velocity, wind, gusts and the prediction for a second ahead at the last pose, by the last completed look.

        None until the damping of an axis is told, and from a jump of the pose until the next look.
        """
        return self._stream.motion()

    def news(self) -> list[Tracked]:
        """All states since the last call, in order, with all alarms; at most the newest `UNREAD`.

        Raises:
            RuntimeError: Live, the process beside has failed; the message has its traceback.
            LinkError: Live, the process beside was killed.
        """
        self._take_in()
        return [self._unread.popleft() for _ in range(len(self._unread))]

    @property
    def origin(self) -> int | None:
        """Stamp of second 0, by the clock that times the commands [ns]; None before the first that is obeyed."""
        return self._growing.origin

    @property
    def parts(self) -> list[Part]:
        """The recordings of the flight: several where it was resumed."""
        return self._growing.parts

    def remarks(self) -> list[str]:
        """What was done about the samples since the last call and should be told, one line each: steps of clocks."""
        return self._growing.remarks()

    def flight(self) -> Flight | None:
        """The flight so far, as far as it is remembered; None before it has a segment with commands and poses."""
        return self._growing.flight()

    @property
    def changes(self) -> list[Alarm]:
        """The alarms that began a regime by the last completed look, each as last revised."""
        return [alarm_from_mapping(alarm) for _, alarm in self._memory["bounds"] if alarm]

    @property
    def another(self) -> bool:
        """Whether the vehicle was found not to be that of the earlier model."""
        return bool(self._memory.get("unlike"))

    def memory(self) -> dict[str, Any]:
        """What `recall` of another tracker continues from, as arrays: the flight so far, its regimes, and the card."""
        following = {**self._memory, "next_look": float(self._due), "card": [self._card.name, self._card.raw]}
        return {**self._growing.memory(), "following": np.array(json.dumps(following))}

    def recall(self, memory: Mapping[str, Any]) -> None:
        """Continues from what `memory` returned; call it before the first sample.

        Raises:
            CardError: The memory was made with another card.
            KeyError: The memory is of another version: it lacks something.
            ValueError: The tracker has taken samples.
        """
        if self._begun:
            raise ValueError("this tracker has taken samples; recall into a new one")
        told = json.loads(str(memory["following"]))
        name, raw = told.pop("card")
        if raw != json.loads(json.dumps(self._card.raw)):
            mine = "another one of that name" if name == self._card.name else self._card.name
            raise CardError(f"was learnt with the card {name}, not with {mine}; name another file")
        Following().recall(told)  # the looks may be in another process, where nobody could say what is wrong with it
        self._growing.recall(memory)
        self._memory = told
        self._due = float(self._memory["next_look"])
        self._looks.recall(self._memory)

    def finish(self) -> End:
        """The final state, after a last fit, and every regime with its model; closes the tracker. Again, the same.

        Raises:
            RuntimeError: Live, the process beside has failed; the message has its traceback.
            LinkError: Live, the process beside was killed.
        """
        if self._end is None:
            try:
                end = self._looks.finish(self._growing)
                self._take_in()
                if end:
                    end = self._not_told_early(end[0]), end[1]
            finally:
                self.close()
            self._end = end or (replace(self._state, alarms=()), ())
        return self._end

    def close(self) -> None:
        """Ends the process beside, if there is one, whether or not the tracker was finished."""
        self._looks.close()

    def __enter__(self) -> "Tracker":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()
