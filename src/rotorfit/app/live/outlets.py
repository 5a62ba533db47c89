"""Outlets of samples and states while a vehicle is tracked: a recording, and a file to resume from."""

import errno
import hashlib
import io
import json
import socket
import threading
import zipfile
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from rotorfit.app.live.regained import Regaining
from rotorfit.core.card import Card
from rotorfit.core.errors import CardError, LogError
from rotorfit.core.log import Sample
from rotorfit.core.tracked import Motion, Tracked
from rotorfit.core.writing import write_whole
from rotorfit.flying.recorder import Recorder, card_as_recorded, record
from rotorfit.tracking.sender_clock import LASTING, ONE_CLOCK, STRANGE
from rotorfit.tracking.tracker import Tracker

TRACKED, ALARM, GAINS = "/rotorfit/tracked", "/rotorfit/alarm", "/rotorfit/gains"
"""Topics of states, alarms and new gains, in JSON like the lines of `rotorfit track --jsonl`."""

MOTION = "/rotorfit/motion"
"""Topic of the motion after each pose, in JSON with the names of a state but no coefficients."""

Moving = Callable[[Motion, int], None]
"""Takes the motion after a pose, and the pose's time of arrival [ns]."""

REMEMBER_EVERY = 1.0
"""Time between two writes of the tracker's memory [s]."""


class Outlet(Protocol):
    """A destination of samples, states and gains."""

    def heard(self, samples: Sequence[Sample], now: int) -> None:
        """Takes samples as they arrived, and the link's clock [ns]."""

    def state(self, state: Tracked, now: int, held: int) -> None:
        """Takes a new state with its alarms, the link's clock, and when the state held by the senders' clock [ns]."""

    def gains(self, message: Mapping[str, Any], now: int) -> None:
        """Takes new gains, and the link's clock [ns]."""

    def close(self) -> None:
        """Ends the outlet."""


MOST_WAITING = 1000
"""Number of samples that wait for the first pose: commands of a vehicle that nobody sees are no flight."""


class Recording:
    """An MCAP file that `fit` reads, with states and alarms beside the samples.

    Args:
        path: Path of a file that does not exist yet.
        card: Meaning of the samples.
        link: Name of the link, stored in the file.
    """

    def __init__(self, path: Path, card: Card, link: str) -> None:
        self._path, self._card, self._link = path, card, link
        self._recorder: Recorder | None = None
        self._waiting: list[Sample] = []
        self._clocks = {name: _ClockOf(name) for name in ("pose", "command")}
        self._written: dict[str, str] = {}  # the clocks in the card of the file

    def heard(self, samples: Sequence[Sample], now: int) -> None:
        """Writes samples; the file begins when the first poses tell which clock times them, as for the tracker.

        Commands may begin long after that: when they tell their clock, the card is written again.
        """
        if self.fault:
            return
        self._waiting += samples
        for clock in self._clocks.values():
            clock.take(samples)
        if self._recorder is None:
            if not self._clocks["pose"].heard:
                del self._waiting[:-MOST_WAITING]
            if not self._clocks["pose"].told:
                return
            self._recorder = self._begun(now)
        self._write(self._recorder)
        if self._clocks["command"].told:
            self._correct(self._recorder)

    def _begun(self, now: int) -> Recorder:
        """A recorder, once there is a pose."""
        recorder = record(self._path, {"card": self._card_text(), "link": self._link})
        recorder.window(min(now, self._waiting[0].received), True)
        return recorder

    def _card_text(self) -> str:
        """The card of the recording, by the clocks that are told so far."""
        import tomli_w

        self._written = {name: clock.name for name, clock in self._clocks.items()}
        pose, command = self._clocks.values()
        late = max(self._card.pose_time.error, pose.error) if pose.name == "header.stamp" else 0.0
        sent = self._card.command_time.error if command.name == "header.stamp" else 0.0
        return tomli_w.dumps(card_as_recorded(self._card.raw, pose.name, command.name, late, sent))

    def _correct(self, recorder: Recorder) -> None:
        """Writes the card again if the commands have another clock than it says."""
        if self._written["command"] != self._clocks["command"].name:
            recorder.attach({"card": self._card_text()})

    def _write(self, recorder: Recorder) -> None:
        """Writes the samples that wait."""
        for sample in self._waiting:
            recorder.sample(sample)
        self._waiting.clear()

    def state(self, state: Tracked, now: int, _held: int) -> None:
        """Writes a state and its alarms, the alarms also as events."""
        if recorder := self._writing:
            for alarm in state.alarms:
                recorder.json_message(ALARM, now, alarm.to_mapping())
                recorder.event(now, f"{alarm.title}: {alarm.why}")
            recorder.json_message(TRACKED, now, state.to_mapping())

    def motion(self, motion: Motion, now: int) -> None:
        """Writes the motion after a pose."""
        if recorder := self._writing:
            recorder.json_message(MOTION, now, motion.to_mapping())

    def gains(self, message: Mapping[str, Any], now: int) -> None:
        """Writes new gains."""
        if recorder := self._writing:
            recorder.json_message(GAINS, now, message)

    @property
    def _writing(self) -> Recorder | None:
        """The recorder, once there is one and as long as its file grows."""
        return None if self.fault else self._recorder

    @property
    def fault(self) -> str:
        """Why the file ends before the flight; empty if it does not."""
        return self._recorder.fault if self._recorder else ""

    def close(self) -> None:
        """Ends the file; one that has not begun is written if there is a pose."""
        if self._recorder is None and self._clocks["pose"].heard:
            self._recorder = self._begun(self._waiting[0].received)
            self._write(self._recorder)
        if self._recorder is not None:
            self._correct(self._recorder)
            self._recorder.close()


class _ClockOf:
    """Which clock times a stream, by its first samples, as their tracker takes it.

    Args:
        stream: The stream.

    Attributes:
        name: The sender's clock, `header.stamp`, or that of the arrival, `log_time`.
        told: Whether the samples so far settle it.
        heard: Whether a sample has come.
        error: Half the 95 % interval of what its stamps may be off by [s]; 0 if unknown.
    """

    def __init__(self, stream: str) -> None:
        self._stream, self._first = stream, list[Sample]()
        self.name, self.told, self.error = "header.stamp", False, 0.0

    @property
    def heard(self) -> bool:
        return bool(self._first)

    def take(self, samples: Sequence[Sample]) -> None:
        """Takes samples of any stream as they arrive."""
        if self.told:
            return
        first = self._first = [*self._first, *(one for one in samples if one.stream == self._stream)]
        self.error = first[-1].error if first else 0.0
        late = [(one.received - one.stamp) / 1e9 for one in first]
        ours = not late or any(ONE_CLOCK[0] <= one <= ONE_CLOCK[1] for one in late)
        self.name = "header.stamp" if ours else "log_time"
        self.told = len(first) >= STRANGE and first[-1].received - first[0].received >= 1e9 * LASTING


class Remembering:
    """A file from which a tracker can resume however it ended, rewritten once a second by a thread of its own.

    Args:
        path: Path of the file; if it exists, the tracker resumes from it.
        tracker: The tracker whose memory is stored.
        regaining: What publishes new gains beside it, if anything; it resumes with it.

    Attributes:
        recalled: Whether the tracker has resumed from the file.
        unrevised: The alarms that the tracker has resumed with whose revision was lost with the process before.
        fault: Why the last write failed; empty if it did not.

    Raises:
        LogError: The file is of another kind, of another vehicle, or in use by a running tracker.
    """

    def __init__(self, path: Path, tracker: Tracker, regaining: Regaining | None = None) -> None:
        with ExitStack() as stack:
            self._held = stack.enter_context(_held(path))
            self.recalled = _recalled(path, tracker, regaining)
            stack.pop_all()
        self.unrevised = [alarm for alarm in tracker.changes if alarm.revises is None and not alarm.turned]
        self._path, self._tracker, self._regaining, self._next = path, tracker, regaining, 0
        self._memory: Mapping[str, Any] | None = None
        self._over, self._due = threading.Event(), threading.Event()
        self.fault = ""
        self._thread = threading.Thread(target=self._run, name="rotorfit-remembering", daemon=True)
        self._thread.start()

    def heard(self, _samples: Sequence[Sample], now: int) -> None:
        """Hands the tracker's memory to the thread, if `REMEMBER_EVERY` has passed."""
        if now >= self._next:
            self._next = now + round(REMEMBER_EVERY * 1e9)
            self._memory = self._all()
            self._due.set()

    def state(self, _state: Tracked, _now: int, _held: int) -> None:
        """Does nothing: the memory is taken with the samples."""

    def gains(self, _message: Mapping[str, Any], _now: int) -> None:
        """Does nothing: the memory is taken with the samples."""

    def _all(self) -> Mapping[str, Any]:
        """The memory of the tracker, and of the gains; a file of gains may hold dates, which JSON has as text."""
        gains = {"gains": np.array(json.dumps(self._regaining.memory(), default=str))} if self._regaining else {}
        return {**self._tracker.memory(), **gains}

    def close(self) -> None:
        """Writes the memory a last time; a disk that fails sets `fault`."""
        self._memory = self._all()
        self._over.set()
        self._due.set()
        self._thread.join()
        self._held.close()

    def _run(self) -> None:
        """Body of the thread; a failed write sets `fault`."""
        last = False
        while not last:
            self._due.wait()
            self._due.clear()
            last = self._over.is_set()
            memory = self._memory
            if not memory or "origin" not in memory:
                continue
            packed = io.BytesIO()
            np.savez(packed, **memory)
            try:
                write_whole(self._path, packed.getvalue(), keep=False)
                self.fault = ""
            except OSError as error:
                self.fault = f"{self._path}: {error.strerror}; what is remembered was not written"


def _held(path: Path) -> socket.socket:
    """A lock on the file: a socket with an abstract name, which Linux frees even after a kill."""
    name = hashlib.sha256(str(path.resolve()).encode()).hexdigest()
    held = socket.socket(socket.AF_UNIX)
    try:
        held.bind(f"\0rotorfit-track-{name}")
    except OSError as error:
        if error.errno == errno.EADDRINUSE:
            held.close()
            raise LogError(f"{path}: another tracker remembers in this file; name another") from None
    return held  # other systems have no abstract names: there is no lock


def _recalled(path: Path, tracker: Tracker, regaining: Regaining | None) -> bool:
    """Lets a tracker, and the gains beside it, resume from a file of `Remembering`; whether there was one."""
    if not path.exists():
        return False
    try:
        with np.load(path, allow_pickle=False) as memory:
            tracker.recall({name: memory[name] for name in memory.files})
            if regaining:
                gains = json.loads(str(memory["gains"])) if "gains" in memory.files else None
                regaining.recall(tracker.changes, tracker.another, gains)
    except CardError as error:
        raise LogError(f"{path}: {error}") from None
    except (OSError, ValueError, KeyError, TypeError, EOFError, zipfile.BadZipFile) as error:
        raise LogError(
            f"{path}: is not what `rotorfit track --state` wrote ({type(error).__name__}); name another file"
        ) from None
    return True


def lines_of(state: Tracked) -> list[str]:
    """A state and its alarms as lines of JSON."""
    return [
        json.dumps(line, allow_nan=False)
        for line in (*(alarm.to_mapping() for alarm in state.alarms), state.to_mapping())
    ]
